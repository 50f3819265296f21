"""The corners of a square sign in the image of a level camera.

Model: a corner c (world, m) stands in the camera at place p, whose axis points a rad from East,
    ahead = (c - p) . (cos a, sin a, 0), right = (c - p) . (sin a, -cos a, 0), down = -(c - p) . up
and is seen at f right / ahead and f down / ahead from the principal point. The sign's side may be
longer than its record says by a share s: c = middle + (1 + s) (corner of the record - middle).

A square has two poses that explain four corners alone (`fgloc.perception.square_pose`). Here the
sign's turn is surveyed and the camera's is known but for an error, so that one place is left.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fgloc.infrastructure import Sign
from fgloc.measurements import Array

LEAST_AHEAD_M = 0.1
"""A corner nearer than this, or behind, is taken to be so far ahead: what is seen stays finite."""


class CornerResidual(NamedTuple):
    """error (N, 8) in px, right and down of each corner; its Jacobians by the camera's place (N, 8,
    3) in px/m, by the direction of its axis (N, 8) in px/rad and by the share of the side (N, 8)
    in px."""

    error: Array
    by_place: Array
    by_axis: Array
    by_share: Array


def sign_corners_m(sign: Sign) -> Array:
    """(4, 3) ENU of a sign's corners, clockwise from the upper left as one who reads it sees it."""
    half = sign.size_m / 2
    # Seen from in front, the left is where the sign's own axes, x towards the reader, have -y.
    aside, up = half * np.array([-1, 1, 1, -1]), half * np.array([1, 1, -1, -1])
    level = aside[:, None] * sign.R_world_sign[:, 1]
    return np.asarray(sign.p_world_m + np.c_[level, up])


def code_size_px(corners_px: Array) -> tuple[Array, Array]:
    """Height and width (N,) of corners (N, 4, 2): mean height of the upright sides, mean width of
    the level ones.

    Not of the box around them: seen by a camera that looks aside, the level sides slant, and the
    box is higher than the code by as much as shortens any distance by dz times the sine of the yaw.
    """
    upper_left, upper_right, lower_right, lower_left = corners_px.swapaxes(0, 1)
    height_px = (lower_left + lower_right - upper_left - upper_right)[:, 1] / 2
    width_px = (upper_right + lower_right - upper_left - lower_left)[:, 0] / 2
    return height_px, width_px


def residual(
    p_world_cam_m: Array, axis_rad: Array, corners_world_m: Array, corners_px: Array,
    focal_px: float, principal_px: ArrayLike, share: ArrayLike = 0.0,
) -> CornerResidual:  # fmt: skip
    """Predicted minus seen corners, of places (N, 3), axes (N,) from East, signs' corners (N, 4, 3)
    in m and in px (N, 4, 2), and shares (N,) by which the sides are longer."""
    reach = corners_world_m - corners_world_m.mean(1, keepdims=True)
    corners = corners_world_m + np.asarray(share, float)[..., None, None] * reach
    R_cam_world = _axes(axis_rad)
    local = np.einsum("nij,nkj->nki", R_cam_world, corners - p_world_cam_m[:, None])
    seen, by_local = _project(local, focal_px)
    error = seen + np.asarray(principal_px, float) - corners_px
    by_place = -np.einsum("nkij,njl->nkil", by_local, R_cam_world)
    # A turn of the axis to the left moves what is ahead to the right, and what is left ahead.
    turned = np.stack([local[..., 2], np.zeros_like(local[..., 0]), -local[..., 0]], -1)
    by_axis = np.einsum("nkij,nkj->nki", by_local, turned)
    by_share = np.einsum("nkij,njl,nkl->nki", by_local, R_cam_world, reach)
    n = len(error)
    return CornerResidual(
        error.reshape(n, 8), by_place.reshape(n, 8, 3), by_axis.reshape(n, 8),
        by_share.reshape(n, 8),
    )  # fmt: skip


def whitening(
    corners_px: Array, focal_px: float, principal_px: ArrayLike, sigma_px: float,
    sigma_axis_rad: ArrayLike,
) -> Array:  # fmt: skip
    """(N, 8, 8) what turns errors of corners (N, 4, 2) into errors of covariance one.

    Each corner errs by `sigma_px` on its own; the axis' direction errs by `sigma_axis_rad` (N,) and
    moves all four at once, to the right by f (1 + x^2) and down by f x y, x and y being tangents.
    """
    x, y = np.moveaxis((corners_px - np.asarray(principal_px, float)) / focal_px, -1, 0)
    moved = focal_px * np.stack([1 + x**2, x * y], -1).reshape(len(corners_px), 8)
    moved *= np.asarray(sigma_axis_rad, float)[..., None]
    together = moved[:, :, None] * moved[:, None, :]
    lower = np.linalg.cholesky(together + sigma_px**2 * np.eye(8))
    return np.asarray(np.linalg.inv(lower))


def _axes(axis_rad: Array) -> Array:
    """(N, 3, 3) from East, North, up to the camera's right, down, ahead."""
    c, s, zero = np.cos(axis_rad), np.sin(axis_rad), np.zeros_like(axis_rad)
    right, ahead = np.stack([s, -c, zero], -1), np.stack([c, s, zero], -1)
    down = np.broadcast_to([0.0, 0.0, -1.0], right.shape)
    return np.stack([right, down, ahead], 1)


def _project(local: Array, focal_px: float) -> tuple[Array, Array]:
    """Pixels (N, 4, 2) from the principal point of points (N, 4, 3) right, down and ahead in m, and
    the Jacobians (N, 4, 2, 3) by these."""
    ahead = np.maximum(local[..., 2], LEAST_AHEAD_M)[..., None]
    seen = focal_px * local[..., :2] / ahead
    by = np.zeros((*local.shape[:2], 2, 3))
    by[..., :2] = focal_px * np.eye(2) / ahead[..., None]
    by[..., 2] = -seen / ahead * (local[..., 2:] > LEAST_AHEAD_M)
    return seen, by
