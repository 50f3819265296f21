"""The commands that estimate and score, end to end: what they write and say."""

import csv
import dataclasses
import json
import re
import shutil
import tomllib

import numpy as np
import pytest
from evaluation.curves import CONTRACT

from fgloc import api
from fgloc.config import load_config
from fgloc.datasets import open_drive
from fgloc.datasets.drive_folder import read_drive
from fgloc.datasets.trajectory_files import read_trajectory, write_trajectory_csv
from fgloc.errors import InputError
from fgloc.outputs import (
    FILES,
    NODES,
    OBJECTS,
    POSTS,
    VERDICT_COLUMNS,
    format_verdicts,
    write_result,
)
from fgloc.verdicts import SourceVerdicts, Verdict

PLAIN_FILES = {"trajectory.tum", "trajectory.csv", "trajectory.geojson", "verdicts.csv",
               "summary.json", "config.toml"}  # fmt: skip


def verdict_rows(folder):
    with (folder / "verdicts.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_smooth_writes_every_file(mems):
    out, done = mems
    assert {path.name for path in out.iterdir()} == {*PLAIN_FILES, "report.html"}
    assert f"Results in {out}" in done.stdout and "Horizontal RMSE" in done.stdout
    assert done.stderr == ""


def test_every_measurement_has_its_verdict(mems):
    out, _ = mems
    drive = open_drive("mems-rtk")
    summary = json.loads((out / "summary.json").read_text())
    rows = verdict_rows(out)
    assert tuple(rows[0]) == VERDICT_COLUMNS
    for source, table in drive.tables.items():
        mine = [row for row in rows if row["source"] == source]
        np.testing.assert_array_equal([int(row["t_ns"]) for row in mine], table.t_ns)
        counted = {v: sum(r["verdict"] == v for r in mine) for v in {r["verdict"] for r in mine}}
        assert summary["counts"][source] == counted
        assert sum(counted.values()) == len(table)
    assert len(rows) == len(drive.gnss) + len(drive.imu)
    assert "nan" not in (out / "verdicts.csv").read_text()


def test_summary_holds_what_the_contract_names(mems):
    out, _ = mems
    summary = json.loads((out / "summary.json").read_text())
    for key in ("drive", "method", "mode", "duration_s", "wall_s", "realtime_factor", "states",
                "factors", "counts", "origin", "metrics", "versions", "seed"):  # fmt: skip
        assert key in summary
    assert (summary["drive"], summary["method"]) == ("mems-rtk", "graph-batch")
    assert set(summary["origin"]) == {"lat_deg", "lon_deg", "height_m", "datum"}
    assert set(summary["metrics"]) >= CONTRACT
    for metric in summary["metrics"].values():
        assert {"value", "unit", "better", "n"} <= set(metric)
        assert metric["value"] is not None or metric["why"]
    assert summary["metrics"]["horizontal_rmse_m"]["value"] < 0.05


def test_requirements_are_judged_by_smooth_and_eval_alike(mems, run, tmp_path):
    out, done = mems
    summary = json.loads((out / "summary.json").read_text())
    freeway = summary["requirements"]["freeway"]
    assert freeway["accuracy95"]["lateral_m"]["answer"] == "yes"
    assert {row["answer"] for row in freeway["alert"].values()} == {"not enough data"}
    assert re.search(r"^Freeway +yes: lateral", done.stdout, re.MULTILINE)
    _, text, _ = run("eval", out, "mems-rtk", "--json")
    again = json.loads(text)["requirements"]["freeway"]["accuracy95"]["lateral_m"]
    assert again["answer"] == "yes"
    assert again["value"] == pytest.approx(freeway["accuracy95"]["lateral_m"]["value"], rel=1e-9)
    assert "alert limits" in run("eval", out, "mems-rtk", "--out", tmp_path)[1]
    assert "requirements" in json.loads((tmp_path / "summary.json").read_text())


def test_trajectories_read_back(mems):
    out, _ = mems
    from_csv, from_tum = (read_trajectory(out / f"trajectory.{kind}") for kind in ("csv", "tum"))
    np.testing.assert_array_equal(from_csv.t_ns, from_tum.t_ns)
    np.testing.assert_array_equal(from_csv.p_world_m, from_tum.p_world_m)
    assert from_csv.cov is not None and from_csv.v_world_mps is not None
    scores = api.score(from_csv, open_drive("mems-rtk").truth)
    summary = json.loads((out / "summary.json").read_text())
    for name in ("horizontal_rmse_m", "anees"):
        assert scores[name].value == pytest.approx(summary["metrics"][name]["value"], rel=1e-9)


def test_the_map_is_valid(mems):
    out, _ = mems
    collection = json.loads((out / "trajectory.geojson").read_text())
    assert collection["type"] == "FeatureCollection"
    estimate, truth = collection["features"]
    assert truth["properties"]["name"] == "truth"
    lon, lat = np.array(estimate["geometry"]["coordinates"])[:, :2].T
    assert np.ptp(lon) < 0.2 and np.abs(lat - 40.1).max() < 0.1


def test_the_report_loads_nothing(mems):
    out, _ = mems
    page = re.sub(r"<script.*?</script>", "", (out / "report.html").read_text(), flags=re.DOTALL)
    assert not re.search(r"""(src|href)\s*=\s*["']?(https?:)?//""", page)
    assert "mems-rtk" in page


def test_the_saved_configuration_is_what_was_in_force(mems, run, city, tmp_path):
    saved = mems[0] / "config.toml"
    in_force = load_config(saved).model_dump(mode="json", exclude_none=True)  # lists as in TOML
    assert in_force == tomllib.loads(saved.read_text())
    assert "gtsam" in saved.read_text()
    first, again = tmp_path / "a", tmp_path / "b"
    run("smooth", city, "--out", first, "--no-report", "--set", "gnss.loss=none", "--mode", "batch")
    run("smooth", city, "--out", again, "--no-report", "--config", first / "config.toml")
    for name in ("trajectory.csv", "config.toml", "verdicts.csv"):
        assert (first / name).read_bytes() == (again / name).read_bytes()


def test_degrade_smooth_explain(run, tmp_path):
    status, out, _ = run("degrade", "mems-rtk", "--source", "gnss", "--keep-every", "2",
                         "--outage", "60:30:200", "--out", tmp_path / "worse")  # fmt: skip
    assert status == 0 and "truth" in out
    worse = read_drive(tmp_path / "worse")
    assert len(worse.gnss) + len(worse.truth) == 543 + 1626
    folder = tmp_path / "result"
    status, out, _ = run("smooth", tmp_path / "worse", "--out", folder, "--no-report", "--json")
    assert status == 0
    summary = json.loads(out)
    assert summary == json.loads((folder / "summary.json").read_text())
    assert summary["metrics"]["outage_count"]["value"] == 3
    assert {path.name for path in folder.iterdir()} == PLAIN_FILES
    status, out, _ = run("explain", folder, "--t", "60.5", "--window", "5")
    assert status == 0
    assert re.search(r"58\.000\s+gnss\s+used", out) and "imu: 1,001 used" in out
    assert "longitudinal" in out and "62.000" not in out
    status, out, _ = run("explain", folder, "--t", "60.5", "--json")
    found = json.loads(out)
    assert found["counted"]["imu"][0]["n"] == 401 and found["sigmas"]["lateral_m"] > 0


def test_a_causal_mode_with_its_smoothed_states(run, city, tmp_path):
    out = tmp_path / "lag"
    status, text, _ = run("smooth", city, "--mode", "fixed-lag", "--lag", "4", "--smoothed",
                          "--out", out, "--score-from", "15", "--also", "gpx,kml")  # fmt: skip
    assert status == 0 and "causal, no look-ahead" in text and "which looks ahead" in text
    assert {path.name for path in out.iterdir()} == set(FILES) - {OBJECTS, POSTS, NODES}
    summary = json.loads((out / "summary.json").read_text())
    assert summary["causal"] and summary["method"] == "graph-lag"
    assert tomllib.loads((out / "config.toml").read_text())["lag_s"] == 4.0
    assert set(summary["smoothed_metrics"]) == set(summary["metrics"])
    assert summary["metrics"]["scored_share"]["value"] == pytest.approx(0.5, abs=0.05)
    status, text, _ = run("eval", out / "trajectory_smoothed.csv", city, "--json",
                          "--score-from", "15")  # fmt: skip
    scored = json.loads(text)["metrics"]
    assert scored["horizontal_rmse_m"]["value"] == pytest.approx(
        summary["smoothed_metrics"]["horizontal_rmse_m"]["value"]
    )
    run("smooth", city, "--out", out, "--no-report")
    assert {path.name for path in out.iterdir()} == PLAIN_FILES  # nothing old among the new


def test_baseline_and_eval(run, city, tmp_path):
    out = tmp_path / "raw"
    status, text, _ = run("baseline", city, "--method", "raw:gnss", "--out", out)
    assert status == 0 and "the estimate has no attitude" in text
    summary = json.loads((out / "summary.json").read_text())
    rmse = summary["metrics"]["horizontal_rmse_m"]["value"]
    for estimate in (out, out / "trajectory.tum", out / "trajectory.csv"):
        status, text, _ = run("eval", estimate, city, "--json")
        assert json.loads(text)["metrics"]["horizontal_rmse_m"]["value"] == pytest.approx(rmse)
    assert run("smooth", city, "--out", out, "--config", out / "config.toml", "--no-report")[0] == 0


def test_eval_of_two_files_does_not_align(run, city, tmp_path):
    truth = read_drive(city).truth
    write_trajectory_csv(tmp_path / "truth.csv", truth)
    moved = type(truth)(truth.t_ns, truth.p_world_m + [3.0, 4.0, 0.0], truth.R_world_veh)
    write_trajectory_csv(tmp_path / "moved.csv", moved)
    out = tmp_path / "scores"
    status, text, _ = run("eval", tmp_path / "moved.csv", tmp_path / "truth.csv", "--out", out)
    assert status == 0 and f"Results in {out}" in text
    metrics = json.loads((out / "summary.json").read_text())["metrics"]
    assert metrics["horizontal_rmse_m"]["value"] == pytest.approx(5.0)
    assert metrics["anees"]["value"] is None and metrics["anees"]["why"]


def test_a_drive_without_truth(run, city, tmp_path):
    blind = tmp_path / "blind"
    shutil.copytree(city, blind)
    (blind / "truth.csv").unlink()
    toml = (blind / "drive.toml").read_text()
    (blind / "drive.toml").write_text(toml.partition("[truth]")[0])
    status, text, _ = run("smooth", blind, "--out", tmp_path / "out")
    assert status == 0 and "no truth" in text
    assert "metrics" not in json.loads((tmp_path / "out" / "summary.json").read_text())


def test_dense_sources_are_counted_in_the_order_of_their_names(city, run, tmp_path):
    run("smooth", city, "--out", tmp_path / "out", "--no-report")
    found = json.loads(run("explain", tmp_path / "out", "--t", "15", "--json")[1])
    assert list(found["counted"]) == ["gnss", "imu", "wheel"]


def test_verdict_cells_are_quoted_where_they_must_be(tmp_path):
    table = open_drive("mems-rtk").gnss.take(slice(0, 3))
    verdicts = SourceVerdicts.of("gnss", table, Verdict.USED)
    verdicts.set(1, Verdict.GATED, 'too far, said "the gate"')
    verdicts.nis[1], verdicts.dof[1], verdicts.threshold[1] = 0.1, 3, np.inf
    (tmp_path / "verdicts.csv").write_text(format_verdicts({"gnss": verdicts}))
    rows = verdict_rows(tmp_path)
    assert rows[1]["reason"] == 'too far, said "the gate"'
    assert (rows[1]["nis"], rows[1]["dof"], rows[1]["threshold"]) == ("0.1", "3", "inf")
    assert (rows[0]["nis"], rows[0]["dof"], rows[0]["threshold"]) == ("", "0", "")


def test_verdicts_are_written_row_by_row_whatever_neighbours_have_in_common(tmp_path):
    table = open_drive("mems-rtk").gnss.take(slice(0, 40))
    verdicts = SourceVerdicts.of("gnss", table, Verdict.USED)
    rng = np.random.default_rng(0)
    kinds = [(Verdict.USED, ""), (Verdict.DOWN_WEIGHTED, "huber weight 0.9"), (Verdict.GATED, "x")]
    for row, kind in enumerate(rng.integers(0, 3, 40).tolist()):
        verdicts.set(row, *kinds[kind])
    verdicts.nis[:] = np.where(rng.random(40) < 0.3, np.nan, rng.random(40))
    verdicts.dof[:] = rng.integers(2, 4, 40)
    verdicts.threshold[:] = rng.choice([np.nan, np.inf, 7.8, 9.2], 40)
    (tmp_path / "verdicts.csv").write_text(format_verdicts({"gnss": verdicts}))
    for i, row in enumerate(verdict_rows(tmp_path)):
        assert int(row["t_ns"]) == verdicts.t_ns[i]
        assert (row["verdict"], row["reason"]) == (verdicts.verdict[i], verdicts.reason[i])
        assert int(row["dof"]) == verdicts.dof[i]
        np.testing.assert_equal(float(row["nis"] or "nan"), verdicts.nis[i])
        np.testing.assert_equal(float(row["threshold"] or "nan"), verdicts.threshold[i])


def test_an_estimate_that_cannot_be_compared_leaves_an_older_result_alone(tmp_path):
    drive = open_drive("mems-rtk")
    result = api.baseline(drive, "raw:gnss")
    write_result(tmp_path, drive, result, report=False)
    older = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    truth = dataclasses.replace(drive.truth, R_world_veh=None, p_veh_point_m=np.array([9.0, 0, 0]))
    with pytest.raises(InputError, match="neither has an attitude"):
        write_result(tmp_path, dataclasses.replace(drive, truth=truth), result, report=False)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == older


def test_on_a_terminal_the_tables_are_the_same(monkeypatch, capsys):
    from fgloc.cli import screen

    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    screen.table("Title", ("name", "value"), [("[bold]", "1,234"), ("b", "2")])
    shown = re.sub("\x1b\\[[0-9;]*m", "", capsys.readouterr().out)
    assert [line.split() for line in shown.splitlines() if line.strip()] == [
        ["Title"], ["name", "value"], ["[bold]", "1,234"], ["b", "2"],
    ]  # fmt: skip
