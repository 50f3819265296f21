"""Detections of a swaying node: golden shifts, Jacobians, and the way back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fgloc.errors import InputError
from fgloc.factors.post import pose_jacobian
from fgloc.factors.sway import compensated, linear_row, reported, residual
from fgloc.infrastructure import Node, Post

POST = Post("isn-1", 10.0, 1.97, 0.05, 20.0, 0.138, 200.0, 0.3)
AHEAD = np.array([[20.0, 0, -10], [40, 0, -10], [60, 0, -10]])
PITCH = np.tile([0.0, 0, 0, 0.01], (3, 1))


def without_height(place_m):
    """As a node reports it that tells no heights."""
    return np.where([False, False, True], np.nan, place_m)


def test_ten_milliradians_shift_a_camera_by_metres_and_a_lidar_by_a_decimetre():
    at_rest = np.zeros((3, 4))
    by_sway = reported(AHEAD, at_rest, "camera")[2]
    np.testing.assert_allclose(by_sway[:, 0, 3] * 0.01, [0.5, 1.7, 3.7])
    np.testing.assert_allclose(reported(AHEAD, at_rest, "lidar")[2][:, 0, 3] * 0.01, 0.1)
    # Exactly, to either side, the far ones shift by more and by less.
    far = reported(AHEAD, PITCH, "camera")[0][2, 0] - 60
    near = reported(AHEAD, -PITCH, "camera")[0][2, 0] - 60
    assert (far, near) == (pytest.approx(3.94, abs=0.01), pytest.approx(-3.49, abs=0.01))


def test_ten_milliradians_lift_what_a_lidar_sees_by_a_hundredth_of_its_distance():
    by_sway = reported(AHEAD, np.zeros((3, 4)), "lidar")[2]
    np.testing.assert_allclose(by_sway[:, 2, 3] * 0.01, [0.2, 0.4, 0.6])
    # It leans forward, so that what is ahead rises; exactly, by x sin t - h cos t.
    lifted = reported(AHEAD, PITCH, "lidar")[0][:, 2] + 10
    expected = np.array([20, 40, 60]) * np.sin(0.01) + 10 * (1 - np.cos(0.01))
    np.testing.assert_allclose(lifted, expected, atol=1e-12)
    # A turn about the x axis sinks what is to the left.
    left = np.array([[0.0, 60, -10]])
    assert reported(left, np.zeros((1, 4)), "lidar")[2][0, 2, 2] == -60
    # What a camera sees stays on the ground.
    np.testing.assert_array_equal(reported(AHEAD, PITCH, "camera")[0][:, 2], -10)


def test_a_node_that_moved_east_sees_all_further_west():
    moved = np.tile([0.1, 0.2, 0, 0], (3, 1))
    for sensor in ("camera", "lidar"):
        told = reported(AHEAD, moved, sensor)[0]
        np.testing.assert_allclose(told, AHEAD - [0.1, 0.2, 0])


@pytest.mark.parametrize("sensor", ["camera", "lidar"])
def test_jacobians_are_those_of_differences(sensor):
    rng = np.random.default_rng(0)
    p_m, told = rng.uniform(-50, 50, (2, 20, 3))
    p_m[:, 2] = rng.uniform(-12, -8, 20)
    told[::3, 2] = np.nan
    states = rng.standard_normal((20, 6)) * [0.1, 1, 5, 0.1, 1, 5]

    def error(place, state):
        return residual(place, told, state, 0.138, sensor).error

    found, step = residual(p_m, told, states, 0.138, sensor), 1e-6
    for k in range(3):
        by = step * np.eye(3)[k]
        change = (error(p_m + by, states) - error(p_m - by, states)) / (2 * step)
        np.testing.assert_allclose(found.by_point[:, :, k], change, atol=1e-6)
    for k in range(6):
        by = step * np.eye(6)[k]
        change = (error(p_m, states + by) - error(p_m, states - by)) / (2 * step)
        np.testing.assert_allclose(found.by_post[:, :, k], change, atol=1e-5)
    assert not found.error[::3, 2].any() and not found.by_point[::3, 2].any()


@given(
    st.floats(-60, 60), st.floats(-60, 60), st.floats(-0.2, 0.2), st.floats(-0.03, 0.03),
    st.floats(-0.03, 0.03), st.sampled_from(["camera", "lidar"]),
)  # fmt: skip
def test_a_known_sway_is_taken_back_exactly(x, y, moved, roll, pitch, sensor):
    p_m, sway = np.array([[x, y, -10]]), np.array([[moved, -moved / 2, roll, pitch]])
    told = without_height(reported(p_m, sway, sensor)[0])
    np.testing.assert_allclose(compensated(told, sway, 10.0, sensor), p_m, atol=1e-7)


@given(st.floats(-60, 60), st.floats(-14, 3), st.floats(-0.2, 0.2), st.floats(-0.05, 0.05))
def test_a_height_that_is_told_needs_no_ground(x, up, moved, tilt):
    p_m, sway = np.array([[x, 20.0, up]]), np.array([[moved, 0.1, tilt, -tilt]])
    told = reported(p_m, sway, "lidar")[0]
    np.testing.assert_allclose(compensated(told, sway, 10.0, "lidar"), p_m, atol=1e-9)


NODE = Node("isn-1", np.array([5.0, 7, 12]), np.pi / 2)
PITCHED = np.array([[0.01 / 0.138, 0, 0, 0, 0, 0]])  # a pitch of 10 mrad


def test_a_linear_row_leaves_a_sixteenth_and_renewed_nothing():
    told = without_height(reported(AHEAD[2:], PITCHED @ pose_jacobian(0.138).T, "camera")[0])
    true = NODE.place_to_world(AHEAD[2:])[0]
    J, z = linear_row(told, POST, NODE, 10.0, "camera")
    np.testing.assert_allclose(z[:, :2], NODE.to_world(told[:, :2]))
    left_m = np.linalg.norm(z[0] - J[0] @ PITCHED[0] - true)
    shift_m = np.linalg.norm(z[0] - true)
    assert 1 / 20 < left_m / shift_m < 1 / 15
    J, z = linear_row(told, POST, NODE, 10.0, "camera", PITCHED)
    np.testing.assert_allclose(z[0] - J[0] @ PITCHED[0], true, atol=1e-9)


@pytest.mark.parametrize(("sensor", "up"), [("camera", np.nan), ("lidar", np.nan), ("lidar", -9.3)])
def test_a_row_about_a_state_is_the_derivative_of_the_way_back(sensor, up):
    told, state, step = np.array([[35.0, -12, up]]), np.array([[0.1, 0, 0, -0.08, 0, 0]]), 1e-6
    J, z = linear_row(told, POST, NODE, 10.0, sensor, state)

    def back(state):
        return NODE.place_to_world(compensated(told, state @ pose_jacobian(0.138).T, 10.0, sensor))[
            0
        ]

    np.testing.assert_allclose(z[0] - J[0] @ state[0], back(state), atol=1e-12)
    for k in range(6):
        by = step * np.eye(6)[[k]]
        change = (back(state + by) - back(state - by)) / (2 * step)
        np.testing.assert_allclose(-J[0, :, k], change, atol=1e-5)
    assert J[0, 2].any() == np.isfinite(up)


def test_the_row_is_in_world_axes():
    told = np.array([[20.0, 0, np.nan], [20.0, 0, -10]])
    for along in linear_row(told, POST, NODE, 10.0, "lidar")[0][:, :2]:
        # A step along the node's x axis, to the North, moves it and tilts it by 0.138 rad a metre.
        np.testing.assert_allclose(along[:, 0], [0, -1 + 10 * 0.138], atol=1e-12)
        np.testing.assert_allclose(along[:, 3], [-(-1 + 10 * 0.138), 0], atol=1e-12)
        np.testing.assert_array_equal(along[:, [1, 2, 4, 5]], 0)


def test_a_row_of_a_height_says_how_a_lean_lifts_what_is_ahead():
    J, z = linear_row(np.array([[20.0, 0, -10]]), POST, NODE, 10.0, "lidar")
    # Leaning forward by 0.138 rad a metre lifts what is 20 m ahead by 2.76 m a metre.
    np.testing.assert_allclose(J[0, 2], [20 * 0.138, 0, 0, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(z[0], [5, 27, 2], atol=1e-12)


def test_what_lies_above_the_horizon_is_refused():
    with pytest.raises(InputError, match="detection 1: the camera sees it above its horizon"):
        reported(AHEAD, np.tile([0, 0, 0, 0.3], (3, 1)), "camera")
