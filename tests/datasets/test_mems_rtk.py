"""The importer of the MEMS and RTK recording, and the sample that was made with it."""

from pathlib import Path

import numpy as np
import pytest

from fgloc.datasets import import_recording, open_drive
from fgloc.datasets.mems_rtk import import_mems_rtk
from fgloc.errors import DriveError

SOURCE = Path(__file__).parents[3] / "shared" / "data" / "mems_rtk_drive"
SAMPLE = Path(__file__).parents[2] / "datasets" / "real" / "mems-rtk"
RTK = (
    "gps_sow_s,lat_deg,lon_deg,ellipsoidal_height_m,quality,sigma_n_m,sigma_e_m,sigma_u_m,"
    "v_north_mps,v_east_mps,v_down_mps\n"
    "99.75,40,-105,1600,1,0.1,0.2,0.3,1,2,3\n"
    "100.00,40,-105,1600,1,0.1,0.2,0.3,1,2,3\n"
    "100.25,40,-105,1601,1,0.1,0.2,0.3,1,2,3\n"
    "101.00,40,-105,1602,2,0.1,0.2,0.3,1,2,3\n"
    "101.25,40,-105,1602,2,0.1,0.2,0.3,1,2,3\n"
)
IMU = (
    "gps_sow_s,accel_x_frd_mps2,accel_y_frd_mps2,accel_z_frd_mps2,"
    "gyro_x_frd_radps,gyro_y_frd_radps,gyro_z_frd_radps\n"
    "99.98,0,0,0,0,0,0\n99.995,1,2,-9.8,0.1,0.2,0.3\n100.5,1,2,-9.8,0.1,0.2,0.3\n"
    "101.005,1,2,-9.8,0.1,0.2,0.3\n101.02,0,0,0,0,0,0\n"
)


@pytest.fixture
def recording(tmp_path):
    (tmp_path / "rtk.csv").write_text(RTK)
    (tmp_path / "imu.csv").write_text(IMU)
    return tmp_path


@pytest.fixture
def source():
    if not SOURCE.is_dir():
        pytest.skip("data not here")
    return SOURCE


def imported(folder: Path):
    return import_mems_rtk(folder, start_sow_s=100.0, end_sow_s=101.0)


def test_whole_seconds_are_measured_and_the_rest_is_truth(recording):
    drive = imported(recording)
    assert (drive.gnss.t_ns - drive.start_ns).tolist() == [5_000_000, 1_005_000_000]
    assert len(drive.truth) == 1
    np.testing.assert_array_equal(drive.truth.p_veh_point_m, drive.rig.p_veh_ant_m)


def test_imu_samples_reach_over_both_ends(recording):
    assert len(imported(recording).imu) == 3


def test_axes_are_turned_to_forward_left_up_and_east_north_up(recording):
    drive = imported(recording)
    np.testing.assert_array_equal(drive.imu.accel_mps2[0], [1, -2, 9.8])
    np.testing.assert_array_equal(drive.imu.gyro_radps[0], [0.1, -0.2, -0.3])
    np.testing.assert_array_equal(drive.gnss.v_world_mps[0], [2, 1, -3])
    np.testing.assert_allclose(drive.gnss.cov_world_m2[0], np.diag([0.04, 0.01, 0.09]))
    np.testing.assert_allclose(drive.gnss.p_world_ant_m, [[0, 0, 0], [0, 0, 2]], atol=1e-6)
    np.testing.assert_array_equal(drive.rig.p_veh_ant_m, [0, 0.05, 0])


def test_the_first_fix_used_is_the_origin(recording):
    origin = imported(recording).origin
    assert (origin.lat_deg, origin.lon_deg, origin.height_m) == (40.0, -105.0, 1600.0)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("sigma_n_m", "sigma_n_cm", r"rtk.csv:1: unknown unit 'cm' in column 'sigma_n_cm'"),
        ("100.25,40", "99.25,40", r"rtk.csv:4: t_ns = \d+ goes back by 750000000 ns"),
        ("100.25,40", "100.25,95", r"rtk.csv:4: lat_deg = 95.0 is outside"),
        ("1601,1,0.1", "1601,1,0", r"rtk.csv:4: .* zero or negative variance"),
        ("1601,1,0.1", "1601,1,x", r"rtk.csv:4: sigma_n_m = 'x' is not a number"),
    ],
)
def test_faults_of_the_source_name_file_and_line(recording, old, new, message):
    (recording / "rtk.csv").write_text(RTK.replace(old, new, 1))
    with pytest.raises(DriveError, match=message):
        imported(recording)


def test_a_missing_file_is_told(recording):
    (recording / "imu.csv").unlink()
    with pytest.raises(DriveError, match=r"imu.csv: no such file"):
        imported(recording)


def test_a_span_without_fixes_is_told(recording):
    with pytest.raises(DriveError, match="no fix at a whole second from 500"):
        import_mems_rtk(recording, start_sow_s=500.0, end_sow_s=600.0)


def test_the_sample_is_what_the_importer_makes_of_the_source(source):
    made, sample = import_recording("mems-rtk", source), open_drive("mems-rtk")
    assert (made.origin, made.about, made.rig.imu_noise) == (
        sample.origin, sample.about, sample.rig.imu_noise,
    )  # fmt: skip
    assert all(made.tables[name].same_as(sample.tables[name]) for name in made.tables)
    assert made.truth.same_as(sample.truth)
    assert (SAMPLE / "LICENSE.txt").read_bytes() == (source / "LICENSE.txt").read_bytes()


def test_the_sample_rounds_to_what_was_printed(source):
    sample = open_drive("mems-rtk")
    printed = np.loadtxt(source / "rtk.csv", delimiter=",", skiprows=1)
    printed = printed[(printed[:, 0] >= 243262.0) & (printed[:, 0] <= 243804.0)]
    t_ns = np.concatenate([sample.gnss.t_ns, sample.truth.t_ns])
    order = np.argsort(t_ns)
    place = np.concatenate([sample.gnss.p_world_ant_m, sample.truth.p_world_m])[order]
    velocity = np.concatenate([sample.gnss.v_world_mps, sample.truth.v_world_mps])[order]
    lat, lon, height = sample.origin.to_geodetic(place).T
    assert len(order) == len(printed) == 543 + 1626
    np.testing.assert_array_equal(lat.round(9), printed[:, 1])
    np.testing.assert_array_equal(lon.round(9), printed[:, 2])
    np.testing.assert_array_equal(height.round(4), printed[:, 3])
    np.testing.assert_array_equal(velocity, printed[:, [9, 8, 10]] * [1, 1, -1])
    gps_minus_posix = (t_ns[order] - printed[:, 0] * 1e9) // 1e9
    assert len(np.unique(gps_minus_posix)) == 1


def test_imu_values_are_those_printed(source):
    sample = open_drive("mems-rtk")
    printed = np.loadtxt(source / "imu.csv", delimiter=",", skiprows=1)
    printed = printed[(printed[:, 0] >= 243262.0) & (printed[:, 0] <= 243804.0)]
    np.testing.assert_array_equal(sample.imu.accel_mps2, printed[:, 1:4] * [1, -1, -1])
    np.testing.assert_array_equal(sample.imu.gyro_radps, printed[:, 4:7] * [1, -1, -1])
    assert set(np.diff(sample.imu.t_ns)) == {10_000_000}
