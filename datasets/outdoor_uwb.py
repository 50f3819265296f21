"""Importer `outdoor-uwb`: ranges to four anchors outdoors, one run's folder of the UWB-dataset.

The folder holds `A*.csv` (ranges, one file an anchor, with the anchor's place), `gnss.csv` (RTK)
and `trajectory.csv` (truth in the anchors' frame). The world frame is the anchors'; that its origin
is at the first RTK fix, and its axes East and North, is not known and only good for maps.

Truth is kept within the window in which the authors score their own results
(`RMSD_results.txt`), and where it is less than 0.5 m off the ground's height:
    Trajectory_A  from the first row with x > 49.3, y > -5 to the first later with x <= 12, y > 3.4
    Trajectory_B  from the first row with x < 8.6, y < -7 to the first later with x > 8.6, y < -7
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgloc.datasets.recording import check_sigma, left_out, number, read_lines
from fgloc.drive import About, Drive, Rig
from fgloc.errors import DriveError
from fgloc.frames import Origin
from fgloc.infrastructure import Anchor, Infrastructure
from fgloc.measurements import Array, Ranges
from fgloc.timing import Instants
from fgloc.trajectory import Trajectory

SIGMA_M = 0.1
"""Of a range in the open, as such modules state it; the files state none."""
HIGHEST_M = 0.5
"""The authors leave out truth that is further off the ground."""

_RANGE = ("field.stamp", "%time", "field.x", "field.y", "field.z", "field.distanceFromTag")
_FIX = ("field.latitude", "field.longitude", "field.altitude")
_TRUTH = ("timestamp", "x", "y", "z")

_Test = Callable[[Array, Array], NDArray[np.bool_]]
_WINDOWS: dict[str, tuple[_Test, _Test]] = {
    "A": (lambda x, y: (x > 49.3) & (y > -5), lambda x, y: (x <= 12) & (y > 3.4)),
    "B": (lambda x, y: (x < 8.6) & (y < -7), lambda x, y: (x > 8.6) & (y < -7)),
}
"""Where the window begins and where it ends, by the letter of the trajectory."""


class _Rows(NamedTuple):
    """Ranges of one anchor: instants and arrivals (N,), ranges (N,), the anchor's place (3,)."""

    t_ns: Instants
    received_ns: Instants
    range_m: Array
    place_m: Array


def import_outdoor_uwb(source: str | Path, sigma_m: float = SIGMA_M) -> Drive:
    """The drive of one run's folder.

    Raises DriveError, naming file, line and value, where a file is missing or not as described,
    or where the folder's path does not say which trajectory it is.
    """
    check_sigma("sigma_m", sigma_m)
    folder = Path(source)
    letter = _letter(folder)
    paths = sorted(folder.glob("A*.csv"), key=lambda path: int(re.sub(r"\D", "", path.stem) or 0))
    if not paths:
        raise DriveError(f"{folder}: has no A*.csv with ranges; give one run's folder")
    anchors = [_anchor_rows(path) for path in paths]
    ranges, lost = _merged(anchors, sigma_m)
    truth, rows_lost = _truth(folder / "trajectory.csv", letter)
    beside = Infrastructure(anchors=tuple(
        Anchor(path.stem, rows.place_m) for path, rows in zip(paths, anchors, strict=True)
    ))  # fmt: skip
    about = About(
        title=f"Ranges to {len(paths)} anchors outdoors, {'/'.join(folder.resolve().parts[-3:])}",
        licence="Apache-2.0",
        source="UWB-dataset of the ADIP lab, Hanyang University; the world frame is the anchors'; "
        + left_out(lost | rows_lost),
    )
    return Drive("outdoor-uwb", _origin(folder / "gnss.csv"), Rig(), {"ranges": ranges}, truth,
                 about, beside)  # fmt: skip


def _letter(folder: Path) -> str:
    found = [part[-1] for part in folder.resolve().parts if re.fullmatch("Trajectory_[AB]", part)]
    if not found:
        raise DriveError(
            f"{folder}: the path names neither Trajectory_A nor Trajectory_B, by which the window "
            "of the truth is known; keep the folders' names as published"
        )
    return found[-1]


def _columns(path: Path, names: tuple[str, ...]) -> tuple[list[list[str]], list[int]]:
    """Cells of the named columns, row by row, and the line that each stands on."""
    lines = read_lines(path)
    header = lines[0].split(",")
    missing = [name for name in names if name not in header]
    if missing:
        raise DriveError(f"{path}:1: missing column {', '.join(missing)}")
    places = [header.index(name) for name in names]
    rows = []
    for i, line in enumerate(lines[1:], 2):
        cells = line.split(",")
        if len(cells) != len(header):
            raise DriveError(f"{path}:{i}: {len(cells)} cells, expected {len(header)}")
        rows.append([cells[place] for place in places])
    if not rows:
        raise DriveError(f"{path}: has a header and no rows")
    return rows, list(range(2, len(lines) + 1))


def _numbers(path: Path, names: tuple[str, ...]) -> Array:
    """The named columns as numbers (N, len(names))."""
    rows, lines = _columns(path, names)
    return np.array([
        [number(f"{path}:{line}", name, cell) for name, cell in zip(names, row, strict=True)]
        for row, line in zip(rows, lines, strict=True)
    ])  # fmt: skip


def _stamps(path: Path, name: str) -> Instants:
    """A column of whole nanoseconds, also where it is written as 1.7e+18."""
    rows, lines = _columns(path, (name,))
    for (cell,), line in zip(rows, lines, strict=True):
        number(f"{path}:{line}", name, cell)
    return np.array([int(cell) if cell.isdigit() else round(float(cell)) for (cell,) in rows])


def _anchor_rows(path: Path) -> _Rows:
    told = _numbers(path, _RANGE[2:])
    if np.ptp(told[:, :3], axis=0).any():
        raise DriveError(f"{path}: the anchor's place changes from row to row; it should stand")
    return _Rows(_stamps(path, _RANGE[0]), _stamps(path, _RANGE[1]), told[:, 3], told[0, :3])


def _merged(anchors: list[_Rows], sigma_m: float) -> tuple[Ranges, dict[str, int]]:
    """The ranges of all anchors in the order of time, and how many were none."""
    t_ns, received_ns, range_m = (
        np.concatenate([rows[i] for rows in anchors]) for i in range(3)
    )  # fmt: skip
    number_of = np.concatenate([np.full(len(rows.t_ns), i) for i, rows in enumerate(anchors)])
    order = np.argsort(t_ns, kind="stable")
    order = order[range_m[order] > 0]
    ranges = Ranges(t_ns[order], np.maximum(received_ns, t_ns)[order], number_of[order],
                    range_m[order], np.full(len(order), sigma_m))  # fmt: skip
    return ranges, {"ranges that are not above 0": len(t_ns) - len(order)}


def _truth(path: Path, letter: str) -> tuple[Trajectory, dict[str, int]]:
    """The truth within the authors' window, and how many rows lie outside."""
    t_ns, p_m = _stamps(path, _TRUTH[0]), _numbers(path, _TRUTH[1:])
    begins, ends = (test(p_m[:, 0], p_m[:, 1]) for test in _WINDOWS[letter])
    first = int(np.argmax(begins))
    later = np.flatnonzero(ends[first + 1 :])
    if not begins.any() or not len(later):
        raise DriveError(f"{path}: never enters or leaves the window of Trajectory_{letter}")
    rows = np.arange(first, first + 1 + int(later[0]) + 1)
    low = np.abs(p_m[rows, 2]) < HIGHEST_M
    lost = {
        "truth outside of the authors' window": len(t_ns) - len(rows),
        f"truth {HIGHEST_M} m or more off the ground": int((~low).sum()),
    }
    return Trajectory(t_ns[rows[low]], p_m[rows[low]]), lost


def _origin(path: Path) -> Origin:
    lat_deg, lon_deg, height_m = _numbers(path, _FIX)[0]
    return Origin(float(lat_deg), float(lon_deg), float(height_m))
