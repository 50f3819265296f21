"""Kalibr's imu.yaml and the sensor.yaml of EuRoC, and an IMU beside a position log."""

import numpy as np
import pytest

from fgloc.datasets.imu_files import read_imu_yaml, with_imu
from fgloc.drive import Drive, Rig
from fgloc.errors import DriveError, InputError
from fgloc.frames import Origin
from fgloc.measurements import GnssFixes

KALIBR = (
    "#Accelerometers\naccelerometer_noise_density: 1.86e-03   #Noise density (continuous-time)\n"
    "accelerometer_random_walk:   4e-04\n"
    "#Gyroscopes\ngyroscope_noise_density:     1.87e-04\ngyroscope_random_walk:       2.66e-05\n"
    "rostopic:                    /imu0\nupdate_rate:                 200.0\n"
)
EUROC = (
    "#Default imu sensor yaml file\nsensor_type: imu\nT_BS:\n  cols: 4\n  rows: 4\n"
    "  data: [0.0, -1.0, 0.0, 0.5,\n         1.0, 0.0, 0.0, 0.0,\n"
    "         0.0, 0.0, 1.0, 0.25,\n         0.0, 0.0, 0.0, 1.0]\nrate_hz: 200\n" + KALIBR
)
T_BS = [[0, -1, 0, 0.5], [1, 0, 0, 0], [0, 0, 1, 0.25], [0, 0, 0, 1]]
IMU_CSV = (
    "t_ns,accel_x_mps2,accel_y_mps2,accel_z_mps2,gyro_x_radps,gyro_y_radps,gyro_z_radps\n"
    "1000,0,0,9.81,0,0,0\n2000,0,0,9.81,0,0,0\n"
)


@pytest.fixture
def yaml(tmp_path):
    def write(text: str):
        path = tmp_path / "imu.yaml"
        path.write_text(text)
        return path

    return write


def drive(t_ns: int = 1500) -> Drive:
    fixes = GnssFixes([t_ns], [t_ns], np.zeros((1, 3)), [np.eye(3)], np.full((1, 3), np.nan))
    return Drive("log", Origin(40.0, -105.0, 0.0), Rig(p_veh_ant_m=np.ones(3)), {"gnss": fixes})


def test_the_four_densities_keep_their_units_and_the_rest_says_nothing(yaml):
    noise, T_veh_imu = read_imu_yaml(yaml(KALIBR))
    assert noise.accel_noise_mps2_per_sqrt_hz == 1.86e-3
    assert noise.accel_bias_walk_mps3_per_sqrt_hz == 4e-4  # for YAML this is text: it has no point
    assert noise.gyro_noise_radps_per_sqrt_hz == 1.87e-4
    assert noise.gyro_bias_walk_radps2_per_sqrt_hz == 2.66e-5
    np.testing.assert_array_equal(T_veh_imu, np.eye(4))


@pytest.mark.parametrize("head", ["", "%YAML:1.0\n", "%YAML:1.0\n---\n"])
def test_the_mounting_of_euroc_maps_the_sensor_into_the_body(yaml, head):
    np.testing.assert_array_equal(read_imu_yaml(yaml(head + EUROC))[1], T_BS)


def test_the_mounting_of_kalibr_maps_the_other_way(yaml):
    indented = "imu0:\n" + "".join(f"  {line}\n" for line in KALIBR.splitlines())
    rows = "".join(f"  - {row}\n" for row in T_BS)
    T_veh_imu = read_imu_yaml(yaml(f"{indented}  T_i_b:\n{rows}"))[1]
    np.testing.assert_allclose(T_veh_imu @ T_BS, np.eye(4), atol=1e-15)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            KALIBR.replace("gyroscope_random", "gyro_random"),
            "imu.yaml: gyroscope_random_walk is miss",
        ),
        (KALIBR.replace("1.87e-04", "fast"), "gyroscope_noise_density = 'fast' is not a number"),
        (
            KALIBR.replace("1.87e-04", "[1, 2]"),
            r"gyroscope_noise_density = \[1, 2\] is not a number",
        ),
        (
            KALIBR.replace("1.87e-04", "0"),
            r"gyroscope_noise_density = 0.0; a finite number above 0",
        ),
        (
            KALIBR.replace("1.87e-04", ".nan"),
            "gyroscope_noise_density = nan; a finite number above",
        ),
        (KALIBR + "T_BS: [1, 2, 3]\n", "T_BS is not a matrix of 4 by 4 numbers"),
        (EUROC.replace("0.0, -1.0, 0.0", "0.0, -2.0, 0.0"), "T_BS is not a rigid transform"),
        ("a: [1\n", "not valid YAML"),
        ("", "holds no keys; accelerometer_noise_density"),
        ("only text\n", "holds no keys"),
    ],
)
def test_faults_of_the_yaml_name_key_and_value(yaml, text, message):
    with pytest.raises(DriveError, match=message):
        read_imu_yaml(yaml(text))


def test_a_missing_yaml_is_told(tmp_path):
    with pytest.raises(DriveError, match=r"imu.yaml: no such file"):
        read_imu_yaml(tmp_path / "imu.yaml")


def test_an_imu_joins_the_drive_with_its_noise_and_mounting(yaml, tmp_path):
    (tmp_path / "imu.csv").write_text(IMU_CSV)
    joined = with_imu(drive(), tmp_path / "imu.csv", yaml(EUROC))
    assert joined.imu.t_ns.tolist() == [1000, 2000]
    np.testing.assert_array_equal(joined.rig.T_veh_imu, T_BS)
    np.testing.assert_array_equal(joined.rig.p_veh_ant_m, np.ones(3))
    assert joined.rig.imu_noise.accel_noise_mps2_per_sqrt_hz == 1.86e-3


def test_without_an_imu_the_drive_stays_as_it_is():
    plain = drive()
    assert with_imu(plain, None, None) is plain


@pytest.mark.parametrize(("imu", "noise", "lacks"), [("a", None, "imu_noise"), (None, "a", "imu")])
def test_samples_and_noise_come_together(imu, noise, lacks):
    with pytest.raises(InputError, match=f"is given without {lacks}: the IMU needs both files"):
        with_imu(drive(), imu, noise)


@pytest.mark.parametrize("t_ns", [999, 2001])
def test_an_imu_at_another_time_than_the_fixes_is_refused(yaml, tmp_path, t_ns):
    (tmp_path / "imu.csv").write_text(IMU_CSV)
    with pytest.raises(DriveError, match=r"no time in common; is t_ns POSIX time"):
        with_imu(drive(t_ns), tmp_path / "imu.csv", yaml(KALIBR))
