"""Importer `euroc`: `imu0/data.csv` with its noise file, and TUM trajectories beside it.

Such recordings have no GNSS. What stands in for it is named by the user: `positions`, a trajectory
file (TUM) of the body's place, for instance of a laser tracker or of another estimator, of which
only the positions are taken, with `sigma_m` on each axis. `truth` is another such file, or the same
one: then an estimate is scored against what it was given, and the description says so.

`imu0/data.csv` is a line of header with # and rows of t_ns, wx wy wz (rad/s), ax ay az (m/s^2).
Noise and the mounting `T_BS` come from `imu0/sensor.yaml`, or from `imu_noise`, a Kalibr imu.yaml.
The body frame of `T_BS` is the vehicle frame. The trajectories' frame must have z up; its place on
the Earth, which only gravity asks for, is an option: by default Zurich, where EuRoC was recorded.
"""

from pathlib import Path

import numpy as np

from fgloc.datasets.imu_files import read_imu_yaml
from fgloc.datasets.recording import check_sigma, left_out, number, read_lines
from fgloc.datasets.trajectory_columns import check_increasing
from fgloc.datasets.trajectory_files import read_tum
from fgloc.drive import About, Drive, Rig
from fgloc.errors import DriveError, InputError
from fgloc.frames import Origin
from fgloc.measurements import GnssFixes, ImuSamples

SIGMA_M = 0.1
ZURICH = (47.38, 8.55, 450.0)
"""Latitude and longitude in deg, height in m, of ETH."""

_COLUMNS = ("timestamp", "wx", "wy", "wz", "ax", "ay", "az")


def import_euroc(
    source: str | Path,
    *,
    positions: str | Path | None = None,
    truth: str | Path | None = None,
    imu_noise: str | Path | None = None,
    sigma_m: float = SIGMA_M,
    lat_deg: float = ZURICH[0],
    lon_deg: float = ZURICH[1],
    height_m: float = ZURICH[2],
) -> Drive:
    """The drive in a folder with `imu0`, or with `mav0/imu0`.

    Raises InputError where no positions are named or sigma_m is no sigma, DriveError where a file
    is missing or wrong or has no time in common with the IMU.
    """
    if positions is None:
        raise InputError(
            "an EuRoC recording has no positions of its own: name a TUM trajectory with "
            "--positions FILE"
        )
    check_sigma("sigma_m", sigma_m)
    folder = _imu_folder(Path(source))
    noise, T_veh_imu = read_imu_yaml(Path(imu_noise or folder / "sensor.yaml"))
    samples = _samples(folder / "data.csv")
    fixes, before_imu = _fixes(Path(positions), samples, sigma_m)
    return Drive(
        "euroc",
        Origin(lat_deg, lon_deg, height_m),
        Rig(T_veh_imu=T_veh_imu, imu_noise=noise),
        {"gnss": fixes, "imu": samples},
        None if truth is None else read_tum(truth),
        _about(positions, truth, before_imu),
    )


def _imu_folder(source: Path) -> Path:
    for folder in (source / "imu0", source / "mav0" / "imu0"):
        if folder.is_dir():
            return folder
    raise DriveError(f"{source}: has neither imu0 nor mav0/imu0; give the recording's folder")


def _samples(path: Path) -> ImuSamples:
    lines = enumerate(read_lines(path), 1)
    numbered = [(i, line) for i, line in lines if line.strip() and not line.startswith("#")]
    if not numbered:
        raise DriveError(f"{path}: holds no rows; lines of {','.join(_COLUMNS)} are needed")
    rows = [_row(f"{path}:{i}", line) for i, line in numbered]
    t_ns = np.array([t for t, _ in rows], np.int64)
    check_increasing(path, t_ns, lines=[i for i, _ in numbered])
    values = np.array([row for _, row in rows])
    return ImuSamples(t_ns, t_ns, values[:, 3:], values[:, :3])


def _row(where: str, line: str) -> tuple[int, list[float]]:
    cells = [cell.strip() for cell in line.split(",")]
    if len(cells) != len(_COLUMNS):
        raise DriveError(f"{where}: {len(cells)} values, expected 7: {','.join(_COLUMNS)}")
    if not (cells[0].isdecimal() and int(cells[0]) <= np.iinfo(np.int64).max):
        raise DriveError(f"{where}: timestamp = {cells[0]!r} is no whole number of nanoseconds")
    return int(cells[0]), [
        number(where, name, cell) for name, cell in zip(_COLUMNS[1:], cells[1:], strict=True)
    ]


def _fixes(path: Path, samples: ImuSamples, sigma_m: float) -> tuple[GnssFixes, int]:
    """The positions within the span of the IMU, and how many lay outside."""
    measured = read_tum(path)
    t_ns = measured.t_ns
    inside = (t_ns >= samples.t_ns[0]) & (t_ns <= samples.t_ns[-1])
    if not inside.any():
        raise DriveError(
            f"{path}: no position within the span of the IMU, {samples.t_ns[0]} to "
            f"{samples.t_ns[-1]} ns; are both on the same clock?"
        )
    n = int(inside.sum())
    fixes = GnssFixes(
        t_ns[inside], t_ns[inside], measured.p_world_m[inside],
        np.tile(np.eye(3) * sigma_m**2, (n, 1, 1)), np.full((n, 3), np.nan),
    )  # fmt: skip
    return fixes, len(inside) - n


def _about(positions: str | Path, truth: str | Path | None, outside: int) -> About:
    same = truth is not None and Path(truth).resolve() == Path(positions).resolve()
    note = "; the truth is the file that was measured: errors flatter" if same else ""
    return About(
        title="IMU in the layout of EuRoC, positions from a trajectory file",
        source=f"{Path(positions).name} as positions{note}; "
        + left_out({"positions outside the span of the IMU": outside}),
    )
