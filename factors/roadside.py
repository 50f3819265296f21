"""How well a roadside node knows where an object is, by the distance and the line of sight.

Lee et al., 'Infrastructure Node-based Vehicle Localization for Autonomous Driving' (2021), eq. (19)
and Table II.
"""

import numpy as np
from numpy.typing import ArrayLike

from fgloc.measurements import Array

SIGMA_PER_M, SIGMA_OFFSET_M = 0.051, 0.702
"""Eq. (19): abs(0.051 d - 0.702) m along, at a distance d from the node."""
SIGMA_ACROSS_M = 0.3
"""Table II."""
FLOOR_M = 0.3
"""Differs from the paper: (19) is zero at 13.76 m, where a detection would weigh infinitely much. A
node is not taken to be better along the line of sight than across it."""


def sigma_along_m(distance_m: ArrayLike, floor_m: float = FLOOR_M) -> Array:
    """Standard deviation (...) in m of a position at distances (...) in m from the node."""
    d = np.asarray(distance_m, float)
    return np.maximum(np.abs(SIGMA_PER_M * d - SIGMA_OFFSET_M), floor_m)  # Eq. (19)


def line_of_sight_cov_m2(p_node_m: Array) -> Array:
    """Covariance (N, 2, 2) in the node's axes, m^2, of positions (N, 2) in m from the node.

    `sigma_along_m` lies along the line from the node to the object, `SIGMA_ACROSS_M` across it.
    """
    distance = np.linalg.norm(p_node_m, axis=-1, keepdims=True)
    ahead = np.where(distance > 0, p_node_m / np.maximum(distance, 1e-12), [1.0, 0.0])
    along = ahead[:, :, None] * ahead[:, None, :]
    variance = sigma_along_m(distance)[..., None] ** 2
    return variance * along + SIGMA_ACROSS_M**2 * (np.eye(2) - along)
