"""Results of methods of the plane: the car as a trajectory, other road users as tracks.

State and covariance are of East, North and heading; of height, roll and pitch these methods know
nothing, and their results say so by `FLAT_COV`.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
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


@dataclass(frozen=True, eq=False)
class TrackStates:
    """What is believed of tracks (n,) at instants (n,), in order of time.

    state  (n, 4) East and North in m, velocity East and North in m/s; cov (n, 4, 4)
    """

    instant: NDArray[np.int64]
    track: NDArray[np.int64]
    state: Array
    cov: Array

    @classmethod
    def of_all(cls, x: list[Array], P: list[Array], born: list[NDArray[np.bool_]]) -> "TrackStates":
        """From states (4K,) and covariances (4K, 4K) of all K tracks, of those that are born."""
        instant, track = np.nonzero(born)
        at = 4 * track[:, None] + np.arange(4)
        cov = [P[k][np.ix_(rows, rows)] for k, rows in zip(instant, at, strict=True)]
        state = np.array(x)[instant[:, None], at]
        return cls(instant, track, state, np.array(cov).reshape(-1, 4, 4))

    @classmethod
    def joined(cls, parts: list["TrackStates"]) -> "TrackStates":
        """One after the other."""
        columns = zip(*((p.instant, p.track, p.state, p.cov) for p in parts), strict=True)
        return cls(*map(np.concatenate, columns))

    def __getitem__(self, which: NDArray[np.bool_]) -> "TrackStates":
        return TrackStates(
            self.instant[which], self.track[which], self.state[which], self.cov[which]
        )


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
    tracks: TrackStates,
    *,
    causal: bool = True,
    **more: Any,
) -> Result:
    """What is believed of all tracks, the car among them, as a result.

    The car's heading is that on which its objects and the nodes' agree, or else its course. The
    other tracks become `objects`, from their first sighting on. `more` goes into the summary.
    """
    own = tracks[tracks.track == found.ego]
    if not len(own.track):
        raise DriveError(
            f"{method} on drive {drive.name!r}: nothing that takes part places the car in the world"
        )
    states, cov = np.zeros((len(own.track), 3)), np.zeros((len(own.track), 3, 3))
    states[:, :2], cov[:, :2, :2] = own.state[:, :2], own.cov[:, :2, :2]
    for row, k in enumerate(own.instant):
        yaw, variance = found.epochs[k].yaw_rad, found.epochs[k].yaw_var
        if not np.isfinite(yaw):
            yaw, variance = _course(own.state[row, 2:], own.cov[row, 2:, 2:])
        states[row, 2], cov[row, 2, 2] = yaw, variance
    t_ns = found.t_ns[own.instant]
    result = planar_result(drive, method, t_ns, states, cov, found.verdicts, causal=causal, **more)
    return replace(result, objects=_objects(found, tracks[tracks.track != found.ego]))


def _course(v_mps: Array, cov: Array) -> tuple[float, float]:
    """Direction of a velocity and its variance, which is that of no direction at all at rest."""
    speed2 = max(float(v_mps @ v_mps), 1e-6)
    across = np.array([-v_mps[1], v_mps[0]])
    variance = float(across @ cov @ across) / speed2**2
    return float(np.arctan2(v_mps[1], v_mps[0])), min(variance, np.pi**2 / 3)


def _objects(found: Epochs, tracks: TrackStates) -> ObjectTracks:
    """Tracks with the numbers of those who say where they are."""
    user = np.full(found.tracks, -1)
    user[list(found.users.values())] = list(found.users)
    t_ns = found.t_ns[tracks.instant]
    return ObjectTracks(t_ns, t_ns, tracks.track, user[tracks.track], tracks.state, tracks.cov)
