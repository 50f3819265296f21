"""Results of methods of the plane: the car as a trajectory, other road users as tracks.

State and covariance are of East, North and heading; of height, roll and pitch these methods know
nothing, and their results say so by `FLAT_COV`.
"""

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgloc.correspondence.epochs import Epochs
from fgloc.drive import Drive
from fgloc.errors import DriveError
from fgloc.frames import yaw_matrix
from fgloc.measurements import Array, ObjectTracks
from fgloc.result import Result
from fgloc.timing import Instants
from fgloc.trajectory import Trajectory
from fgloc.verdicts import SourceVerdicts, Verdict, counts

FLAT_COV = np.diag([0, 0, 1.0, 0.1**2, 0.1**2, 0])
"""Variance of height (m^2), roll and pitch (rad^2) of what is taken to move on a plane."""
_PLANAR = np.array([0, 1, 5])


def planar_result(
    drive: Drive,
    method: str,
    t_ns: Instants,
    x: Array,
    P: Array,
    verdicts: Mapping[str, SourceVerdicts],
    *,
    causal: bool = True,
    **more: Any,
) -> Result:
    """States [East m, North m, heading rad] (N, 3) with covariances (N, 3, 3) as a result.

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
    return Result(trajectory, verdicts, summary, method, causal=causal)


def cooperative_result(
    drive: Drive,
    method: str,
    found: Epochs,
    x: list[Array],
    P: list[Array],
    born: list[NDArray[np.bool_]],
    *,
    causal: bool = True,
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
    result = planar_result(drive, method, t_ns, states, cov, found.verdicts, causal=causal, **more)
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
    user = {track: number for number, track in found.users.items()}
    track_id = np.array([t for _, t in rows], np.int64)
    user_id = np.array([user.get(t, -1) for _, t in rows], np.int64)
    return ObjectTracks(t_ns, t_ns, track_id, user_id, state, cov)
