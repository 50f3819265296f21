"""The command `compare` and its page, end to end."""

import dataclasses
import json
import re

import numpy as np
import pytest
from baselines.roadside import roadside_drive
from test_report import Page, without_scripts

import fgloc
from fgloc.cli import main
from fgloc.datasets.drive_folder import write_drive
from fgloc.evaluation.conditions import ELSEWHERE, IN_RANGE
from fgloc.outputs import write_comparison
from fgloc.report.comparison_page import render
from fgloc.report.versus import (
    errors_of_methods,
    histogram_of_methods,
    method_style,
    plan_of_methods,
)  # fmt: skip


def without_noise(drive):
    """The drive without the noise of its IMU, which the graph cannot do without."""
    return dataclasses.replace(drive, rig=dataclasses.replace(drive.rig, imu_noise=None))


@pytest.fixture(scope="module")
def drive():
    return fgloc.make("city", seed=3, duration_s=30.0)


@pytest.fixture(scope="module")
def folder(drive, tmp_path_factory):
    path = tmp_path_factory.mktemp("compare") / "drive"
    write_drive(drive, path)
    return path


@pytest.fixture(scope="module")
def table(drive):
    return fgloc.compare(
        drive, ["graph-batch", "raw:gnss"],
        configs={"plain": fgloc.SmoothConfig.model_validate({"gnss": {"loss": "none"}})},
    )  # fmt: skip


@pytest.fixture(scope="module")
def passes():
    """A drive past a roadside node."""
    return fgloc.compare(roadside_drive(1, duration_s=60.0), ["raw:gnss", "lee2021-ekf"])


def test_the_command_writes_a_table_and_a_page(folder, tmp_path, capsys):
    (tmp_path / "plain.toml").write_text('[gnss]\nloss = "none"\n')
    out = tmp_path / "out"
    status = main([
        "compare", str(folder), "--methods", "raw:gnss, graph-batch", "--score-from", "5",
        "--config", f"plain={tmp_path / 'plain.toml'}", "--out", str(out),
    ])  # fmt: skip
    shown = capsys.readouterr().out
    assert status == 0 and f"Results in {out}" in shown and "minus raw:gnss" in shown
    assert re.search(r"^city +graph-batch +smoothed +0\.", shown, re.MULTILINE)
    assert {path.name for path in out.iterdir()} == {"compare.json", "report.html"}
    plain = json.loads((out / "compare.json").read_text())
    assert plain["methods"] == ["raw:gnss", "graph-batch", "plain"] and plain["score_from_s"] == 5
    assert [row["causal"] for row in plain["rows"]] == [True, False, False]
    last = plain["rows"][2]
    assert last["config"]["gnss"]["loss"] == "none" and last["config"]["versions"]["gtsam"]
    assert last["difference"]["low"] <= last["difference"]["value"] <= last["difference"]["high"]
    assert last["wall_s"] > 0 and "freeway" in last["requirements"]


def test_seeds_repeat_a_scenario_and_the_means_come_first(tmp_path, capsys):
    arguments = ["compare", "city", "--seeds", "4:6", "--methods", "raw:gnss", "--no-report"]
    status = main([*arguments, "--out", str(tmp_path / "out")])
    shown = capsys.readouterr().out
    assert status == 0 and shown.startswith("Horizontal RMSE over 2 drives")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"compare.json"}
    assert main([*arguments, "--json", "--out", str(tmp_path / "out")]) == 0
    plain = json.loads(capsys.readouterr().out)
    assert [row["seed"] for row in plain["rows"]] == [4, 5]
    assert plain["overall"][0]["horizontal_rmse_m"]["n"] == 2


def test_where_every_run_fails_the_command_does(drive, tmp_path, capsys):
    write_drive(without_noise(drive), tmp_path / "blind")
    status = main(["compare", str(tmp_path / "blind"), "--methods", "graph-batch", "--no-report",
                   "--out", str(tmp_path / "out")])  # fmt: skip
    assert status == 3 and "no method gave a result" in capsys.readouterr().err
    told = json.loads((tmp_path / "out" / "compare.json").read_text())
    assert "imu_noise" in told["rows"][0]["failed"]


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (["--methods", "graph-bach"], "the nearest is 'graph-batch'"),
        (["--methods", "raw:gnss,raw:gnss"], "'raw:gnss' is there twice"),
        (["--config", "raw:gnss=x.toml"], "is a method's name or empty"),
        (["--config", "a=none.toml"], "none.toml: No such file"),
        (["--methods", "raw:gnss", "--seeds", "0:2"], "seeds and options go with scenarios"),
    ],
)
def test_what_cannot_be_compared_is_refused_in_one_line(folder, tmp_path, capsys, more, says):
    assert main(["compare", str(folder), *more, "--out", str(tmp_path / "out")]) == 2
    out, err = capsys.readouterr()
    assert out == "" and says in err and err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_the_page_loads_nothing_and_holds_every_section(table):
    text = render(table)
    page = Page(text)
    assert page.loads == ["data:,"] and "http" not in without_scripts(text)
    assert page.headings == [
        "3 methods compared", "Run by run", "Plan view: city", "Errors over time: city",
        "Distribution of errors: city", "Histogram of errors: city",
        "How their configurations differ",
    ]  # fmt: skip
    assert without_scripts(text).count("gnss.loss") == 1
    assert "gnss.loss_width" not in text  # what is equal is not listed


def test_several_drives_are_summed_up_and_failures_named(drive):
    blind = dataclasses.replace(without_noise(drive), name="blind")
    table = fgloc.compare([drive, drive, blind], ["raw:gnss", "graph-batch"])
    page = Page(render(table))
    assert {"overall", "drives", "plan", "plan-1", "plan-2"} <= page.ids
    assert "city (2 drives), blind" in render(table)
    assert table.overall()[1].failed == 1 and "imu_noise" in render(table)


def test_near_a_node_and_elsewhere_are_scored_apart(passes, tmp_path, capsys):
    rows = {row.method: row for row in passes.rows}
    filtered = rows["lee2021-ekf"]
    parts = [filtered.conditions[name].metrics for name in (IN_RANGE, ELSEWHERE)]
    n = [one["horizontal_mean_m"].n for one in parts]
    assert sum(n) == filtered.metrics["horizontal_mean_m"].n and min(n) > 50
    by_hand = np.dot(n, [one["horizontal_mean_m"].value for one in parts]) / sum(n)
    assert filtered.metrics["horizontal_mean_m"].value == pytest.approx(by_hand)
    ratio = filtered.conditions[IN_RANGE].ratio
    means = [rows[m].conditions[IN_RANGE].metrics["horizontal_mean_m"].value
             for m in ("lee2021-ekf", "raw:gnss")]  # fmt: skip
    assert ratio.value == pytest.approx(means[0] / means[1], rel=0.02)
    assert ratio.low < ratio.value < ratio.high < 1
    standing = passes.standings()
    assert [s.condition for s in standing] == ["whole drive"] * 2 + [IN_RANGE] * 2 + [ELSEWHERE] * 2
    assert standing[0].ratio is None and standing[3].ratio == ratio
    plain = passes.to_dict()
    assert plain["rows"][1]["conditions"][IN_RANGE]["ratio"]["value"] == ratio.value
    assert len(plain["standings"]) == 6


def test_a_drive_that_lies_all_in_range_has_nothing_elsewhere():
    table = fgloc.compare(fgloc.make("marr2019/iea", seed=1), ["raw:gnss"])
    assert [one.condition for one in table.standings()] == ["whole drive", IN_RANGE]


def test_the_page_shades_the_range_of_the_node_and_shows_histograms_there(passes):
    page = Page(render(passes))
    assert {"conditions", "histogram", "cdf", "cdf-near"} <= page.ids
    picture = passes.pictures[0]
    shapes = errors_of_methods(picture, passes.methods)["layout"]["shapes"]
    near = picture.masks[IN_RANGE]
    t_s = (picture.truth.t_ns[near] - picture.start_ns) / 1e9
    assert shapes[0]["x0"] == t_s[0] and shapes[-1]["x1"] == t_s[-1]
    histogram = histogram_of_methods(picture, passes.methods)["data"]
    assert [one["name"] for one in histogram] == ["raw:gnss", "lee2021-ekf"]
    for one in histogram:
        assert 0.98 < one["y"][:-1].sum() <= 1 + 1e-9
    assert plan_of_methods(picture, passes.methods)["data"][-1]["name"] == "node"


def test_over_several_drives_the_ratio_is_of_the_sums():
    drives = [roadside_drive(seed, duration_s=40.0) for seed in (1, 3)]
    table = fgloc.compare(drives, ["raw:gnss", "lee2021-ekf"])
    means = {m: [r.metrics["horizontal_mean_m"].value for r in table.of(m)] for m in table.methods}
    ratio = table.standings()[1].ratio
    assert ratio.n == 2 and ratio.low <= ratio.value <= ratio.high
    assert ratio.value == pytest.approx(
        sum(means["lee2021-ekf"]) / sum(means["raw:gnss"]), rel=0.01
    )


def test_a_method_that_says_little_is_compared_where_it_does():
    drives = [roadside_drive(seed, duration_s=40.0) for seed in (1, 3)]
    table = fgloc.compare(drives, ["raw:gnss", "raw:detections"])
    standing = table.standings()[1]
    pairs = np.array([row.means for row in table.of("raw:detections")])
    assert standing.ratio.value == pytest.approx(pairs[:, 0].sum() / pairs[:, 1].sum())
    assert all(row.metrics["scored_share"].value < 0.9 for row in table.of("raw:detections"))
    own = [row.metrics["horizontal_mean_m"].value for row in table.of("raw:detections")]
    np.testing.assert_allclose(pairs[:, 0], own, rtol=0.02)


def test_the_command_prints_the_conditions(tmp_path, capsys):
    write_drive(roadside_drive(1, duration_s=40.0), tmp_path / "drive")
    status = main(["compare", str(tmp_path / "drive"), "--methods", "raw:gnss,lee2021-ekf",
                   "--no-report", "--out", str(tmp_path / "out")])  # fmt: skip
    shown = capsys.readouterr().out
    assert status == 0 and "within the range of a node, elsewhere" in shown
    assert "mean / raw:gnss" in shown and re.search(r"^in range +lee2021-ekf +0\.", shown, re.M)


def test_without_truth_the_paths_are_shown_all_the_same(drive, tmp_path):
    table = fgloc.compare(dataclasses.replace(drive, truth=None), ["raw:gnss", "graph-batch"])
    write_comparison(tmp_path / "out", table)
    page = Page((tmp_path / "out" / "report.html").read_text())
    assert "plan" in page.ids and not {"errors", "cdf"} & page.ids


def test_labels_are_escaped(drive):
    evil = fgloc.Method("<img src=x>", lambda of: fgloc.baseline(of, "raw:gnss"))
    text = render(fgloc.compare(drive, [evil]))
    assert "<img src=x>" not in text and "&lt;img src=x&gt;" in text


def test_each_method_has_a_line_of_its_own_in_every_panel(table):
    picture = table.pictures[0]
    lines = errors_of_methods(picture, table.methods)["data"]
    panels = {name: sum(line["name"] == name for line in lines) for name in table.methods}
    assert panels == {"graph-batch": 5, "raw:gnss": 4, "plain": 5}  # raw fixes have no heading
    assert len({line["line"]["color"] for line in lines}) == 3
    names = [line["name"] for line in plan_of_methods(picture, table.methods)["data"]]
    assert names == ["truth", "graph-batch", "raw:gnss", "plain"]
    assert len({method_style(n) for n in range(18)}) == 18


def test_trajectories_are_kept_of_the_first_drives_only():
    table = fgloc.compare("city", ["raw:gnss"], seeds=range(6))
    assert [picture.seed for picture in table.pictures] == [0, 1, 2, 3] and table.drives == 6


def test_options_of_a_scenario_go_into_the_table(tmp_path, capsys):
    out = tmp_path / "out"
    asked = ["compare", "city", "--methods", "raw:gnss", "--seeds", "1:3", "--out", str(out)]
    assert main([*asked, "--set", "duration_s=20"]) == 0
    written = json.loads((out / "compare.json").read_text())
    assert written["options"] == {"duration_s": 20}
    assert written["rows"][0]["metrics"]["horizontal_rmse_m"]["n"] <= 20 * 50 + 1
    assert "duration_s = 20" in (out / "report.html").read_text()
    assert main([*asked, "--set", "duration=20"]) == 2
    assert "duration_s" in capsys.readouterr().err
    assert main([*asked, "--set", "seed=1"]) == 2


def test_options_need_a_scenario(drive):
    with pytest.raises(fgloc.FglocError, match="none of the drives is given as one by name"):
        fgloc.compare(drive, ["raw:gnss"], options={"duration_s": 20})
