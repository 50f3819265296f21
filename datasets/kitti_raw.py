"""Importer `kitti-raw`: the OXTS text files of a KITTI raw recording.

The folder holds `oxts/timestamps.txt` and `oxts/data/0000000000.txt` ... with 30 numbers each. The
device is an OXTS RT3003: GNSS and IMU in one, already fused by itself. So its position is no raw
fix and its pose no independent truth:

* GNSS: latitude, longitude, altitude (above mean sea level) of one row in each `fix_every_s`
  seconds, `pos_accuracy` as the sigma of each axis;
* IMU: ax ay az, wx wy wz in the vehicle's axes, forward-left-up;
* truth, unless `use_truth=false`: position, attitude and velocity of all rows. A method is then
  scored against the device's own fusion of the same data, which flatters what resembles it.

The vehicle frame is the device's. Stamps bear no zone and are taken as UTC. A stamp without a data
file, a row whose stamp is not later than the one before (the unsynchronised recordings have some)
and a fix without a positive accuracy are left out and counted.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgloc.datasets.recording import calendar_ns, geodetic_fixes, left_out, number, read_lines
from fgloc.drive import About, Drive, ImuNoise, Rig
from fgloc.errors import DriveError, InputError
from fgloc.frames import Origin, exp_so3, yaw_matrix
from fgloc.measurements import Array, ImuSamples
from fgloc.timing import Instants, seconds_to_ns
from fgloc.trajectory import Trajectory

FIELDS = (
    "lat", "lon", "alt", "roll", "pitch", "yaw", "vn", "ve", "vf", "vl", "vu", "ax", "ay", "az",
    "af", "al", "au", "wx", "wy", "wz", "wf", "wl", "wu", "pos_accuracy", "vel_accuracy",
    "navstat", "numsats", "posmode", "velmode", "orimode",
)  # fmt: skip
"""Names of the 30 numbers, as KITTI's dataformat.txt has them."""

IMU_NOISE = ImuNoise(
    accel_noise_mps2_per_sqrt_hz=0.01,
    gyro_noise_radps_per_sqrt_hz=0.000175,
    accel_bias_walk_mps3_per_sqrt_hz=0.000167,
    gyro_bias_walk_radps2_per_sqrt_hz=2.91e-6,
)
"""What GTSAM's example states for this very device."""

FIX_EVERY_S = 1.0


def import_kitti_raw(
    source: str | Path, *, fix_every_s: float = FIX_EVERY_S, use_truth: bool = True
) -> Drive:
    """The drive in a recording's folder, or in its `oxts` folder.

    fix_every_s  seconds from one fix to the next; 0 takes every row
    use_truth    whether the device's pose becomes the truth

    Raises DriveError where files are missing or a row is wrong, InputError for a negative span.
    """
    if not (np.isfinite(fix_every_s) and fix_every_s >= 0):
        raise InputError(f"fix_every_s = {fix_every_s}: expected seconds, 0 or more")
    folder = Path(source) / "oxts" if (Path(source) / "oxts").is_dir() else Path(source)
    names, t_ns, rows, lost = _rows(folder)
    one = dict(zip(FIELDS, rows.T, strict=True))
    chosen = _one_in_each(t_ns, seconds_to_ns(fix_every_s)) & (one["pos_accuracy"] > 0)
    lines = [names[row] for row in np.flatnonzero(chosen)]
    places = np.stack([one["lat"], one["lon"], one["alt"]], -1)
    cov_m2 = one["pos_accuracy"][:, None, None] ** 2 * np.eye(3)
    v_world_mps = np.stack([one["ve"], one["vn"], one["vu"]], -1)
    fixes, origin, _ = geodetic_fixes(
        folder / "data", lines, t_ns[chosen], places[chosen], cov_m2[chosen],
        v_world_mps[chosen], "msl",
    )  # fmt: skip
    samples = ImuSamples(t_ns, t_ns, rows[:, 11:14], rows[:, 17:20])
    lost["rows without a positive pos_accuracy, as fixes"] = int((one["pos_accuracy"] <= 0).sum())
    truth = _truth(t_ns, rows, origin) if use_truth else None
    return Drive("kitti-raw", origin, Rig(imu_noise=IMU_NOISE), {"gnss": fixes, "imu": samples},
                 truth, _about(fix_every_s, use_truth, lost))  # fmt: skip


def _rows(folder: Path) -> tuple[list[int], Instants, Array, dict[str, int]]:
    """Numbers of the data files, their instants (N,) and contents (N, 30), and what was lost."""
    path = folder / "timestamps.txt"
    stamps = [_stamp(f"{path}:{i}", line) for i, line in enumerate(read_lines(path), 1)]
    files = {_file_number(file): file for file in sorted((folder / "data").glob("*.txt"))}
    if not files:
        raise DriveError(f"{folder / 'data'}: holds no .txt files; give the recording's folder")
    if max(files) >= len(stamps):
        raise DriveError(
            f"{files[max(files)]}: has no stamp, {path.name} has {len(stamps)} lines; "
            "copy the recording again"
        )
    t_ns = np.array([stamps[i] for i in files], np.int64)
    later = np.concatenate([[True], t_ns[1:] > np.maximum.accumulate(t_ns)[:-1]])
    rows = np.array([_numbers(file) for file in files.values()])
    lost = {
        "stamps without a data file": len(stamps) - len(files),
        "rows not later than the one before": int((~later).sum()),
    }
    return [i for i, keep in zip(files, later, strict=True) if keep], t_ns[later], rows[later], lost


def _stamp(where: str, line: str) -> int:
    date, _, clock = line.strip().partition(" ")
    return calendar_ns(where, date, clock)


def _file_number(file: Path) -> int:
    if not file.stem.isdecimal():
        raise DriveError(f"{file}: is not named by a number, as 0000000000.txt; take it away")
    return int(file.stem)


def _numbers(file: Path) -> list[float]:
    cells = read_lines(file)[0].split()
    if len(cells) != len(FIELDS):
        raise DriveError(f"{file}:1: {len(cells)} numbers, expected {len(FIELDS)}: lat ... orimode")
    return [number(f"{file}:1", name, cell) for name, cell in zip(FIELDS, cells, strict=True)]


def _one_in_each(t_ns: Instants, period_ns: int) -> NDArray[np.bool_]:
    """(N,) bool: the first row of each period since the first row; all where the period is 0."""
    if not period_ns:
        return np.ones(len(t_ns), bool)
    period = (t_ns - t_ns[0]) // period_ns
    return np.concatenate([[True], np.diff(period) > 0])


def _truth(t_ns: Instants, rows: Array, origin: Origin) -> Trajectory:
    """The device's pose; its yaw is from East, positive roll and pitch turn about x and y."""
    about_x, about_y = np.zeros((2, len(rows), 3))
    about_x[:, 0], about_y[:, 1] = rows[:, 3], rows[:, 4]
    R_world_veh = yaw_matrix(rows[:, 5]) @ exp_so3(about_y) @ exp_so3(about_x)
    v_world_mps = rows[:, [7, 6, 10]]
    return Trajectory(t_ns, origin.to_world(*rows[:, :3].T), R_world_veh, v_world_mps)


def _about(fix_every_s: float, use_truth: bool, lost: dict[str, int]) -> About:
    truth = "truth is the same device's fused pose" if use_truth else "no truth taken"
    return About(
        title=f"KITTI raw recording: OXTS, a fix each {fix_every_s:g} s, IMU",
        licence="CC-BY-NC-SA-3.0",
        source=f"KITTI raw (Geiger et al. 2013); fixes are the device's own fusion; {truth}; "
        + left_out(lost),
    )
