"""What the filters of one object in the plane share: sightings at each instant, and inputs."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc.drive import Drive
from fgloc.errors import DriveError
from fgloc.measurements import Array, NodeDetections, Odometry
from fgloc.timing import Instants
from fgloc.verdicts import SourceVerdicts, Verdict


@dataclass(frozen=True, eq=False)
class Sightings:
    """Positions of one object at one instant, in the world.

    z_m          (S, 2) East and North
    sensor_m     (S, 3) where each sensor stands
    a            (S, 2) variance over the square of the slant range; NaN where the noise is fixed
    cov_m2       (S, 2, 2) the fixed noise, or what the sensor states
    """

    z_m: Array
    sensor_m: Array
    a: Array
    cov_m2: Array

    def noise(self, p_m: Array) -> Array:
        """(S, 2, 2) at a position (2,) on the ground. Khamooshi (2023), Eq. (3.16)."""
        slant2 = ((self.sensor_m - [*p_m, 0.0]) ** 2).sum(-1)
        scaled = (self.a * slant2[:, None])[:, :, None] * np.eye(2)
        return np.where(np.isnan(self.a)[:, :, None], self.cov_m2, scaled)


def detections_of(drive: Drive) -> NodeDetections:
    """The detections of a drive; DriveError where it has none."""
    table = drive.tables.get(NodeDetections.KIND)
    if not isinstance(table, NodeDetections) or not len(table):
        have = ", ".join(drive.tables) or "nothing"
        raise DriveError(f"drive {drive.name!r} has no detections of nodes (it has {have})")
    return table


def usable_rows(
    drive: Drive, seen: NodeDetections, object_id: int, nodes: str, verdicts: SourceVerdicts
) -> NDArray[np.int64]:
    """Rows (n,) of an object seen by nodes whose names begin with a text; all others are judged.

    Raises DriveError where none is left.
    """
    names = np.array([node.name.startswith(nodes) for node in drive.infrastructure.nodes])
    reach = np.array([node.range_m for node in drive.infrastructure.nodes])
    finite = np.asarray(np.isfinite(seen.p_node_m).all(-1))
    near = np.linalg.norm(np.where(finite[:, None], seen.p_node_m, 0), axis=-1) <= reach[seen.node]
    asked = (seen.object_id == object_id) & names[seen.node]
    verdicts.set(asked & ~finite, Verdict.INVALID, "position is not finite")
    verdicts.set(asked & finite & ~near, Verdict.OUTSIDE, "beyond the range of the node")
    verdicts.set(~asked, Verdict.UNUSED, "another object or another node")
    rows = np.flatnonzero(asked & finite & near)
    if not len(rows):
        raise DriveError(
            f"drive {drive.name!r} has no usable detection of object {object_id} by nodes "
            f"named {nodes or 'anything'}..."
        )
    verdicts.set(rows, Verdict.USED)
    return rows


def inputs_at(drive: Drive, t_ns: Instants) -> Array:
    """(N, 2) speed in m/s and yaw rate in rad/s at instants, by odometry; DriveError without it."""
    table = drive.tables.get(Odometry.KIND)
    if not isinstance(table, Odometry) or not len(table):
        raise DriveError(
            f"drive {drive.name!r} has no odometry, which this motion model takes as input"
        )
    at = (table.t_ns - table.t_ns[0]) / 1e9
    when = (t_ns - table.t_ns[0]) / 1e9
    return np.stack(
        [np.interp(when, at, table.speed_mps), np.interp(when, at, table.yaw_rate_radps)], -1
    )
