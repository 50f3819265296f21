"""Smart Codes: where a camera is by the size of a square sign in its image.

T. S. Marr, "Utilizing the Infrastructure for Ground Truth Based Localization", thesis, Texas A&M
University, 2019, section 3.2. The sign is square and upright; the camera is level.

    d_m1, d_m2   height_m, width_m    distance if the sign were seen head-on, by height and by width
    d            range_m              from the camera to the middle of the sign
    dz           height_above_m       of the sign's middle over the camera
    theta_1      elevation of the sign
    theta_2 - phi  angle at the sign between its normal and the ray, seen along its width
    dx, dy       p_sign_m             along the sign's normal, and to the side

The sign's axes: x along its normal, z up, y to the left of one who looks along the normal. A car
that drives up to a sign on the right of its road is therefore at negative y.

# Differs from the paper: a pinhole image shows depth, not distance, so sizes in pixels are first
turned into angles along the ray (`head_on`); the camera's yaw then drops out, as (3.4) has it. At
45 deg and more of elevation (3.2) would take the wrong root, and beyond d = d_m2 (3.3) has none:
both are answered by a status. The side of the sign, which (3.3) loses, comes from its record.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgloc.measurements import Array

SIZE_SIGMA_PX = np.sqrt(1 / 12)
"""Of a size that is rounded to a whole pixel."""


class Reading(IntEnum):
    """What one sighting tells."""

    POSITION = 0
    RANGE_ONLY = 1
    TOO_NEAR = 2

    @property
    def text(self) -> str:
        """For people."""
        return {0: "position", 1: "no position, range only", 2: "too near"}[self.value]


class HeadOn(NamedTuple):
    """Distances (N,) in m if the sign were seen head-on, and the sign's elevation (N,) in rad."""

    height_m: Array
    width_m: Array
    elevation_rad: Array


@dataclass(frozen=True, eq=False)
class Located:
    """N cameras in the axes of the sign that each of them sees; finite in every row.

    status         (N,) of `Reading`
    range_m        (N,) distance; of `TOO_NEAR` the largest that it can be
    p_sign_m       (N, 2) along the sign's normal and to its left; where the status is not
                   `POSITION`, a place straight ahead of the sign, which is not a measurement
    by_head_on     (N, 3, 2) change of range and of `p_sign_m` with the distances by height and by
                   width; zero where the status is not `POSITION`, but for the range's of
                   `RANGE_ONLY`
    """

    status: NDArray[np.int64]
    range_m: Array
    p_sign_m: Array
    by_head_on: Array

    def texts(self) -> list[str]:
        """The status of each row for people."""
        return [Reading(one).text for one in self.status]


def head_on(
    height_px: ArrayLike, width_px: ArrayLike, centre_px: ArrayLike, size_m: ArrayLike,
    focal_px: float, principal_px: ArrayLike, along_ray: bool = True,
) -> HeadOn:  # fmt: skip
    """Distances (N,) from pixel sizes (N,) of signs of `size_m` (N,) centred at (N, 2) px.

    Off the axis by the angles a to the side and e upwards, an upright length shows f / (cos a
    cos^2 e) pixels per radian and a level one f / (cos^2 a cos e). `along_ray` False takes the
    pixels as they are, which the thesis does.
    """
    off = (np.asarray(centre_px, float) - np.asarray(principal_px, float)) / focal_px
    cos_a = 1 / np.hypot(1, off[..., 0])
    elevation = np.arctan(-off[..., 1] * cos_a)
    cos_e = np.cos(elevation)
    at_f = focal_px * np.asarray(size_m, float)
    height, width = np.asarray(height_px, float), np.asarray(width_px, float)
    if along_ray:
        height, width = height * cos_a * cos_e**2, width * cos_a**2 * cos_e
    return HeadOn(at_f / height, at_f / width, elevation)


def step_1(height_m: ArrayLike, height_above_m: ArrayLike) -> Array:
    """Range (N,) by (3.2); the root is that of an elevation below 45 deg, 0 where there is none."""
    d_m1, dz = np.asarray(height_m, float), np.asarray(height_above_m, float)
    inner = d_m1**2 - 4 * dz**2
    d = np.sqrt(2 * d_m1) * np.sqrt(np.sqrt(np.maximum(inner, 0)) + d_m1) / 2  # (3.2)
    return np.where(inner >= 0, d, 0.0)


def locate(seen: HeadOn, height_above_m: ArrayLike, sign_is_left: ArrayLike) -> Located:
    """The three steps, for all sightings at once.

    `height_above_m` (N,) is how far the sign's middle lies over the camera, `sign_is_left` (N,)
    whether the sign stands on the left of the road as the driver sees it.
    """
    d_m1, d_m2 = np.broadcast_arrays(seen.height_m, seen.width_m)
    dz = np.broadcast_to(np.asarray(height_above_m, float), d_m1.shape)
    side = np.where(sign_is_left, 1.0, -1.0)
    too_near = (d_m1 < 2 * np.abs(dz)) | (np.abs(seen.elevation_rad) > np.pi / 4)
    d = np.where(too_near, np.sqrt(2) * np.abs(dz), step_1(d_m1, dz))
    cos_theta = np.minimum(d / d_m2, 1.0)  # (3.3)
    dy2 = d**2 * (1 - cos_theta**2)  # (3.4)
    dx2 = d**2 - dy2 - dz**2  # (3.5)
    there = ~too_near & (d < d_m2) & (dx2 > 0)
    status = np.select([there, ~too_near], [Reading.POSITION, Reading.RANGE_ONLY], Reading.TOO_NEAR)
    ahead = np.stack([np.sqrt(np.maximum(d**2 - dz**2, 0)), np.zeros_like(d)], -1)
    sides = np.stack([np.sqrt(np.maximum(dx2, 0)), side * np.sqrt(dy2)], -1)
    p = np.where(there[..., None], sides, ahead)
    by = _by_head_on(d_m1, d_m2, dz, d, p, there, ~too_near)
    return Located(status.astype(np.int64), d, p, by)


def _by_head_on(
    d_m1: Array, d_m2: Array, dz: Array, d: Array, p: Array, there: NDArray[np.bool_],
    ranged: NDArray[np.bool_],
) -> Array:  # fmt: skip
    """(N, 3, 2) of range, dx and dy by d_m1 and d_m2, from d_m1 = d^2 / sqrt(d^2 - dz^2) and
    dx^2 + dz^2 = d^4 / d_m2^2."""
    by = np.zeros((*d.shape, 3, 2))
    flat = d**2 - dz**2
    slope = d * (d**2 - 2 * dz**2) / np.where(ranged, flat, 1.0) ** 1.5
    steep = ranged & (slope > 0)
    d_by = np.where(steep, 1 / np.where(steep, slope, 1.0), 0.0)
    by[..., 0, 0] = d_by
    dx, dy = (np.where(there, p[..., i], 1.0) for i in range(2))
    across = d**4 / d_m2**2
    by[..., 1, 0] = np.where(there, 2 * d**3 / d_m2**2 * d_by / dx, 0.0)
    by[..., 1, 1] = np.where(there, -across / d_m2 / dx, 0.0)
    by[..., 2, 0] = np.where(there, (d - 2 * d**3 / d_m2**2) * d_by / dy, 0.0)
    by[..., 2, 1] = np.where(there, across / d_m2 / dy, 0.0)
    return by


def head_on_sigma_m(
    distance_m: ArrayLike, size_m: ArrayLike, focal_px: float, sigma_px: float = SIZE_SIGMA_PX
) -> Array:
    """Standard deviation (N,) of a head-on distance from that of its pixel size: d^2 s / (f size).

    At 20 m a code of 0.56 m, of which a camera of 2400 px sees 67, is known to 0.09 m.
    """
    d = np.asarray(distance_m, float)
    return d**2 * sigma_px / (focal_px * np.asarray(size_m, float))


def covariance_m2(
    found: Located, seen: HeadOn, size_m: ArrayLike, focal_px: float,
    sigma_px: float = SIZE_SIGMA_PX,
) -> Array:  # fmt: skip
    """(N, 3, 3) of range and `p_sign_m`, from pixel sizes that are known to `sigma_px`."""
    by_m = np.stack([seen.height_m, seen.width_m], -1)
    sigma = head_on_sigma_m(by_m, np.asarray(size_m, float)[..., None], focal_px, sigma_px)
    half = found.by_head_on * sigma[..., None, :]
    return half @ half.swapaxes(-1, -2)
