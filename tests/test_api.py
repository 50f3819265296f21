"""The library's public surface, as a user meets it."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest
from baselines.roadside import roadside_drive

import fgloc
from fgloc import baselines
from fgloc.datasets.degrade import degrade
from fgloc.errors import InputError
from fgloc.verdicts import Verdict

SURFACE = {
    "load", "make", "smooth", "baseline", "score", "compare", "doctor", "tune", "Finding",
    "Drive", "Rig", "ImuNoise", "About", "Origin", "GnssFixes", "ImuSamples", "WheelSpeeds",
    "SteeringAngles", "Tuning", "EnuVelocities", "Odometry", "NodeDetections", "Node",
    "NodePoses", "Post", "PostStates",
    "Infrastructure", "GnssBias",
    "Trajectory", "Result", "Event", "Verdict", "SourceVerdicts", "Metric", "Method", "Comparison",
    "SmoothConfig", "FglocError", "InputError", "DriveError", "ConfigError", "SolverError",
    "__version__",
}  # fmt: skip


@pytest.fixture(scope="module")
def drive():
    return fgloc.make("city", seed=3, duration_s=30.0)


@pytest.fixture(scope="module")
def result(drive):
    return fgloc.smooth(drive)


def test_the_surface_is_what_all_says():
    assert set(fgloc.__all__) == SURFACE
    for name in SURFACE:
        assert getattr(fgloc, name) is not None
    assert set(dir(fgloc)) >= SURFACE
    with pytest.raises(AttributeError, match="no attribute 'smoth'"):
        fgloc.smoth  # noqa: B018


def test_importing_the_package_imports_nothing_heavy():
    code = "import fgloc, sys; print(*sorted({m.partition('.')[0] for m in sys.modules}))"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    heavy = {"numpy", "gtsam", "scipy", "pydantic", "click", "rich", "plotly", "pymap3d"}
    assert not heavy & set(shown.stdout.split())


def test_four_lines(drive):
    drive = fgloc.load(drive)
    result = fgloc.smooth(drive, mode="batch")
    scores = fgloc.score(result.trajectory, drive.truth)
    table = fgloc.compare(drive, ["raw:gnss", "graph-batch"])
    assert scores["horizontal_rmse_m"].value < 1.5
    assert [row.method for row in table.rows] == ["raw:gnss", "graph-batch"]


def test_load_takes_a_drive_a_name_and_a_folder(drive, tmp_path):
    from fgloc.datasets.drive_folder import write_drive

    assert fgloc.load(drive) is drive
    assert fgloc.load("city", seed=3, duration_s=30.0).gnss.same_as(drive.gnss)
    write_drive(drive, tmp_path / "city")
    assert fgloc.load(tmp_path / "city").gnss.same_as(drive.gnss)
    with pytest.raises(InputError, match="made already"):
        fgloc.load(drive, seed=1)


def test_a_config_may_be_a_file_a_model_or_settings(drive, tmp_path):
    path = tmp_path / "config.toml"
    path.write_text('[gnss]\nloss = "none"\n')
    model = fgloc.SmoothConfig.model_validate({"gnss": {"loss": "none"}})
    found = [
        fgloc.smooth(drive, config=path), fgloc.smooth(drive, config=model),
        fgloc.smooth(drive, settings=["gnss.loss=none"]),
    ]  # fmt: skip
    assert [run.config["gnss"]["loss"] for run in found] == ["none"] * 3
    assert found[0].trajectory.same_as(found[1].trajectory)
    assert found[0].trajectory.same_as(found[2].trajectory)


def test_contradictions_are_refused(drive):
    with pytest.raises(InputError, match="a lag goes with mode fixed-lag"):
        fgloc.smooth(drive, lag_s=3.0)
    with pytest.raises(InputError, match="smoothed goes with the causal modes"):
        fgloc.smooth(drive, "batch", smoothed=True)
    with pytest.raises(InputError, match="there is no truth"):
        fgloc.score(drive.truth, None)


def test_a_configurations_seed_makes_the_scenario_again():
    from fgloc.api import prepare

    opened, config = prepare("city", fgloc.SmoothConfig(seed=5))
    assert opened.gnss.same_as(fgloc.make("city", seed=5).gnss)
    opened, config = prepare("city", fgloc.SmoothConfig())
    assert config.seed == 0
    opened, config = prepare(opened, fgloc.SmoothConfig(seed=5))
    assert config.seed == 5


def test_raw_gnss_is_the_fixes(drive):
    result = fgloc.baseline(drive, "raw:gnss")
    estimate = result.trajectory
    np.testing.assert_array_equal(estimate.p_world_m, drive.gnss.p_world_ant_m)
    np.testing.assert_array_equal(estimate.cov[:, :3, :3], drive.gnss.cov_world_m2)
    np.testing.assert_array_equal(estimate.p_veh_point_m, drive.rig.p_veh_ant_m)
    assert np.linalg.eigvalsh(estimate.cov).min() > 0
    assert estimate.R_world_veh is None and result.causal
    assert result.summary["counts"]["gnss"] == {"used": len(drive.gnss)}
    assert result.summary["counts"]["imu"] == {"unused": len(drive.imu)}


def test_raw_gnss_judges_duplicates_and_broken_rows(drive):
    fixes = drive.gnss
    position = fixes.p_world_ant_m.copy()
    position[4] = np.nan
    t_ns = fixes.t_ns.copy()
    t_ns[5] = t_ns[4]
    t_ns[7] = t_ns[6]
    broken = dataclasses.replace(fixes, p_world_ant_m=position, t_ns=t_ns)
    result = fgloc.baseline(drive.with_tables(gnss=broken), "raw:gnss")
    verdict = result.verdicts["gnss"].verdict
    assert list(verdict[4:8]) == [Verdict.INVALID, Verdict.USED, Verdict.USED, Verdict.DUPLICATE]
    assert len(result.trajectory) == len(fixes) - 2
    with pytest.raises(InputError, match="none of the"):
        nothing = dataclasses.replace(fixes, p_world_ant_m=np.full_like(position, np.nan))
        fgloc.baseline(drive.with_tables(gnss=nothing), "raw:gnss")


@pytest.mark.parametrize(
    ("method", "says"),
    [
        ("raw-gnss", "no baseline named 'raw-gnss'; the nearest is 'raw:gnss'"),
        ("raw:imu", "imu does not tell positions; the nearest is 'raw:gnss'"),
        ("raw:gps", "it has no such source; the nearest is 'raw:gnss'"),
    ],
)
def test_unknown_baselines_are_refused_with_the_nearest(drive, method, says):
    with pytest.raises(InputError, match=says):
        fgloc.baseline(drive, method)


def test_every_baseline_that_is_listed_runs():
    one_car = roadside_drive(1, duration_s=40.0)
    node, several = (fgloc.load(f"khamooshi2023/{n}", seed=1) for n in ("right-turn", "one-node"))
    sway = fgloc.make("khamooshi2023/sway-low", duration_s=2.0)
    fitting = {
        "khamooshi2023-uio": sway, "sway-kf": sway, "raw:node_poses": sway,
        "khamooshi2023-ckf": node, "khamooshi2023-kcf": several, "covariance-intersection": several,
        "marr2019-iea": fgloc.load("marr2019/iea", seed=0),
        "marr2019-smart-code": fgloc.load("marr2019/smart-code", seed=0),
    }  # fmt: skip
    for name in baselines.available():
        if name == "khamooshi2023-uio-printed":  # says that its existence condition fails
            continue
        fits = fitting.get(name) or fitting.get(name.partition(":")[0], one_car)
        assert len(fgloc.baseline(fits, name).states_ns)


def test_compare_pairs_in_time_and_survives_a_failure(drive):
    rig = dataclasses.replace(drive.rig, imu_noise=None)
    blind = dataclasses.replace(drive, name="blind", rig=rig)
    table = fgloc.compare([drive, blind], ["raw:gnss", "graph-batch"], score_from_s=2.0)
    raw, graph, raw_blind, graph_blind = table.rows
    assert raw.difference is None and raw_blind.difference is None
    scored = [row.metrics["horizontal_rmse_m"].value for row in (raw, graph)]
    assert graph.difference.value == pytest.approx(scored[1] - scored[0])
    assert graph.difference.low <= graph.difference.value <= graph.difference.high
    assert "no [rig.imu_noise]" in graph_blind.failed and not graph_blind.metrics
    plain = table.to_dict()
    assert plain["against"] == "raw:gnss" and len(plain["rows"]) == 4
    assert plain["rows"][1]["metrics"]["anees"]["unit"] == "1"


def test_compare_repeats_scenarios_over_seeds():
    table = fgloc.compare("city", ["raw:gnss"], seeds=range(2))
    assert [(row.drive, row.seed) for row in table.rows] == [("city", 0), ("city", 1)]


def test_compare_takes_configurations_by_label_and_methods_of_ones_own(drive, tmp_path):
    (tmp_path / "plain.toml").write_text('[gnss]\nloss = "none"\n')
    ideal = fgloc.Method("truth", lambda of: dataclasses.replace(
        fgloc.baseline(of, "raw:gnss"), trajectory=of.truth))  # fmt: skip
    table = fgloc.compare(
        drive, ["graph-batch", ideal],
        configs={"plain": tmp_path / "plain.toml", "lag": fgloc.SmoothConfig(mode="fixed-lag")},
    )  # fmt: skip
    assert [row.method for row in table.rows] == ["graph-batch", "truth", "plain", "lag"]
    assert [row.label for row in table.rows] == ["smoothed", "causal", "smoothed", "causal"]
    losses = [row.config.get("gnss", {}).get("loss") for row in table.rows]
    assert losses == ["huber", None, "none", "huber"]
    assert table.rows[1].metrics["horizontal_rmse_m"].value == 0.0
    assert all(row.wall_s > 0 and row.requirements for row in table.rows)


def test_compare_sums_up_over_drives():
    table = fgloc.compare("city", ["raw:gnss", "graph-batch"], seeds=range(3))
    raw, graph = table.overall()
    each = [row.metrics["horizontal_rmse_m"].value for row in table.of("graph-batch")]
    assert graph.mean.value == pytest.approx(np.mean(each)) and graph.mean.n == table.drives == 3
    half = 4.3027 * np.std(each, ddof=1) / np.sqrt(3)  # Student t, 2 degrees of freedom
    assert graph.mean.high == pytest.approx(np.mean(each) + half, rel=1e-4)
    paired = [row.difference.value for row in table.of("graph-batch")]
    assert raw.difference is None and graph.difference.value == pytest.approx(np.mean(paired))
    assert graph.difference.high < 0


def test_compare_refuses_what_it_cannot_run(drive):
    with pytest.raises(InputError, match="no method named 'graph-bach'; the nearest is 'graph-b"):
        fgloc.compare(drive, ["graph-bach"])
    with pytest.raises(InputError, match="no methods to compare"):
        fgloc.compare(drive, [])
    with pytest.raises(InputError, match="seeds and options go with scenarios"):
        fgloc.compare(drive, ["raw:gnss"], seeds=[1])
    with pytest.raises(InputError, match="'raw:gnss' is there twice"):
        fgloc.compare(drive, ["raw:gnss", "raw:gnss"])
    with pytest.raises(InputError, match="'graph-lag' of a configuration is a method's name"):
        fgloc.compare(drive, configs={"graph-lag": fgloc.SmoothConfig()})
    with pytest.raises(InputError, match=r"none\.toml: No such file"):
        fgloc.compare(drive, configs={"a": "none.toml"})


def test_removed_fixes_score_the_rest(drive):
    thin = degrade(dataclasses.replace(drive, truth=None), keep_every=5)
    scores = fgloc.score(fgloc.baseline(thin, "raw:gnss").trajectory, thin.truth)
    assert scores["scored_share"].value == pytest.approx(1.0, abs=0.02)
