"""IMU data that lies beside a position log: samples as our `imu.csv`, noise as Kalibr's imu.yaml.

Kalibr's keys are `accelerometer_noise_density` (m/s^2/sqrt(Hz)), `accelerometer_random_walk`
(m/s^3/sqrt(Hz)), `gyroscope_noise_density` (rad/s/sqrt(Hz)) and `gyroscope_random_walk`
(rad/s^2/sqrt(Hz)); all four are needed. The `sensor.yaml` of EuRoC has the same keys and `T_BS`,
which maps the sensor into the body; Kalibr's results stand under `imu0` and may have `T_i_b`, the
inverse of it. Other keys, such as `update_rate` and `rostopic`, say nothing that is needed here.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fgloc.datasets.csv_table import read_csv
from fgloc.datasets.drive_tables import LAYOUTS, imu_from_columns
from fgloc.drive import Drive, ImuNoise, Rig
from fgloc.errors import DriveError, InputError, nearest
from fgloc.files import read_text
from fgloc.measurements import Array, ImuSamples

_NOISE_KEYS = {
    "accelerometer_noise_density": "accel_noise_mps2_per_sqrt_hz",
    "gyroscope_noise_density": "gyro_noise_radps_per_sqrt_hz",
    "accelerometer_random_walk": "accel_bias_walk_mps3_per_sqrt_hz",
    "gyroscope_random_walk": "gyro_bias_walk_radps2_per_sqrt_hz",
}
_OPENCV_HEAD = "%YAML:1.0"  # OpenCV writes it so; YAML itself wants a space


def read_imu_yaml(path: Path) -> tuple[ImuNoise, Array]:
    """Noise and mounting `T_veh_imu` (4, 4) of a Kalibr or EuRoC file.

    Where the file has no mounting, the IMU's axes are the vehicle's. Raises DriveError, naming the
    key and its value, where the file is missing, no YAML or incomplete.
    """
    values = _load(path)
    numbers = {ours: _positive(path, values, key) for key, ours in _NOISE_KEYS.items()}
    return ImuNoise(**numbers), _mounting(path, values)


def read_imu_csv(path: Path) -> ImuSamples:
    """Samples of a table as a drive's `imu.csv`; DriveError where it is missing or wrong."""
    return imu_from_columns(path, read_csv(path, LAYOUTS["imu"]))


def with_imu(drive: Drive, imu: Path | str | None, imu_noise: Path | str | None) -> Drive:
    """The drive with the IMU of two files beside it, or as it is where none are given.

    Raises InputError where only one of the two is given, DriveError where a file is wrong or the
    IMU was not running while there were fixes.
    """
    if imu is None and imu_noise is None:
        return drive
    if imu is None or imu_noise is None:
        have, lacks = ("imu", "imu_noise") if imu_noise is None else ("imu_noise", "imu")
        raise InputError(f"{have} is given without {lacks}: the IMU needs both files, or none")
    samples = read_imu_csv(Path(imu))
    noise, T_veh_imu = read_imu_yaml(Path(imu_noise))
    if samples.t_ns[-1] < drive.gnss.t_ns[0] or samples.t_ns[0] > drive.gnss.t_ns[-1]:
        raise DriveError(
            f"{imu}: its samples and the fixes have no time in common; is t_ns POSIX time (UTC)? "
            f"first sample {samples.t_ns[0]}, first fix {drive.gnss.t_ns[0]}"
        )
    rig = Rig(drive.rig.p_veh_ant_m, T_veh_imu, noise)
    return replace(drive.with_tables(imu=samples), rig=rig)


def _load(path: Path) -> dict[str, Any]:
    import yaml

    try:
        values = yaml.safe_load(read_text(path).replace(_OPENCV_HEAD, "#", 1))
    except yaml.YAMLError as err:
        raise DriveError(f"{path}: not valid YAML: {' '.join(str(err).split())}") from err
    if isinstance(values, dict) and isinstance(values.get("imu0"), dict):
        values = values["imu0"]
    if not isinstance(values, dict):
        raise DriveError(f"{path}: holds no keys; {', '.join(_NOISE_KEYS)} are needed")
    return values


def _positive(path: Path, values: dict[str, Any], key: str) -> float:
    if key not in values:
        near = nearest(key, map(str, values)) if values else "nothing"
        raise DriveError(f"{path}: {key} is missing (nearest there is {near!r}); add it")
    try:
        value = float(values[key])  # YAML 1.1 takes 2e-4 for text
    except (TypeError, ValueError) as err:
        raise DriveError(f"{path}: {key} = {values[key]!r} is not a number") from err
    if not (np.isfinite(value) and value > 0):
        raise DriveError(f"{path}: {key} = {value}; a finite number above 0 is needed")
    return value


def _mounting(path: Path, values: dict[str, Any]) -> Array:
    for key in ("T_BS", "T_i_b"):
        if key in values:
            T = _transform(path, key, values[key])
            return T if key == "T_BS" else np.asarray(np.linalg.inv(T), float)
    return np.eye(4)


def _transform(path: Path, key: str, value: Any) -> Array:
    """Sixteen numbers in a row or four rows of four; EuRoC has the former under `data`."""
    numbers = value.get("data") if isinstance(value, dict) else value
    try:
        T = np.array(numbers, float).reshape(4, 4)
    except (TypeError, ValueError) as err:
        raise DriveError(f"{path}: {key} is not a matrix of 4 by 4 numbers") from err
    try:
        Rig(T_veh_imu=T)
    except InputError as err:
        raise DriveError(f"{path}: {key} is not a rigid transform: {err}") from err
    return T
