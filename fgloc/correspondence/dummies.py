"""Stand-ins for objects that the car cannot see. Khamooshi (2023), section 4.2.1.1."""

import numpy as np

from fgloc.correspondence.rigid import Correspondence, rotation
from fgloc.measurements import Array

DUMMY_SIGMA_M = 1e4
"""So large that a dummy weighs nothing beside any sensor."""


def with_dummies(
    found: Correspondence, p_world_m: Array, p_veh_m: Array, cov_veh_m2: Array
) -> tuple[Array, Array]:
    """The car's measurement of each of a node's N objects: positions (N, 2) and covariances.

    Of a pair, what the car sees (M, 2) with its covariance (M, 2, 2); of an object without
    partner, the place where the node has it, in the car's axes, with a very large covariance. So
    car and node tell of the same objects in the same order.
    """
    back = (p_world_m - found.pose.t_m) @ rotation(found.pose.yaw_rad)
    cov = np.tile(DUMMY_SIGMA_M**2 * np.eye(2), (len(p_world_m), 1, 1))
    own, theirs = found.pairs[:, 0], found.pairs[:, 1]
    back[theirs], cov[theirs] = p_veh_m[own], cov_veh_m2[own]
    return back, cov
