"""Importer `rtklib-pos`: a solution file of RTKLIB (rnx2rtkp, RTKPOST, RTKNAVI).

Lines with % are a header, the last of which names the columns: the time scale (GPST, UTC or JST),
latitude(deg), longitude(deg), height(m), Q, ns, sdn sde sdu sdne sdeu sdun, age, ratio and, where
it was asked for, vn ve vu. Times are `2018/08/02 16:15:06.397` or GPS week and seconds of it.

The sigmas give a full covariance. Of sdne, sdeu, sdun the square is the covariance and the sign is
that of the covariance: sdne = -0.2 m stands for -0.04 m^2.

Left out and counted: rows without a solution (Q = 0) or worse than `worst_quality`, and those whose
printed covariance is not positive definite. Q is 1 fix, 2 float, 3 SBAS, 4 DGPS, 5 single, 6 PPP.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from fgloc.datasets.imu_files import with_imu
from fgloc.datasets.recording import (
    INDEFINITE,
    calendar_ns,
    geodetic_fixes,
    left_out,
    number,
    read_lines,
)
from fgloc.datasets.trajectory_columns import symmetric
from fgloc.drive import About, Drive, Rig
from fgloc.errors import DriveError, InputError
from fgloc.frames import Datum
from fgloc.measurements import Array
from fgloc.timing import GPS_EPOCH_UNIX_S, NS_PER_S, WEEK_S, Instants, decimal_to_ns, gps_to_utc_ns

WORST_QUALITY = 6

_SCALES = ("GPST", "UTC", "JST")
_JST_NS = 9 * 3600 * NS_PER_S
_PLACE = ("latitude(deg)", "longitude(deg)", "height(m)")
_SIGMAS = ("sde(m)", "sdn(m)", "sdu(m)", "sdne(m)", "sdeu(m)", "sdun(m)")
_VELOCITY = ("ve(m/s)", "vn(m/s)", "vu(m/s)")
_NEEDED = (*_PLACE, "Q", *_SIGMAS)


def import_rtklib_pos(
    source: str | Path,
    *,
    worst_quality: int = WORST_QUALITY,
    imu: str | Path | None = None,
    imu_noise: str | Path | None = None,
) -> Drive:
    """The drive in a .pos file, with the IMU of two files beside it where they are given.

    worst_quality  the largest Q that is taken: 1 takes fixed solutions alone

    Raises DriveError, naming line, field and value, where the file is not as described.
    """
    path = Path(source)
    lines = read_lines(path)
    scale, columns, datum = _header(path, lines)
    data = [(i, line) for i, line in enumerate(lines, 1) if line.strip() and line[0] != "%"]
    if not data:
        raise DriveError(f"{path}: holds no solutions, only a header")
    numbers = [i for i, _ in data]
    stamps, rows = zip(*(_row(f"{path}:{i}", line, columns) for i, line in data), strict=True)
    one = dict(zip(columns, np.array(rows).T, strict=True))
    good = (one["Q"] >= 1) & (one["Q"] <= worst_quality)
    fixes, origin, indefinite = geodetic_fixes(
        path,
        np.array(numbers)[good].tolist(),
        _to_posix(path, scale, np.array(stamps, np.int64))[good],
        np.stack([one[name] for name in _PLACE], -1)[good],
        _covariances(one)[good],
        _velocities(one, good),
        datum,
    )
    lost = {
        "rows without a solution": int((one["Q"] < 1).sum()),
        f"rows of a quality above {worst_quality}": int((one["Q"] > worst_quality).sum()),
        INDEFINITE: indefinite,
    }
    about = About(title="GNSS solution of RTKLIB", source=f"{path.name}; {left_out(lost)}")
    return with_imu(
        Drive("rtklib-pos", origin, Rig(), {"gnss": fixes}, about=about), imu, imu_noise
    )


def _header(path: Path, lines: list[str]) -> tuple[str, list[str], Datum]:
    """Time scale, names of the columns after the time, and the datum of the heights."""
    heads = [line.lstrip("%").replace(",", " ") for line in lines if line.startswith("%")]
    named = [head.split() for head in heads if head.split()[:1] and head.split()[0] in _SCALES]
    if not named:
        raise DriveError(
            f"{path}: no header that names GPST, UTC or JST and the columns; "
            "write the solution with out-outhead=on"
        )
    scale, *columns = named[-1]
    columns = ["sdun(m)" if name == "sdue(m)" else name for name in columns]
    missing = [name for name in _NEEDED if name not in columns]
    if missing:
        raise DriveError(f"{path}: the header has no column {missing[0]}; {_remedy(columns)}")
    is_geodetic = any("height=WGS84/geodetic" in head for head in heads)
    return scale, columns, "msl" if is_geodetic else "ellipsoid"


def _remedy(columns: list[str]) -> str:
    """What to set in RTKLIB, by what the file has instead."""
    if any(name.startswith("latitude(d'") for name in columns):
        return "degrees, minutes and seconds are not read: write it with out-degform=deg"
    if any(name.startswith(("x-ecef", "e-baseline")) for name in columns):
        return "write it with out-solformat=llh"
    return f"needed are {', '.join(_NEEDED)}: write it with out-solformat=llh"


def _row(where: str, line: str, columns: list[str]) -> tuple[int, list[float]]:
    """Nanoseconds since 1970 on the file's own scale, and the numbers after it."""
    cells = line.replace(",", " ").split()
    if len(cells) != len(columns) + 2:
        raise DriveError(
            f"{where}: {len(cells)} values, expected {len(columns) + 2} as the header names them; "
            "is the line cut off?"
        )
    pairs = zip(columns, cells[2:], strict=True)
    return _stamp(where, *cells[:2]), [number(where, name, cell) for name, cell in pairs]


def _stamp(where: str, first: str, second: str) -> int:
    if not first.isdecimal():
        return calendar_ns(where, first, second)
    try:
        return (GPS_EPOCH_UNIX_S + int(first) * WEEK_S) * NS_PER_S + decimal_to_ns(second)
    except ValueError as err:
        raise DriveError(f"{where}: seconds of the week = {second!r} is not a number") from err


def _to_posix(path: Path, scale: str, stamps: Instants) -> Instants:
    convert: dict[str, Callable[[Instants], Instants]] = {
        "GPST": lambda ns: gps_to_utc_ns(ns - GPS_EPOCH_UNIX_S * NS_PER_S),
        "UTC": lambda ns: ns,
        "JST": lambda ns: np.asarray(ns - _JST_NS, np.int64),
    }
    try:
        return convert[scale](stamps)
    except InputError as err:
        raise DriveError(f"{path}: {err}") from err


def _covariances(one: dict[str, Array]) -> Array:
    """(N, 3, 3) in m^2, ENU, of the six columns: squares that keep their sign."""
    e, n, u, ne, eu, un = (np.sign(one[name]) * one[name] ** 2 for name in _SIGMAS)
    return symmetric(np.stack([e, ne, eu, n, un, u], -1), 3)


def _velocities(one: dict[str, Array], good: Array) -> Array | None:
    if not all(name in one for name in _VELOCITY):
        return None
    return np.stack([one[name] for name in _VELOCITY], -1)[good]
