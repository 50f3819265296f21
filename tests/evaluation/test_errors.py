"""Errors of a trajectory against its truth, by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgloc import frames
from fgloc.errors import InputError
from fgloc.evaluation import (
    errors,
    score,
    score_errors,
)
from fgloc.trajectory import Trajectory

from .curves import CONTRACT, START, S, curve, straight


def test_errors_due_north_split_into_left_and_ahead():
    e = errors(*straight([[-2.0, 3.0, 0.5], [1.0, 0.0, 0.0]], yaw_error=[0.1, -0.2]))
    np.testing.assert_allclose(e.lateral_m, [2.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(e.longitudinal_m, [3.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(e.up_m, [0.5, 0.0])
    np.testing.assert_allclose(e.yaw_rad, [0.1, -0.2])
    np.testing.assert_allclose(e.rotvec_rad, [[0, 0, 0.1], [0, 0, -0.2]], atol=1e-12)
    np.testing.assert_allclose(e.horizontal_m, [np.sqrt(13), 1.0])


def test_yaw_error_is_wrapped():
    e = errors(*straight(np.zeros((2, 3)), yaw_error=[2 * np.pi - 0.1, np.pi + 0.5]))
    np.testing.assert_allclose(e.yaw_rad, [-0.1, 0.5 - np.pi])


def test_sigmas_follow_the_truths_direction():
    cov = np.diag([4.0, 9.0, 16.0, 1e-4, 1e-4, 4e-4])
    estimate, truth = straight(np.zeros((3, 3)), cov=np.tile(cov, (3, 1, 1)))
    e = errors(estimate, truth)
    np.testing.assert_allclose(e.sigma_lateral_m, 2.0)
    np.testing.assert_allclose(e.sigma_longitudinal_m, 3.0)
    np.testing.assert_allclose(e.sigma_up_m, 4.0)
    np.testing.assert_allclose(e.sigma_yaw_rad, 0.02)


def test_sigma_of_yaw_on_a_slope_follows_finite_differences():
    pitched = frames.exp_so3([0.2, -0.3, 0.4])
    cov = np.zeros((6, 6))
    cov[3:, 3:] = np.outer([0.01, 0.02, 0.03], [0.01, 0.02, 0.03])
    estimate = Trajectory(np.array([START]), np.zeros((1, 3)), pitched[None], None, cov[None])
    turned = frames.exp_so3(1e-5 * np.array([0.01, 0.02, 0.03])) @ pitched
    expected = abs(frames.yaw_of(turned) - frames.yaw_of(pitched)) / 1e-5
    e = errors(estimate, estimate)
    # The trajectory stands in for its own truth, so its covariance is counted twice.
    np.testing.assert_allclose(e.sigma_yaw_rad[0], np.sqrt(2) * expected, rtol=1e-4)


def test_truths_covariance_is_added():
    cov = np.tile(np.eye(6), (4, 1, 1))
    estimate, truth = straight(np.full((4, 3), 1.0), cov=3 * cov)
    noisy = Trajectory(truth.t_ns, truth.p_world_m, truth.R_world_veh, None, cov)
    np.testing.assert_allclose(errors(estimate, truth).nees_position, 1.0)
    np.testing.assert_allclose(errors(estimate, noisy).nees_position, 0.75)


def test_lever_arm_is_carried_through_the_estimates_attitude():
    antenna = np.array([1.5, 0.2, 1.8])
    e = errors(curve(), curve(point=antenna))
    np.testing.assert_allclose(e.p_world_m, 0, atol=1e-9)
    estimate, truth = straight(np.zeros((3, 3)), yaw_error=np.full(3, 0.01))
    moved = errors(estimate, truth.at_point([2.0, 0, 0]))
    np.testing.assert_allclose(moved.lateral_m, 2 * np.sin(0.01))


def test_lever_arm_carries_the_covariance():
    cov = np.diag([0, 0, 0, 0, 0, 1e-4]) + np.diag([1e-6] * 6)
    estimate, truth = straight(np.zeros((2, 3)), cov=np.tile(cov, (2, 1, 1)))
    e = errors(estimate, truth.at_point([2.0, 0, 0]))
    np.testing.assert_allclose(e.sigma_lateral_m, np.sqrt(4 * (1e-4 + 1e-6) + 1e-6))


def test_lever_arm_is_carried_through_the_truths_attitude_where_the_estimate_has_none():
    e = errors(curve(attitude=False, point=(1.0, 0.2, 0)), curve())
    np.testing.assert_allclose(e.p_world_m, 0, atol=1e-9)


def test_lever_arm_without_any_attitude_is_refused():
    with pytest.raises(InputError, match="neither has an attitude to carry it"):
        errors(curve(attitude=False), curve(attitude=False, point=(1.0, 0, 0)))


def test_truth_left_out_is_counted_and_adds_up():
    truth = curve(200)
    rows = np.r_[20:80, 120:180]
    e = errors(truth.take(rows), truth, score_from_ns=int(truth.t_ns[30]))
    assert e.left_out == {
        "before the start of scoring": 30,
        "outside the time of the estimate": 20,
        "in a gap of the estimate over 1.5 s": 40,
    }
    assert len(e) + sum(e.left_out.values()) == e.n_truth == 200


def test_states_once_a_second_still_cover_everything():
    e = errors(curve(21, rate_hz=1.0), curve(200))
    assert len(e) == 200
    assert np.abs(e.p_world_m).max() < 0.01


def test_truth_without_attitude_is_split_by_its_course():
    for velocity in (True, False):
        e = errors(curve(cov=np.eye(6)), curve(attitude=False, velocity=velocity))
        assert e.course_based
        np.testing.assert_allclose(e.yaw_rad[5:-5], 0, atol=1e-3)
        assert np.isnan(e.rotvec_rad).all()
        assert e.why["nees_pose"] == "the truth has no attitude"


def test_slow_truth_without_attitude_has_no_direction():
    n = 40
    t = START + np.arange(n) * S // 10
    speed = np.linspace(0, 6, n)
    v = np.stack([speed, np.zeros(n), np.zeros(n)], -1)
    p = np.cumsum(v * 0.1, axis=0)
    estimate = Trajectory(t, p, frames.yaw_matrix(np.zeros(n)))
    e = errors(estimate, Trajectory(t, p, None, v))
    np.testing.assert_array_equal(np.isfinite(e.lateral_m), speed >= 1.0)
    np.testing.assert_array_equal(np.isfinite(e.yaw_rad), speed >= 4.0)
    assert score_errors(e)["lateral_rmse_m"].n == (speed >= 1.0).sum()


def test_against_itself_everything_is_zero():
    drive = curve(cov=np.eye(6))
    scores = score(drive, drive)
    for name in CONTRACT - {"anees", "coverage95"}:
        assert scores[name].value == pytest.approx(0, abs=1e-9), name
    assert scores["anees"].value == pytest.approx(0, abs=1e-9)
    assert scores["coverage95"].value == 1.0


@given(st.integers(0, 10_000), st.floats(-np.pi, np.pi))
@settings(max_examples=30, deadline=None)
def test_lateral_and_longitudinal_do_not_depend_on_where_north_is(seed, turn_rad):
    rng = np.random.default_rng(seed)
    truth = curve(20)
    noise = frames.exp_so3(rng.normal(0, 0.1, (20, 3)))
    estimate = Trajectory(
        truth.t_ns, truth.p_world_m + rng.normal(0, 2, (20, 3)), noise @ truth.attitude(), None,
        np.tile(np.diag(rng.uniform(0.5, 2, 6)), (20, 1, 1)),
    )  # fmt: skip
    a, b = errors(estimate, truth), errors(turned(estimate, turn_rad), turned(truth, turn_rad))
    np.testing.assert_allclose(a.lateral_m**2 + a.longitudinal_m**2, a.horizontal_m**2, atol=1e-9)
    for name in ("lateral_m", "longitudinal_m", "yaw_rad", "nees_pose", "sigma_lateral_m"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=1e-6, err_msg=name)


def turned(trajectory, yaw_rad):
    """The whole world turned about the vertical."""
    R = frames.yaw_matrix(yaw_rad)
    J = np.kron(np.eye(2), R)
    cov = None if trajectory.cov is None else J @ trajectory.cov @ J.T
    return Trajectory(
        trajectory.t_ns, trajectory.p_world_m @ R.T, R @ trajectory.attitude(), None, cov
    )
