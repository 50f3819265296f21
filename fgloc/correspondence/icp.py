"""Iterative closest point between a node's objects and the car's.

Khamooshi, Cooperative perception and localization for autonomous driving (thesis, Waterloo, 2023),
section 4.2.2, Algorithm 4.1.

| thesis | here |
|---|---|
| N_k, the broadcast positions | `p_world_m` |
| M_k, the car's own, 0 among them | `p_veh_m` |
| r, t | `pose`; the increments of the iterations are put together |
| C_k | `pairs` |
| eps, j_max | `EPS_M`, `J_MAX` |
"""

import numpy as np

from fgloc.correspondence.rigid import (
    IDENTITY,
    Correspondence,
    Index,
    Rigid,
    check_points,
    fit,
    mutual_nearest,
    plain,
    squared_distances,
    wrapped,
)
from fgloc.measurements import Array

EPS_M = 0.1
J_MAX = 100
STILL = 1e-6
"""Change of yaw (rad) and of position (m) below which nothing moves any more."""
GATE_M = 1.3
"""Three sigma of two positions with 0.3 m in each axis: beyond it, a pair is none."""


def icp(
    p_world_m: Array,
    p_veh_m: Array,
    start: Rigid = IDENTITY,
    *,
    printed: bool = False,
    gate_m: float = GATE_M,
) -> Correspondence:
    """Match the car's points (M, 2) to a node's (N, 2), from a first guess of the car's pose.

    printed  every broadcast object has its nearest partner, and the search ends on the error alone
    Raises InputError where the points are not finite or not of two columns.
    """
    world, veh = check_points("p_world_m", p_world_m), check_points("p_veh_m", p_veh_m)
    if not len(world) or not len(veh):
        return plain(start, np.empty((0, 2), np.int64), 0)
    pose = start
    for j in range(1, J_MAX + 1):  # noqa: B007 told in the answer
        pairs = _pairs(pose, world, veh, printed)
        found = fit(veh[pairs[:, 0]], world[pairs[:, 1]])
        moved = max(abs(wrapped(found.yaw_rad - pose.yaw_rad)), *np.abs(found.t_m - pose.t_m))
        pose = found
        # Differs from the paper: with noise or ghosts the error stays above eps, so the mended
        # form ends when the pose stands still.
        error_m = np.sqrt(squared_distances(world, pose.apply(veh)).min(1)).mean()
        if error_m < EPS_M or (not printed and moved < STILL):
            break
    pairs = _pairs(pose, world, veh, printed)
    if not printed:
        gap_m = np.linalg.norm(pose.apply(veh)[pairs[:, 0]] - world[pairs[:, 1]], axis=-1)
        pairs = pairs[gap_m < gate_m]
    return plain(pose, pairs, j)


def _pairs(pose: Rigid, world: Array, veh: Array, printed: bool) -> Index:
    """(K, 2) indices among the car's points and the node's."""
    squares = squared_distances(pose.apply(veh), world)
    if printed:
        return np.stack([squares.argmin(0), np.arange(len(world))], -1)
    # Differs from the paper: only those that are nearest to each other are a pair, or objects that
    # the car does not see would all be matched falsely.
    return mutual_nearest(squares)
