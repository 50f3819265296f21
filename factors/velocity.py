"""A velocity of the vehicle in the world: v of the state, which sits at the vehicle's origin.

What is told may err by a constant share s of the speed and a constant angle h on the level; both
are small, so that true is told - s told - h (up x told).

Where the state sits elsewhere, at an IMU with an arm to the origin, the origin moves by up to the
angular rate times that arm otherwise: `sigma_with_arm` makes room for it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from fgloc.factors.linear import linear_factor
from fgloc.measurements import Array

if TYPE_CHECKING:
    import gtsam

TIE_SIGMA_MPS = 1e-4
"""Slack of what ties a told velocity to the state's: far below any velocity's noise."""


def residual(v_world_mps: Array, measured_mps: Array, errors: ArrayLike = (0.0, 0.0)) -> Array:
    """States' minus measured velocities (N, 3), ENU m/s, where speed and direction of the latter
    err by `errors` (share, rad); the Jacobian by velocity is one."""
    return v_world_mps - measured_mps + by_errors(measured_mps) @ np.asarray(errors, float)


def by_errors(measured_mps: Array) -> Array:
    """The Jacobian (..., 3, 2) of `residual` by the errors of speed and direction."""
    east, north, up = np.moveaxis(measured_mps, -1, 0)
    across = np.stack([-north, east, np.zeros_like(up)], -1)
    return np.stack([measured_mps, across], -1)


def late_residual(
    v_world_mps: Array, measured_mps: Array, slope_mps2: Array, late_s: float,
    errors: ArrayLike = (0.0, 0.0),
) -> tuple[Array, Array]:  # fmt: skip
    """`residual` of velocities that are stamped too late, and its Jacobian by that (N, 3, 1).

    What was true at the stamp is told only `late_s` later, by when the velocity has changed by the
    slope (N, 3) of what is measured.
    """
    told = residual(v_world_mps, measured_mps, errors) - late_s * slope_mps2
    return told, -slope_mps2[..., None]


def sigma_with_arm(sigma_mps: ArrayLike, rate_radps: Array, arm_m: Array) -> Array:
    """Sigmas (N,) of a velocity of the origin as one of the state's place, for rates (N, 3)."""
    return np.hypot(sigma_mps, np.linalg.norm(np.cross(rate_radps, arm_m), axis=-1))


def sigma_with_errors(sigma_mps: ArrayLike, measured_mps: Array, error_sigmas: ArrayLike) -> Array:
    """Sigmas (N,) of velocities (N, 3) whose lasting errors, of sigmas (2,), are taken for noise:
    of the larger of the two on every axis."""
    speed_mps = np.linalg.norm(measured_mps, axis=-1)
    return np.hypot(sigma_mps, speed_mps * np.max(error_sigmas))


def factor(
    velocity: int, measured_mps: Array, model: gtsam.noiseModel.Base
) -> gtsam.NonlinearFactor:
    """The native factor of `residual`."""
    import gtsam

    return gtsam.PriorFactorVector(velocity, np.asarray(measured_mps, float), model)


def erring_factors(
    velocity: int, told: int, errors: int, measured_mps: Array, model: gtsam.noiseModel.Base
) -> list[gtsam.NonlinearFactor]:
    """The native factors of `residual` where the errors of speed and direction are a variable.

    What should be told is a variable too, held by what is told under its noise, loss and all, and
    next to exactly tied to velocity and errors.
    """
    parts = {velocity: np.eye(3), errors: by_errors(measured_mps), told: -np.eye(3)}
    tie = {key: J / TIE_SIGMA_MPS for key, J in parts.items()}
    return [factor(told, measured_mps, model), linear_factor(tie, np.zeros(3))]
