"""Checks of the stamps: units and epochs, spans that do not meet, latencies."""

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from fgloc.diagnosis.finding import Finding, fault, remark, rows_of, warning
from fgloc.drive import Drive
from fgloc.measurements import Array, Table
from fgloc.timing import GPS_EPOCH_UNIX_S, NS_PER_S, TAI_MINUS_GPS_S, gps_minus_utc_s, iso_utc
from fgloc.trajectory import Trajectory

NTP_EPOCH_S = 2_208_988_800  # from 1900 to 1970
FIRST_S, LAST_S = GPS_EPOCH_UNIX_S, 3_471_292_800
"""Recordings are from 1980 (GPS time begins) to 2080; elsewhere lies another epoch."""
FASTEST_S = 5e-4
"""Rows closer than this (2 kHz) are in another unit than ns, where the date is impossible too."""
UNITS = ((1_000, "microseconds"), (1_000_000, "milliseconds"), (NS_PER_S, "seconds"))
EARLY_S, OLD_S = 1e-3, 10.0
DRIFT, DRIFT_S = 1e-4, 0.05
"""Quartz keeps time to 1e-4; a latency that grows faster, and so far, is a clock that drifts."""
_FEWEST = 80  # rows; a quarter of them has a smallest latency to compare


def check_epochs(drive: Drive) -> Iterator[Finding]:
    """Stamps that are not nanoseconds of POSIX time."""
    relative = []
    for name, table in _clocks(drive).items():
        start_s = int(table.t_ns[0]) / NS_PER_S
        if _too_dense(table):
            yield _not_ns(name, table)
        elif 0 <= start_s < FIRST_S:
            relative.append(name)
        elif not FIRST_S <= start_s <= LAST_S:
            yield warning(
                "epoch",
                name,
                f"t_ns begins at {iso_utc(int(table.t_ns[0]))}",
                "stamps are POSIX time (from 1970, UTC); NTP counts from 1900, GPS from 1980",
            )
    if relative and len(relative) == len(_clocks(drive)):
        yield remark(
            "epoch",
            "drive",
            "t_ns counts from a zero of the recorder's own, not from 1970",
            "none needed while all tables share it",
        )


def _too_dense(table: Table | Trajectory) -> bool:
    """Whether stamps can be no nanoseconds: rows come too fast, and of an impossible date."""
    return int(table.t_ns[0]) < FIRST_S * NS_PER_S and _interval_ns(table) < FASTEST_S * NS_PER_S


def _interval_ns(table: Table | Trajectory) -> float:
    return float(np.median(np.diff(table.t_ns))) if len(table) > 1 else NS_PER_S


def _not_ns(name: str, table: Table | Trajectory) -> Finding:
    first = int(table.t_ns[0])
    fits = [
        (factor, unit) for factor, unit in UNITS if FIRST_S <= first * factor / NS_PER_S <= LAST_S
    ]
    what = f"t_ns begins at {first} and rows are {_interval_ns(table):,.0f} ns apart"
    if not fits:
        return fault(
            "time-unit",
            name,
            what,
            "the unit of t_ns is the nanosecond: multiply",
        )
    factor, unit = fits[0]
    return fault(
        "time-unit",
        name,
        f"{what}: it is in {unit}",
        f"multiply t_ns by {factor:,}",
    )


def check_overlap(drive: Drive) -> Iterator[Finding]:
    """Tables that tell of different times altogether, or hardly of the same."""
    clocks = _clocks(drive)
    gnss = clocks.pop("gnss", None)
    if gnss is None or len(gnss) < 2:
        return
    for name, table in clocks.items():
        if _too_dense(table):
            continue  # told of already
        missed = (gnss.t_ns < table.t_ns[0]) | (gnss.t_ns > table.t_ns[-1])
        if missed.all():
            start_s = (int(table.t_ns[0]) - int(gnss.t_ns[0])) / NS_PER_S
            known = known_offset(start_s, int(gnss.t_ns[0]), 600.0)
            yield fault(
                "no-overlap",
                name,
                f"no row within the time of the fixes; it begins {abs(start_s):,.1f} s "
                f"{'after' if start_s > 0 else 'before'} them{known}",
                "bring both to UTC: GPS seconds count from 1980-01-06 and are ahead by the leap "
                "seconds",
            )
        elif name == "imu" and missed.any():
            yield _partly(len(gnss), missed)


def _partly(fixes: int, missed: NDArray[np.bool_]) -> Finding:
    what = f"{int(missed.sum()):,} of {fixes:,} fixes lie before or after the IMU's rows"
    if missed.mean() > 0.5:
        return warning(
            "coverage",
            "imu",
            what,
            "these fixes cannot be used; is the IMU cut?",
        )
    return remark(
        "coverage",
        "imu",
        what,
        "none needed; these fixes are left out",
    )


def check_latency(drive: Drive) -> Iterator[Finding]:
    """When measurements arrived: not before they were true, and at a steady delay."""
    for name, table in drive.tables.items():
        if not len(table):
            continue
        late_s = (table.received_ns - table.t_ns) / NS_PER_S
        early = np.flatnonzero(late_s < -EARLY_S)
        if len(early):
            yield warning(
                "latency",
                name,
                f"received up to {-late_s.min():,.3f} s before it was true in "
                f"{rows_of(table, early)}",
                "t_ns and received_ns are of two clocks; bring both to one, or leave received_ns "
                "out",
            )
        elif np.median(late_s) > OLD_S:
            known = known_offset(float(np.median(late_s)), int(table.t_ns[0]), 1.0)
            yield warning(
                "latency",
                name,
                f"received {np.median(late_s):,.1f} s after it was true{known}",
                "t_ns and received_ns are of two clocks; bring both to one, or leave received_ns "
                "out",
            )
        yield from _drift(name, table, late_s)


def _drift(name: str, table: Table, late_s: Array) -> Iterator[Finding]:
    """The smallest latency is what a clock adds to the way; it must not grow with time."""
    if len(table) < _FEWEST:
        return
    parts = np.array_split(late_s, 4)
    grows_s = float(parts[-1].min() - parts[0].min())
    span_s = (int(table.t_ns[-1]) - int(table.t_ns[0])) / NS_PER_S * 0.75
    if abs(grows_s) > max(DRIFT_S, DRIFT * span_s):
        yield warning(
            "drift",
            name,
            f"received_ns moves against t_ns by {grows_s:+.3f} s over {span_s:,.0f} s "
            f"({grows_s / span_s * 1e6:+,.0f} ppm)",
            "one of the two clocks drifts, or a queue grows: stamp both by one clock",
        )


def _clocks(drive: Drive) -> dict[str, Table | Trajectory]:
    tables: Mapping[str, Table | Trajectory] = drive.tables
    clocks = {name: table for name, table in tables.items() if len(table)}
    return (
        clocks if drive.truth is None or not len(drive.truth) else clocks | {"truth": drive.truth}
    )


def known_offset(offset_s: float, t_ns: int, within_s: float) -> str:
    """', as ... would' for an offset between two well-known clocks, or nothing."""
    now_s = gps_minus_utc_s(LAST_S)
    leap_s = gps_minus_utc_s(t_ns / NS_PER_S) if t_ns > FIRST_S * NS_PER_S else now_s
    known = (
        (leap_s, "GPS time against UTC"),
        (TAI_MINUS_GPS_S, "TAI against GPS time"),
        (leap_s + TAI_MINUS_GPS_S, "TAI against UTC"),
        (now_s, "GPS time against UTC since 2017"),
        (now_s + TAI_MINUS_GPS_S, "TAI against UTC since 2017"),
        (GPS_EPOCH_UNIX_S, "the epoch of GPS (1980) against that of POSIX (1970)"),
        (NTP_EPOCH_S, "the epoch of NTP (1900) against that of POSIX (1970)"),
        *((3600 * hours, f"a time zone of {hours} h") for hours in range(1, 15)),
    )
    distance = [abs(abs(offset_s) - seconds) for seconds, _ in known]
    nearest = int(np.argmin(distance))
    if distance[nearest] > within_s:
        return ""
    seconds, name = known[nearest]
    return f", like {name} ({seconds:,} s)"
