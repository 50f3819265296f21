"""GNSS position: the antenna is where the receiver says, up to noise and a slow bias.

Model: z = p_world_veh + R_world_veh l + c + n, with l the antenna in the vehicle frame, n white
with the fix's covariance and c an optional bias in ENU, a first-order Gauss-Markov process
c(t + dt) = exp(-dt / tau) c(t) + w, w ~ N(0, sigma^2 (1 - exp(-2 dt / tau)) I).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fgloc.factors.linear import linear_factor
from fgloc.frames import skew
from fgloc.measurements import Array

if TYPE_CHECKING:
    import gtsam

TIE_SIGMA_M = 1e-3
"""Slack of what ties a measured point to more than the pose: far below any measurement's noise."""


class GnssResidual(NamedTuple):
    """error (N, 3) in m; its Jacobians by pose (N, 3, 6) and by bias (3, 3)."""

    error: Array
    by_pose: Array
    by_bias: Array


def residual(
    p_world_m: Array, R_world_veh: Array, z_world_m: Array, p_veh_ant_m: ArrayLike,
    bias_world_m: ArrayLike = (0.0, 0.0, 0.0),
) -> GnssResidual:  # fmt: skip
    """Predicted minus measured antenna position of poses (N, ...) and fixes (N, 3), ENU m."""
    lever = np.asarray(p_veh_ant_m, float)
    turned = (R_world_veh.reshape(-1, 3) @ skew(-lever)).reshape(-1, 3, 3)  # one large product
    by_pose = np.concatenate([turned, R_world_veh], axis=-1)
    told = error(p_world_m, R_world_veh, z_world_m, lever, bias_world_m)
    return GnssResidual(told, by_pose, np.eye(3))


def error(
    p_world_m: Array, R_world_veh: Array, z_world_m: Array, p_veh_ant_m: ArrayLike,
    bias_world_m: ArrayLike = (0.0, 0.0, 0.0),
) -> Array:  # fmt: skip
    """That of `residual` alone, (N, 3)."""
    arm = (R_world_veh.reshape(-1, 3) @ np.asarray(p_veh_ant_m, float)).reshape(-1, 3)
    return np.asarray(p_world_m + arm + np.asarray(bias_world_m, float) - z_world_m)


class LateResidual(NamedTuple):
    """error (N, 3) in m; Jacobians by pose (N, 3, 6), velocity (3), gyro bias (3), lateness (1)."""

    error: Array
    by_pose: Array
    by_velocity: Array
    by_gyro_bias: Array
    by_late: Array


def late_residual(
    told: GnssResidual, R_world_veh: Array, v_world_mps: Array, rate_radps: Array,
    p_veh_ant_m: ArrayLike, late_s: float,
) -> LateResidual:  # fmt: skip
    """`residual` of fixes that are stamped too late: they tell where the antenna was before.

    The antenna is brought back along its velocity v + R (w x l), with w the angular rate (N, 3)
    less the gyro's bias, in rad/s; what accelerates within `late_s` is left out.
    """
    lever = np.asarray(p_veh_ant_m, float)
    swing = np.cross(rate_radps, lever)
    v = v_world_mps + np.einsum("nij,nj->ni", R_world_veh, swing)
    by_pose = told.by_pose.copy()
    by_pose[:, :, :3] += late_s * R_world_veh @ skew(swing)
    by_velocity = np.broadcast_to(-late_s * np.eye(3), R_world_veh.shape)
    by_gyro_bias = -late_s * R_world_veh @ skew(lever)
    return LateResidual(told.error - late_s * v, by_pose, by_velocity, by_gyro_bias, -v[..., None])


def position_factor(
    pose_key: int, z_world_m: Array, p_veh_ant_m: Array, model: gtsam.noiseModel.Base
) -> gtsam.GPSFactorArm:
    """The native factor of `residual` without a bias."""
    import gtsam

    return gtsam.GPSFactorArm(pose_key, z_world_m, p_veh_ant_m, model)


def linked_position_factors(
    pose_key: int, point_key: int, lever_key: int, z_world_m: Array,
    model: gtsam.noiseModel.Base, by: dict[int, Array],
) -> list[gtsam.NonlinearFactor]:  # fmt: skip
    """The native factors of `residual` where more vectors than the pose have a part in it.

    GTSAM has no such factor: the measured point becomes a variable, tied to the pose through the
    lever-arm variable under the measurement's own noise, loss and all, and
    point + sum of by[key] x_key = z is linear and next to exact. `by` gives the Jacobian (3, q) of
    each vector x (q,): the identity for a bias.
    """
    import gtsam

    tie = gtsam.ReferenceFrameFactorPoint3Pose3(lever_key, pose_key, point_key, model)
    blocks = {key: J / TIE_SIGMA_M for key, J in ((point_key, np.eye(3)), *by.items())}
    return [tie, linear_factor(blocks, z_world_m / TIE_SIGMA_M)]


def bias_transition(dt_s: ArrayLike, sigma_m: float, tau_s: float) -> tuple[Array, Array]:
    """Factors phi (...) and noise sigmas in m (...) of the Gauss-Markov bias over times (...)."""
    over = np.asarray(dt_s, float) / tau_s
    return np.exp(-over), sigma_m * np.sqrt(-np.expm1(-2 * over))


def bias_transition_factor(
    key_i: int, key_j: int, dt_s: float, sigma_m: float, tau_s: float
) -> gtsam.LinearContainerFactor:
    """The native factor c_j - phi c_i = w of the Gauss-Markov bias."""
    phi, sigma = bias_transition(dt_s, sigma_m, tau_s)
    return linear_factor({key_i: -phi / sigma * np.eye(3), key_j: np.eye(3) / sigma}, np.zeros(3))
