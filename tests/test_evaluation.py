"""Errors, metrics, consistency, bootstrap and outages against numbers worked out by hand."""

import json
import time

import numpy as np
import pytest
import scipy.special
from hypothesis import given, settings
from hypothesis import strategies as st

from fgloc import frames
from fgloc.errors import InputError
from fgloc.evaluation import (
    Bootstrap,
    Metric,
    anees_band,
    chi2_quantile,
    effective_samples,
    error_growth,
    errors,
    gnss_outages,
    nees,
    outages,
    paired_difference,
    score,
    score_errors,
    used_fixes_ns,
)
from fgloc.measurements import GnssFixes
from fgloc.result import Result
from fgloc.trajectory import Trajectory
from fgloc.verdicts import SourceVerdicts, Verdict

CONTRACT = {
    "horizontal_rmse_m", "horizontal_mean_m", "horizontal_std_m", "horizontal_p95_m",
    "horizontal_max_m", "lateral_rmse_m", "longitudinal_rmse_m", "lateral_mean_abs_m",
    "lateral_std_abs_m", "longitudinal_mean_abs_m", "longitudinal_std_abs_m", "yaw_rmse_rad",
    "anees", "coverage95",
}  # fmt: skip
S = 1_000_000_000
START = 1_750_000_000 * S


def curve(n=200, rate_hz=10.0, cov=None, *, attitude=True, velocity=True, point=(0.0, 0, 0)):
    """A vehicle on a circle of 100 m at 10 m/s, seen at its origin or at `point`."""
    t = np.arange(n) / rate_hz
    yaw = 0.3 + 0.1 * t
    p = 100 * np.stack([np.sin(yaw), -np.cos(yaw), np.zeros(n)], -1)
    R = frames.yaw_matrix(yaw)
    v = 10 * R[:, :, 0]
    lever = np.asarray(point, float)
    return Trajectory(
        START + np.rint(t * S).astype(np.int64),
        p + R @ lever,
        R if attitude else None,
        v + np.cross([0, 0, 0.1], R @ lever) if velocity else None,
        None if cov is None else np.broadcast_to(cov, (n, 6, 6)),
        lever,
    )


def straight(p_error, yaw_error=None, cov=None, rate_hz=10.0):
    """An estimate with given errors (N, 3) and yaw errors (N,) of a drive due north, and truth."""
    p_error = np.asarray(p_error, float)
    n = len(p_error)
    t = START + np.rint(np.arange(n) / rate_hz * S).astype(np.int64)
    p = np.stack([np.zeros(n), np.arange(n) * 1.0, np.zeros(n)], -1)
    yaw = np.full(n, np.pi / 2)
    truth = Trajectory(t, p, frames.yaw_matrix(yaw))
    wrong = yaw + (np.zeros(n) if yaw_error is None else yaw_error)
    return Trajectory(t, p + p_error, frames.yaw_matrix(wrong), None, cov), truth


# --- errors


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


# --- metrics


def test_metrics_of_five_errors_by_hand():
    # Horizontal 0, 1, 2, 3, 4: mean 2, mean square 6, population variance 2, p95 = 3.8.
    scores = score(*straight([[0, 0, 1], [0, 1, 1], [0, -2, 1], [0, 3, 1], [0, 4, 1]]))
    assert scores["horizontal_rmse_m"].value == pytest.approx(np.sqrt(6))
    assert scores["horizontal_mean_m"].value == pytest.approx(2)
    assert scores["horizontal_std_m"].value == pytest.approx(np.sqrt(2))
    assert scores["horizontal_p95_m"].value == pytest.approx(3.8)
    assert scores["horizontal_max_m"].value == pytest.approx(4)
    assert scores["up_rmse_m"].value == pytest.approx(1)
    assert scores["longitudinal_mean_abs_m"].value == pytest.approx(2)
    assert scores["longitudinal_std_abs_m"].value == pytest.approx(np.sqrt(2))
    assert scores["lateral_rmse_m"].value == pytest.approx(0, abs=1e-12)
    assert scores["horizontal_rmse_m"].n == 5


def test_score_holds_the_promised_names_and_says_why_a_value_is_missing():
    scores = score(curve(attitude=False), curve(attitude=False))
    assert set(scores) >= CONTRACT
    assert scores["yaw_rmse_rad"].why == "the estimate has no attitude"
    assert scores["anees"].why == scores["coverage95"].why == "the estimate has no covariance"
    assert scores["lateral_rmse_m"].note.startswith("by the truth's course")
    written = json.loads(json.dumps({name: m.to_dict() for name, m in scores.items()}))
    assert written["anees"]["value"] is None
    assert {"value", "unit", "better", "n"} <= written["horizontal_rmse_m"].keys()


def test_score_starts_so_many_seconds_after_the_first_state():
    truth = curve(100)
    scores = score(truth.take(slice(10, None)), truth, score_from_s=2.0)
    assert scores["horizontal_rmse_m"].n == 70
    assert scores["scored_share"].value == pytest.approx(0.7)
    assert "30 rows before the start of scoring" in scores["scored_share"].note


def test_nothing_to_score_is_said_and_not_raised():
    truth = curve(20)
    later = Trajectory(truth.t_ns + 100 * S, truth.p_world_m, truth.R_world_veh)
    for estimate in (later, truth.take(slice(0, 0))):
        scores = score(estimate, truth)
        assert scores["horizontal_rmse_m"].value is None
        assert scores["horizontal_rmse_m"].why == "no truth row could be scored"
        assert scores["scored_share"].value == 0.0


def test_a_metric_has_a_finite_value_or_a_reason():
    with pytest.raises(InputError, match="must say why"):
        Metric(None, "m")
    with pytest.raises(InputError, match="finite"):
        Metric(float("nan"), "m")


# --- consistency


def test_nees_by_hand():
    cov = np.array([np.diag([4.0, 9.0]), [[2.0, 1.0], [1.0, 2.0]]])
    np.testing.assert_allclose(nees(np.array([[2.0, 3.0], [1.0, 1.0]]), cov), [2.0, 2 / 3])


def test_nees_of_a_singular_covariance_is_unknown():
    cov = np.array([np.diag([1.0, 0.0]), np.ones((2, 2)), np.eye(2)])
    result = nees(np.ones((3, 2)), cov)
    assert np.isnan(result[:2]).all() and result[2] == pytest.approx(2)


def test_a_planar_estimate_is_judged_in_the_plane():
    cov = np.tile(np.diag([1.0, 1.0, 0, 0, 0, 0.01]), (5, 1, 1))
    scores = score(*straight([[1.0, 1.0, 0]] * 5, cov=cov))
    assert scores["anees"].value == pytest.approx(1.0)
    assert scores["anees"].note == "East and North, 2 degrees of freedom"
    assert scores["anees_position"].why.startswith("a covariance is not positive definite")
    assert scores["coverage95"].value == 1.0


def test_chi_square_quantiles_of_the_tables():
    expected = [3.841, 5.991, 7.815, 12.592]
    np.testing.assert_allclose(chi2_quantile(0.95, [1, 2, 3, 6]), expected, atol=5e-4)


@pytest.mark.parametrize("probability", [1e-9, 0.025, 0.5, 0.95, 0.9999, 1 - 1e-12])
def test_chi_square_quantiles_are_scipys(probability):
    dof = np.array([0.5, 1, 2, 3, 6, 59.5, 61, 1234.5, 1e5])
    expected = 2 * scipy.special.gammaincinv(dof / 2, probability)
    np.testing.assert_allclose(chi2_quantile(probability, dof), expected, rtol=1e-10)


def test_chi_square_quantiles_at_the_ends():
    assert chi2_quantile(1.0, 3) == np.inf
    assert chi2_quantile(0.0, 3) == 0.0
    with pytest.raises(ValueError, match="no quantile"):
        chi2_quantile(0.5, 0)


def test_band_of_a_hundred_runs():
    # Bar-Shalom's form: 200 degrees of freedom, two-sided 95 %: [162.7, 241.1] / 200.
    assert anees_band(100, 2) == pytest.approx((0.8136, 1.2053), abs=1e-3)
    with pytest.raises(InputError):
        anees_band(0, 3)


def test_anees_of_honest_errors_lies_in_its_band():
    rng = np.random.default_rng(7)
    A = rng.normal(size=(6, 6))
    P = np.diag([1, 1, 1, 0.01, 0.01, 0.01]) @ (A @ A.T + np.eye(6))
    P = 1e-4 * (P + P.T) + np.diag([1, 1, 1, 1e-3, 1e-3, 1e-3])
    truth = curve(2000)
    x = rng.multivariate_normal(np.zeros(6), P, 2000)
    estimate = Trajectory(
        truth.t_ns, truth.p_world_m + x[:, :3], frames.exp_so3(x[:, 3:]) @ truth.attitude(), None,
        np.tile(P, (2000, 1, 1)),
    )  # fmt: skip
    scores = score(estimate, truth)
    low, high = anees_band(2000, 6)
    assert low < scores["anees"].value < high
    assert scores["anees"].note == "position and attitude, 6 degrees of freedom"
    assert scores["anees_band_low"].value < scores["anees"].value < scores["anees_band_high"].value
    assert scores["coverage95"].value == pytest.approx(0.95, abs=0.015)
    assert scores["coverage95"].low < 0.95 < scores["coverage95"].high


def test_effective_samples_of_white_and_of_correlated_noise():
    rng = np.random.default_rng(1)
    white = rng.normal(size=20_000)
    assert effective_samples(white) > 15_000
    a = 0.9
    correlated = np.zeros(20_000)
    for k in range(1, len(white)):
        correlated[k] = a * correlated[k - 1] + white[k]
    # First-order autoregression: N (1 - a) / (1 + a).
    assert effective_samples(correlated) == pytest.approx(20_000 * 0.1 / 1.9, rel=0.25)
    assert effective_samples(np.ones(50)) == 50


# --- bootstrap


def test_interval_of_independent_errors_is_the_textbook_one():
    rng = np.random.default_rng(3)
    x = rng.normal(1.0, 1.0, 4000)
    t = START + np.arange(4000) * S // 10
    low, high = Bootstrap(block_s=0.1).mean(x, t)
    assert low < x.mean() < high
    assert high - low == pytest.approx(2 * 1.96 / np.sqrt(4000), rel=0.15)


def test_blocks_widen_the_interval_of_correlated_errors():
    rng = np.random.default_rng(4)
    x = np.repeat(rng.normal(size=400), 10)
    t = START + np.arange(4000) * S // 10
    narrow, wide = (Bootstrap(block_s=b).mean(x, t) for b in (0.1, 10.0))
    assert wide[1] - wide[0] > 2 * (narrow[1] - narrow[0])


def test_intervals_hold_their_values_and_repeat():
    rng = np.random.default_rng(5)
    estimate, truth = straight(rng.normal(0, 1, (500, 3)))
    first, second = score(estimate, truth), score(estimate, truth)
    for name in ("horizontal_rmse_m", "horizontal_mean_m", "horizontal_std_m", "horizontal_p95_m"):
        assert first[name].low <= first[name].value <= first[name].high
        assert first[name] == second[name]


def test_the_interval_of_a_quantile_is_not_misled_by_errors_that_come_and_go():
    """Ten rows between two fixes, the error largest at the fix: every tenth row sees no other."""
    n = 20_000
    x = np.abs(np.random.default_rng(0).normal(size=n)) * np.where(np.arange(n) % 10 == 0, 3.0, 0.5)
    low, high = Bootstrap().quantile(x, np.arange(n) * (S // 10), 0.95)
    assert low <= np.quantile(x, 0.95) <= high


def test_too_few_errors_have_no_interval():
    metric = score(*straight(np.ones((5, 3))))["horizontal_rmse_m"]
    assert metric.low is None and metric.high is None


def test_scoring_is_fast():
    rng = np.random.default_rng(6)
    cov = np.tile(np.eye(6), (2000, 1, 1))
    estimate, truth = straight(rng.normal(0, 1, (2000, 3)), cov=cov)
    score(estimate, truth)  # the first call imports scipy
    start = time.perf_counter()
    Bootstrap().rmse(errors(estimate, truth).horizontal_m, truth.t_ns)
    score(estimate, truth)
    assert time.perf_counter() - start < 2.0


def test_paired_difference_of_the_same_luck():
    rng = np.random.default_rng(8)
    common = rng.normal(0, 1, (1000, 3))
    better, truth = straight(common)
    worse, _ = straight(1.1 * common)
    a, b = errors(better, truth), errors(worse, truth)
    difference = paired_difference(a, b)
    rmse = np.sqrt(np.mean(a.horizontal_m**2))
    assert difference.value == pytest.approx(-0.1 * rmse)
    assert difference.low < difference.value < difference.high < 0
    assert difference.n == 1000
    # Unpaired intervals of the two overlap; only the pairing tells them apart.
    separate = [score_errors(e)["horizontal_rmse_m"] for e in (a, b)]
    assert difference.high - difference.low < 0.5 * (separate[0].high - separate[0].low)
    assert paired_difference(a, a).value == 0.0


def test_paired_difference_needs_common_instants():
    a = errors(*straight(np.ones((10, 3))))
    truth = curve(20)
    with pytest.raises(InputError, match="no instant in common"):
        paired_difference(a, errors(truth, Trajectory(truth.t_ns + 7, truth.p_world_m).take([0])))


# --- outages


def test_outages_are_gaps_longer_than_three_seconds():
    t = START + np.r_[np.arange(10), 15, 16, 18, 25] * S
    np.testing.assert_array_equal(outages(t), START + np.array([[9, 15], [18, 25]]) * S)
    np.testing.assert_array_equal(outages(t, min_length_s=6.5), START + np.array([[18, 25]]) * S)


def test_slow_receivers_are_not_always_in_an_outage():
    t = START + np.r_[np.arange(0, 50, 5), 70] * S
    np.testing.assert_array_equal(outages(t), START + np.array([[45, 70]]) * S)


def test_the_ends_of_the_drive_count_when_asked():
    t = START + np.arange(10, 20) * S
    assert len(outages(t)) == 0
    span = (START, START + 22 * S)
    np.testing.assert_array_equal(outages(t, span_ns=span), [[START, START + 10 * S]])
    np.testing.assert_array_equal(outages([], span_ns=span), [list(span)])
    assert outages([]).shape == (0, 2)


def test_only_measurements_that_entered_count_as_fixes():
    t = START + np.arange(4) * S
    zeros = np.zeros((4, 3))
    table = GnssFixes(t, t, zeros, np.tile(np.eye(3), (4, 1, 1)), zeros)
    verdicts = SourceVerdicts.of("gnss", table)
    verdicts.set(0, Verdict.USED)
    verdicts.set(1, Verdict.GATED)
    verdicts.set(2, Verdict.DOWN_WEIGHTED)
    np.testing.assert_array_equal(used_fixes_ns({"gnss": verdicts}), t[[0, 2]])
    assert len(used_fixes_ns({})) == 0


def test_outages_of_a_result_reach_to_the_ends_of_its_trajectory():
    t = START + np.arange(4) * S
    zeros = np.zeros((4, 3))
    table = GnssFixes(t, t, zeros, np.tile(np.eye(3), (4, 1, 1)), zeros)
    verdicts = {"gnss": SourceVerdicts.of("gnss", table, Verdict.USED)}
    driven = curve(200)
    result = Result(driven, verdicts, {}, "x", causal=False)
    np.testing.assert_array_equal(gnss_outages(result), [[t[-1], driven.t_ns[-1]]])
    assert len(gnss_outages(Result(driven, {}, {}, "x", causal=False))) == 0


def test_growth_in_two_outages_by_hand():
    # Errors of 1 m, but in [10 s, 15 s] and [20 s, 25 s] they grow by 1 and by 2 m each second.
    seconds = np.arange(31)
    size = np.ones(31)
    size[11:15], size[21:25] = [1, 2, 3, 4], [2, 4, 6, 8]
    e = errors(*straight(np.outer(size, [1, 0, 0]), rate_hz=1.0))
    spans = START + np.array([[10, 15], [20, 25]]) * S
    growth = error_growth(e, spans)
    np.testing.assert_array_equal(growth.n, [4, 4])
    np.testing.assert_allclose(growth.rmse_m, np.sqrt([7.5, 30]))
    np.testing.assert_allclose(growth.end_m, [4, 8])
    np.testing.assert_allclose(growth.end_since_s, [4, 4])
    np.testing.assert_allclose(growth.bin_s, np.arange(6))
    np.testing.assert_allclose(growth.bin_mean_m, [np.nan, 1.5, 3.0, 4.5, 6.0])
    np.testing.assert_array_equal(growth.bin_outages, [0, 2, 2, 2, 2])
    assert seconds[growth.inside].tolist() == [11, 12, 13, 14, 21, 22, 23, 24]
    scores = score_errors(e, outages=spans)
    assert scores["outage_count"].value == 2
    assert scores["outage_rmse_m"].value == pytest.approx(np.sqrt(18.75))
    assert scores["outage_end_mean_m"].value == pytest.approx(6)
    assert scores["outage_end_max_m"].value == pytest.approx(8)


def test_without_outages_their_metrics_say_so():
    e = errors(*straight(np.ones((10, 3))))
    scores = score_errors(e, outages=outages([]))
    assert scores["outage_count"].value == 0
    assert scores["outage_rmse_m"].why == "there was no outage"
    assert "outage_count" not in score_errors(e)
    elsewhere = score_errors(e, outages=np.array([[0, 10 * S]]))
    assert elsewhere["outage_rmse_m"].why == "there is no truth in the outages"
