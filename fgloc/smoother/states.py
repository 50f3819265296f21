"""Estimates collected epoch by epoch, and their turn from GTSAM's tangent to the world's."""

from dataclasses import replace

import numpy as np

from fgloc.measurements import Array
from fgloc.smoother.model import Model
from fgloc.trajectory import Trajectory


class StateLog:
    """Room for the estimates of n epochs; covariances are (6, 6) in GTSAM's pose tangent."""

    def __init__(self, n: int) -> None:
        self.R = np.full((n, 3, 3), np.nan)
        self.p = np.full((n, 3), np.nan)
        self.v = np.full((n, 3), np.nan)
        self.cov = np.full((n, 6, 6), np.nan)
        self.gyro_bias = np.zeros((n, 3))

    def put(self, k: int, R: Array, p: Array, v: Array, cov: Array, gyro_bias: Array) -> None:
        """Write one epoch."""
        self.R[k], self.p[k], self.v[k], self.cov[k] = R, p, v, cov
        self.gyro_bias[k] = gyro_bias

    def trajectory(self, model: Model) -> Trajectory:
        """The epochs as the vehicle origin's trajectory, with covariance in the world frame."""
        of_imu = Trajectory(
            model.epochs.t_ns, self.p, self.R, None, pose_cov_to_world(self.R, self.cov),
            model.p_veh_imu_m,
        )  # fmt: skip
        arm = np.cross(model.epochs.rate_radps - self.gyro_bias, -model.p_veh_imu_m)
        v = self.v + np.einsum("nij,nj->ni", self.R, arm)
        return replace(of_imu.at_point(np.zeros(3)), v_world_mps=v)


def pose_cov_to_world(R: Array, cov: Array) -> Array:
    """(N, 6, 6) of (rotation, translation) in the vehicle frame to (position, rotation) in ENU."""
    turn = np.zeros((len(R), 6, 6))
    turn[:, :3, 3:] = R
    turn[:, 3:, :3] = R
    return turn @ cov @ turn.swapaxes(-1, -2)
