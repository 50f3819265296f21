"""Integer-nanosecond time.

An instant is an int64 count of nanoseconds of POSIX time (UTC without leap seconds); a duration
is a float in seconds. GPS and TAI stamps are turned into POSIX here and nowhere else.
"""

import re
from datetime import UTC, datetime

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgloc.errors import InputError

Instants = NDArray[np.int64]

NS_PER_S = 1_000_000_000
GPS_EPOCH_UNIX_S = 315_964_800  # 1980-01-06T00:00:00Z
WEEK_S = 604_800
TAI_MINUS_GPS_S = 19
LEAP_TABLE_EXPIRES_UNIX_S = 1_782_604_800
"""2026-06-28: until then IERS Bulletin C announced no other leap second; later ones are missing."""

# (POSIX second from which it holds, TAI - UTC in s): IERS Bulletin C, unchanged since 2017.
_TAI_MINUS_UTC_S = (
    (315_964_800, 19), (362_793_600, 20), (394_329_600, 21), (425_865_600, 22),
    (489_024_000, 23), (567_993_600, 24), (631_152_000, 25), (662_688_000, 26),
    (709_948_800, 27), (741_484_800, 28), (773_020_800, 29), (820_454_400, 30),
    (867_715_200, 31), (915_148_800, 32), (1_136_073_600, 33), (1_230_768_000, 34),
    (1_341_100_800, 35), (1_435_708_800, 36), (1_483_228_800, 37),
)  # fmt: skip
_TAI_OF_GPS_EPOCH_NS = (GPS_EPOCH_UNIX_S + TAI_MINUS_GPS_S) * NS_PER_S
_DECIMAL = re.compile(r"([+-]?)(?=\.?[0-9])([0-9]*)\.?([0-9]{0,9})")


def gps_minus_utc_s(unix_s: float) -> int:
    """Whole seconds that GPS time is ahead of UTC at a POSIX second after 1980-01-06."""
    for start, tai_minus_utc in reversed(_TAI_MINUS_UTC_S):
        if unix_s >= start:
            return tai_minus_utc - TAI_MINUS_GPS_S
    raise InputError(f"POSIX second {unix_s} lies before GPS time began (1980-01-06)")


def gps_to_utc_ns(gps_ns: ArrayLike) -> Instants:
    """POSIX nanoseconds (N,) of nanoseconds since the GPS epoch, 1980-01-06, each on its own.

    A leap second has no POSIX number of its own: it gets those of the second after it. Raises
    InputError before the epoch.
    """
    on_posix_axis = _since(gps_ns, 0, "GPS time") + GPS_EPOCH_UNIX_S * NS_PER_S
    offsets = _offsets_s() - TAI_MINUS_GPS_S
    # Seen on the GPS axis, an offset holds from so many seconds later than its UTC midnight.
    row = np.searchsorted((_starts_s() + offsets) * NS_PER_S, on_posix_axis, side="right") - 1
    return np.asarray(on_posix_axis - offsets[row] * NS_PER_S, np.int64)


def utc_to_gps_ns(t_ns: ArrayLike) -> Instants:
    """Nanoseconds (N,) since the GPS epoch of POSIX nanoseconds; InputError before the epoch."""
    posix = _since(t_ns, GPS_EPOCH_UNIX_S * NS_PER_S, "GPS time")
    offsets = _offsets_s() - TAI_MINUS_GPS_S
    row = np.searchsorted(_starts_s() * NS_PER_S, posix, side="right") - 1
    return np.asarray(posix + (offsets[row] - GPS_EPOCH_UNIX_S) * NS_PER_S, np.int64)


def tai_to_utc_ns(tai_ns: ArrayLike) -> Instants:
    """POSIX nanoseconds (N,) of nanoseconds of TAI since 1970-01-01 TAI, as PTP counts them.

    Raises InputError before 1980-01-06, where the table of leap seconds begins.
    """
    tai = _since(tai_ns, _TAI_OF_GPS_EPOCH_NS, "the table of leap seconds")
    return gps_to_utc_ns(tai - _TAI_OF_GPS_EPOCH_NS)


def utc_to_tai_ns(t_ns: ArrayLike) -> Instants:
    """Inverse of `tai_to_utc_ns`; InputError before 1980-01-06."""
    return np.asarray(utc_to_gps_ns(t_ns) + _TAI_OF_GPS_EPOCH_NS, np.int64)


def gps_week_to_ns(week: int, seconds_of_week: ArrayLike) -> Instants:
    """POSIX nanoseconds of GPS week (not modulo 1024) and seconds of the week, (N,) to (N,).

    The leap-second offset is that of the first stamp. Exact to the nanosecond where the
    seconds carry six decimals or fewer.
    """
    sow_s = np.asarray(seconds_of_week, float)
    start_s = GPS_EPOCH_UNIX_S + week * WEEK_S
    first_s = start_s + (float(sow_s.flat[0]) if sow_s.size else 0.0)
    # The stamp as it stands is ahead of UTC: what holds is the offset of the UTC second it means.
    leap_s = gps_minus_utc_s(first_s - gps_minus_utc_s(first_s))
    whole = np.floor(sow_s)
    fraction_ns = np.rint((sow_s - whole) * 1e9).astype(np.int64)
    return (np.int64(start_s - leap_s) + whole.astype(np.int64)) * NS_PER_S + fraction_ns


def _starts_s() -> Instants:
    return np.array([start for start, _ in _TAI_MINUS_UTC_S], np.int64)


def _offsets_s() -> Instants:
    return np.array([offset for _, offset in _TAI_MINUS_UTC_S], np.int64)


def _since(ns: ArrayLike, first_ns: int, what: str) -> Instants:
    """The stamps as integers; InputError where one is no integer or lies before the first."""
    stamps = np.asarray(ns)
    if stamps.size and stamps.dtype.kind not in "iu":
        raise InputError(f"stamps of type {stamps.dtype}: give whole nanoseconds as int64")
    stamps = stamps.astype(np.int64)
    if stamps.size and int(stamps.min()) < first_ns:
        raise InputError(f"{stamps.min()} ns lies before {what} began (1980-01-06)")
    return stamps


def seconds_to_ns(seconds: float) -> int:
    """A duration in s as whole nanoseconds."""
    return round(seconds * NS_PER_S)


def elapsed_s(t_ns: ArrayLike, start_ns: int) -> NDArray[np.float64]:
    """Durations in s since `start_ns`, subtracted as integers so that no digit is lost."""
    return (np.asarray(t_ns, np.int64) - np.int64(start_ns)) / NS_PER_S


def ns_to_decimal(t_ns: int) -> str:
    """`1751900000123456789` as '1751900000.123456789': seconds with every nanosecond kept."""
    text = str(t_ns)
    if t_ns >= NS_PER_S:
        return f"{text[:-9]}.{text[-9:]}"
    sign, magnitude = ("-", -t_ns) if t_ns < 0 else ("", t_ns)
    return f"{sign}{magnitude // NS_PER_S}.{magnitude % NS_PER_S:09d}"


def decimal_to_ns(text: str) -> int:
    """Inverse of `ns_to_decimal`; takes any decimal with at most nine fractional digits.

    Raises ValueError on anything else.
    """
    match = _DECIMAL.fullmatch(text.strip())
    if match is None:
        raise ValueError(f"{text!r} is not a decimal number of seconds down to nanoseconds")
    sign, whole, fraction = match.groups()
    ns = int(whole or 0) * NS_PER_S + int(fraction.ljust(9, "0"))
    return -ns if sign == "-" else ns


def iso_utc(t_ns: int) -> str:
    """The instant as '2025-07-08T19:34:04.000Z', for people to read."""
    moment = datetime.fromtimestamp(t_ns // NS_PER_S, UTC)
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{t_ns % NS_PER_S // 1_000_000:03d}Z"
