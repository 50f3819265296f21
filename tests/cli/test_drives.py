"""The commands that make, import and list drives; help."""

import ctypes
import json
import subprocess
import sys

import numpy as np
import pytest

from fgloc import cli
from fgloc.datasets import open_drive
from fgloc.datasets.drive_folder import read_drive, write_drive

COMMANDS = (
    "datasets", "make", "import", "doctor", "degrade", "smooth", "baseline", "compare", "eval",
    "explain", "tune", "correspond", "perceive",
)  # fmt: skip


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


def test_the_c_library_takes_the_settings_of_memory_or_has_none(run, monkeypatch):
    settings = getattr(ctypes.CDLL(None), "mallopt", None)
    assert settings is None or settings(cli._M_MMAP_THRESHOLD, cli.KEPT_BYTES) == 1
    monkeypatch.setattr(ctypes, "CDLL", lambda name: object())
    status, text, _ = run("datasets")
    assert status == 0 and "mems-rtk" in text


def test_as_a_module():
    command = [sys.executable, "-m", "fgloc", "--version"]
    assert (
        subprocess.run(command, capture_output=True, text=True, check=True).stdout[:6] == "fgloc "
    )


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
