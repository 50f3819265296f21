"""The range graph: derivatives, the two ways of solving it, and drives whose truth is known."""

import numpy as np
import pytest

import fgloc
from fgloc.drive import Drive, Rig
from fgloc.errors import DriveError, InputError
from fgloc.frames import Origin
from fgloc.infrastructure import Anchor, Infrastructure
from fgloc.measurements import Odometry, Ranges
from fgloc.smoother.ranges import SETTINGS, build, smooth_ranges
from fgloc.smoother.ranges_lag import run_lag
from fgloc.smoother.ranges_model import SCALE
from fgloc.smoother.ranges_solve import covariances, marginal_prior, step
from fgloc.smoother.ranges_start import optimize, start
from fgloc.timing import NS_PER_S
from fgloc.trajectory import Trajectory

ANCHORS = np.array([[0.0, 0, 0], [30, 0, 0], [28, 25, 0], [-3, 28, 0]])
SPEED_MPS, RADIUS_M, HEIGHT_M, SIGMA_M = 1.5, 10.0, 1.0, 0.1


def circle(t_s):
    """A tag that goes round (14, 12): position (N, 3) and yaw (N,)."""
    angle = t_s * SPEED_MPS / RADIUS_M
    level = [14 + RADIUS_M * np.cos(angle), 12 + RADIUS_M * np.sin(angle)]
    return np.stack([*level, np.full(len(t_s), HEIGHT_M)], -1), angle + np.pi / 2


def drive(odometry: bool, seed=0, duration_s=25.0, scale=1.0, lies=0) -> Drive:
    rng = np.random.default_rng(seed)
    t_s = np.arange(0, duration_s, 0.05)
    t_ns, anchor = np.rint(t_s * NS_PER_S).astype(np.int64), np.arange(len(t_s)) % 4
    apart = np.linalg.norm(circle(t_s)[0] - ANCHORS[anchor], axis=1)
    z = scale * apart + SIGMA_M * rng.standard_normal(len(t_s))
    z[rng.choice(len(z), lies, replace=False)] += 8.0
    tables = {"ranges": Ranges(t_ns, t_ns, anchor, z, np.full(len(z), SIGMA_M))}
    if odometry:
        n = len(t_s)
        speed = SPEED_MPS + 0.05 * rng.standard_normal(n)
        rate = SPEED_MPS / RADIUS_M + 0.003 + 0.02 * rng.standard_normal(n)
        tables["odometry"] = Odometry(t_ns, t_ns, speed, rate, np.full(n, 0.05), np.full(n, 0.02))
    truth = Trajectory(t_ns, circle(t_s)[0])
    beside = Infrastructure(anchors=tuple(Anchor(str(i), place) for i, place in enumerate(ANCHORS)))
    return Drive("circle", Origin(37, 127, 0), Rig(), tables, truth, infrastructure=beside)


def errors_m(one: Drive, result) -> np.ndarray:
    told = result.trajectory
    inside = (told.t_ns >= one.truth.t_ns[0]) & (told.t_ns <= one.truth.t_ns[-1])
    true = one.truth.at(told.t_ns[inside]).p_world_m
    return (told.p_world_m[inside] - true)[:, :2]


def random_window(odometry: bool, n=7):
    model, _ = build(drive(odometry), SETTINGS)
    rng, m = np.random.default_rng(3), model.motion.size
    p, yaw = circle(np.arange(n) * SETTINGS.interval_s + 2.0)
    states = np.c_[p[:, :2], yaw] if m == 3 else np.c_[p[:, :2], rng.normal(0, 1, (n, 2))]
    mean, _ = model.prior
    return model, states + 0.1 * rng.standard_normal((n, m)), mean + 0.02


@pytest.mark.parametrize("odometry", [False, True])
def test_gradients_are_the_differences_of_the_cost(odometry):
    model, states, globals_ = random_window(odometry)
    blocks = model.linearize(states, globals_, 10)

    def cost_at(change):
        n = states.size
        return model.linearize(states + change[:n].reshape(states.shape),
                         globals_ + change[n:], 10).cost  # fmt: skip

    told = np.r_[blocks.gradient.ravel(), blocks.gradient_globals]
    steps = np.eye(len(told)) * 1e-6
    found = np.array([(cost_at(s) - cost_at(-s)) / 2e-6 for s in steps])
    np.testing.assert_allclose(told, found, rtol=1e-4, atol=1e-3 * np.abs(told).max())


def dense(blocks):
    """The whole information matrix and gradient of some blocks."""
    n, m = blocks.gradient.shape
    H = np.zeros((n * m + len(blocks.globals_),) * 2)
    for k in range(n):
        i = slice(k * m, (k + 1) * m)
        H[i, i] = blocks.diagonal[k]
        H[i, n * m :], H[n * m :, i] = blocks.tied[k], blocks.tied[k].T
        if k + 1 < n:
            j = slice((k + 1) * m, (k + 2) * m)
            H[i, j], H[j, i] = blocks.beside[k], blocks.beside[k].T
    H[n * m :, n * m :] = blocks.globals_
    return H, np.r_[blocks.gradient.ravel(), blocks.gradient_globals]


def held(odometry: bool, n: int):
    """Blocks of a window with priors on its first state and the globals."""
    model, states, globals_ = random_window(odometry, n)
    blocks = model.linearize(states, globals_, 10)
    blocks.globals_ += np.eye(len(globals_))
    blocks.diagonal[0] += np.eye(model.motion.size)
    return blocks


@pytest.mark.parametrize("odometry", [False, True])
def test_the_banded_solution_and_covariances_are_the_dense_ones(odometry):
    blocks = held(odometry, 7)
    H, g = dense(blocks)
    d_states, d_globals = step(blocks)
    np.testing.assert_allclose(np.r_[d_states.ravel(), d_globals], -np.linalg.solve(H, g))
    cov, cov_globals = covariances(blocks)
    inverse, (n, m) = np.linalg.inv(H), d_states.shape
    np.testing.assert_allclose(cov_globals, inverse[n * m :, n * m :], atol=1e-12)
    for k in range(n):
        i = slice(k * m, (k + 1) * m)
        np.testing.assert_allclose(cov[k], inverse[i, i], rtol=1e-6, atol=1e-10)


def test_what_leaves_the_window_is_kept_as_its_marginal():
    blocks = held(True, 2)
    H, g = dense(blocks)
    information, gradient = marginal_prior(blocks)
    np.testing.assert_allclose(np.linalg.inv(information), np.linalg.inv(H)[3:, 3:], atol=1e-9)
    np.testing.assert_allclose(
        np.linalg.solve(information, gradient), np.linalg.solve(H, g)[3:], atol=1e-9
    )


@pytest.mark.parametrize("odometry", [False, True])
def test_a_drive_is_found_from_ranges_alone(odometry):
    one = drive(odometry)
    rmse = {lag_s: np.sqrt((errors_m(one, smooth_ranges(one, lag_s)) ** 2).sum(1).mean())
            for lag_s in (None, 5.0)}  # fmt: skip
    assert rmse[None] < 0.08
    assert rmse[None] < rmse[5.0] < 0.2


def test_the_scale_of_the_ranges_is_found_without_truth():
    result = smooth_ranges(drive(True, scale=1.07))
    assert result.summary["ranges"]["scale"] == pytest.approx(1.07, abs=0.01)
    assert result.summary["ranges"]["yaw_rate_bias_radps"] == pytest.approx(0.003, abs=0.002)


def test_a_lag_as_long_as_the_drive_ends_where_the_batch_does():
    model, _ = build(drive(False, duration_s=12.0), SETTINGS)
    states, globals_ = start(model)
    run = run_lag(model, states, globals_, 1e3)
    batch, batch_globals, _ = optimize(model, run.last, run.globals_)
    np.testing.assert_allclose(run.states[-1, :2], batch[-1, :2], atol=0.1)
    assert run.globals_[SCALE] == pytest.approx(batch_globals[SCALE], abs=0.01)


def test_ranges_that_went_another_way_are_doubted():
    one = drive(False, lies=40)
    result = smooth_ranges(one)
    assert np.sqrt((errors_m(one, result) ** 2).sum(1).mean()) < 0.15
    assert result.summary["counts"]["ranges"]["down-weighted"] == pytest.approx(40, abs=5)
    assert sum(result.summary["counts"]["ranges"].values()) == len(one.tables["ranges"])


def test_the_covariance_is_that_of_the_errors():
    nees = []
    for seed in range(3):
        one = drive(False, seed, duration_s=15.0)
        result = smooth_ranges(one)
        error, cov = errors_m(one, result), result.trajectory.cov[:, :2, :2]
        nees.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(cov[: len(error)]), error) / 2)
    assert 0.3 < np.mean(nees) < 2.0


def test_the_command_line_takes_the_range_graph_where_there_are_no_fixes(tmp_path):
    one = drive(False, duration_s=8.0)
    assert fgloc.smooth(one).method == "graph-batch"
    assert fgloc.smooth(one, "fixed-lag", lag_s=5.0).causal
    with pytest.raises(InputError, match="modes batch and fixed-lag, not incremental"):
        fgloc.smooth(one, "incremental")
    table = fgloc.compare(one, ["graph-batch", "graph-lag"])
    assert all(not row.failed for row in table.rows)


def test_too_few_ranges_are_told():
    one = drive(False)
    few = one.with_tables(ranges=one.tables["ranges"].take(slice(5)))
    with pytest.raises(DriveError, match="5 ranges can be used, too few"):
        smooth_ranges(few)
