"""Frames: places on the Earth against published numbers, rotations against their own algebra."""

import numpy as np
import pymap3d
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fgloc import frames
from fgloc.errors import InputError
from fgloc.frames import Origin

ORIGIN = Origin(42.30, -83.70, 260.0)
SMALL_TO_NEARLY_PI = st.sampled_from([1e-12, 1e-6, 1e-5, 9.9e-4, 1.1e-3, 0.1, 1.0, 3.0, 3.1415])
DIRECTIONS = arrays(float, 3, elements=st.floats(-1, 1)).filter(lambda v: np.linalg.norm(v) > 0.1)
ROTVECS = st.builds(
    lambda direction, angle: direction / np.linalg.norm(direction) * angle,
    DIRECTIONS,
    st.one_of(SMALL_TO_NEARLY_PI, st.floats(0, 3.1415)),
)


# Places. UTM numbers are those of PROJ 9 (EPSG:326xx and 327xx), rounded to 0.01 mm.


@pytest.mark.parametrize(
    ("lat_deg", "lon_deg", "zone", "easting_m", "northing_m"),
    [
        (42.30, -83.70, 17, 277437.89677, 4686616.40732),
        (0.0, -81.0, 17, 500000.0, 0.0),
        (0.0, -84.0, 17, 166021.44308, 0.0),
        (-33.8568, 151.2153, 56, 334900.56965, 6252288.75289),
        (84.0, -84.0, 17, 465005.34494, 9329005.18245),
        (60.0, 5.0, 32, 276979.92640, 6658157.20241),
        (52.3759, 9.7320, 32, 549829.85790, 5803100.33768),
        (-79.9, 152.0, 56, 480423.38899, 1129407.48263),
    ],
)
def test_utm_agrees_with_proj_to_a_tenth_of_a_millimetre(
    lat_deg, lon_deg, zone, easting_m, northing_m
):
    utm = frames.geodetic_to_utm(lat_deg, lon_deg, zone)
    np.testing.assert_allclose(utm, [easting_m, northing_m], atol=1e-4)


@given(st.floats(-80, 84), st.floats(-3, 3), st.integers(1, 60))
@example(-5e-324, 0.0, 1)
def test_utm_and_back_is_the_same_place(lat_deg, from_centre_deg, zone):
    lon_deg = 6 * zone - 183 + from_centre_deg
    utm = frames.geodetic_to_utm(lat_deg, lon_deg, zone)
    again = frames.utm_to_geodetic(utm, zone, north=lat_deg >= 0)
    np.testing.assert_allclose(again, [lat_deg, lon_deg], rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    ("lat_deg", "lon_deg", "zone"),
    [(42.3, -83.7, 17), (0, -180, 1), (0, 179.9, 60), (0, 180, 1), (42.3, 276.3, 17), (0, 6, 32),
     (60, 5, 32), (55.9, 5, 31), (64, 5, 31), (78, 8, 31), (78, 10, 33), (78, 22, 35),
     (78, 40, 37), (78, 43, 38), (71.9, 10, 32)],
)  # fmt: skip
def test_utm_zones_with_the_exceptions_of_norway_and_svalbard(lat_deg, lon_deg, zone):
    assert frames.utm_zone(lat_deg, lon_deg) == zone


@pytest.mark.parametrize(
    ("lat_deg", "height_m", "gravity_mps2"),
    [(0, 0, 9.7803253359), (90, 0, 9.8321849379), (-90, 0, 9.8321849379), (45, 0, 9.806197769),
     (45, 1000, 9.803111769)],
)  # fmt: skip
def test_normal_gravity_is_that_of_wgs84(lat_deg, height_m, gravity_mps2):
    gravity = Origin(lat_deg, 0.0, height_m).gravity_mps2()
    assert gravity == pytest.approx(gravity_mps2, abs=1e-6)


@given(arrays(float, (4, 3), elements=st.floats(-20_000, 20_000)))
def test_enu_to_geodetic_and_back_is_the_same_point(p_world_m):
    geodetic = ORIGIN.to_geodetic(p_world_m)
    np.testing.assert_allclose(ORIGIN.to_world(*geodetic.T), p_world_m, rtol=0, atol=1e-6)


@given(arrays(float, (4, 3), elements=st.floats(-20_000, 20_000)))
def test_enu_to_ecef_and_back_is_the_same_point(p_world_m):
    ecef = ORIGIN.world_to_ecef(p_world_m)
    np.testing.assert_allclose(ORIGIN.ecef_to_world(ecef), p_world_m, rtol=0, atol=1e-7)


def test_geodetic_and_ecef_lead_to_the_same_world_point():
    place = (42.31, -83.68, 300.0)
    ecef = np.array(pymap3d.geodetic2ecef(*place))
    np.testing.assert_allclose(ORIGIN.ecef_to_world(ecef), ORIGIN.to_world(*place), atol=1e-7)


def test_the_origin_on_the_equator_is_one_earth_radius_out_along_x():
    ecef = Origin(0.0, 0.0, 0.0).world_to_ecef([1.0, 2.0, 3.0])  # x is up, y east, z north
    np.testing.assert_allclose(ecef, [6_378_137.0 + 3.0, 1.0, 2.0], atol=1e-8)


def test_the_origin_is_the_zero_of_the_world():
    np.testing.assert_allclose(ORIGIN.to_world(42.30, -83.70, 260.0), np.zeros(3), atol=1e-8)


@pytest.mark.parametrize(
    ("place", "hint"),
    [((91, 0, 0), "swapped with longitude"), ((0, 361, 0), "longitude 361"),
     ((0, 0, 260_000), "in mm or cm"), ((float("nan"), 0, 0), "latitude nan")],
)  # fmt: skip
def test_an_origin_off_the_earth_is_refused(place, hint):
    with pytest.raises(InputError, match=hint):
        Origin(*place)


# Rotations


def test_a_rotation_is_told_from_what_mirrors_scales_or_shears():
    R = frames.exp_so3([0.1, 2.0, -0.4])
    stack = np.stack([R, -R, 1.001 * R, R + 1e-3, np.zeros((3, 3))])
    assert frames.is_rotation(stack, 1e-6).tolist() == [True] + [False] * 4
    assert frames.is_rotation(R.round(6), 1e-5) and frames.is_rotation(R + 1e-4, 1e-3)


def test_frames_of_the_trade_turn_into_ours():
    np.testing.assert_array_equal(frames.R_FLU_FRD @ [1, 2, 3], [1, -2, -3])
    np.testing.assert_array_equal(frames.R_ENU_NED @ [1, 2, 3], [2, 1, -3])
    for R in (frames.R_FLU_FRD, frames.R_ENU_NED):
        np.testing.assert_array_equal(R @ R, np.eye(3))
        assert np.linalg.det(R) == pytest.approx(1)


def test_a_quarter_turn_about_up_brings_east_to_north():
    np.testing.assert_allclose(frames.exp_so3([0, 0, np.pi / 2]) @ [1, 0, 0], [0, 1, 0], atol=1e-15)


@given(ROTVECS)
def test_exp_gives_a_rotation_about_the_vector_itself(rotvec):
    R = frames.exp_so3(rotvec)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1, abs=1e-14)
    np.testing.assert_allclose(R @ rotvec, rotvec, atol=1e-14)
    assert np.trace(R) == pytest.approx(1 + 2 * np.cos(np.linalg.norm(rotvec)), abs=1e-14)


@given(ROTVECS)
def test_log_undoes_exp(rotvec):
    np.testing.assert_allclose(frames.log_so3(frames.exp_so3(rotvec)), rotvec, rtol=0, atol=1e-13)


@given(DIRECTIONS)
def test_log_of_a_half_turn_is_the_axis_in_either_sense(direction):
    axis = direction / np.linalg.norm(direction)
    R = 2 * np.outer(axis, axis) - np.eye(3)
    rotvec = frames.log_so3(R)
    assert np.linalg.norm(rotvec) == pytest.approx(np.pi)
    np.testing.assert_allclose(np.cross(rotvec, axis), np.zeros(3), atol=1e-7)


def test_log_of_no_turn_is_zero():
    np.testing.assert_array_equal(frames.log_so3(np.eye(3)), np.zeros(3))


@given(ROTVECS, DIRECTIONS)
def test_the_right_jacobian_is_the_derivative_of_exp(rotvec, direction):
    h = 1e-5
    Jr = frames.right_jacobian_so3(rotvec)
    R = frames.exp_so3(rotvec)
    ahead, back = frames.exp_so3(rotvec + h * direction), frames.exp_so3(rotvec - h * direction)
    difference = (frames.log_so3(R.T @ ahead) - frames.log_so3(R.T @ back)) / (2 * h)
    np.testing.assert_allclose(Jr @ direction, difference, rtol=0, atol=1e-8)


@given(ROTVECS)
def test_the_inverse_of_the_right_jacobian_is_its_inverse(rotvec):
    product = frames.right_jacobian_so3(rotvec) @ frames.right_jacobian_inverse_so3(rotvec)
    np.testing.assert_allclose(product, np.eye(3), atol=1e-12)


@given(ROTVECS)
def test_quaternion_and_back_is_the_same_rotation(rotvec):
    R = frames.exp_so3(rotvec)
    q = frames.matrix_to_quat_xyzw(R)
    assert np.linalg.norm(q) == pytest.approx(1, abs=1e-15)
    np.testing.assert_allclose(frames.quat_to_matrix(q), R, rtol=0, atol=1e-14)


@pytest.mark.parametrize("axis", range(3))
def test_half_turns_about_the_axes_have_a_quaternion(axis):
    R = -np.eye(3)
    R[axis, axis] = 1.0
    q = frames.matrix_to_quat_xyzw(R)
    np.testing.assert_array_equal(np.abs(q), np.eye(4)[axis])


def test_the_scalar_of_a_quaternion_comes_last():
    q = frames.matrix_to_quat_xyzw(frames.exp_so3([0, 0, np.pi / 3]))
    np.testing.assert_allclose(q, [0, 0, 0.5, np.sqrt(0.75)], atol=1e-15)


def test_a_quaternion_of_any_length_is_the_same_rotation():
    q = np.array([0.1, -0.2, 0.3, 0.9])
    np.testing.assert_allclose(
        frames.quat_to_matrix(-5 * q), frames.quat_to_matrix(q), rtol=0, atol=1e-15
    )


@given(arrays(float, (2, 3), elements=st.floats(-10, 10)))
def test_skew_is_the_cross_product(pair):
    a, b = pair
    np.testing.assert_allclose(frames.skew(a) @ b, np.cross(a, b), atol=1e-12)


@pytest.mark.parametrize(
    "function",
    [frames.exp_so3, frames.right_jacobian_so3, frames.right_jacobian_inverse_so3, frames.skew],
)
def test_a_stack_of_vectors_is_one_after_the_other(function):
    stack = np.random.default_rng(1).standard_normal((2, 3, 3))
    single = [[function(v) for v in row] for row in stack]
    np.testing.assert_allclose(function(stack), single, rtol=0, atol=1e-15)


@given(st.floats(-3.1415, 3.1415))
def test_yaw_of_a_level_attitude_is_the_yaw_it_was_made_of(yaw_rad):
    assert frames.yaw_of(frames.yaw_matrix(yaw_rad)) == pytest.approx(yaw_rad, abs=1e-12)


def test_yaw_is_that_of_the_forward_axis_even_on_a_slope():
    nose_up = frames.yaw_matrix(0.7) @ frames.exp_so3([0.1, -0.3, 0.0])
    forward = nose_up[:, 0]
    assert frames.yaw_of(nose_up) == pytest.approx(np.arctan2(forward[1], forward[0]))


@given(st.floats(-3.14, 3.14), st.integers(-5, 5))
def test_wrapping_takes_whole_turns_away(angle_rad, turns):
    wrapped = frames.wrap_pi(angle_rad + 2 * np.pi * turns)
    assert wrapped == pytest.approx(angle_rad, abs=1e-13)


def test_wrapping_gives_minus_pi_for_the_half_turn():
    assert frames.wrap_pi([np.pi, -np.pi, 3 * np.pi]).tolist() == [-np.pi] * 3
