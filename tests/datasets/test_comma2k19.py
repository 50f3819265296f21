"""The importer of comma2k19 segments, and the sample that was made with it."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgloc.config import SmoothConfig
from fgloc.datasets import import_recording, open_drive
from fgloc.datasets.comma2k19 import WHEEL_SIGMA_MPS, import_comma2k19
from fgloc.errors import DriveError, InputError
from fgloc.frames import Origin, wrap_pi
from fgloc.sync import plan
from fgloc.timing import iso_utc

SOURCE = Path(__file__).parents[3] / "shared" / "data" / "comma2k19_example"
SAMPLE = Path(__file__).parents[2] / "datasets" / "real" / "comma2k19"
BOOT_S = 100.0
PLACE = Origin(0.0, 0.0, 0.0)
"""Where the Earth's x axis comes out: east is y, north is z, up is x."""


def save(folder: Path, name: str, array) -> None:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:  # np.save would add a suffix to a path
        np.save(file, np.asarray(array, float))


@pytest.fixture
def segment(tmp_path):
    """Two seconds on the equator, driving east at 10 m/s; the device is level."""
    t = BOOT_S + np.array([0.0, 1.0, 2.0])
    ones = np.ones(3)
    arrays = {
        "processed_log/IMU/accelerometer": [[0.5, 0.25, -9.8]] * 2 + [[-0.5, -0.25, -9.8]],
        "processed_log/IMU/gyro": [[0.1, 0.2, 0.3]] * 3,
        "processed_log/CAN/speed": 10 * ones[:, None],
        "processed_log/CAN/steering_angle": [90.0, 0.0, -180.0],
        "processed_log/GNSS/live_gnss_ublox": [
            [1e-9, 1e-9, 10, 0, 5, 90], [0, 0, 0, 0, 0, 0], [1e-9, 1e-4, 10, 0, 6, 90],
        ],
    }  # fmt: skip
    for name, value in arrays.items():
        save(tmp_path, f"{name}/value", value)
        save(tmp_path, f"{name}/t", t)
    pose = "global_pose"
    save(tmp_path, f"{pose}/frame_times", t)
    save(tmp_path, f"{pose}/frame_gps_times", np.stack([2000 * ones, [18.5, 19.5, 20.5]], -1))
    save(
        tmp_path,
        f"{pose}/frame_positions",
        PLACE.world_to_ecef([[0, 0, 0], [10, 0, 0], [20, 0, 0]]),
    )
    save(tmp_path, f"{pose}/frame_velocities", [[0, 10, 0]] * 3)
    # Forward y, right -z, down -x: columns of the matrix, as quaternion (w, x, y, z).
    save(tmp_path, f"{pose}/frame_orientations", [[0.5, -0.5, -0.5, 0.5]] * 3)
    return tmp_path


@pytest.fixture
def source():
    if not SOURCE.is_dir():
        pytest.skip("data not here")
    return SOURCE


def test_the_boot_clock_is_put_on_utc_by_the_frames_gps_time(segment):
    drive = import_comma2k19(segment)
    # Week 2000 begins on 2018-05-06; GPS is 18 s ahead of UTC, so 18.5 s into it is half past.
    assert iso_utc(int(drive.imu.t_ns[0])) == "2018-05-06T00:00:00.500Z"
    assert (drive.gnss.t_ns - drive.imu.t_ns[0]).tolist() == [0, 2_000_000_000]


def test_axes_are_turned_to_forward_left_up(segment):
    drive = import_comma2k19(segment)
    np.testing.assert_array_equal(drive.imu.accel_mps2[0], [0.5, -0.25, 9.8])
    np.testing.assert_array_equal(drive.imu.gyro_radps[0], [0.1, -0.2, -0.3])


def test_car_data_come_in_si_units(segment):
    drive = import_comma2k19(segment)
    np.testing.assert_allclose(drive.tables["steering"].angle_rad, [np.pi / 2, 0, -np.pi])
    np.testing.assert_array_equal(drive.tables["wheel"].speed_mps, [10, 10, 10])
    assert set(drive.tables["wheel"].sigma_mps) == {WHEEL_SIGMA_MPS}


def test_fixes_have_the_sigmas_given_and_rows_without_a_position_are_counted(segment):
    drive = import_comma2k19(segment, sigma_horizontal_m=2.0, sigma_up_m=3.0)
    np.testing.assert_allclose(drive.gnss.cov_world_m2, [np.diag([4.0, 4.0, 9.0])] * 2)
    assert drive.gnss.p_world_ant_m[1] == pytest.approx([11.132, 0, 1], abs=1e-3)
    assert drive.about.source.endswith("left out: u-blox rows without a position (1)")


def test_the_pose_becomes_truth_that_looks_where_it_goes(segment):
    drive = import_comma2k19(segment)
    np.testing.assert_allclose(drive.truth.v_world_mps, [[10, 0, 0]] * 3, atol=1e-6)
    tilt = drive.rig.T_veh_imu[:3, :3]
    np.testing.assert_allclose(drive.truth.R_world_veh[0] @ tilt, np.eye(3), atol=1e-6)


def test_the_device_is_levelled_by_the_mean_specific_force(segment):
    accel = segment / "processed_log/IMU/accelerometer/value"
    lean = np.deg2rad(4.0)
    save(segment, accel.relative_to(segment), [[-9.8 * np.sin(lean), 0, -9.8 * np.cos(lean)]] * 3)
    drive = import_comma2k19(segment)
    upright = drive.rig.T_veh_imu[:3, :3] @ drive.imu.accel_mps2[0]
    np.testing.assert_allclose(upright, [0, 0, 9.8], atol=1e-12)
    assert "leans by 4.00 deg" in drive.about.source


def test_speeding_up_does_not_tilt_the_vehicle(segment):
    save(segment, "processed_log/IMU/accelerometer/value", [[1.0, 0, -9.8]] * 3)
    save(segment, "processed_log/CAN/speed/value", [[10.0], [11.0], [12.0]])
    np.testing.assert_allclose(import_comma2k19(segment).rig.T_veh_imu, np.eye(4), atol=1e-12)


@pytest.mark.parametrize(
    ("name", "array", "message"),
    [
        ("processed_log/IMU/gyro/value", np.ones((3, 2)), r"gyro/value: .* shape \(3, 2\)"),
        ("processed_log/IMU/gyro/t", [100.0, 101.0, 102.5], "accelerometer/t and gyro/t differ"),
        ("processed_log/IMU/gyro/t", [100.0, 101.0], "gyro/t: 2 times for 3 values"),
        ("processed_log/IMU/accelerometer/t", [100.0, 102.0, 101.0], "/t:3: .* goes back by"),
        ("processed_log/IMU/accelerometer/t", [100.0, 100.0, 101.0], "/t:2: .* occurs twice"),
        ("processed_log/CAN/speed/value", [[1.0], [np.nan], [1.0]], r"value: row 1 \(from 0\)"),
        ("processed_log/GNSS/live_gnss_ublox/value", [[0.0] * 6] * 3, "holds no usable fix"),
        ("processed_log/GNSS/live_gnss_ublox/value", [[1, 1, 0, 0, 5, 0], [95, 1, 0, 0, 5, 0],
         [1, 1, 0, 0, 5, 0]], "value:2: lat_deg = 95.0 is outside"),
        ("global_pose/frame_velocities", np.zeros((2, 3)), "the arrays differ in length"),
        ("global_pose/frame_gps_times", np.zeros((2, 2)), "2 frame_gps_times for 3 frame_times"),
    ],
)  # fmt: skip
def test_faults_of_the_arrays_name_file_and_row(segment, name, array, message):
    save(segment, name, array)
    with pytest.raises(DriveError, match=message):
        import_comma2k19(segment)


def test_a_file_that_is_no_array_or_missing_is_told(segment):
    path = segment / "processed_log/CAN/speed/value"
    path.write_bytes(b"not an array")
    with pytest.raises(DriveError, match="speed/value: is not an array of numpy"):
        import_comma2k19(segment)
    path.unlink()
    with pytest.raises(DriveError, match=r"speed/value: no such file; is this a segment"):
        import_comma2k19(segment)


def test_a_sigma_of_zero_is_refused(segment):
    with pytest.raises(InputError, match=r"sigma_up_m = 0.0: a standard deviation above 0 m"):
        import_comma2k19(segment, sigma_up_m=0.0)


def test_the_sample_is_what_the_importer_makes_of_the_source(source):
    made, sample = import_recording("comma2k19", source), open_drive("comma2k19")
    assert (made.origin, made.about, made.rig.imu_noise) == (
        sample.origin, sample.about, sample.rig.imu_noise,
    )  # fmt: skip
    assert all(made.tables[name].same_as(sample.tables[name]) for name in made.tables)
    np.testing.assert_allclose(made.truth.R_world_veh, sample.truth.R_world_veh, atol=1e-12)
    assert replace(made.truth, R_world_veh=None).same_as(replace(sample.truth, R_world_veh=None))
    assert (SAMPLE / "LICENSE.txt").read_bytes() == (source / "LICENSE.txt").read_bytes()


def test_a_copy_in_another_folder_is_imported_alike(source, tmp_path):
    shutil.copytree(source, tmp_path / "b0c9|40")
    assert import_comma2k19(tmp_path / "b0c9|40").gnss.same_as(open_drive("comma2k19").gnss)


def test_the_samples_truth_looks_along_its_course_and_stands_upright():
    truth = open_drive("comma2k19").truth
    course_rad = np.arctan2(truth.v_world_mps[:, 1], truth.v_world_mps[:, 0])
    assert np.abs(np.rad2deg(wrap_pi(truth.yaw_rad - course_rad))).max() < 1.5
    v_veh = np.einsum("nji,nj->ni", truth.R_world_veh, truth.v_world_mps)
    assert abs(np.rad2deg(np.median(v_veh[:, 2] / v_veh[:, 0]))) < 0.5


def test_steering_angles_are_kept_and_not_used():
    drive = open_drive("comma2k19")
    verdicts = plan(drive, SmoothConfig()).verdicts["steering"]
    assert verdicts.counts() == {"unused": 4974}
    assert set(verdicts.reason) == {"no steering factor in this method"}


def test_the_samples_fixes_are_a_tenth_of_a_second_late():
    drive = open_drive("comma2k19")
    inside = (drive.gnss.t_ns > drive.truth.t_ns[0] + 10**8) & (
        drive.gnss.t_ns < drive.truth.t_ns[-1]
    )
    fixes = drive.gnss.take(inside)
    rms = []
    for late_ns in (0, 100_000_000):
        error_m = fixes.p_world_ant_m - drive.truth.at(fixes.t_ns - late_ns).p_world_m
        rms.append(np.sqrt((error_m[:, :2] ** 2).sum(-1).mean()))
    assert rms == pytest.approx([1.47, 0.55], abs=0.02)
