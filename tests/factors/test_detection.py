"""Detections: the documented laws by hand, and what a survey's error does to them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fgloc.factors import detection
from fgloc.frames import exp_so3


@pytest.mark.parametrize(
    ("distance_m", "sigma_m"),
    [(0.0, 0.702), (10.0, 0.192), (30.0, 0.828), (60.0, 2.358), (13.76, 0.1)],
)
def test_lees_law_has_a_floor(distance_m, sigma_m):
    assert detection.lee2021_sigma_m(distance_m, 0.1) == pytest.approx(sigma_m, abs=1e-9)


def test_khamooshis_variance_grows_with_the_square_of_the_range():
    near, far = detection.khamooshi2023_sigma_m([10.0, 30.0]) ** 2
    assert far == pytest.approx(9 * near)


@given(st.floats(-3.1, 3.1), st.floats(0.1, 5), st.floats(0.1, 5))
def test_sigmas_lie_along_the_line_of_sight_and_across_it(angle_rad, along_m, across_m):
    u = np.array([np.cos(angle_rad), np.sin(angle_rad)])
    (cov,) = detection.line_of_sight_cov_m2(30 * u[None], along_m, across_m)
    assert u @ cov @ u == pytest.approx(along_m**2)
    w = np.array([-u[1], u[0]])
    assert w @ cov @ w == pytest.approx(across_m**2)
    assert u @ cov @ w == pytest.approx(0, abs=1e-12)


def test_a_survey_turned_by_a_degree_moves_what_is_60_m_away_by_a_metre():
    z, node = np.array([[70.0, 10.0, 0.0]]), np.array([10.0, 10.0, 6.0])
    (J,) = detection.by_survey(z, node, np.array([True]))
    turn = np.deg2rad(1.0)
    np.testing.assert_allclose(J @ [0, 0, turn, 0, 0, 0], [0, 60 * turn, 0])
    np.testing.assert_allclose(J @ [0.3, -0.2, 0, 0.1, 0, 0], [0.3, -0.2, 0.1])
    # A lean to the East sinks what is there; what is below the node goes West.
    np.testing.assert_allclose(J @ [0, 0, 0, 0, 0, turn], [-6 * turn, 0, -60 * turn])


def test_a_node_that_tells_no_height_feels_its_survey_in_the_plane_alone():
    z, node = np.array([[70.0, 10.0, 0.0]] * 2), np.array([10.0, 20.0, 6.0])
    flat, high = detection.by_survey(z, node, np.array([False, True]))
    np.testing.assert_array_equal(flat[:, :3], high[:, :3])
    assert not flat[:, 3:].any() and not flat[2].any()


def test_the_jacobian_by_the_survey_is_the_slope():
    z, node, eps = np.array([[70.0, -30.0, 0.0]]), np.array([10.0, 10.0, 6.0]), 1e-6
    (J,) = detection.by_survey(z, node, np.array([True]))
    arm = (z - node)[0]
    for column, axis in ((2, [0, 0, 1]), (4, [1, 0, 0]), (5, [0, 1, 0])):
        turned = exp_so3(eps * np.array([axis], float))[0] @ arm
        np.testing.assert_allclose(J[:, column], (turned - arm) / eps, atol=1e-4)
