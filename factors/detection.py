"""A roadside node's detection: the centre of the box around the vehicle is where the node says.

Model: in the world's horizontal plane, and in height where the node tells one,
z + J s = p_world_veh + R_world_veh b + c + n, with z where the detection lies by the node's survey,
s by what the node is off it (east and north in m, yaw in rad, and where it tells a height up in m
and turns about East and North in rad), b the centre of the box in the vehicle frame, c an optional
slow bias as of a GNSS fix and n white noise. The covariance is what the node states, or in the
plane a law of the distance d in the node's line of sight to the car:

- Lee et al. (2021) (19): sigma along |0.051 d - 0.702| m, across 0.3 m. Differs from the paper:
  the law is 0 at 13.76 m, so it has a floor, and it holds in the line of sight, not East/North.
- Khamooshi (2023) (3.16): variance a_n d^2, alike in all directions, d the slant range.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgloc.measurements import Array

LEE2021_SLOPE, LEE2021_OFFSET_M, LEE2021_ACROSS_M = 0.051, -0.702, 0.3
"""Lee et al. (2021), (19) and section III-D."""
KHAMOOSHI2023_SHARE = 0.02
"""sqrt(a_n): sigma over slant range. The thesis does not print a_n; this gives 0.3 m at 15 m."""
SURVEY, FLAT_SURVEY = 6, 3
"""Errors that a survey may have, and those that a node feels which tells no heights."""


def lee2021_sigma_m(distance_m: ArrayLike, floor_m: float) -> Array:
    """Sigma (...) along the line of sight at some distances (...) from the node, at least the
    floor."""
    law = np.abs(LEE2021_SLOPE * np.asarray(distance_m, float) + LEE2021_OFFSET_M)
    return np.maximum(law, floor_m)


def khamooshi2023_sigma_m(slant_range_m: ArrayLike) -> Array:
    """Sigma (...) of each axis at some slant ranges (...) from the node."""
    return KHAMOOSHI2023_SHARE * np.asarray(slant_range_m, float)


def line_of_sight_cov_m2(direction: Array, along_m: ArrayLike, across_m: ArrayLike) -> Array:
    """Covariances (N, 2, 2) with these sigmas (N,) along directions (N, 2) and across them.

    The directions need not be of unit length, but of some.
    """
    u = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    w = np.stack([-u[:, 1], u[:, 0]], -1)
    along, across = (np.broadcast_to(s, len(u))[:, None, None] for s in (along_m, across_m))
    return (along**2 * u[:, :, None] * u[:, None, :]) + across**2 * w[:, :, None] * w[:, None, :]


def by_survey(z_world_m: Array, p_world_node_m: Array, has_height: NDArray[np.bool_]) -> Array:
    """Jacobian (N, 3, 6) of detections (N, 3) by the node's survey error: a shift east and north, a
    turn about the vertical through the node; of those (N,) that tell a height also a shift up, and
    turns about East and North."""
    arm = z_world_m - p_world_node_m
    J = np.zeros((len(arm), 3, SURVEY))
    J[:, 0, 0] = J[:, 1, 1] = 1.0
    J[:, 0, 2], J[:, 1, 2] = -arm[:, 1], arm[:, 0]
    east, north, up = arm[has_height].T
    J[has_height, 2, 3] = 1.0
    J[has_height, 1, 4], J[has_height, 2, 4] = -up, north
    J[has_height, 0, 5], J[has_height, 2, 5] = up, -east
    return J
