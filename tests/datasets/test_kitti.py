"""The KITTI drive of the gtsam wheel: golden rows, and files that are not as known."""

import numpy as np
import pytest

from fgloc.datasets import import_recording, kitti, open_drive
from fgloc.datasets.degrade import degrade
from fgloc.errors import DriveError
from fgloc.timing import iso_utc

GPS = "Time,X,Y,Z\n9.5,1,2,3\n11.5,4,5,6\n"
IMU = (
    "Time dt accelX accelY accelZ omegaX omegaY omegaZ\n"
    "8 8 0 0 0 0 0 0\n10 2 0 0 0 0 0 0\n10.01 0.01 1 2 9.8 0.1 0.2 0.3\n"
)
METADATA = (
    "BodyPtx BodyPty BodyPtz BodyPrx BodyPry BodyPrz AccelerometerSigma GyroscopeSigma "
    "IntegrationSigma AccelerometerBiasSigma GyroscopeBiasSigma AverageDeltaT\n"
    "1 2 3 0 0 1.5707963267948966 0.01 0.000175 0 0.000167 2.91e-006 0.01\n"
)


@pytest.fixture
def files(tmp_path, monkeypatch):
    """Small files in place of the wheel's, some replaced."""

    def write(**replaced: str) -> None:
        contents = {"gps": GPS, "imu": IMU, "metadata": METADATA} | replaced
        names = {"gps": kitti._GPS, "imu": kitti._IMU, "metadata": kitti._METADATA}
        for kind, text in contents.items():
            (tmp_path / names[kind]).write_text(text)
        monkeypatch.setattr(kitti, "example_file", lambda name: tmp_path / name)

    return write


def test_golden_rows_of_the_wheel():
    drive = open_drive("kitti")
    assert (len(drive.gnss), len(drive.imu), drive.truth) == (469, 46_966, None)
    accel_mps2, gyro_radps = drive.imu.accel_mps2[0].tolist(), drive.imu.gyro_radps[0].tolist()
    assert accel_mps2 == [0.86576212047901, 0.68649938713432, 10.032802106483]
    assert gyro_radps == [0.005952543296471, 0.0069608321556425, 0.017633263249783]
    place_m = [3.8971155017667178, 7.5450738511330808, 0.0247879028299991]
    np.testing.assert_allclose(drive.gnss.p_world_ant_m[0], place_m, rtol=1e-12)
    assert iso_utc(int(drive.imu.t_ns[0])) == "2011-10-03T12:55:36.407Z"
    assert (drive.gnss.t_ns[0] - kitti.MIDNIGHT_NS) == 46_537_387_955_333
    noise = drive.rig.imu_noise
    assert noise.accel_noise_mps2_per_sqrt_hz == kitti.IMU_NOISE["accel_noise_mps2_per_sqrt_hz"]
    assert noise.accel_bias_walk_mps3_per_sqrt_hz == 1.67e-4
    np.testing.assert_array_equal(drive.rig.T_veh_imu, np.eye(4))


def test_what_cannot_be_used_is_counted():
    assert open_drive("kitti").about.source.endswith(
        "left out: IMU rows without a usable interval (2), fixes before the IMU starts (1)"
    )


def test_opened_by_name_or_imported_it_is_the_same():
    opened, imported = open_drive("kitti"), import_recording("kitti")
    assert all(opened.tables[name].same_as(imported.tables[name]) for name in opened.tables)


def test_fixes_that_are_withheld_become_truth():
    drive = open_drive("kitti")
    worse = degrade(drive, keep_every=10)
    assert (len(worse.gnss), len(worse.truth)) == (47, 422)
    np.testing.assert_array_equal(worse.truth.p_world_m[:9], drive.gnss.p_world_ant_m[1:10])


def test_small_files_are_read_as_they_stand(files):
    files()
    drive = kitti.import_kitti()
    assert (drive.gnss.t_ns - kitti.MIDNIGHT_NS).tolist() == [11_500_000_000]
    np.testing.assert_array_equal(drive.gnss.p_world_ant_m, [[4, 5, 6]])
    np.testing.assert_allclose(drive.gnss.cov_world_m2, [np.eye(3) * 0.0049])
    np.testing.assert_array_equal(drive.imu.accel_mps2, [[1, 2, 9.8]])
    quarter_turn = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    np.testing.assert_allclose(drive.rig.T_veh_imu, quarter_turn, atol=1e-15)


@pytest.mark.parametrize(
    ("replaced", "message"),
    [
        ({"gps": GPS.replace("Time,X", "t,X")}, r"Gps_converted.txt:1: expected a header Time X"),
        ({"gps": GPS.replace("4,5,6", "4,5")}, r"Gps_converted.txt:3: 3 values, expected 4"),
        ({"gps": GPS.replace("4,5,6", "4,x,6")}, r"Gps_converted.txt:3: Y = 'x' is not a number"),
        ({"gps": GPS.replace("11.5", "9.0")}, r"Gps_converted.txt:3: t_ns = \d+ goes back by"),
        ({"gps": "Time,X,Y,Z\n"}, "expected a header Time X Y Z and rows below it"),
        ({"imu": IMU.replace("10.01 0.01", "nan 0.01")}, r"BiasedImu.txt:4: Time = nan is not"),
        ({"imu": "".join(IMU.splitlines(keepends=True)[:3])}, "no rows after the 2"),
        ({"metadata": METADATA.replace("BodyPtx", "x")}, r"metadata.txt:1: expected a header"),
    ],
)  # fmt: skip
def test_faults_name_file_and_line(files, replaced, message):
    files(**replaced)
    with pytest.raises(DriveError, match=message):
        kitti.import_kitti()


def test_a_gtsam_without_the_files_is_told():
    with pytest.raises(
        DriveError, match=r"NoSuchDrive.txt: not among the files of the installed gtsam"
    ):
        kitti.example_file("NoSuchDrive.txt")
