"""Estimates collected epoch by epoch, and their turn from GTSAM's tangent to the world's."""

import numpy as np

from fgloc.measurements import Array
from fgloc.timing import Instants
from fgloc.trajectory import Trajectory


class StateLog:
    """Room for the estimates of n epochs; covariances are (6, 6) in GTSAM's pose tangent."""

    def __init__(self, n: int) -> None:
        self.R = np.full((n, 3, 3), np.nan)
        self.p = np.full((n, 3), np.nan)
        self.v = np.full((n, 3), np.nan)
        self.cov = np.full((n, 6, 6), np.nan)

    def put(self, k: int, R: Array, p: Array, v: Array, cov: Array) -> None:
        """Write one epoch."""
        self.R[k], self.p[k], self.v[k], self.cov[k] = R, p, v, cov

    def trajectory(self, t_ns: Instants, keep: Array | None = None) -> Trajectory:
        """The epochs (all, or those kept) as a trajectory with covariance in the world frame."""
        which = np.isfinite(self.p).all(-1) if keep is None else keep
        return Trajectory(
            t_ns[which], self.p[which], self.R[which], self.v[which],
            pose_cov_to_world(self.R[which], self.cov[which]),
        )  # fmt: skip


def pose_cov_to_world(R: Array, cov: Array) -> Array:
    """(N, 6, 6) of (rotation, translation) in the vehicle frame to (position, rotation) in ENU."""
    turn = np.zeros((len(R), 6, 6))
    turn[:, :3, 3:] = R
    turn[:, 3:, :3] = R
    return turn @ cov @ turn.swapaxes(-1, -2)
