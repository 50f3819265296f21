"""Method `lee2021-ekf`: a planar EKF of GPS, velocity and the detections of roadside nodes.

Lee, Vora, Parchami, Chakravarty, Pandey, Kumar, 'Infrastructure Node-based Vehicle Localization for
Autonomous Driving' (2021), sections III-C to III-E and Table II.

    X = [x, y], Sigma           East and North, their covariance      `Belief.x_m`, `.cov_m2`
    x_dot, y_dot                velocity from the inertial unit       table `velocity`
    Delta t                     time from one fix to the next
    R                           process noise                         `Lee2021.process_sigma_m`
    X_gps, Q_gps                fix and its covariance                table `gnss`, `gps_cov_m2`
    X_ix, Q_ix                  candidate and its covariance          `Candidates`, `node_cov_m2`
    d_thresh                    threshold of the candidate filter     `Lee2021.threshold_m`
    d_ix                        distance from node to candidate       `Candidates.distance_m`

The paper knows one point of the vehicle, which is here the antenna: that the centre of the box lies
elsewhere goes into the error. Its x and y are East and North, although Table II calls the sigmas
longitudinal and lateral; they are used as printed.
"""

from dataclasses import asdict, replace

import numpy as np
from numpy.typing import NDArray

from fgloc.arrays import finite_rows
from fgloc.baselines.lee2021_filter import (
    BEYOND,
    FAR,
    LEE2021,
    PRINTED,
    SECOND,
    TAKEN,
    UNSEEN,
    Belief,
    Fates,
    Filter,
    Lee2021,
)
from fgloc.baselines.lee2021_sync import Synchronised, synchronised, velocities
from fgloc.baselines.planar import summarize, with_unknown_attitude
from fgloc.drive import Drive
from fgloc.errors import DriveError
from fgloc.measurements import PEDESTRIAN, EnuVelocities, GnssFixes, NodeDetections
from fgloc.result import Event, Result
from fgloc.trajectory import Trajectory
from fgloc.verdicts import SourceVerdicts, Verdict

_VERDICTS = {TAKEN: Verdict.USED, SECOND: Verdict.OTHER, FAR: Verdict.GATED,
             BEYOND: Verdict.OUTSIDE, UNSEEN: Verdict.UNUSED}  # fmt: skip


def run(drive: Drive, parameters: Lee2021 = LEE2021, method: str = "lee2021-ekf") -> Result:
    """The filter's estimate of a drive: a state for each fix, East and North of the antenna.

    Up and its variance are the fix's own; of the attitude nothing is known. Synchronising looks
    ahead to the next frame of a node, a tenth of a second as a rule. Raises DriveError where the
    drive has no fixes or no velocities, or the two do not overlap in time.
    """
    verdicts = {
        name: SourceVerdicts.of(name, table, Verdict.UNUSED, f"{method} does not take {name}")
        for name, table in drive.tables.items()
    }
    velocity = velocities(drive, method)
    rows = _usable_fixes(drive, velocity, verdicts["gnss"])
    data = synchronised(drive, rows, velocity, parameters.late)
    filtering = Filter(data, parameters)
    beliefs = filtering.run()
    _judge_fixes(filtering, verdicts["gnss"])
    _judge_velocities(drive, data, verdicts["velocity"])
    _judge_detections(drive, filtering, verdicts)
    trajectory = _trajectory(drive, data, beliefs)
    if abs(parameters.correlation) == 1:
        trajectory = replace(trajectory, cov=None)  # what is left of Sigma is rounding
    summary = summarize(drive, method, "filter", trajectory, verdicts,
                        {"restarts": len(filtering.restarts)})  # fmt: skip
    return Result(trajectory, verdicts, summary, method, causal=True, events=_events(filtering),
                  config={"lee2021": asdict(parameters)})  # fmt: skip


def run_on_arrival(drive: Drive) -> Result:
    """The same where every detection counts as true when it was received: the price of latency."""
    return run(drive, replace(LEE2021, late="on-arrival"), "lee2021-ekf:on-arrival")


def run_printed(drive: Drive) -> Result:
    """The same with the covariances as printed: not of use, but what the paper says."""
    return run(drive, PRINTED, "lee2021-ekf:printed")


def _usable_fixes(
    drive: Drive, velocity: EnuVelocities, verdicts: SourceVerdicts
) -> NDArray[np.int64]:
    """Rows that are finite, the first of their instant, and where there are velocities."""
    gnss = drive.gnss
    finite = finite_rows(gnss.p_world_ant_m, gnss.cov_world_m2)
    inside = (gnss.t_ns >= velocity.t_ns[0]) & (gnss.t_ns <= velocity.t_ns[-1])
    usable = np.flatnonzero(finite & inside)
    _, first = np.unique(gnss.t_ns[usable], return_index=True)
    verdicts.set(slice(None), Verdict.DUPLICATE, "an earlier row has the same t_ns")
    verdicts.set(~inside, Verdict.OUTSIDE, "no velocity at this time")
    verdicts.set(~finite, Verdict.INVALID, "position or covariance is not finite")
    if not len(first):
        raise DriveError(
            f"drive {drive.name!r}: none of its {len(gnss)} fixes is finite and lies within the "
            f"time of the velocities ({int((~inside).sum())} outside; are both on one clock?)"
        )
    return usable[first]


def _judge_fixes(filtering: Filter, verdicts: SourceVerdicts) -> None:
    data, p, fates = filtering.data, filtering.parameters, filtering.fixes
    verdicts.nis[data.fix_row] = fates.nis
    verdicts.dof[data.fix_row] = np.where(np.isfinite(fates.nis), 2, 0)
    for k, row in enumerate(data.fix_row):
        verdict = _VERDICTS[int(fates.fate[k])]
        verdicts.set(row, verdict, "" if verdict is Verdict.USED else _far(fates.far_m[k], p))
    for k in [0, *filtering.restarts]:
        verdicts.set(data.fix_row[k], Verdict.USED, "the filter starts from it")


def _judge_velocities(drive: Drive, data: Synchronised, verdicts: SourceVerdicts) -> None:
    """Used are those from the last one before the first fix to the first one after the last."""
    table = drive.tables["velocity"]
    assert isinstance(table, EnuVelocities)
    finite = np.isfinite(table.v_world_mps).all(-1)
    needed_ns = table.t_ns[finite]
    first = needed_ns[np.searchsorted(needed_ns, data.t_ns[0], side="right") - 1]
    last = needed_ns[np.searchsorted(needed_ns, data.t_ns[-1])]
    verdicts.set(slice(None), Verdict.USED)
    verdicts.set((table.t_ns < first) | (table.t_ns > last), Verdict.OUTSIDE, "no fix at this time")
    verdicts.set(~finite, Verdict.INVALID, "velocity is not finite")


def _judge_detections(drive: Drive, filtering: Filter, verdicts: dict[str, SourceVerdicts]) -> None:
    """A row's verdict is the best fate of the candidates that it was part of."""
    table = drive.tables.get("detections")
    if not isinstance(table, NodeDetections):
        return
    own, seen, fates = verdicts["detections"], filtering.data.seen, filtering.candidates
    own.set(slice(None), Verdict.UNUSED, "no fix is near enough in time")
    own.set(table.kind == PEDESTRIAN, Verdict.OTHER, "a pedestrian")
    own.set(~np.isfinite(table.p_node_m).all(-1), Verdict.INVALID, "position is not finite")
    for fate in sorted(_VERDICTS):
        for m in np.flatnonzero(fates.fate == fate):
            own.set(seen.rows[m], _VERDICTS[fate], _why(fate, fates, int(m), filtering.parameters))
    taken = fates.fate == TAKEN
    own.nis[seen.rows[taken]] = fates.nis[taken, None]
    own.dof[seen.rows[taken]] = 2


def _why(fate: int, fates: Fates, m: int, p: Lee2021) -> str:
    return {
        TAKEN: "", SECOND: "another candidate was nearer", BEYOND: "beyond the node's range",
        FAR: _far(fates.far_m[m], p), UNSEEN: "",
    }[fate]  # fmt: skip


def _far(far_m: float, p: Lee2021) -> str:
    return f"{far_m:.1f} m from the prediction; the threshold is {p.threshold_m:g} m"


def _events(filtering: Filter) -> tuple[Event, ...]:
    p = filtering.parameters
    text = (
        f"no fix within {p.threshold_m:g} m of the prediction for {p.restart_s:g} s: "
        "started anew from this one"
    )
    return tuple(Event(int(filtering.data.t_ns[k]), "restart", text) for k in filtering.restarts)


def _trajectory(drive: Drive, data: Synchronised, beliefs: list[Belief]) -> Trajectory:
    gnss: GnssFixes = drive.gnss
    position, cov = gnss.p_world_ant_m[data.fix_row].copy(), np.zeros((len(beliefs), 3, 3))
    position[:, :2] = [belief.x_m for belief in beliefs]
    cov[:, :2, :2] = [belief.cov_m2 for belief in beliefs]
    cov[:, 2, 2] = gnss.cov_world_m2[data.fix_row, 2, 2]
    return Trajectory(
        data.t_ns, position, v_world_mps=data.v_mps, cov=with_unknown_attitude(cov),
        p_veh_point_m=drive.rig.p_veh_ant_m,
    )  # fmt: skip
