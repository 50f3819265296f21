"""A velocity of the vehicle in the world: v of the state, which sits at the vehicle's origin.

Where the state sits elsewhere, at an IMU with an arm to the origin, the origin moves by up to the
angular rate times that arm otherwise: `sigma_with_arm` makes room for it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from fgloc.measurements import Array

if TYPE_CHECKING:
    import gtsam


def residual(v_world_mps: Array, measured_mps: Array) -> Array:
    """States' minus measured velocities (N, 3), ENU m/s; the Jacobian by velocity is one."""
    return v_world_mps - measured_mps


def late_residual(
    v_world_mps: Array, measured_mps: Array, slope_mps2: Array, late_s: float
) -> tuple[Array, Array]:
    """`residual` of velocities that are stamped too late, and its Jacobian by that (N, 3, 1).

    What was true at the stamp is told only `late_s` later, by when the velocity has changed by the
    slope (N, 3) of what is measured.
    """
    return residual(v_world_mps, measured_mps + late_s * slope_mps2), -slope_mps2[..., None]


def sigma_with_arm(sigma_mps: ArrayLike, rate_radps: Array, arm_m: Array) -> Array:
    """Sigmas (N,) of a velocity of the origin as one of the state's place, for rates (N, 3)."""
    return np.hypot(sigma_mps, np.linalg.norm(np.cross(rate_radps, arm_m), axis=-1))


def factor(
    velocity: int, measured_mps: Array, model: gtsam.noiseModel.Base
) -> gtsam.NonlinearFactor:
    """The native factor of `residual`."""
    import gtsam

    return gtsam.PriorFactorVector(velocity, np.asarray(measured_mps, float), model)
