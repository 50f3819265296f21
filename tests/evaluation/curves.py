"""Trajectories with known errors."""

import numpy as np

from fgloc import frames
from fgloc.trajectory import Trajectory

S = 1_000_000_000


START = 1_750_000_000 * S
CONTRACT = {
    "horizontal_rmse_m", "horizontal_mean_m", "horizontal_std_m", "horizontal_p95_m",
    "horizontal_max_m", "lateral_rmse_m", "longitudinal_rmse_m", "lateral_mean_abs_m",
    "lateral_std_abs_m", "longitudinal_mean_abs_m", "longitudinal_std_abs_m", "yaw_rmse_rad",
    "anees", "coverage95",
}  # fmt: skip
"""Metrics that every score names."""


def curve(n=200, rate_hz=10.0, cov=None, *, attitude=True, velocity=True, point=(0.0, 0, 0)):
    """A vehicle on a circle of 100 m at 10 m/s, seen at its origin or at `point`."""
    t = np.arange(n) / rate_hz
    yaw = 0.3 + 0.1 * t
    p = 100 * np.stack([np.sin(yaw), -np.cos(yaw), np.zeros(n)], -1)
    R = frames.yaw_matrix(yaw)
    v = 10 * R[:, :, 0]
    lever = np.asarray(point, float)
    return Trajectory(
        START + np.rint(t * S).astype(np.int64),
        p + R @ lever,
        R if attitude else None,
        v + np.cross([0, 0, 0.1], R @ lever) if velocity else None,
        None if cov is None else np.broadcast_to(cov, (n, 6, 6)),
        lever,
    )


def straight(p_error, yaw_error=None, cov=None, rate_hz=10.0):
    """An estimate with given errors (N, 3) and yaw errors (N,) of a drive due north, and truth."""
    p_error = np.asarray(p_error, float)
    n = len(p_error)
    t = START + np.rint(np.arange(n) / rate_hz * S).astype(np.int64)
    p = np.stack([np.zeros(n), np.arange(n) * 1.0, np.zeros(n)], -1)
    yaw = np.full(n, np.pi / 2)
    truth = Trajectory(t, p, frames.yaw_matrix(yaw))
    wrong = yaw + (np.zeros(n) if yaw_error is None else yaw_error)
    return Trajectory(t, p + p_error, frames.yaw_matrix(wrong), None, cov), truth
