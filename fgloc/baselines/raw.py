"""Method `raw:SOURCE`: one source alone, taken as it is, as the estimate.

What everything else has to be better than. Each GNSS fix is a state: the antenna's position with
the covariance that the receiver states. Between fixes the evaluation interpolates: by a cubic
curve where the receiver gives velocities, by a straight line where it does not. What becomes of
detections by roadside nodes is in `raw_detections`.
"""

import numpy as np

from fgloc.arrays import Array, finite_rows
from fgloc.baselines import RAW
from fgloc.baselines.planar import summarize, with_unknown_attitude
from fgloc.baselines.raw_detections import trajectory_of_detections
from fgloc.drive import Drive
from fgloc.errors import DriveError, InputError, nearest
from fgloc.measurements import GnssFixes, NodeDetections
from fgloc.result import Result
from fgloc.trajectory import Trajectory
from fgloc.verdicts import SourceVerdicts, Verdict


def run_raw(drive: Drive, source: str) -> Result:
    """The estimate that a source gives alone.

    Raises InputError where the drive has no such source or it does not tell positions.
    """
    table = _table(drive, source)
    method = f"{RAW}{source}"
    verdicts = {
        name: SourceVerdicts.of(name, other, Verdict.UNUSED, f"{method} takes {source} alone")
        for name, other in drive.tables.items()
    }
    if isinstance(table, NodeDetections):
        trajectory = trajectory_of_detections(drive, table, verdicts[source])
    else:
        rows = _judge(table, verdicts[source])
        trajectory = _trajectory(table, rows, drive.rig.p_veh_ant_m)
    summary = summarize(drive, method, "raw", trajectory, verdicts)
    return Result(trajectory, verdicts, summary, method, causal=True)


def _table(drive: Drive, source: str) -> GnssFixes | NodeDetections:
    """The table of a source that tells positions."""
    table = drive.tables.get(source)
    if isinstance(table, GnssFixes | NodeDetections) and len(table):
        return table
    able = [
        name
        for name, other in drive.tables.items()
        if isinstance(other, GnssFixes | NodeDetections)
    ]
    if not able:
        raise InputError(f"drive {drive.name!r} has no source that tells positions by itself")
    fault = "it has no such source"
    if source in drive.tables:
        fault = f"{source} does not tell positions"
    raise InputError(
        f"{RAW}{source} on drive {drive.name!r}: {fault}; the nearest is "
        f"{RAW + nearest(source, able)!r} "
        f"(there are: {', '.join(RAW + name for name in able)})"
    )


def _judge(fixes: GnssFixes, verdicts: SourceVerdicts) -> np.ndarray:
    """Rows (n,) that can be a state: finite, and the first such of their instant."""
    finite = finite_rows(fixes.p_world_ant_m, fixes.cov_world_m2)
    usable = np.flatnonzero(finite)
    _, first = np.unique(fixes.t_ns[usable], return_index=True)
    verdicts.set(finite, Verdict.DUPLICATE, "an earlier row has the same t_ns")
    verdicts.set(~finite, Verdict.INVALID, "position or covariance is not finite")
    verdicts.set(usable[first], Verdict.USED)
    if not len(usable):
        raise DriveError(f"none of the {len(fixes)} {verdicts.source} rows is finite")
    return usable[first]


def _trajectory(fixes: GnssFixes, rows: np.ndarray, p_veh_ant_m: Array) -> Trajectory:
    velocity = fixes.v_world_mps[rows]
    return Trajectory(
        fixes.t_ns[rows],
        fixes.p_world_ant_m[rows],
        v_world_mps=velocity if np.isfinite(velocity).all() else None,
        cov=with_unknown_attitude(fixes.cov_world_m2[rows]),
        p_veh_point_m=p_veh_ant_m,
    )
