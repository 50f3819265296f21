"""Recordings in the layout of EuRoC with a trajectory file beside them."""

import numpy as np
import pytest

from fgloc.datasets.euroc import import_euroc
from fgloc.errors import DriveError, InputError

DATA = (
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n"
    "1403636579000000001,1,2,3,4,5,6\r\n1403636580000000001,7,8,9,10,11,12\r\n"
)
SENSOR = (
    "T_BS:\n  data: [0, -1, 0, 0.5, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n"
    "gyroscope_noise_density: 1.6968e-04\ngyroscope_random_walk: 1.9393e-05\n"
    "accelerometer_noise_density: 2.0000e-3\naccelerometer_random_walk: 3.0000e-3\n"
)
TUM = "1403636578.5 0 0 0 0 0 0 1\n1403636579.25 1 2 3 0 0 0 1\n1403636579.5 2 3 4 0 0 0.6 0.8\n"


@pytest.fixture
def recording(tmp_path):
    """Writes a recording and its trajectory; gives the options that import it."""

    def write(data: str = DATA, sensor: str = SENSOR, tum: str = TUM, inside: str = "mav0/imu0"):
        folder = tmp_path / inside
        folder.mkdir(parents=True)
        (folder / "data.csv").write_bytes(data.encode())
        (folder / "sensor.yaml").write_text(sensor)
        (tmp_path / "leica.tum").write_text(tum)
        return {"source": tmp_path, "positions": tmp_path / "leica.tum"}

    return write


@pytest.mark.parametrize("inside", ["imu0", "mav0/imu0"])
def test_gyro_comes_before_accelerometer_and_stamps_keep_their_nanoseconds(recording, inside):
    drive = import_euroc(**recording(inside=inside))
    assert drive.imu.t_ns.tolist() == [1_403_636_579_000_000_001, 1_403_636_580_000_000_001]
    np.testing.assert_array_equal(drive.imu.gyro_radps[0], [1, 2, 3])
    np.testing.assert_array_equal(drive.imu.accel_mps2[1], [10, 11, 12])


def test_positions_within_the_span_of_the_imu_are_measured(recording):
    drive = import_euroc(**recording(), sigma_m=0.5)
    np.testing.assert_array_equal(drive.gnss.p_world_ant_m, [[1, 2, 3], [2, 3, 4]])
    np.testing.assert_array_equal(drive.gnss.cov_world_m2, [np.eye(3) * 0.25] * 2)
    assert drive.truth is None
    assert drive.about.source == (
        "leica.tum as positions; left out: positions outside the span of the IMU (1)"
    )


def test_noise_and_mounting_come_from_the_sensor_file_or_another(recording, tmp_path):
    options = recording()
    drive = import_euroc(**options)
    np.testing.assert_array_equal(
        drive.rig.T_veh_imu[:3], [[0, -1, 0, 0.5], [1, 0, 0, 0], [0, 0, 1, 0]]
    )
    assert drive.rig.imu_noise.accel_bias_walk_mps3_per_sqrt_hz == 3e-3
    (tmp_path / "imu.yaml").write_text(SENSOR.replace("3.0000e-3", "5e-3"))
    other = import_euroc(**options, imu_noise=tmp_path / "imu.yaml")
    assert other.rig.imu_noise.accel_bias_walk_mps3_per_sqrt_hz == 5e-3


def test_a_truth_that_was_measured_is_called_so(recording, tmp_path):
    options = recording()
    (tmp_path / "truth.tum").write_text(TUM)
    apart = import_euroc(**options, truth=tmp_path / "truth.tum")
    assert len(apart.truth) == 3 and "flatter" not in apart.about.source
    same = import_euroc(**options, truth=options["positions"])
    assert "the truth is the file that was measured: errors flatter" in same.about.source


def test_the_place_on_the_earth_is_an_option(recording):
    origin = import_euroc(**recording(), lat_deg=10.0, lon_deg=20.0, height_m=30.0).origin
    assert (origin.lat_deg, origin.lon_deg, origin.height_m) == (10.0, 20.0, 30.0)


def test_without_positions_it_is_said_what_to_name(recording, tmp_path):
    recording()
    with pytest.raises(InputError, match="name a TUM trajectory with --positions FILE"):
        import_euroc(tmp_path)


@pytest.mark.parametrize(
    ("files", "message"),
    [
        (
            {"data": DATA.replace(",11,12", ",11")},
            r"data.csv:3: 6 values, expected 7: timestamp,wx",
        ),
        ({"data": DATA.replace(",8,9", ",8,x")}, r"data.csv:3: wz = 'x' is not a number"),
        (
            {"data": DATA.replace("1403636580000000001", "1.4e18")},
            r"data.csv:3: timestamp = '1.4e18'",
        ),
        (
            {"data": DATA.replace("1403636580", "1403636570")},
            r"data.csv:3: t_ns = \d+ goes back by",
        ),
        ({"data": DATA.splitlines()[0]}, r"data.csv: holds no rows"),
        ({"sensor": "rate_hz: 200\n"}, r"sensor.yaml: accelerometer_noise_density is missing"),
        ({"tum": TUM.replace("2 3 4", "2 3")}, r"leica.tum:3: 7 values, expected 8"),
        ({"tum": "5 0 0 0 0 0 0 1\n"}, r"leica.tum: no position within the span of the IMU"),
    ],
)
def test_faults_name_file_and_line(recording, files, message):
    with pytest.raises(DriveError, match=message):
        import_euroc(**recording(**files))


def test_a_folder_without_an_imu_is_told(tmp_path):
    with pytest.raises(DriveError, match="has neither imu0 nor mav0/imu0"):
        import_euroc(tmp_path, positions="x.tum")


def test_a_sigma_of_zero_is_refused(recording):
    with pytest.raises(InputError, match=r"sigma_m = 0.0: a standard deviation above 0 m"):
        import_euroc(**recording(), sigma_m=0.0)
