"""Method `marr2019-iea`: speed and heading, corrected by a blend of GPS and roadside cameras.

T. S. Marr, "Utilizing the Infrastructure for Ground Truth Based Localization", thesis, Texas A&M
University, 2019, section 4.2.

    x, y               position, East and North            rows of `trajectory.p_world_m`
    v, theta           speed and heading                   table `velocity`
    x_gps, x_mssp      last fix, last detection            tables `gnss`, `detections`
    dT_1, dT_2         ages of these two                   `gps_age_s`, `mssp_age_s`
    x_m                their blend                         `measured_m`
    beta, lambda_1     weights                             `beta`, `gain` is 1 - lambda_1

# Differs from the paper: (4.3) as printed takes lambda_1, nearly 1, of the innovation off the
prediction and diverges; read is x = lambda_1 (prediction) + (1 - lambda_1) x_m. (4.4) has the ages
of the two sources crossed; here each is carried forward by its own. Gains are per step and the
thesis gives no rate: `step_hz` is 100, at which 0.005 a step forgets a start over 2 s ('quickly').

The filter knows one point of the vehicle, here the antenna, one car, and no covariance.
"""

from dataclasses import asdict, dataclass

import numpy as np

from fgloc.baselines.dead_reckoning import DeadReckoning
from fgloc.baselines.marr2019_sources import Positions, detected, fixed, heights_m
from fgloc.baselines.planar import summarize
from fgloc.drive import Drive
from fgloc.errors import DriveError
from fgloc.measurements import Array
from fgloc.result import Result
from fgloc.timing import Instants
from fgloc.trajectory import Trajectory
from fgloc.verdicts import SourceVerdicts, Verdict


@dataclass(frozen=True)
class Marr2019Iea:
    """The printed gains, and the step rate that is not printed."""

    gain: float = 0.005
    mssp_weight: float = 20.0
    step_hz: float = 100.0


MARR2019_IEA = Marr2019Iea()
MOST_S = 700.0
"""Difference of ages beyond which the older source weighs nothing: e to it is still a number."""


def run(
    drive: Drive, parameters: Marr2019Iea = MARR2019_IEA, method: str = "marr2019-iea"
) -> Result:
    """The filter's estimate of a drive: a state each step from the first measurement on.

    Up is that of the newest fix. Raises DriveError where there are no velocities, or neither
    fixes nor detections.
    """
    verdicts = {
        name: SourceVerdicts.of(name, table, Verdict.UNUSED, f"{method} does not take {name}")
        for name, table in drive.tables.items()
    }
    reckoning = DeadReckoning.of(drive, method)
    gps, mssp = fixed(drive, verdicts), detected(drive, verdicts)
    now_ns = _steps(drive, gps, mssp, parameters.step_hz)
    of_gps = gps.latest(now_ns)
    measured_m, gain = blend(now_ns, gps, mssp, reckoning, parameters)
    p_m = track(reckoning.at(now_ns), measured_m, gain)
    gps.judge(verdicts, of_gps)
    mssp.judge(verdicts, mssp.latest(now_ns))
    reckoning.judge(verdicts["velocity"])
    p_m = np.c_[p_m, heights_m(drive, gps, of_gps)]
    trajectory = Trajectory(now_ns, p_m, p_veh_point_m=drive.rig.p_veh_ant_m)
    summary = summarize(drive, method, "filter", trajectory, verdicts)
    return Result(trajectory, verdicts, summary, method, causal=True,
                  config={"marr2019_iea": asdict(parameters)})  # fmt: skip


def run_10_hz(drive: Drive) -> Result:
    """The same at 10 steps a second, at which the gain forgets a start over 20 s."""
    return run(drive, Marr2019Iea(step_hz=10.0), "marr2019-iea:10hz")


def blend(
    now_ns: Instants, gps: Positions, mssp: Positions, reckoning: DeadReckoning,
    parameters: Marr2019Iea,
) -> tuple[Array, Array]:  # fmt: skip
    """Measured positions (K, 2) in m at steps (K,), and the gain (K,) towards them."""
    gps_m, gps_age_s = _carried(now_ns, gps, reckoning)
    mssp_m, mssp_age_s = _carried(now_ns, mssp, reckoning)
    older = np.exp(np.clip(gps_age_s - mssp_age_s, -MOST_S, MOST_S))
    beta = 1 / (1 + parameters.mssp_weight * older)  # (4.7), divided by e^(-dT_1)
    measured_m = beta[:, None] * gps_m + (1 - beta)[:, None] * mssp_m  # (4.6)
    gain = parameters.gain * np.exp(-np.minimum(gps_age_s, mssp_age_s))  # 1 - (4.8)
    return measured_m, gain


def track(travel_m: Array, measured_m: Array, gain: Array) -> Array:
    """Positions (K, 2) in m: each from the last by the step travelled, and the gain (K,) towards
    the measured ones (K, 2). It starts at the first measured one."""
    p_m = np.empty_like(measured_m)
    p_m[0] = measured_m[0]
    steps = np.diff(travel_m, axis=0)
    for k in range(1, len(p_m)):
        predicted = p_m[k - 1] + steps[k - 1]  # (4.1), (4.2)
        p_m[k] = predicted + gain[k] * (measured_m[k] - predicted)  # (4.3), as read above
    return p_m


def _carried(now_ns: Instants, source: Positions, reckoning: DeadReckoning) -> tuple[Array, Array]:
    """(4.4): the newest of a source carried forward to steps (K,), and its age (K,) in s; the age
    is infinite, and the position 0, where none has come in."""
    latest = source.latest(now_ns)
    if not len(source.row):
        return np.zeros((len(now_ns), 2)), np.full(len(now_ns), np.inf)
    there = latest >= 0
    carried = source.p_world_m[latest] + reckoning.at(now_ns) - reckoning.at(source.t_ns[latest])
    age_s = (now_ns - source.t_ns[latest]) / 1e9
    return np.where(there[:, None], carried, 0.0), np.where(there, age_s, np.inf)


def _steps(drive: Drive, gps: Positions, mssp: Positions, step_hz: float) -> Instants:
    """Even instants from the first arrival to the end of the velocities."""
    arrivals = [int(source.received_ns[0]) for source in (gps, mssp) if len(source.row)]
    if not arrivals:
        raise DriveError(f"drive {drive.name!r} has neither fixes nor detections that are finite")
    first, last = min(arrivals), int(drive.tables["velocity"].t_ns[-1])
    count = int((last - first) / 1e9 * step_hz) + 1
    if count < 2:
        raise DriveError(f"drive {drive.name!r}: its velocities end before the first position")
    return first + np.rint(np.arange(count) * 1e9 / step_hz).astype(np.int64)
