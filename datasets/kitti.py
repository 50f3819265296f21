"""Importer `kitti`: GPS and IMU of a KITTI drive, from the examples in the installed gtsam wheel.

Drive 0027 of 2011-10-03, as length, distance and time of day show: 471 s and 3.7 km in a town.
The files are read where gtsam keeps them; nothing of KITTI is in this package.

* `KittiGps_converted.txt`: 1 Hz, metres east, north, up about a point that the file does not name.
  The origin here is that place to a kilometre, enough for gravity; maps are off by that much.
* `KittiEquivBiasedImu.txt`: 100 Hz, axes forward-left-up. The first two rows carry no interval
  that can be used (the time itself, and a gap of 1.9 s), so the drive starts after them and fixes
  before that are left out.
* `KittiEquivBiasedImu_metadata.txt`: the place of the IMU in the body, and how its biases walk.
  Its white noise is that of the sensor alone, and is not taken: see `IMU_NOISE`.

Times are seconds of the day; with the date above and no known zone they are taken as UTC. There is
no truth: `fgloc degrade kitti --keep-every 10` turns the fixes it withholds into truth.
"""

from pathlib import Path

import numpy as np

from fgloc.datasets.recording import left_out, number, read_lines
from fgloc.datasets.trajectory_columns import check_increasing
from fgloc.drive import About, Drive, ImuNoise, Rig
from fgloc.errors import DriveError
from fgloc.frames import Origin, exp_so3
from fgloc.measurements import Array, GnssFixes, ImuSamples
from fgloc.timing import Instants

SIGMA_M = 0.07
"""Of a fix on each axis, as GTSAM's own example takes it; the files state none."""

IMU_NOISE = {"accel_noise_mps2_per_sqrt_hz": 0.08, "gyro_noise_radps_per_sqrt_hz": 0.005}
"""What `fgloc tune` finds on the first 235 s, half of the drive; the other half was never seen.

The metadata's 0.01 and 0.000175 hold for the sensor, not for what was made of its samples: with
them the NIS of fixes withheld for 1, 4 and 19 s is 7, 11 and 66 times what it should be, with these
1.5, 1.4 and 0.4 times. Smoothing then trusts the gyro over the fixes, and bends the path.
"""

MIDNIGHT_NS = 1_317_600_000_000_000_000
"""2011-10-03T00:00:00Z."""

ORIGIN = Origin(48.98, 8.39, 112.0, "msl")
"""Karlsruhe."""

_UNUSABLE_ROWS = 2
_GPS, _IMU, _METADATA = (
    "KittiGps_converted.txt", "KittiEquivBiasedImu.txt", "KittiEquivBiasedImu_metadata.txt",
)  # fmt: skip
_GPS_COLUMNS = ("Time", "X", "Y", "Z")
_IMU_COLUMNS = ("Time", "dt", "accelX", "accelY", "accelZ", "omegaX", "omegaY", "omegaZ")
_METADATA_COLUMNS = (
    "BodyPtx", "BodyPty", "BodyPtz", "BodyPrx", "BodyPry", "BodyPrz", "AccelerometerSigma",
    "GyroscopeSigma", "IntegrationSigma", "AccelerometerBiasSigma", "GyroscopeBiasSigma",
    "AverageDeltaT",
)  # fmt: skip


def import_kitti() -> Drive:
    """The drive; DriveError where the installed gtsam lacks the files or they are not as known."""
    gps_path, imu_path = example_file(_GPS), example_file(_IMU)
    gps, imu = _table(gps_path, _GPS_COLUMNS), _table(imu_path, _IMU_COLUMNS)
    samples = _samples(imu_path, imu)
    t_ns = _instants(gps_path, gps)
    early = t_ns < samples.t_ns[0]
    fixes = GnssFixes(
        t_ns, t_ns, gps[:, 1:4], np.tile(np.eye(3) * SIGMA_M**2, (len(gps), 1, 1)),
        np.full((len(gps), 3), np.nan),
    )  # fmt: skip
    lost = {
        "IMU rows without a usable interval": _UNUSABLE_ROWS,
        "fixes before the IMU starts": int(early.sum()),
    }
    return Drive("kitti", ORIGIN, _rig(), {"gnss": fixes.take(~early), "imu": samples},
                 about=_about(lost))  # fmt: skip


def example_file(name: str) -> Path:
    """Path of one of gtsam's example files; DriveError where this gtsam does not have it."""
    import gtsam

    try:
        return Path(gtsam.findExampleDataFile(name))
    except FileNotFoundError as err:
        raise DriveError(f"{name}: not among the files of the installed gtsam") from err


def _table(path: Path, columns: tuple[str, ...]) -> Array:
    """Rows of numbers (N, len(columns)) under a header of these names."""
    lines = read_lines(path)
    rows = [line.replace(",", " ").split() for line in lines]
    if tuple(rows[0]) != columns or len(rows) == 1:
        raise DriveError(f"{path}:1: expected a header {' '.join(columns)} and rows below it")
    return np.array([_row(f"{path}:{i}", cells, columns) for i, cells in enumerate(rows[1:], 2)])


def _row(where: str, cells: list[str], columns: tuple[str, ...]) -> list[float]:
    if len(cells) != len(columns):
        raise DriveError(f"{where}: {len(cells)} values, expected {len(columns)}")
    return [number(where, name, cell) for name, cell in zip(columns, cells, strict=True)]


def _instants(path: Path, table: Array) -> Instants:
    t_ns = np.rint(table[:, 0] * 1e9).astype(np.int64) + MIDNIGHT_NS
    check_increasing(path, t_ns)
    return t_ns


def _samples(path: Path, imu: Array) -> ImuSamples:
    t_ns = _instants(path, imu)[_UNUSABLE_ROWS:]
    if not len(t_ns):
        raise DriveError(f"{path}: no rows after the {_UNUSABLE_ROWS} that cannot be used")
    return ImuSamples(t_ns, t_ns, imu[_UNUSABLE_ROWS:, 2:5], imu[_UNUSABLE_ROWS:, 5:8])


def _rig() -> Rig:
    values = _table(example_file(_METADATA), _METADATA_COLUMNS)[0]
    about = dict(zip(_METADATA_COLUMNS, values.tolist(), strict=True))
    T_veh_imu = np.eye(4)
    T_veh_imu[:3, :3] = exp_so3(values[3:6])
    T_veh_imu[:3, 3] = values[:3]
    noise = ImuNoise(
        **IMU_NOISE,
        accel_bias_walk_mps3_per_sqrt_hz=about["AccelerometerBiasSigma"],
        gyro_bias_walk_radps2_per_sqrt_hz=about["GyroscopeBiasSigma"],
    )
    return Rig(T_veh_imu=T_veh_imu, imu_noise=noise)


def _about(lost: dict[str, int]) -> About:
    return About(
        title="KITTI drive 0027 of 2011-10-03 in a town: IMU at 100 Hz, fixes at 1 Hz",
        licence="CC-BY-NC-SA-3.0",
        source=f"KITTI (Geiger et al. 2013), as converted in the gtsam wheel; {left_out(lost)}",
    )
