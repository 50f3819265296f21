"""The examples of the README, run as their reader would run them."""

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import online
import pytest

import fgloc
from fgloc.datasets.drive_folder import write_drive
from fgloc.datasets.perception_recording import read_recording
from fgloc.evaluation import errors
from fgloc.outputs import read_result_trajectory

HERE = Path(__file__).parent


def shell(name, *arguments):
    """The lines that an example prints."""
    command = [sys.executable, HERE / name, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.fixture(scope="module")
def drive():
    return fgloc.make("city", seed=3, duration_s=30.0)


@pytest.fixture(scope="module")
def folder(drive, tmp_path_factory):
    path = tmp_path_factory.mktemp("examples") / "drive"
    write_drive(drive, path)
    return path


def plain_files(drive, folder):
    """A drive as the plain files that people have: degrees, seconds, one sigma."""
    gnss, imu = drive.gnss, drive.imu
    place = drive.origin.to_geodetic(gnss.p_world_ant_m)
    rows = np.column_stack([gnss.t_ns / 1e9, place, np.sqrt(gnss.cov_world_m2[:, 0, 0])])
    np.savetxt(folder / "gps.csv", rows, delimiter=",", comments="", fmt="%.10f",
               header="time_s,lat_deg,lon_deg,height_m,sigma_m")  # fmt: skip
    rows = np.column_stack([imu.t_ns / 1e9, imu.accel_mps2, np.rad2deg(imu.gyro_radps)])
    np.savetxt(folder / "imu.csv", rows, delimiter=",", comments="", fmt="%.10f",
               header="time_s,ax,ay,az,gx,gy,gz")  # fmt: skip


def test_smooth_your_csv(drive, tmp_path):
    plain_files(drive, tmp_path)
    lines = shell("smooth_your_csv.py", tmp_path / "gps.csv", tmp_path / "imu.csv", tmp_path)
    assert "states in" in lines[-1] and (tmp_path / "result" / "report.html").is_file()
    made = fgloc.load(tmp_path / "drive")
    np.testing.assert_allclose(made.imu.gyro_radps, drive.imu.gyro_radps, atol=1e-9)
    assert np.abs(made.gnss.t_ns - drive.gnss.t_ns).max() < 1_000  # a double holds microseconds
    estimate = read_result_trajectory(tmp_path / "result" / "trajectory.csv")
    moved = drive.origin.to_world(*made.origin.to_geodetic(estimate.p_world_m).T)
    e = errors(replace(estimate, p_world_m=moved), drive.truth)
    assert len(e) > 500 and np.sqrt(np.mean(e.horizontal_m**2)) < 0.5


def test_compare_configurations(folder, tmp_path):
    lines = shell("compare_configurations.py", folder, tmp_path / "out")
    assert [line.partition(":")[0] for line in lines] == [
        "as it is", "no robust loss", "  minus as it is",
    ]  # fmt: skip
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"compare.json", "report.html"}


def test_online_says_every_second_where_the_vehicle_is(drive, folder):
    lines = shell("online.py", folder)
    said = np.array([re.findall(r"-?\d+\.\d+", line) for line in lines], float)
    np.testing.assert_allclose(said[:, 0], np.arange(10, 31))
    truth = drive.truth.at(drive.start_ns + np.arange(10, 31) * online.S).p_world_m
    error_m = np.hypot(*(said[:, 1:3] - truth[:, :2]).T)
    assert error_m.max() < 3.0 and np.sqrt(np.mean(error_m**2)) < 1.0
    assert (said[:, 3:] > 0).all()


def test_online_looks_at_nothing_that_has_not_arrived(drive):
    played = online.delayed(drive)
    now_ns = drive.start_ns + 20 * online.S
    known = online.received(played, now_ns)
    assert known.gnss.t_ns[-1] == now_ns - online.DELAY_NS and known.imu.t_ns[-1] == now_ns
    wild = replace(played.gnss, p_world_ant_m=np.where(
        (played.gnss.t_ns > now_ns - online.DELAY_NS)[:, None], 1e6, played.gnss.p_world_ant_m
    ))  # fmt: skip
    first, second = (
        fgloc.smooth(online.received(of, now_ns)).trajectory
        for of in (played, played.with_tables(gnss=wild))
    )
    assert first.same_as(second)


def test_a_simulated_street_becomes_a_recording(tmp_path):
    said = shell("simulated_street.py", tmp_path / "street", "--seconds", 0.1, "--sway", 0.05)
    assert said == [f"2 frames of each sensor in {tmp_path / 'street'}"]
    made = read_recording(tmp_path / "street")
    assert made.image(1, 1).shape == (1200, 1920, 3)
    assert len(made.cloud(0, 1)) > 10_000
    assert len(made.objects)
