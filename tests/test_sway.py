"""Posts estimated from poses of their nodes: observers, filter, graph, their scores and files."""

import csv
import dataclasses
import json
from functools import partial

import numpy as np
import pytest

import fgloc
from fgloc import cli
from fgloc.baselines.khamooshi2023_uio import combined, existence
from fgloc.baselines.sway_kf import filtered
from fgloc.errors import DriveError, InputError, SolverError
from fgloc.evaluation import score_posts
from fgloc.factors.post import axis_spread, axis_step, pose_jacobian, post_step
from fgloc.infrastructure import Infrastructure, Node, Post
from fgloc.measurements import NodePoses
from fgloc.posts import PostStates
from fgloc.smoother.post_modes import log_likelihood, sought
from fgloc.watches import watches

LOW, HIGH = "khamooshi2023/sway-low", "khamooshi2023/sway-high"
POST = Post("pole", 10.0, 1.5, 0.02, 20.0, 0.138, 200.0, 0.3)


@pytest.fixture(scope="module")
def drive():
    return fgloc.make(LOW, seed=1, duration_s=20.0, tilt_noise=30.0)


def own_wind(seed: int, n: int = 400, dt_s: float = 0.1, post: Post = POST):
    """A drive whose post moves exactly as the model says."""
    rng = np.random.default_rng(seed)
    spread, step = np.kron(np.eye(2), axis_spread(post)), post_step(post, dt_s)
    root = np.linalg.cholesky(step.noise)
    states = [np.linalg.cholesky(spread) @ rng.standard_normal(6)]
    for _ in range(n - 1):
        states.append(step.transition @ states[-1] + root @ rng.standard_normal(6))
    x = np.array(states)
    sigmas = np.array([0.02, 0.03, 0.003, 0.002])
    told = x @ pose_jacobian(post.tip_slope_per_m).T + sigmas * rng.standard_normal((n, 4))
    t_ns = np.arange(n) * round(dt_s * 1e9)
    poses = NodePoses(t_ns, t_ns, np.zeros(n), told[:, :2], told[:, 2:],
                      np.tile(sigmas[:2], (n, 1)), np.tile(sigmas[2:], (n, 1)))  # fmt: skip
    tilt = (x @ pose_jacobian(post.tip_slope_per_m).T)[:, 2:]
    truth = PostStates.truth(t_ns, 0, x[:, [0, 3]], x[:, [1, 4]], tilt)
    beside = Infrastructure((Node("pole", np.zeros(3)),), (post,))
    origin = fgloc.Origin(43, -80, 0)
    return fgloc.Drive("own", origin, fgloc.Rig(), {"node_poses": poses}, None,
                       infrastructure=beside, post_truth=truth)  # fmt: skip


def test_the_printed_observer_does_not_exist_and_sampling_hides_a_motion():
    told = existence(POST, 0.1)
    assert (told.rank_cb, told.rank_b) == (0, 1)
    assert told.zero == pytest.approx(-0.987, abs=5e-4)
    # At the smallest damping that Eq. (3.25) allows, alpha = 1.
    least = dataclasses.replace(POST, damping=1 / (2 * 2 * np.pi * 1.5))
    assert existence(least, 0.1).zero == pytest.approx(-0.966, abs=5e-4)


def test_the_printed_observer_says_so_instead_of_estimating(drive):
    with pytest.raises(SolverError, match=r"rank\(C B\) = 0 and rank\(B\) = 1"):
        fgloc.baseline(drive, "khamooshi2023-uio-printed")


def test_the_kinematic_observer_gives_back_the_poses(drive):
    watch = watches(drive, "test")[0][0]
    posts = fgloc.baseline(drive, "khamooshi2023-uio").posts
    np.testing.assert_allclose(posts.p_node_m, combined(watch)[0], atol=1e-12)
    np.testing.assert_allclose(posts.v_node_mps[1:], np.diff(posts.p_node_m, axis=0) / 0.1)


def test_displacement_and_angle_are_weighed_by_their_variances():
    drive = own_wind(0, n=2)
    watch = watches(drive, "test")[0][0]
    p_m, sigma_m = combined(watch)
    x, pitch = watch.told[0, 0], watch.told[0, 3]
    by_angle, sigma = pitch / 0.138, 0.002 / 0.138
    weights = np.array([0.02**-2, sigma**-2])
    assert p_m[0, 0] == pytest.approx(weights @ [x, by_angle] / weights.sum())
    assert sigma_m[0, 0] == pytest.approx(weights.sum() ** -0.5)
    assert p_m[0, 1] == pytest.approx(
        (watch.told[0, 1] / 0.03**2 - watch.told[0, 2] / 0.138 / (0.003 / 0.138) ** 2)
        / (0.03**-2 + (0.003 / 0.138) ** -2)
    )


def test_the_newest_state_of_the_graph_is_that_of_the_filter(drive):
    kf = fgloc.baseline(drive, "sway-kf")
    for mode in ("fixed-lag", "incremental"):
        graph = fgloc.smooth(drive, mode)
        assert graph.causal
        np.testing.assert_allclose(graph.posts.p_node_m, kf.posts.p_node_m, atol=1e-9)
        np.testing.assert_allclose(graph.posts.sigma_v_mps, kf.posts.sigma_v_mps, rtol=1e-6)
        nis = (graph.verdicts["node_poses"].nis, kf.verdicts["node_poses"].nis)
        np.testing.assert_allclose(*nis, rtol=1e-4)


def test_the_batch_is_the_rauch_tung_striebel_smoother():
    drive = own_wind(3, n=60)
    found, verdicts = watches(drive, "test")
    x, P = filtered(found[0], verdicts["node_poses"])
    step = post_step(POST, 0.1)
    for k in range(len(x) - 2, -1, -1):
        ahead = step.transition @ P[k] @ step.transition.T + step.noise
        G = np.linalg.solve(ahead, step.transition @ P[k]).T
        x[k] += G @ (x[k + 1] - step.transition @ x[k])
        P[k] += G @ (P[k + 1] - ahead) @ G.T
    posts = fgloc.smooth(drive).posts
    np.testing.assert_allclose(posts.p_node_m, x[:, [0, 3]], atol=1e-8)
    np.testing.assert_allclose(posts.sigma_v_mps[:, 1], np.sqrt(P[:, 4, 4]), rtol=1e-5)


@pytest.mark.parametrize("method", ["sway-kf", "graph-batch"])
def test_where_the_wind_is_that_of_the_model_the_claims_hold(method):
    squares = []
    for seed in range(4):
        drive = own_wind(seed)
        result = fgloc.smooth(drive) if method == "graph-batch" else fgloc.baseline(drive, method)
        for claimed, column in (("sigma_p_m", "p_node_m"), ("sigma_v_mps", "v_node_mps")):
            off = getattr(result.posts, column) - getattr(drive.post_truth, column)
            squares.append(np.mean((off / getattr(result.posts, claimed)) ** 2))
        nis = result.verdicts["node_poses"].nis
        assert np.mean(nis) / 4 == pytest.approx(1.0, abs=0.15)
    assert np.mean(squares) == pytest.approx(1.0, abs=0.12)


def test_the_graph_that_looks_ahead_is_better_than_the_filter_and_that_than_the_poses(drive):
    runs = [fgloc.baseline(drive, "raw:node_poses"), fgloc.baseline(drive, "sway-kf"),
            fgloc.smooth(drive)]  # fmt: skip
    scores = [score_posts(run.posts, drive) for run in runs]
    x = [one["posts.isn-1.x_rmse_mm"].value for one in scores]
    assert x[0] > 1.1 * x[1] > 1.3 * x[2]
    assert scores[0]["posts.isn-1.vx_rmse_mmps"].value is None


def test_the_likelihood_is_that_of_the_filters_innovations():
    drive = own_wind(5, n=50)
    watch = watches(drive, "test")[0][0]
    x, P, expected = np.zeros(6), np.kron(np.eye(2), axis_spread(POST)), 0.0
    step = post_step(POST, 0.1)
    H, R = pose_jacobian(POST.tip_slope_per_m), np.diag(watch.sigmas[0] ** 2)
    for k, z in enumerate(watch.told):
        if k:
            x, P = step.transition @ x, step.transition @ P @ step.transition.T + step.noise
        S, error = H @ P @ H.T + R, z - H @ x
        expected -= (error @ np.linalg.solve(S, error) + np.linalg.slogdet(2 * np.pi * S)[1]) / 2
        K = np.linalg.solve(S, H @ P).T
        x, P = x + K @ error, P - K @ H @ P
    assert log_likelihood(watch, POST) == pytest.approx(expected, rel=1e-9)


def test_frequency_damping_and_load_are_found_from_the_poses():
    other = dataclasses.replace(POST, frequency_hz=1.8, damping=0.06, load_sigma_n=100.0)
    drive = own_wind(7, n=1200, post=other)
    watch = dataclasses.replace(watches(drive, "test")[0][0], post=POST)
    post, errors = sought(watch.post, partial(log_likelihood, watch))
    for name, error in zip(("frequency_hz", "damping", "load_sigma_n"), errors, strict=False):
        off = np.log(getattr(post, name) / getattr(other, name))
        assert abs(off) < 3 * error
    assert errors[0] < 0.02
    assert log_likelihood(watch, post) > log_likelihood(watch, POST) + 10


def test_a_causal_run_does_not_look_for_the_frequency_ahead(drive):
    with pytest.raises(InputError, match="goes with mode batch, not with fixed-lag"):
        fgloc.smooth(drive, "fixed-lag", settings=["posts.estimate_mode=true"])
    found = fgloc.smooth(own_wind(7, n=200), settings=["posts.estimate_mode=true"])
    told = found.summary["posts_sought"]["pole"]["frequency_hz"]
    assert told["stated"] == 1.5
    assert told["value"] == pytest.approx(1.5, abs=4 * told["relative_error"] * 1.5)


def test_poses_of_one_instant_are_taken_together_and_gaps_are_bridged():
    drive = own_wind(2, n=30)
    poses = drive.tables["node_poses"]
    both = poses.take(np.sort(np.r_[np.arange(10), np.arange(10), 25:30]))
    doubled = fgloc.smooth(dataclasses.replace(drive, tables={"node_poses": both})).posts
    half = np.sqrt(0.5)
    once = poses.take(np.r_[:10, 25:30])
    sigmas = np.where(np.arange(15)[:, None] < 10, half, 1.0)
    once = dataclasses.replace(once, sigma_p_m=sigmas * once.sigma_p_m,
                               sigma_tilt_rad=sigmas * once.sigma_tilt_rad)  # fmt: skip
    single = fgloc.smooth(dataclasses.replace(drive, tables={"node_poses": once})).posts
    np.testing.assert_allclose(doubled.p_node_m, single.p_node_m, atol=1e-9)
    np.testing.assert_allclose(doubled.sigma_v_mps, single.sigma_v_mps, rtol=1e-6)


def test_without_angles_the_displacement_alone_is_used(drive):
    poses = drive.tables["node_poses"]
    nothing = np.full((len(poses), 2), np.nan)
    bare = dataclasses.replace(poses, tilt_rad=nothing, sigma_tilt_rad=nothing)
    result = fgloc.smooth(dataclasses.replace(drive, tables={"node_poses": bare}))
    assert set(result.verdicts["node_poses"].dof) == {2}
    assert np.all(np.isfinite(result.verdicts["node_poses"].nis))
    assert np.all(result.posts.sigma_p_m > fgloc.smooth(drive).posts.sigma_p_m)


def test_every_row_gets_a_verdict():
    drive = own_wind(1, n=5)
    poses = drive.tables["node_poses"]
    p_m = poses.p_node_m.copy()
    p_m[2] = np.nan
    node = np.array([0, 1, 0, 0, 0])
    odd = dataclasses.replace(poses, p_node_m=p_m, node=node)
    beside = Infrastructure((*drive.infrastructure.nodes, Node("wall", np.ones(3))), (POST,))
    odd_drive = dataclasses.replace(drive, tables={"node_poses": odd}, infrastructure=beside)
    verdicts = fgloc.baseline(odd_drive, "sway-kf").verdicts["node_poses"]
    assert verdicts.counts() == {"invalid": 1, "unused": 1, "used": 3}
    assert verdicts.reason[1] == "the node has no [[post]]"


def test_a_drive_without_poses_or_posts_is_told_what_is_missing():
    city = fgloc.make("city", duration_s=2.0)
    with pytest.raises(DriveError, match="has no node_poses"):
        fgloc.baseline(city, "sway-kf")
    drive = own_wind(1, n=5)
    bare = dataclasses.replace(drive, infrastructure=Infrastructure(drive.infrastructure.nodes))
    with pytest.raises(DriveError, match=r"which node stands on one, as \[\[post"):
        fgloc.smooth(bare)


def test_health_tells_amplitude_frequency_latency_and_what_is_missing():
    drive = fgloc.make(LOW, seed=4, duration_s=30.0)
    poses = drive.tables["node_poses"]
    kept = dataclasses.replace(poses, received_ns=poses.t_ns + 80_000_000)
    rows = np.flatnonzero(np.arange(len(poses)) % 10 != 5)
    kept = kept.take(rows)
    told = fgloc.smooth(dataclasses.replace(drive, tables={"node_poses": kept})).summary["posts"]
    post = told["isn-1"]
    assert (post["latency_s"], post["rate_hz"]) == (0.08, 10.0)
    assert post["missing_share"] == pytest.approx(0.1, abs=0.002)
    assert post["frequency_hz"] == pytest.approx(1.965, abs=1e-3)
    length_m = np.linalg.norm(drive.post_truth.p_node_m[20 * rows], axis=-1)
    assert post["rms_m"] == pytest.approx(np.sqrt(np.mean(length_m**2)), rel=0.01)
    # The load drives the post at 0.5 and 1 Hz; the pose estimates left out smear that little.
    assert min(abs(post["strongest_hz"] - f) for f in (0.5, 1.0)) < 0.15


def test_errors_are_counted_in_millimetres_and_milliradians():
    drive = own_wind(1, n=3)
    off = dataclasses.replace(
        drive.post_truth, p_node_m=drive.post_truth.p_node_m + [[0.003, 0], [0.004, 0], [0, 0.001]],
        sigma_p_m=np.full((3, 2), 0.001),
    )  # fmt: skip
    scores = score_posts(off, drive)
    assert scores["posts.pole.x_rmse_mm"].value == pytest.approx(5 / np.sqrt(3))
    assert scores["posts.pole.x_max_mm"].value == pytest.approx(4)
    assert scores["posts.pole.y_max_mm"].value == pytest.approx(1)
    assert scores["posts.pole.pitch_max_mrad"].value == 0
    assert scores["posts.pole.anees"].value == pytest.approx(26 / 6)
    assert scores["posts.pole.coverage95"].value == pytest.approx(4 / 6)
    late = score_posts(off, drive, score_from_s=0.15)
    assert (late["posts.pole.x_max_mm"].value, late["posts.pole.x_max_mm"].n) == (0, 1)


def test_the_command_writes_posts_csv_and_scores(tmp_path, capsys):
    args = ["smooth", LOW, "--seed", "2", "--out", str(tmp_path / "out")]
    assert cli.main(args) == 0
    assert "posts.isn-1.x_rmse_mm" in capsys.readouterr().out
    summary = json.loads((tmp_path / "out/summary.json").read_text())
    assert summary["metrics"]["posts.isn-1.roll_rmse_mrad"]["unit"] == "mrad"
    with (tmp_path / "out/posts.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == summary["states"] == 601
    assert rows[0]["node"] == "isn-1"
    truth = fgloc.make(LOW, seed=2).post_truth
    assert float(rows[300]["x_m"]) == pytest.approx(truth.p_node_m[6000, 0], abs=0.004)
    assert float(rows[300]["roll_rad"]) == pytest.approx(
        -0.13765 * float(rows[300]["y_m"]), rel=1e-3
    )
    page = (tmp_path / "out/report.html").read_text()
    assert "Sway of the posts" in page and "Frequencies of the sway" in page
    assert not (tmp_path / "out/trajectory.csv").exists()


def test_compare_shows_the_sway_of_each_method(tmp_path, capsys):
    methods = "raw:node_poses,khamooshi2023-uio-printed,sway-kf"
    args = ["compare", LOW, "--seeds", "0:2", "--methods", methods, "--out", str(tmp_path)]
    assert cli.main(args) == 0
    shown = capsys.readouterr().out
    assert "Sway of isn-1" in shown and "rank(C B) = 0" in shown
    rows = json.loads((tmp_path / "compare.json").read_text())["rows"]
    assert rows[0]["metrics"]["posts.isn-1.x_rmse_mm"]["value"] > 10
    assert rows[2]["metrics"]["posts.isn-1.x_rmse_mm"]["value"] < 1


def test_the_printed_observer_ends_with_status_three(tmp_path, capsys):
    args = ["baseline", HIGH, "--method", "khamooshi2023-uio-printed", "--out", str(tmp_path)]
    assert cli.main(args) == 3
    assert "no such observer" in capsys.readouterr().err


def test_an_axis_step_is_found_again_for_every_step():
    assert axis_step(POST, 0.1) is axis_step(POST, 0.1)
