"""Smart Code geometry: printed equations, the regions where they have no answer, derivatives."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fgloc.factors.smart_code import (
    HeadOn,
    Reading,
    covariance_m2,
    head_on,
    head_on_sigma_m,
    locate,
    step_1,
)

FOCAL_PX, CENTRE_PX, SIZE_M = 2400.0, (1224.0, 1024.0), 0.5588


def by_hand(dx, dy, dz) -> HeadOn:
    """What (3.1) and (3.3) say of a camera at dx, dy from a sign that is dz higher."""
    dx, dy, dz = np.broadcast_arrays(*(np.asarray(x, float) for x in (dx, dy, dz)))
    d = np.sqrt(dx**2 + dy**2 + dz**2)
    return HeadOn(d**2 / np.hypot(dx, dy), d**2 / np.hypot(dx, dz), np.arcsin(dz / d))


def image_of(dx, dy, dz, yaw_rad=0.0, size_m=SIZE_M):
    """Height, width and middle in px of a sign: a pinhole camera turned by `yaw_rad` to its right.

    The sign is on the right, so it is dy to the right of the camera, and its face looks back.
    """
    half = size_m / 2
    points = np.array(
        [[dx, dy, dz], [dx, dy, dz + half], [dx, dy, dz - half], [dx, dy + half, dz],
         [dx, dy - half, dz]]
    )  # fmt: skip
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    depth, right = points[:, 0] * c + points[:, 1] * s, points[:, 1] * c - points[:, 0] * s
    px = np.stack([right, -points[:, 2]], -1) / depth[:, None] * FOCAL_PX + CENTRE_PX
    return abs(px[1, 1] - px[2, 1]), abs(px[3, 0] - px[4, 0]), px[0]


def test_step_1_of_a_sign_three_metres_up_and_twenty_away():
    d_m1 = 20 / np.cos(np.arcsin(3 / 20))  # (3.1)
    assert d_m1 == pytest.approx(20.2288, abs=1e-4)
    assert step_1(d_m1, 3.0) == pytest.approx(20.0, abs=1e-12)


def test_below_45_degrees_3_2_takes_the_wrong_root_as_four_metres_show():
    d_m1 = 4 / np.cos(np.arcsin(3 / 4))
    assert step_1(d_m1, 3.0) == pytest.approx(4.54, abs=5e-3)
    seen = HeadOn(np.array([d_m1]), np.array([d_m1]), np.array([np.arcsin(3 / 4)]))
    found = locate(seen, 3.0, False)
    assert found.texts() == ["too near"]
    assert found.range_m[0] == pytest.approx(3 * np.sqrt(2))


def test_the_three_steps_find_the_camera_on_either_side():
    found = locate(by_hand([15, 15], [4, 4], [2, 2]), 2.0, [False, True])
    np.testing.assert_allclose(found.p_sign_m, [[15, -4], [15, 4]], atol=1e-9)
    np.testing.assert_allclose(found.range_m, np.sqrt(15**2 + 4**2 + 2**2))
    assert found.texts() == ["position", "position"]


def test_a_code_wider_than_high_gives_a_range_only_and_no_nan():
    seen = HeadOn(np.array([20.0]), np.array([19.0]), np.array([0.0]))
    found = locate(seen, 0.0, False)
    assert found.texts() == ["no position, range only"]
    assert found.range_m[0] == pytest.approx(20.0)
    np.testing.assert_allclose(found.p_sign_m, [[20.0, 0.0]])


def test_a_code_too_narrow_to_stand_anywhere_gives_a_range_only():
    found = locate(HeadOn(np.array([10.0]), np.array([60.0]), np.array([0.2])), 2.0, False)
    assert found.status[0] == Reading.RANGE_ONLY


def test_a_code_higher_than_any_distance_makes_it_is_too_near():
    found = locate(HeadOn(np.array([3.9]), np.array([5.0]), np.array([0.5])), 2.0, False)
    assert found.status[0] == Reading.TOO_NEAR


@given(st.floats(0.1, 300), st.floats(0.1, 300), st.floats(-1.5, 1.5), st.floats(-5, 5))
def test_whatever_is_read_the_answer_is_finite(height_m, width_m, elevation_rad, above_m):
    seen = HeadOn(*(np.array([x]) for x in (height_m, width_m, elevation_rad)))
    found = locate(seen, above_m, True)
    for part in (found.range_m, found.p_sign_m, found.by_head_on):
        assert np.isfinite(part).all()


@pytest.mark.parametrize("yaw_deg", [0, 30, 45])
@pytest.mark.parametrize(("dx", "dy", "dz"), [(18, 6, 1.5), (30, 3, 1.0), (10, 5, -0.5)])
def test_along_the_ray_the_cameras_yaw_drops_out(yaw_deg, dx, dy, dz):
    height, width, middle = image_of(dx, dy, dz, np.deg2rad(yaw_deg))
    seen = head_on(height, width, middle, SIZE_M, FOCAL_PX, CENTRE_PX)
    found = locate(HeadOn(*np.atleast_1d(*seen)), dz, False)
    # The sign has a size and its width a slant in the image: what is left is a few centimetres.
    np.testing.assert_allclose(found.p_sign_m[0], [dx, -dy], atol=0.15)
    assert found.range_m[0] == pytest.approx(np.sqrt(dx**2 + dy**2 + dz**2), rel=2e-3)


def test_pixels_as_they_are_show_depth_twenty_metres_are_17_5_at_30_degrees():
    height, width, middle = image_of(20, 0.0, 0.0, np.deg2rad(30), size_m=0.01)
    plain = head_on(height, width, middle, 0.01, FOCAL_PX, CENTRE_PX, along_ray=False)
    assert plain.height_m == pytest.approx(20 * np.cos(np.deg2rad(30)), rel=1e-3)
    on_ray = head_on(height, width, middle, 0.01, FOCAL_PX, CENTRE_PX)
    assert on_ray.height_m == pytest.approx(20.0, rel=1e-3)


def test_pixels_as_they_are_say_nothing_of_the_side_for_a_camera_that_looks_ahead():
    height, width, middle = image_of(20, 6.0, 0.0, 0.0)
    plain = head_on(height, width, middle, SIZE_M, FOCAL_PX, CENTRE_PX, along_ray=False)
    assert plain.height_m == pytest.approx(plain.width_m)


@pytest.mark.parametrize(("dx", "dy", "dz"), [(18, 6, 1.5), (8, 2, 3.0), (40, 9, 0.0)])
def test_jacobians_are_the_differences(dx, dy, dz):
    seen = by_hand([dx], [dy], [dz])
    found = locate(seen, dz, True)
    for column, step in enumerate(([1e-6, 0], [0, 1e-6])):
        more = HeadOn(seen.height_m + step[0], seen.width_m + step[1], seen.elevation_rad)
        less = HeadOn(seen.height_m - step[0], seen.width_m - step[1], seen.elevation_rad)
        a, b = locate(more, dz, True), locate(less, dz, True)
        change = np.c_[a.range_m - b.range_m, a.p_sign_m - b.p_sign_m] / 2e-6
        np.testing.assert_allclose(found.by_head_on[..., column], change, rtol=1e-5, atol=1e-6)


def test_sigma_grows_with_the_square_of_the_distance():
    at = head_on_sigma_m([10.0, 20.0], SIZE_M, FOCAL_PX, 1.0)
    assert at[1] == pytest.approx(4 * at[0])
    assert at[0] == pytest.approx(100 / (FOCAL_PX * SIZE_M))


def test_the_covariance_is_that_of_many_draws():
    rng, n, dx, dy, dz = np.random.default_rng(3), 40_000, 14.0, 6.0, 1.0
    seen = by_hand(np.full(n, dx), np.full(n, dy), np.full(n, dz))
    noisy = HeadOn(
        *(FOCAL_PX * SIZE_M / (FOCAL_PX * SIZE_M / x + 0.1 * rng.standard_normal(n))
          for x in seen[:2]), seen.elevation_rad,
    )  # fmt: skip
    drawn = locate(noisy, dz, False)
    one = by_hand([dx], [dy], [dz])
    told = covariance_m2(locate(one, dz, False), one, SIZE_M, FOCAL_PX, 0.1)[0]
    np.testing.assert_allclose(np.cov(np.c_[drawn.range_m, drawn.p_sign_m].T), told, rtol=0.06)
