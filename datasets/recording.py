"""What importers share: text and lines of a file, numbers in them, and the account of what is lost.

Nothing is dropped without a word: an importer counts what it leaves out, by reason, and the counts
become part of the drive's description.
"""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from fgloc.datasets.drive_tables import is_covariance
from fgloc.datasets.trajectory_columns import GEODETIC, check_increasing, check_places
from fgloc.errors import DriveError, InputError
from fgloc.files import read_filled
from fgloc.frames import Datum, Origin
from fgloc.measurements import Array, GnssFixes
from fgloc.timing import NS_PER_S, Instants, decimal_to_ns

DAY_NS = 86_400 * NS_PER_S
_LONGEST_MINUTE_NS = 61 * NS_PER_S  # one with a leap second
INDEFINITE = "fixes whose covariance is not positive definite"
"""Why a fix is left out whose printed sigmas are zero or rounded to an impossible covariance."""


def read_lines(path: Path) -> list[str]:
    """The lines of a text file; bytes that are not ASCII become U+FFFD.

    Raises DriveError where the file is missing, unreadable or empty.
    """
    return read_filled(path).decode("ascii", errors="replace").splitlines()


def number(where: str, name: str, cell: str) -> float:
    """A finite number; DriveError that names the place and the field where it is none."""
    try:
        value = float(cell)
    except ValueError as err:
        raise DriveError(f"{where}: {name} = {cell!r} is not a number") from err
    if not np.isfinite(value):
        raise DriveError(f"{where}: {name} = {cell} is not finite; remove the line or repair it")
    return value


def check_sigma(name: str, value: float) -> None:
    """Raise InputError where an option is no standard deviation in m."""
    if not (np.isfinite(value) and value > 0):
        raise InputError(f"{name} = {value}: a standard deviation above 0 m is needed")


def calendar_ns(where: str, date: str, clock: str) -> int:
    """Nanoseconds since 1970 of '2025/07/08' or '2025-07-08' and '19:34:04.25', leap-second free.

    Raises DriveError that names the place.
    """
    hour, minute, seconds = (*clock.split(":"), "", "")[:3]
    try:
        midnight = datetime.strptime(date.replace("/", "-"), "%Y-%m-%d").replace(tzinfo=UTC)
        start = datetime.strptime(f"{hour}:{minute}", "%H:%M")
        within_ns = decimal_to_ns(seconds)
        if not 0 <= within_ns < _LONGEST_MINUTE_NS:
            raise ValueError(f"{seconds} is no second of a minute")
    except ValueError as err:
        raise DriveError(
            f"{where}: {date} {clock} is not a date and time such as 2025-07-08 19:34:04.25"
        ) from err
    whole_s = int(midnight.timestamp()) + start.hour * 3600 + start.minute * 60
    return whole_s * NS_PER_S + within_ns


def left_out(counts: Mapping[str, int]) -> str:
    """'left out: rows without a fix (3), fixes before the IMU (1)', or that none were."""
    parts = [f"{what} ({n})" for what, n in counts.items() if n]
    return f"left out: {', '.join(parts)}" if parts else "no rows were left out"


def geodetic_fixes(
    path: Path,
    lines: Sequence[int],
    t_ns: Instants,
    places: Array,
    cov_m2: Array,
    v_world_mps: Array | None = None,
    datum: Datum = "ellipsoid",
) -> tuple[GnssFixes, Origin, int]:
    """Fixes about the first of them as origin, and how many `INDEFINITE` ones were left out.

    lines        (N,) numbers of the lines they stand in, for messages
    places       (N, 3) latitude deg, longitude deg, height m above `datum`
    cov_m2       (N, 3, 3) covariance, ENU
    v_world_mps  (N, 3) velocity, ENU, or None

    Raises DriveError where a place cannot be, time goes back or no fix is left.
    """
    if not len(t_ns):
        raise DriveError(f"{path}: holds no usable fix; is it the right file?")
    check_increasing(path, t_ns, duplicates=True, lines=lines)
    check_places(path, dict(zip(GEODETIC, places.T, strict=True)), lines)
    fine = is_covariance(cov_m2)
    if not fine.any():
        raise DriveError(
            f"{path}:{lines[0]}: no fix has a usable covariance; let the receiver write its sigmas"
        )
    lat_deg, lon_deg, height_m = places[fine][0].tolist()
    origin = Origin(lat_deg, lon_deg, height_m, datum)
    v_world_mps = np.full((len(t_ns), 3), np.nan) if v_world_mps is None else v_world_mps
    fixes = GnssFixes(
        t_ns[fine], t_ns[fine], origin.to_world(*places[fine].T), cov_m2[fine], v_world_mps[fine]
    )
    return fixes, origin, int((~fine).sum())
