"""What the filters of the plane share: sightings at each instant, inputs, and the result.

State and covariance are of East, North and heading; of height, roll and pitch these filters know
nothing, and their results say so by `FLAT_COV`.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgloc.correspondence.tracks import Epochs
from fgloc.drive import Drive
from fgloc.errors import DriveError
from fgloc.frames import yaw_matrix
from fgloc.measurements import Array, NodeDetections, ObjectTracks, Odometry
from fgloc.result import Result
from fgloc.timing import Instants
from fgloc.trajectory import Trajectory
from fgloc.verdicts import SourceVerdicts, Verdict, counts

FLAT_COV = np.diag([0, 0, 1.0, 0.1**2, 0.1**2, 0])
"""Variance of height (m^2), roll and pitch (rad^2) of what is taken to move on a plane."""
_PLANAR = np.array([0, 1, 5])


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


def planar_result(
    drive: Drive,
    method: str,
    t_ns: Instants,
    x: Array,
    P: Array,
    verdicts: Mapping[str, SourceVerdicts],
    **more: Any,
) -> Result:
    """States [East m, North m, heading rad] (N, 3) with covariances (N, 3, 3) as a causal result.

    `more` goes into the summary.
    """
    cov = np.tile(FLAT_COV, (len(t_ns), 1, 1))
    cov[:, _PLANAR[:, None], _PLANAR] = P
    p = np.column_stack([x[:, :2], np.zeros(len(x))])
    trajectory = Trajectory(t_ns, p, yaw_matrix(x[:, 2]), cov=cov)
    used = sum(int(table.is_(Verdict.USED).sum()) for table in verdicts.values())
    summary = {
        "drive": drive.name, "method": method, "mode": "filter", "states": len(t_ns),
        "factors": used, "counts": counts(verdicts), "origin": asdict(drive.origin),
        "duration_s": float(t_ns[-1] - t_ns[0]) / 1e9, **more,
    }  # fmt: skip
    return Result(trajectory, verdicts, summary, method, causal=True)


def cooperative_result(
    drive: Drive,
    method: str,
    found: Epochs,
    x: list[Array],
    P: list[Array],
    born: list[NDArray[np.bool_]],
    **more: Any,
) -> Result:
    """States [East, North, and their velocities] (4K,) of all tracks at each instant as a result.

    The car's heading is that on which its objects and the nodes' agree, or else its course. The
    other tracks become `objects`, from their first sighting on. `more` goes into the summary.
    """
    ego = slice(4 * found.ego, 4 * found.ego + 4)
    there = [k for k, b in enumerate(born) if b[found.ego]]
    if not there:
        raise DriveError(
            f"{method} on drive {drive.name!r}: nothing that takes part places the car in the world"
        )
    t_ns = found.t_ns[there]
    states, cov = np.zeros((len(there), 3)), np.zeros((len(there), 3, 3))
    for row, k in enumerate(there):
        epoch, mean, block = found.epochs[k], x[k][ego], P[k][ego, ego]
        yaw, variance = epoch.yaw_rad, epoch.yaw_var
        if not np.isfinite(yaw):
            yaw, variance = _course(mean[2:], block[2:, 2:])
        states[row] = [*mean[:2], yaw]
        cov[row, :2, :2], cov[row, 2, 2] = block[:2, :2], variance
    objects = _tracks(found, x, P, born)
    result = planar_result(drive, method, t_ns, states, cov, found.verdicts, **more)
    return replace(result, objects=objects)


def _course(v_mps: Array, cov: Array) -> tuple[float, float]:
    """Direction of a velocity and its variance, which is that of no direction at all at rest."""
    speed2 = max(float(v_mps @ v_mps), 1e-6)
    across = np.array([-v_mps[1], v_mps[0]])
    variance = float(across @ cov @ across) / speed2**2
    return float(np.arctan2(v_mps[1], v_mps[0])), min(variance, np.pi**2 / 3)


def _tracks(
    found: Epochs, x: list[Array], P: list[Array], born: list[NDArray[np.bool_]]
) -> ObjectTracks:
    """All but the car."""
    names = [track for track in range(found.tracks) if track != found.ego]
    rows = [(k, t) for k in range(len(x)) for t in names if born[k][t]]
    t_ns = found.t_ns[[k for k, _ in rows]]
    at = [slice(4 * t, 4 * t + 4) for _, t in rows]
    state = np.array([x[k][a] for (k, _), a in zip(rows, at, strict=True)]).reshape(-1, 4)
    cov = np.array([P[k][a, a] for (k, _), a in zip(rows, at, strict=True)]).reshape(-1, 4, 4)
    return ObjectTracks(t_ns, t_ns, np.array([t for _, t in rows], np.int64), state, cov)
