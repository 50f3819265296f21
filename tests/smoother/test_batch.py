"""The whole drive at once: accuracy, outliers, gaps, reverse, GNSS bias, what the verdicts say."""

import dataclasses

import numpy as np
import pytest

from fgloc.datasets.degrade import degrade
from fgloc.errors import SolverError
from fgloc.evaluation import chi2_quantile
from fgloc.verdicts import Verdict

MODES = ["batch", "incremental", "fixed-lag"]
UNWEIGHTED = {"loss": "none", "gate_probability": 1.0}


# A clean drive


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_city_drive_is_known_to_decimetres_and_a_degree_or_so(city, run, against_truth, seed):
    drive = city(seed, 60.0)
    scored = against_truth(run(drive).trajectory, drive, from_s=10.0)
    assert np.sqrt((scored.horizontal_m**2).mean()) < 0.35  # fixes are of 1.4 m
    assert np.rad2deg(np.abs(scored.yaw_rad)).max() < 3.0
    assert scored.nees_pose.mean() < 15


def test_every_row_that_was_read_has_a_verdict(city, run):
    drive = city(1, 30.0)
    result = run(drive)
    told = result.summary["counts"]
    assert {name: sum(told[name].values()) for name in told} == {
        name: len(table) for name, table in drive.tables.items()
    }
    used = result.verdicts["gnss"].is_(Verdict.USED) | result.verdicts["gnss"].is_(
        Verdict.DOWN_WEIGHTED
    )
    assert used.all()


def test_the_same_drive_gives_the_same_answer(city, run):
    drive = city(2, 20.0)
    assert run(drive).trajectory.same_as(run(drive).trajectory)


def test_velocity_is_that_of_the_vehicles_origin(city, run):
    drive = city(1, 40.0)
    estimate = run(drive).trajectory
    truth = drive.truth.at(estimate.t_ns)
    error = (estimate.v_world_mps - truth.v_world_mps)[estimate.t_ns > drive.start_ns + 10e9]
    assert np.sqrt((error**2).mean()) < 0.1


# Outliers

PLANTED = {205: 60.0, 206: 60.0, 300: 60.0, 401: 60.0, 470: 60.0}
PLANTED |= dict(zip(range(230, 471, 40), (10, 12, 14, 16, 18, 20, 11), strict=True))


@pytest.fixture(scope="module")
def clean(city):
    return city(1, 50.0)


@pytest.fixture(scope="module")
def spoilt(clean, altered):
    """The clean drive with some fixes moved sideways by 10 to 60 m."""
    p = clean.gnss.p_world_ant_m.copy()
    for k, (row, distance_m) in enumerate(PLANTED.items()):
        p[row, :2] += distance_m * np.array([np.cos(k), np.sin(k)])
    return altered.with_fixes(clean, p_world_ant_m=p)


@pytest.mark.parametrize(("mode", "bound_m"), [("batch", 0.15), ("fixed-lag", 0.6)])
def test_outliers_barely_move_the_answer(clean, spoilt, run, apart, mode, bound_m):
    moved = apart(run(spoilt, mode).trajectory, run(clean, mode).trajectory, from_s=12.0)
    assert moved.m.max() < bound_m
    assert np.rad2deg(moved.rad.max()) < 4.0


@pytest.mark.parametrize("mode", MODES)
def test_outliers_are_gated_or_weighed_down_and_told(spoilt, run, mode):
    verdicts = run(spoilt, mode).verdicts["gnss"]
    far = [row for row, distance_m in PLANTED.items() if distance_m == 60]
    assert set(verdicts.verdict[far]) == {Verdict.GATED}
    assert set(verdicts.verdict[list(PLANTED)]) <= {Verdict.GATED, Verdict.DOWN_WEIGHTED}
    assert (verdicts.nis[far] > verdicts.threshold[far]).all()
    assert all(verdicts.reason[row] for row in PLANTED)
    honest = np.setdiff1d(np.arange(len(verdicts)), list(PLANTED))
    assert not verdicts.is_(Verdict.GATED)[honest].any()


def test_a_gate_that_has_been_shut_for_long_opens(clean, altered, run):
    p = clean.gnss.p_world_ant_m.copy()
    p[300:] += [40.0, 0.0, 0.0]  # as after a change of the receiver's reference
    result = run(altered.with_fixes(clean, p_world_ant_m=p), "fixed-lag")
    verdicts = result.verdicts["gnss"]
    opened = [(event.t_ns - clean.start_ns) / 1e9 for event in result.events
              if event.kind == "gate reset"]  # fmt: skip
    assert 34.9 < opened[0] < 35.3
    assert set(verdicts.verdict[302:349]) == {Verdict.GATED}
    assert not verdicts.is_(Verdict.GATED)[-50:].any()
    error = result.trajectory.p_world_m[-1] - clean.truth.p_world_m[-1]
    np.testing.assert_allclose(error[:2], [40, 0], atol=2.5)


# Gaps of the IMU


@pytest.mark.parametrize("mode", MODES)
def test_a_gap_of_the_imu_is_bridged_and_told(city, altered, run, against_truth, mode):
    drive = altered.without_imu(city(1, 50.0), 30.0, 33.0)
    result = run(drive, mode)
    scored = against_truth(result.trajectory, drive, from_s=12.0)
    assert scored.horizontal_m.max() < 2.5
    assert scored.nees_position.mean() < 6
    assert [event.kind for event in result.events if event.kind != "aligned"] == ["imu gap"]


def test_inside_a_gap_the_covariance_grows_away_from_both_ends(city, altered, run):
    drive = altered.without_imu(city(1, 50.0), 30.0, 33.0)
    estimate = run(altered.without_fixes(drive, 29.95, 33.05)).trajectory
    variance = np.trace(estimate.cov[:, :3, :3], axis1=1, axis2=2)
    at = lambda s: variance[np.searchsorted(estimate.t_ns, drive.start_ns + s * 10**9)]  # noqa: E731
    assert at(29) < at(30.25) < at(31)
    assert at(32) > at(32.75) > at(34)
    assert at(31.5) > 10 * at(29)


# A heading that is not the course


@pytest.mark.parametrize("mode", ["batch", "fixed-lag"])
@pytest.mark.parametrize("turn_rad", [np.pi, np.pi / 2, -np.pi / 2])
def test_the_yaw_is_the_vehicles_where_it_drives_in_reverse_or_sideways(
    city, altered, run, against_truth, mode, turn_rad
):
    drive = altered.turned(city(0, 40.0), turn_rad)
    scored = against_truth(run(drive, mode).trajectory, drive, from_s=20.0)
    assert np.rad2deg(np.abs(scored.yaw_rad)).max() < 12.0
    assert scored.nees_pose.mean() < 20


@pytest.mark.parametrize("mode", ["batch", "fixed-lag"])
@pytest.mark.parametrize("ahead_s", [20.0, 100.0])
def test_a_drive_that_begins_in_reverse_is_told_from_one_ahead(
    altered, run, against_truth, mode, ahead_s
):
    drive = altered.reversing(20.0, ahead_s)
    scored = against_truth(run(drive, mode).trajectory, drive, from_s=20.0)
    assert np.rad2deg(np.abs(scored.yaw_rad)).max() < 12.0
    assert scored.nees_pose.mean() < 20


def test_the_answer_turns_with_the_vehicles_axes_and_is_otherwise_the_same(city, altered, run):
    drive = city(0, 40.0)
    ahead, back = (run(altered.turned(drive, yaw_rad)) for yaw_rad in (0.0, np.pi))
    assert ahead.summary["cost"] == pytest.approx(back.summary["cost"], rel=1e-3)


# A bias of GNSS


def with_bias(drive, altered, seed, sigma_m=2.0, tau_s=60.0):
    """Gauss-Markov noise added to the fixes."""
    rng = np.random.default_rng(seed)
    dt_s = np.diff(drive.gnss.t_ns, prepend=drive.gnss.t_ns[0]) / 1e9
    bias, biases = sigma_m * rng.standard_normal(3), []
    for phi in np.exp(-dt_s / tau_s):
        bias = phi * bias + sigma_m * np.sqrt(1 - phi**2) * rng.standard_normal(3)
        biases.append(bias)
    return altered.with_fixes(drive, p_world_ant_m=drive.gnss.p_world_ant_m + biases)


def test_a_bias_variable_makes_the_covariance_honest_again(city, altered, run, against_truth):
    """Mean NEES of 6 drives, each worth about one sample of a bias with 3 degrees of freedom."""
    knowing, naive = [], []
    for seed in range(6):
        drive = with_bias(degrade(city(seed, 40.0), keep_every=5), altered, seed)
        for means, sigma_m in ((knowing, 2.0), (naive, 0.0)):
            result = run(drive, gnss={"bias_sigma_m": sigma_m})
            means.append(against_truth(result.trajectory, drive, 10.0).nees_position.mean())
    low, high = chi2_quantile([0.005, 0.995], 3 * 6) / 6
    assert low < np.mean(knowing) < high
    assert np.mean(naive) > 20 * 3


@pytest.mark.parametrize("mode", ["incremental", "fixed-lag"])
def test_a_bias_variable_serves_causal_runs_too(city, altered, run, against_truth, mode):
    drive = with_bias(degrade(city(0, 40.0), keep_every=5), altered, seed=0)
    result = run(drive, mode, gnss={"bias_sigma_m": 2.0})
    naive = run(drive, mode)
    nees, too_sure = (
        against_truth(r.trajectory, drive, 15.0).nees_position.mean() for r in (result, naive)
    )
    assert nees < 16.3  # 0.999 of chi-square with 3 degrees
    assert too_sure > 3 * nees
    assert result.summary["counts"]["gnss"] == {"used": len(drive.gnss)}


# States between keyframes


@pytest.fixture(scope="module")
def sparse(city):
    """City with a fix a second."""
    return degrade(city(0, 60.0), keep_every=10)


def test_output_epochs_are_as_good_as_keyframes_would_be(sparse, run, apart, rmse_m):
    inner = run(sparse, gnss=UNWEIGHTED).trajectory
    keys = run(sparse, keyframe_interval_s=0.25, gnss=UNWEIGHTED).trajectory
    np.testing.assert_array_equal(inner.t_ns, keys.t_ns)
    moved = apart(inner, keys)
    assert moved.m.max() < 0.02
    assert np.rad2deg(moved.rad.max()) < 0.1
    assert rmse_m(inner, sparse) == pytest.approx(rmse_m(keys, sparse), rel=0.01)


def test_output_epochs_claim_no_more_than_keyframes_would(sparse, run):
    inner = run(sparse, gnss=UNWEIGHTED).trajectory
    keys = run(sparse, keyframe_interval_s=0.25, gnss=UNWEIGHTED).trajectory
    ratio = np.trace(inner.cov[:, :3, :3], axis1=1, axis2=2) / np.trace(
        keys.cov[:, :3, :3], axis1=1, axis2=2
    )
    assert ratio.min() > 0.98
    assert np.median(ratio) < 1.1


@pytest.mark.parametrize("mode", ["batch", "fixed-lag"])
def test_output_epochs_have_sane_nees(sparse, run, against_truth, mode):
    trajectory = run(sparse, mode).trajectory
    between = ~np.isin(trajectory.t_ns, sparse.gnss.t_ns)
    scored = against_truth(trajectory.take(between), sparse, from_s=20.0)
    assert len(scored) > 100
    assert 0.3 < scored.nees_position.mean() < 9
    assert scored.nees_pose.mean() < 18


# NIS of leaving one out


def test_nis_of_a_clean_drive_is_near_its_degrees_of_freedom(city, run):
    verdicts = run(city(1, 60.0)).verdicts["gnss"]
    assert set(verdicts.dof) == {3}
    # The mean of 601 chi-squares with 3 degrees has a sigma of sqrt(6 / 601) = 0.1.
    assert verdicts.nis.mean() == pytest.approx(3.0, abs=0.4)


@pytest.mark.parametrize("row", [1, 57, 130, 199, 200])
def test_nis_is_that_of_really_leaving_the_fix_out(city, run, row):
    drive, settings = city(0, 20.0), {"gnss": UNWEIGHTED, "keyframe_interval_s": 0.1}
    told = run(drive, **settings).verdicts["gnss"].nis[row]
    others = np.arange(len(drive.gnss)) != row
    rest = run(drive.with_tables(gnss=drive.gnss.take(others)), **settings).trajectory
    at = rest.take(rest.t_ns == drive.gnss.t_ns[row]).at_point(drive.rig.p_veh_ant_m)
    error = at.p_world_m[0] - drive.gnss.p_world_ant_m[row]
    nis = error @ np.linalg.solve(at.cov[0, :3, :3] + drive.gnss.cov_world_m2[row], error)
    assert told == pytest.approx(nis, rel=0.01)


# What the solver could not do is told


def test_a_solver_that_runs_out_of_iterations_says_so(city, run):
    drive = city(0, 20.0)
    events = {event.kind: event.text for event in run(drive, solver={"max_iterations": 1}).events}
    assert "stopped after 1 iterations" in events["solver"]
    assert run(drive).events == ()


def test_a_bias_that_lasts_the_whole_drive_is_one_constant(city, run, rmse_m):
    drive = city(0, 30.0)
    constant = run(drive, imu={"bias_interval_s": 1e5})
    by_gtsam = run(drive, imu={"bias_interval_s": 1e5}, solver={"batch": "gtsam"})
    assert constant.summary["iterations"] < 10
    assert constant.summary["cost"] == pytest.approx(by_gtsam.summary["cost"], rel=1e-4)
    assert rmse_m(constant.trajectory, drive) < 0.35


def test_many_outliers_widen_gate_and_loss_by_no_more_than_tenfold(clean, altered, run):
    p = clean.gnss.p_world_ant_m.copy()
    p[::4] += [1e5, 0.0, 0.0]
    result = run(altered.with_fixes(clean, p_world_ant_m=p))
    assert "noise" in [event.kind for event in result.events]
    assert (
        result.verdicts["gnss"].threshold[0] <= 100.001 * run(clean).verdicts["gnss"].threshold[0]
    )


def test_a_gyro_in_raw_counts_is_an_error_and_no_traceback(city, run):
    drive = city(0, 10.0)
    rows = drive.imu
    wrong = dataclasses.replace(rows, gyro_radps=rows.gyro_radps + 1e3)
    with pytest.raises(SolverError, match=r"keyframe \d+"):
        run(drive.with_tables(imu=wrong))


def test_a_causal_run_is_not_led_away_by_one_wrong_fix_after_another(city, altered, run, rmse_m):
    """Every twelfth fix is 100 m off, each to another side: two that agree must open the gate."""
    drive = city(1, 40.0)
    rng, p = np.random.default_rng(0), city(1, 40.0).gnss.p_world_ant_m.copy()
    rows = np.arange(100, len(p), 12)
    p[rows] += 100 * rng.normal(size=(len(rows), 3))
    result = run(altered.with_fixes(drive, p_world_ant_m=p), "fixed-lag")
    assert rmse_m(result.trajectory, drive, 15.0) < 2.0
