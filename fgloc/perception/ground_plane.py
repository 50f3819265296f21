"""The ground as a cloud shows it: a plane, and the cloud turned so that it is level again.

A tilt of 7 mrad lifts what lies 80 m away by 0.6 m, so that ground passes for an object. Levelled
points serve to tell objects from background. Where objects are is told from the points as they
came: how a node sways is for others to estimate (`fgloc.perception.node_pose`, `fgloc.sway`).
"""

import numpy as np

from fgloc.frames import exp_so3
from fgloc.measurements import Array

REACHES_M = (1.0, 0.3, 0.15)
"""Points so near to the plane of the step before are its ground, first to that of the survey."""
LEAST_POINTS = 100
MOST_POINTS = 5000
"""That the plane is fitted to, evenly chosen."""
_LEAST_SPREAD_M = 1.0


def levelled(points_m: Array, ground_m: float) -> Array:
    """Points (N, 3) in the node's axes, turned about the node and lifted so that the ground that
    they show is level at z = `ground_m`; as they are where they show too little of it."""
    slope = np.array([0.0, 0.0, ground_m])
    some = points_m[:: -(-len(points_m) // MOST_POINTS) or 1]
    for reach_m in REACHES_M:
        ground = some[np.abs(some[:, 2] - some[:, :2] @ slope[:2] - slope[2]) < reach_m]
        if len(ground) < LEAST_POINTS or ground[:, :2].std(0).min() < _LEAST_SPREAD_M:
            return points_m
        rows = np.column_stack([ground[:, :2], np.ones(len(ground))])
        slope = np.linalg.solve(rows.T @ rows, rows.T @ ground[:, 2])
    normal = np.array([-slope[0], -slope[1], 1.0])
    normal /= np.linalg.norm(normal)
    turned = points_m @ exp_so3(np.array([normal[1], -normal[0], 0.0])).T
    # Of a plane with unit normal n every point has n x = n_z c, its height once it is level.
    return turned + [0.0, 0.0, ground_m - normal[2] * slope[2]]
