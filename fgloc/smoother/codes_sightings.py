"""Sightings of Smart Codes as the planar graph takes them: by size and middle, or by corners.

By size: the range that the code's height tells, the direction of its middle, which the heading and
the camera's yaw turn into the world's, and its width, which tells from how far aside it is seen.
By corners: the four corners as the camera projects them, which say all of that and more exactly.

What may be wrong with every sighting of a size of sign is a variable: by size a bias of the range,
by corners a share by which the code's side differs from its record. A reader that counts whole
pixels, or those of a box around the code, tells ranges that are off by about so many metres (the
thesis finds just under 1 m). Corners do without that count; what is left is a side that is not as
long as recorded or a focal length that is not as stated, and both put a sign too far in proportion
to its distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgloc.factors import corners, ranging
from fgloc.frames import wrap_pi
from fgloc.measurements import Array

SPEED, HEADING, BIASES = 0, 1, 2
"""Where the globals stand: scale error of the speed, error of the heading, and from there on the
biases of ranges, then the shares of sides."""


class Told(NamedTuple):
    """Whitened errors (R, k) of some sightings, by the camera's East and North (R, k, 2) and by the
    globals (R, k, G)."""

    error: Array
    by_camera: Array
    by_globals: Array


@dataclass(frozen=True, eq=False)
class Rows:
    """Sightings (M,) in the order of time: the epoch before each, how far it is to the one after,
    the global that its size of sign has, the row of the table; `first` (N,) is the first sighting
    after each epoch."""

    epoch: NDArray[np.int64]
    share: Array
    own: NDArray[np.int64]
    row: NDArray[np.int64]
    first: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class BySize:
    """The sign's place (M, 3), the way (M, 2) in m from there to the code's left side, as seen;
    range in m, direction from East of the ray to it and width, both in rad on the level, with
    their sigmas."""

    at: Rows
    place_m: Array
    to_left_m: Array
    range_m: Array
    range_sigma_m: Array
    direction_rad: Array
    direction_sigma_rad: Array
    width_rad: Array
    width_sigma_rad: float
    loss_width: float
    size: int = 3

    def errors(self, camera: Array, globals_: Array, rows: slice) -> Told:
        """Of range, direction and width, predicted minus told, from cameras (R, 3)."""
        level = np.broadcast_to(np.eye(3), (len(camera), 3, 3))
        own = self.at.own[rows]
        told = ranging.residual(
            camera, level, self.place_m[rows], self.range_m[rows], bias_m=globals_[own]
        )
        off, by_direction = self._direction(camera, globals_, rows)
        wide, by_width = self._width(camera, rows)
        by_camera = np.stack([told.by_tag[:, 0, :2], by_direction, by_width], 1)
        by_globals = np.zeros((len(camera), self.size, len(globals_)))
        by_globals[np.arange(len(camera)), 0, own] = 1.0
        by_globals[:, 1, HEADING] = -1.0
        wide_sigma = np.full(len(camera), self.width_sigma_rad)
        root = 1 / np.c_[self.range_sigma_m[rows], self.direction_sigma_rad[rows], wide_sigma]
        error = np.stack([told.error[:, 0], off, wide], -1) * root
        return Told(error, by_camera * root[:, :, None], by_globals * root[:, :, None])

    def _direction(self, camera: Array, globals_: Array, rows: slice) -> tuple[Array, Array]:
        """Predicted minus measured directions (R,) in rad of cameras (R, 3), by their East and
        North (R, 2)."""
        direction, by = _towards(camera, self.place_m[rows, :2])
        return wrap_pi(direction - self.direction_rad[rows] - globals_[HEADING]), by

    def _width(self, camera: Array, rows: slice) -> tuple[Array, Array]:
        """Predicted minus measured widths (R,) in rad, the angle between the directions of the
        code's sides, by East and North (R, 2)."""
        place, to_left = self.place_m[rows, :2], self.to_left_m[rows]
        left, by_left = _towards(camera, place + to_left)
        right, by_right = _towards(camera, place - to_left)
        return wrap_pi(left - right - self.width_rad[rows]), by_left - by_right


@dataclass(frozen=True, eq=False)
class ByCorners:
    """The sign's corners (M, 4, 3) in m and as seen (M, 4, 2) in px, the direction (M,) from East
    of the camera's axis as the heading tells it, and what whitens the errors (M, 8, 8)."""

    at: Rows
    corners_world_m: Array
    corners_px: Array
    axis_rad: Array
    root: Array
    focal_px: float
    principal_px: Array
    loss_width: float
    size: int = 8

    def errors(self, camera: Array, globals_: Array, rows: slice) -> Told:
        """Of the corners' pixels, predicted minus seen, from cameras (R, 3)."""
        own, root = self.at.own[rows], self.root[rows]
        told = corners.residual(
            camera, self.axis_rad[rows] + globals_[HEADING], self.corners_world_m[rows],
            self.corners_px[rows], self.focal_px, self.principal_px, globals_[own],
        )  # fmt: skip
        by_globals = np.zeros((len(camera), self.size, len(globals_)))
        by_globals[:, :, HEADING] = told.by_axis
        by_globals[np.arange(len(camera)), :, own] = told.by_share
        error = np.einsum("nij,nj->ni", root, told.error)
        return Told(error, root @ told.by_place[..., :2], root @ by_globals)


def _towards(camera: Array, place_m: Array) -> tuple[Array, Array]:
    """Directions (R,) from East in rad from cameras (R, 3) to places (R, 2), by the cameras' East
    and North (R, 2)."""
    ray = place_m - camera[:, :2]
    by = np.stack([ray[:, 1], -ray[:, 0]], -1) / (ray**2).sum(1)[:, None]
    return np.arctan2(ray[:, 1], ray[:, 0]), by
