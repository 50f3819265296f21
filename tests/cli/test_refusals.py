"""The command line on bad usage and bad input: one line that says what is wrong, and a status."""

import shutil

import pytest

from fgloc import cli
from fgloc.cli import main
from fgloc.errors import SolverError
from fgloc.outputs import VERDICT_COLUMNS


def test_other_formats_than_gpx_and_kml_are_refused(run, city, tmp_path):
    status, _, err = run("smooth", city, "--out", tmp_path / "a", "--also", "gpx,shp")
    assert status == 2 and "'shp' is none of gpx, kml" in err


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
