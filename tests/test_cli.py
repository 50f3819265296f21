"""The command line, end to end: what it writes, what it says, how it ends."""

import csv
import json
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from fgloc import api, cli
from fgloc.cli import main
from fgloc.config import load_config
from fgloc.datasets import open_drive
from fgloc.datasets.drive_folder import read_drive, write_drive
from fgloc.datasets.trajectory_files import read_trajectory, write_trajectory_csv
from fgloc.errors import SolverError
from fgloc.outputs import FILES, NODES, OBJECTS, POSTS, VERDICT_COLUMNS, format_verdicts
from fgloc.verdicts import SourceVerdicts, Verdict

COMMANDS = (
    "datasets", "make", "import", "doctor", "degrade", "smooth", "baseline", "compare", "eval",
    "explain", "tune", "correspond",
)  # fmt: skip
METRICS = {
    "horizontal_rmse_m", "horizontal_mean_m", "horizontal_std_m", "horizontal_p95_m",
    "horizontal_max_m", "lateral_rmse_m", "longitudinal_rmse_m", "lateral_mean_abs_m",
    "lateral_std_abs_m", "longitudinal_mean_abs_m", "longitudinal_std_abs_m", "yaw_rmse_rad",
    "anees", "coverage95",
}  # fmt: skip
PLAIN_FILES = {"trajectory.tum", "trajectory.csv", "trajectory.geojson", "verdicts.csv",
               "summary.json", "config.toml"}  # fmt: skip


def shell(*arguments, **more):
    """Run the command as people do."""
    command = [Path(sys.executable).parent / "fgloc", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, **more)


@pytest.fixture
def run(capsys):
    """Run a command in this process: exit status, standard output, standard error."""

    def call(*arguments):
        status = main([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        assert "Traceback" not in out + err
        return status, out, err

    return call


@pytest.fixture
def refuse(run):
    """Run a command that has to end with status 2 and one line; gives the line."""

    def call(*arguments):
        status, out, err = run(*arguments)
        assert (status, out) == (2, "")
        assert err.startswith("fgloc: ") and err.count("\n") == 1, err
        return err

    return call


@pytest.fixture(scope="module")
def mems(tmp_path_factory):
    """The embedded drive smoothed by the real command, report and all."""
    out = tmp_path_factory.mktemp("mems") / "result"
    done = shell("smooth", "mems-rtk", "--out", out)
    assert done.returncode == 0, done.stderr
    return out, done


@pytest.fixture(scope="module")
def city(tmp_path_factory):
    """A folder with a simulated drive of 30 s."""
    folder = tmp_path_factory.mktemp("city") / "drive"
    assert main(["make", "city", "--seed", "1", "--duration", "30", "--out", str(folder)]) == 0
    return folder


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
    assert set(summary["metrics"]) >= METRICS
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


def test_make_is_repeatable_and_does_not_overwrite_unasked(run, refuse, city, tmp_path):
    options = ("make", "city", "--seed", "1", "--set", "duration_s=30", "--out")
    assert run(*options, tmp_path / "again")[0] == 0
    for name in ("gnss.csv", "imu.csv", "truth.csv", "drive.toml"):
        assert (tmp_path / "again" / name).read_bytes() == (city / name).read_bytes()
    assert "holds a drive already" in refuse(*options, tmp_path / "again")
    assert run(*options, tmp_path / "again", "--overwrite")[0] == 0


def test_drives_tell_of_themselves_in_json(run, city, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    made = run("make", "city", "--seed", "1", "--duration", "30", "--out", "made", "--json")
    told = json.loads(made[1])
    assert told == {
        "drive": "city", "folder": "made", "duration_s": 30.0,
        "rows": {"gnss": 301, "imu": 3001, "wheel": 1501}, "truth_rows": 601,
    }  # fmt: skip
    worse = run("degrade", city, "--keep-every", "10", "--out", "worse", "--json")
    assert json.loads(worse[1])["rows"] == {**told["rows"], "gnss": 31}
    source = tmp_path / "recording"
    source.mkdir()
    (source / "imu.csv").write_text(
        "gps_sow_s,accel_x_frd_mps2,accel_y_frd_mps2,accel_z_frd_mps2,"
        "gyro_x_frd_radps,gyro_y_frd_radps,gyro_z_frd_radps\n243262.0,0,0,-9.8,0,0,0\n"
    )
    (source / "rtk.csv").write_text(
        "gps_sow_s,lat_deg,lon_deg,ellipsoidal_height_m,quality,sigma_e_m,sigma_n_m,sigma_u_m,"
        "v_north_mps,v_east_mps,v_down_mps\n243262.0,40,-105,1600,1,1,1,1,0,0,0\n"
    )
    status, text, _ = run("import", "mems-rtk", source, "--out", "new", "--json")
    assert status == 0 and json.loads(text) == {
        "drive": "mems-rtk", "folder": "new", "duration_s": 0.0, "rows": {"gnss": 1, "imu": 1},
        "truth_rows": 0, "source": read_drive("new").about.source,
    }  # fmt: skip


def test_import_and_datasets(run, refuse, tmp_path):
    status, text, _ = run("datasets")
    assert status == 0 and "mems-rtk" in text and "BSD-3-Clause" in text and "city" in text
    assert {row["name"] for row in json.loads(run("datasets", "--json")[1])["datasets"]} >= {"city"}
    assert "no such file" in refuse("import", "mems-rtk", tmp_path, "--out", tmp_path / "a")
    assert "the nearest is 'mems-rtk'" in refuse("import", "mems", tmp_path, "--out", tmp_path)


def test_an_import_says_what_was_left_out(run, refuse, tmp_path):
    status, text, _ = run("import", "kitti", "--out", tmp_path / "kitti")
    assert status == 0 and "left out: IMU rows without a usable interval (2)" in text
    assert "left out" in (tmp_path / "kitti" / "drive.toml").read_text()
    assert "takes no source" in refuse("import", "kitti", "x", "--out", tmp_path / "b")
    assert "needs a source" in refuse("import", "nmea", "--out", tmp_path / "b")


def test_a_position_log_with_an_imu_beside_it_can_be_smoothed(run, refuse, city, tmp_path):
    drive = read_drive(city)
    lines = ["%  UTC latitude(deg) longitude(deg) height(m) Q sdn(m) sde(m) sdu(m) "
             "sdne(m) sdeu(m) sdun(m)"]  # fmt: skip
    places = drive.origin.to_geodetic(drive.gnss.p_world_ant_m)
    sigmas = np.sqrt(np.diagonal(drive.gnss.cov_world_m2, axis1=1, axis2=2))
    for t_ns, place, (east, north, up) in zip(drive.gnss.t_ns, places, sigmas, strict=True):
        stamp = str(np.datetime64(int(t_ns), "ns")).replace("-", "/").replace("T", " ")
        lat, lon, height = place
        lines.append(f"{stamp} {lat:.10f} {lon:.10f} {height:.4f} 1 {north} {east} {up} 0 0 0")
    (tmp_path / "rover.pos").write_text("\n".join(lines) + "\n")
    noise = drive.rig.imu_noise
    (tmp_path / "imu.yaml").write_text(
        f"accelerometer_noise_density: {noise.accel_noise_mps2_per_sqrt_hz}\n"
        f"accelerometer_random_walk: {noise.accel_bias_walk_mps3_per_sqrt_hz}\n"
        f"gyroscope_noise_density: {noise.gyro_noise_radps_per_sqrt_hz}\n"
        f"gyroscope_random_walk: {noise.gyro_bias_walk_radps2_per_sqrt_hz}\n"
    )
    files = "--imu", city / "imu.csv", "--imu-noise", tmp_path / "imu.yaml"
    out = tmp_path / "imported"
    arguments = "import", "rtklib-pos", tmp_path / "rover.pos"
    assert "imu is given without imu_noise" in refuse(*arguments, *files[:2], "--out", out)
    assert "--set imu and the option of that name" in run(
        *arguments, *files, "--set", "imu=x", "--out", out
    )[2]  # fmt: skip
    assert run(*arguments, *files, "--out", out)[0] == 0
    imported = read_drive(out)
    np.testing.assert_array_equal(imported.gnss.t_ns, drive.gnss.t_ns)
    assert imported.imu.same_as(drive.imu)
    status, text, _ = run("smooth", out, "--out", tmp_path / "result", "--no-report", "--json",
                          "--set", "solver.max_iterations=30", "--also", "kml")  # fmt: skip
    assert status == 0, text
    assert (tmp_path / "result" / "trajectory.kml").is_file()


def test_other_formats_than_gpx_and_kml_are_refused(run, city, tmp_path):
    status, _, err = run("smooth", city, "--out", tmp_path / "a", "--also", "gpx,shp")
    assert status == 2 and "'shp' is none of gpx, kml" in err


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_with_an_example(run, command):
    status, text, _ = run(command, "--help")
    assert status == 0 and f"fgloc {command}" in text.partition("Example")[2]


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from fgloc.cli import main; status = main(sys.argv[1:]);"
        "print(*{m.partition('.')[0] for m in sys.modules}, file=sys.stderr); sys.exit(status)"
    )
    for arguments in (["--help"], ["smooth", "--help"]):
        done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True,
                              text=True, check=True)  # fmt: skip
        heavy = {"numpy", "gtsam", "scipy", "pydantic", "rich", "plotly", "jinja2", "pymap3d"}
        assert not heavy & set(done.stderr.split())


def test_as_a_module():
    command = [sys.executable, "-m", "fgloc", "--version"]
    assert (
        subprocess.run(command, capture_output=True, text=True, check=True).stdout[:6] == "fgloc "
    )


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["smooth", "mems-rtk"], "Missing option '--out'"),
        (["smoth"], "No such command 'smoth'"),
        (["smooth", "city", "--out", "x", "--lag", "3", "--lag", "4"], "--lag is given twice"),
        (["smooth", "city", "--out", "x", "--mode", "batsh"], "'batch', 'incremental'"),
        (["smooth", "city", "--out", "x", "--set", "gnss.loss"], "not of the form key=value"),
        (
            ["smooth", "city", "--out", "x", "--set", "a=1", "--set", "a=2"],
            "--set a is given twice",
        ),
        (["smooth", "city", "--out", "x", "--mode", "batch", "--set", "mode=batch"], "give one of"),
        (["smooth", "city", "--out", "x", "--config", "none.toml"], "does not exist"),
        (["smooth", "city", "--out", "x", "--score-from", "nan"], "not a finite number"),
        (["smooth", "city", "--out", "x", "--seed", "-1"], "-1 is not in the range"),
        (["make", "city", "--duration", "9", "--set", "duration_s=9", "--out", "x"], "give one of"),
        (["degrade", "mems-rtk", "--outage", "60:30", "--out", "x"], "FIRST:LEN:PERIOD"),
        (["degrade", "mems-rtk", "--noise", "1,1,m", "--out", "x"], "not of the form E,N,U"),
        (["degrade", "mems-rtk", "--seed", "1", "--out", "x"], "--seed goes with --noise"),
        (["degrade", "mems-rtk", "--source", "imu", "--out", "x"], "'imu' is not 'gnss'"),
        (["explain", "x"], "Missing option '--t'"),
        (["compare", "city", "--out", "x"], "give --methods, --config or both"),
        (["compare", "--methods", "graph-batch", "--out", "x"], "Missing argument 'DRIVE...'"),
        (["compare", "city", "--methods", "a", "--seeds", "5:5", "--out", "x"], "holds no seed"),
        (["compare", "city", "--methods", "a", "--seeds", "-1", "--out", "x"], "FIRST:END"),
        (["compare", "city", "--config", "plain.toml", "--out", "x"], "of the form LABEL=FILE"),
        (["compare", "city", "--config", "a=b", "--config", "a=c", "--out", "x"], "given twice"),
    ],
)
def test_wrong_usage(run, tmp_path, monkeypatch, arguments, says):
    monkeypatch.chdir(tmp_path)
    status, out, err = run(*arguments)
    assert (status, out) == (2, "") and says in err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["mems-rtx"], "no drive named 'mems-rtx'"),
        (["mems-rtk", "--seed", "3"], "is a recorded drive"),
        (["mems-rtk", "--lag", "3"], "a lag goes with mode fixed-lag"),
        (["mems-rtk", "--smoothed"], "smoothed goes with the causal modes"),
        (["mems-rtk", "--set", "gnss.los=none"], "the nearest valid key is 'gnss.loss'"),
        (["mems-rtk", "--set", "gnss.loss_width=-1"], "gnss.loss_width = -1"),
    ],
)
def test_wrong_options_of_smooth(refuse, tmp_path, arguments, says):
    assert says in refuse("smooth", *arguments, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def edit_cell(column, value, row=3):
    """A change of one cell of gnss.csv; rows count from 1 below the header."""

    def change(lines):
        cells = lines[row].split(",")
        cells[lines[0].split(",").index(column)] = value
        lines[row] = ",".join(cells)
        return lines

    return change


def rename(column, name):
    return lambda lines: [lines[0].replace(column, name, 1), *lines[1:]]


SPOILED = {
    "wrong header": (rename("east_m", "eest_m"), "unknown column 'eest_m'"),
    "unknown unit": (rename("east_m", "east_km"), "unknown unit 'km' in column 'east_km'"),
    "text in a cell": (edit_cell("up_m", "high"), "gnss.csv:4: up_m = 'high' is not a number"),
    "NaN": (edit_cell("up_m", "nan"), "gnss.csv:4: up_m is nan"),
    "time back": (edit_cell("t_ns", "1"), "goes back by"),
    "no rows": (lambda lines: lines[:1], "the table is empty"),
    "no variance": (edit_cell("cov_ee_m2", "0.0"), "a zero or negative variance"),
    "cut off": (lambda lines: [*lines[:5], lines[5][:30]], "the file looks cut off"),
}


@pytest.fixture
def spoiled(city, tmp_path):
    folder = tmp_path / "spoiled"
    shutil.copytree(city, folder)
    return folder


@pytest.mark.parametrize("fault", SPOILED)
def test_spoiled_tables(refuse, spoiled, tmp_path, fault):
    change, says = SPOILED[fault]
    path = spoiled / "gnss.csv"
    path.write_text("\n".join(change(path.read_text().splitlines())))
    assert says in refuse("smooth", spoiled, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_spoiled_places(refuse, spoiled, tmp_path):
    path = spoiled / "gnss.csv"
    text = path.read_text().replace("east_m,north_m,up_m", "lat_deg,lon_deg,height_m", 1)
    path.write_text(text)
    edited = edit_cell("lat_deg", "91.5")(text.splitlines())
    path.write_text("\n".join(edited) + "\n")
    assert "lat_deg = 91.5 is outside" in refuse("smooth", spoiled, "--out", tmp_path / "out")


def test_missing_files(refuse, spoiled, tmp_path):
    out = tmp_path / "out"
    assert "no drive named" in refuse("smooth", tmp_path / "none", "--out", out)
    assert "no such file" in refuse("eval", tmp_path / "none.csv", spoiled)
    assert "no such file" in refuse("explain", tmp_path, "--t", "1")
    (spoiled / "drive.toml").unlink()
    assert "not a drive folder" in refuse("smooth", spoiled, "--out", out)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["make", "city", "--set", "seed=3"], "a seed comes from --seed alone"),
        (["make", "city", "--seed", "3", "--set", "seed=3"], "a seed comes from --seed alone"),
        (["make", "city", "--set", "name=x"], "no option 'name'; the nearest valid name is"),
        (["make", "city", "--set", "scenario=x"], "(there are: duration_s)"),
        (["import", "mems-rtk", "x", "--set", "source=y"], "no option 'source'"),
        (["import", "mems-rtk", "x", "--set", "format=y"], "there are: gps_week, start_sow_s"),
    ],
)
def test_settings_that_are_no_options(refuse, tmp_path, arguments, says):
    assert says in refuse(*arguments, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_places_where_no_results_can_go(refuse, city, tmp_path):
    a_file = tmp_path / "file"
    a_file.write_text("")
    assert "is a file" in refuse("smooth", "mems-rtk", "--out", a_file)
    assert "is a drive folder" in refuse("smooth", "mems-rtk", "--out", city)
    assert "cannot be written" in refuse("baseline", city, "--method", "raw:gnss", "--out",
                                         a_file / "below")  # fmt: skip


def test_explain_refuses_what_it_cannot_explain(refuse, mems, tmp_path):
    assert "lies outside the drive" in refuse("explain", mems[0], "--t", "9999")
    spoiled = tmp_path / "result"
    shutil.copytree(mems[0], spoiled, ignore=shutil.ignore_patterns("report.html"))
    (spoiled / "verdicts.csv").write_text(",".join(VERDICT_COLUMNS) + "\ngnss,1,x,used,,,,\n")
    assert "verdicts.csv:2: is not a row of verdicts" in refuse("explain", spoiled, "--t", "1")
    (spoiled / "summary.json").write_text("{")
    assert "not readable as JSON" in refuse("explain", spoiled, "--t", "1")


def test_a_failing_estimator_ends_with_3_and_a_fault_of_ours_with_1(run, monkeypatch, tmp_path):
    def fail(error):
        def smooth(*_):
            raise error

        monkeypatch.setattr("fgloc.smoother.smooth", smooth)
        return run("smooth", "mems-rtk", "--out", tmp_path / "out")

    status, out, err = fail(SolverError("keyframe 7 at 12.0 s is not determined"))
    assert (status, out, err) == (3, "", "fgloc: keyframe 7 at 12.0 s is not determined\n")
    status, out, err = fail(KeyError("oops"))
    assert (status, out) == (1, "") and err.count("\n") == 1
    assert err.startswith("fgloc: internal error: KeyError: 'oops'; please report it")


def test_the_traceback_is_there_for_the_asking(monkeypatch, capsys, tmp_path):
    monkeypatch.setenv(cli.TRACEBACK, "1")
    assert main(["smooth", "mems-rtx", "--out", str(tmp_path / "out")]) == 2
    assert "Traceback" in capsys.readouterr().err


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


def test_on_a_terminal_the_tables_are_the_same(monkeypatch, capsys):
    from fgloc.cli import screen

    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    screen.table("Title", ("name", "value"), [("[bold]", "1,234"), ("b", "2")])
    shown = re.sub("\x1b\\[[0-9;]*m", "", capsys.readouterr().out)
    assert [line.split() for line in shown.splitlines() if line.strip()] == [
        ["Title"], ["name", "value"], ["[bold]", "1,234"], ["b", "2"],
    ]  # fmt: skip


def test_write_drive_is_what_make_writes(city, tmp_path):
    write_drive(open_drive("city", seed=1, duration_s=30.0), tmp_path / "drive")
    assert (tmp_path / "drive" / "imu.csv").read_bytes() == (city / "imu.csv").read_bytes()


def test_correspond_tells_rates_on_screen_and_to_machines(run, tmp_path):
    status, out, _ = run("correspond", "--layouts", 3, "--sizes", "6", "--out", tmp_path / "rates")
    assert status == 0
    assert "6 objects" in out and "consistent" in out and "cpd-warm" in out
    status, out, _ = run("correspond", "--layouts", 3, "--sizes", "6", "--json")
    assert json.loads(out)["rows"][0]["method"] == "icp-printed"
    assert [
        row["method"]
        for row in json.loads((tmp_path / "rates/correspond.json").read_text())["rows"]
    ]


@pytest.mark.parametrize("sizes", ["5,x", "", "2"])
def test_correspond_refuses_sizes_that_are_none(run, sizes):
    status, out, err = run("correspond", "--sizes", sizes)
    assert (status, out) == (2, "")
    assert "5,10" in err or "2 objects" in err
