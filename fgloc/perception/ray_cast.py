"""A simulated LiDAR: rays against upright boxes and a level ground, noise along each ray.

A ray meets a box where the spans between its three pairs of planes overlap (the slab method). Each
box is tried only with the rays that pass its bounding sphere.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc.measurements import Array
from fgloc.perception.heads import Lidar
from fgloc.perception.street import Street, Turned

NOTHING, GROUND = -2, -1
"""What a ray meets that meets no box; boxes count from 0."""


@dataclass(frozen=True, eq=False)
class Scan:
    """What came back: points (N, 3) in the LiDAR's axes with noise, and what each is on, (N,)."""

    points_m: Array
    hit: NDArray[np.int64]


def scan(street: Street, lidar: Lidar, t_ns: int, rng: np.random.Generator) -> Scan:
    """One sweep, taken at an instant. Ranges out of the LiDAR's reach give no point."""
    solids = street.solids(t_ns)
    R_sway, p_sway_m = street.pose(t_ns)
    R = R_sway @ lidar.R_node_lidar
    p_m = R_sway @ lidar.p_node_lidar_m + p_sway_m
    rays = lidar.directions()
    range_m, hit = nearest(rays, solids.moved(R, p_m), R[2], p_m[2] - street.node.ground_m)
    back = (hit != NOTHING) & (range_m >= lidar.min_range_m) & (range_m <= lidar.max_range_m)
    measured_m = range_m[back] + lidar.sigma_m * rng.standard_normal(int(back.sum()))
    return Scan(measured_m[:, None] * rays[back], hit[back])


def nearest(
    rays: Array, boxes: Turned, up: Array, height_m: float
) -> tuple[Array, NDArray[np.int64]]:
    """Distance (R,) along each ray from the origin to what it meets first, infinite where that is
    nothing, and what it is (R,).

    rays      (R, 3) unit directions
    up        (3,) the upward direction in the same axes
    height_m  of the origin above the ground
    """
    down = -(rays @ up)
    to_ground = down > height_m / 1e6
    range_m = np.where(to_ground, height_m / np.where(to_ground, down, 1.0), np.inf)
    hit = np.where(to_ground, GROUND, NOTHING)
    for number, near in enumerate(_near_sphere(rays, boxes).T):
        which = np.flatnonzero(near)
        enter_m = _enter(rays[which], boxes.centre_m[number], boxes.axes[number],
                         boxes.half_m[number])  # fmt: skip
        first = enter_m < range_m[which]
        range_m[which[first]], hit[which[first]] = enter_m[first], number
    return range_m, hit


def _near_sphere(rays: Array, boxes: Turned) -> NDArray[np.bool_]:
    """(R, N) bool: which rays come by the sphere around each box, ahead of the origin."""
    along_m = rays @ boxes.centre_m.T
    radius2, away2 = (boxes.half_m**2).sum(-1), (boxes.centre_m**2).sum(-1)
    ahead = (along_m > 0) | (away2 < radius2)
    return np.asarray(ahead & (away2 - along_m**2 <= radius2))


def _enter(rays: Array, centre_m: Array, axes: Array, half_m: Array) -> Array:
    """(R,) distance to where rays enter a box, infinite where they do not, or are inside."""
    slope = rays @ axes
    slope = np.where(np.abs(slope) < 1e-12, 1e-12, slope)
    middle_m, reach_m = (centre_m @ axes) / slope, half_m / np.abs(slope)
    enter_m = (middle_m - reach_m).max(-1)
    leave_m = (middle_m + reach_m).min(-1)
    return np.where((enter_m <= leave_m) & (enter_m > 0), enter_m, np.inf)
