"""Method `raw:detections`: what roadside nodes say of the vehicle, taken as it is.

Which of the objects is the vehicle has to be told somehow without the truth: at each instant that a
node saw anything, it is the one nearest to the fixes, interpolated, if it lies within 5 m (the
threshold of Lee et al. 2021). So the errors of the detections themselves can be tabled; where the
fixes are off by metres, this may be a neighbour.
"""

import numpy as np
from numpy.typing import NDArray

from fgloc.baselines.planar import with_unknown_attitude
from fgloc.config import DetectionConfig
from fgloc.drive import Drive
from fgloc.errors import DriveError
from fgloc.measurements import PEDESTRIAN, Array, NodeDetections
from fgloc.positions import horizontal_cov_m2, world_positions
from fgloc.timing import elapsed_s
from fgloc.trajectory import Trajectory
from fgloc.verdicts import SourceVerdicts, Verdict

NEAR_M = 5.0


def trajectory_of_detections(
    drive: Drive, table: NodeDetections, verdicts: SourceVerdicts
) -> Trajectory:
    """Positions of the centre of the box that nodes see; up is from the fixes.

    The covariance is what the node states, or Lee's law of the distance. Raises DriveError where
    no detection is near a fix.
    """
    p_world_m = world_positions(drive, table)
    antenna_m, up_m2, known = _antenna_at(drive, table)
    far_m = np.linalg.norm(p_world_m - antenna_m[:, :2], axis=-1)
    finite = np.isfinite(table.p_node_m).all(-1)
    sound = finite & (table.kind != PEDESTRIAN) & known
    rows = _nearest(table, np.where(sound & (far_m <= NEAR_M), far_m, np.inf))
    verdicts.set(slice(None), Verdict.OTHER, "another was nearer to the fixes")
    far = f"more than {NEAR_M:g} m from the fixes"
    verdicts.set(far_m > NEAR_M, Verdict.GATED, far)
    verdicts.set(table.kind == PEDESTRIAN, Verdict.OTHER, "a pedestrian")
    verdicts.set(~known, Verdict.OUTSIDE, "no fixes at this time")
    verdicts.set(~finite, Verdict.INVALID, "position is not finite")
    verdicts.set(rows, Verdict.USED)
    if not len(rows):
        raise DriveError(f"none of the {len(table)} detections lies within {NEAR_M:g} m of a fix")
    lift_m = drive.rig.p_veh_box_m[2] - drive.rig.p_veh_ant_m[2]
    position = np.column_stack([p_world_m[rows], antenna_m[rows, 2] + lift_m])
    full = np.zeros((len(rows), 3, 3))
    full[:, :2, :2] = _covariances(drive, table.take(rows), position[:, 2])
    full[:, 2, 2] = up_m2[rows]
    return Trajectory(
        table.t_ns[rows], position, cov=with_unknown_attitude(full),
        p_veh_point_m=drive.rig.p_veh_box_m,
    )  # fmt: skip


def _covariances(drive: Drive, taken: NodeDetections, up_m: Array) -> Array:
    """East and North (n, 2, 2) of some detections at heights (n,), as the graph has them."""
    cov = np.zeros((len(taken), 2, 2))
    for number, node in enumerate(drive.infrastructure.nodes):
        rows = taken.node == number
        if rows.any():
            height_m = float(np.median(up_m[rows]))
            cov[rows] = horizontal_cov_m2(node, taken.take(rows), DetectionConfig(), height_m)
    return cov


def _antenna_at(drive: Drive, table: NodeDetections) -> tuple[Array, Array, NDArray[np.bool_]]:
    """The antenna (N, 3) by the fixes when each detection was true, the variance (N,) of its
    height, and whether there are fixes around."""
    gnss = drive.gnss
    fixes = gnss.take(np.isfinite(gnss.p_world_ant_m).all(-1))
    if not len(fixes):
        raise DriveError(f"drive {drive.name!r}: none of its {len(gnss)} fixes is finite")
    at, have = (elapsed_s(t, int(fixes.t_ns[0])) for t in (table.t_ns, fixes.t_ns))
    columns = [*fixes.p_world_ant_m.T, fixes.cov_world_m2[:, 2, 2]]
    *place, up_m2 = (np.interp(at, have, column) for column in columns)
    return np.stack(place, -1), up_m2, (at >= have[0]) & (at <= have[-1])


def _nearest(table: NodeDetections, far_m: Array) -> NDArray[np.int64]:
    """At each instant the row that is nearest; those at infinity are none."""
    order = np.lexsort((far_m, table.t_ns))
    _, first = np.unique(table.t_ns[order], return_index=True)
    rows = order[first]
    return rows[np.isfinite(far_m[rows])]
