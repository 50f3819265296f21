"""Corners of a sign in the image: an independent projection, derivatives, noise, two poses."""

import gtsam
import numpy as np
import pytest

from fgloc.factors.corners import LEAST_AHEAD_M, code_size_px, residual, sign_corners_m, whitening
from fgloc.infrastructure import Sign

FOCAL_PX, PRINCIPAL_PX = 2400.0, np.array([1224.0, 1024.0])
NORTH = np.pi / 2
SIGN = Sign("curve", "22a1", np.array([3.0, 20.0, 2.1]), -NORTH, 0.6)  # it looks south
PLACE, AXIS = np.array([-4.0, 2.0, 1.6]), NORTH - 0.4


def seen_from(place, axis_rad, share=0.0) -> np.ndarray:
    """Corners (4, 2) in px of the sign."""
    zero = np.zeros((1, 4, 2))
    told = residual(place[None], np.array([axis_rad]), sign_corners_m(SIGN)[None], zero,
                    FOCAL_PX, PRINCIPAL_PX, [share])  # fmt: skip
    return told.error.reshape(4, 2)


def test_who_drives_north_sees_the_left_of_a_sign_that_looks_south_in_the_west():
    np.testing.assert_allclose(
        sign_corners_m(SIGN),
        [[2.7, 20, 2.4], [3.3, 20, 2.4], [3.3, 20, 1.8], [2.7, 20, 1.8]], atol=1e-12,
    )  # fmt: skip


def test_a_corner_twenty_metres_ahead_and_one_aside_is_120_px_off_the_middle():
    seen = seen_from(np.array([1.7, 0.0, 2.4]), NORTH)
    np.testing.assert_allclose(seen[0] - PRINCIPAL_PX, [120, 0], atol=1e-9)
    np.testing.assert_allclose(seen[2] - PRINCIPAL_PX, [192, 72], atol=1e-9)


def test_the_projection_is_gtsams():
    c, s = np.cos(AXIS), np.sin(AXIS)
    right_down_ahead = np.array([[s, 0, c], [-c, 0, s], [0, -1, 0]])
    pose = gtsam.Pose3(gtsam.Rot3(right_down_ahead), PLACE)
    camera = gtsam.PinholeCameraCal3_S2(pose, gtsam.Cal3_S2(FOCAL_PX, FOCAL_PX, 0, *PRINCIPAL_PX))
    expected = [camera.project(corner) for corner in sign_corners_m(SIGN)]
    np.testing.assert_allclose(seen_from(PLACE, AXIS), expected, atol=1e-9)


def test_jacobians_are_the_differences():
    told = residual(PLACE[None], np.array([AXIS]), sign_corners_m(SIGN)[None],
                    np.zeros((1, 4, 2)), FOCAL_PX, PRINCIPAL_PX, [0.01])  # fmt: skip
    step = 1e-6
    for by, move in (
        *((told.by_place[0, :, i], (step * np.eye(3)[i], 0.0, 0.0)) for i in range(3)),
        (told.by_axis[0], (np.zeros(3), step, 0.0)),
        (told.by_share[0], (np.zeros(3), 0.0, step)),
    ):
        place, axis, share = move
        more = seen_from(PLACE + place, AXIS + axis, 0.01 + share)
        less = seen_from(PLACE - place, AXIS - axis, 0.01 - share)
        np.testing.assert_allclose(by, (more - less).ravel() / (2 * step), rtol=1e-6, atol=1e-5)


def test_a_sign_behind_the_camera_gives_finite_errors_and_derivatives():
    behind = residual(PLACE[None], np.array([AXIS + np.pi]), sign_corners_m(SIGN)[None],
                      np.zeros((1, 4, 2)), FOCAL_PX, PRINCIPAL_PX)  # fmt: skip
    assert all(np.isfinite(part).all() for part in behind)
    assert np.abs(behind.error).max() < FOCAL_PX * 40 / LEAST_AHEAD_M


def test_a_longer_side_is_a_nearer_sign():
    longer, plain = (np.ptp(seen_from(PLACE, AXIS, share), axis=0) for share in (0.02, 0.0))
    np.testing.assert_allclose(longer, 1.02 * plain, rtol=1e-3)


def test_height_and_width_are_those_of_the_sides_not_of_the_box():
    slanted = np.array([[[0.0, 2], [10, 0], [10, 12], [0, 14]]])
    np.testing.assert_allclose(code_size_px(slanted), [[12.0], [10.0]])


def test_whitened_errors_of_many_draws_have_the_unit_covariance():
    rng, n = np.random.default_rng(4), 20_000
    sigma_px, sigma_rad = 0.3, 0.002
    true = seen_from(PLACE, AXIS)
    turned = residual(
        np.tile(PLACE, (n, 1)), AXIS + sigma_rad * rng.standard_normal(n),
        np.tile(sign_corners_m(SIGN), (n, 1, 1)), np.tile(true, (n, 1, 1)), FOCAL_PX, PRINCIPAL_PX,
    )  # fmt: skip
    errors = turned.error + sigma_px * rng.standard_normal((n, 8))
    root = whitening(true[None], FOCAL_PX, PRINCIPAL_PX, sigma_px, sigma_rad)[0]
    np.testing.assert_allclose(np.cov((errors @ root.T).T), np.eye(8), atol=0.05)


@pytest.mark.parametrize("east_m", [-4.0, 10.0])
def test_with_the_turn_known_one_place_is_left_wherever_the_search_starts(east_m):
    """Of the two poses that a square allows, only one fits a camera whose axis is known."""
    px = seen_from(PLACE, AXIS)
    place = np.array([east_m, 2.0, 1.6])  # 10 m: the same range, mirrored about the sign's normal
    for _ in range(12):
        told = residual(place[None], np.array([AXIS]), sign_corners_m(SIGN)[None], px[None],
                        FOCAL_PX, PRINCIPAL_PX)  # fmt: skip
        step = np.linalg.lstsq(told.by_place[0, :, :2], -told.error[0], rcond=None)[0]
        place[:2] += step
    np.testing.assert_allclose(place, PLACE, atol=1e-6)
