"""Checks of every table by itself: rates, gaps, repeats, values that are missing or stuck."""

from collections.abc import Iterator
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from fgloc.diagnosis.finding import Finding, fault, remark, robust_sigma, rows_of, warning
from fgloc.drive import Drive
from fgloc.measurements import (
    Array,
    GnssFixes,
    ImuSamples,
    NodeDetections,
    RelativeSightings,
    Table,
)
from fgloc.timing import NS_PER_S

SLOWEST_HZ = {"gnss": 0.1, "imu": 20.0, "wheel": 1.0}
"""Below these a source misses too much: a consumer IMU drifts by metres within 10 s without a fix,
and its own steps have to be far shorter than the swing of a car on its springs (1 to 2 Hz)."""
WIDE = 5.0
"""A gap is this many times the usual interval."""
GAP_S = 0.2
"""Shorter gaps are bridged without a word: in 0.2 s even hard braking is known to centimetres."""
STUCK_S = 0.5
"""Noise moves the last digit of an IMU that works; for so long it cannot be the same."""
STUCK_ROWS = 10
CLIPPED_ROWS = 5
CLIPPED_SIGMAS = 3.0
"""Coarse digits of an IMU at rest repeat as well, but not so far from the middle."""
HARDEST_MPS2, HARDEST_RADPS = 160.0, 35.0
"""The widest ranges that are built into vehicles: 16 g and 2000 deg/s."""
STAMPS = ("t_ns", "received_ns")
IMU_CHANNELS = ("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z")
_DAY_S = 86_400.0


def check_rows(drive: Drive) -> Iterator[Finding]:
    """What there is at all: tables, and rows in them."""
    # Where nodes see several road users, the graph needs neither fixes nor an IMU of the car.
    of_many = NodeDetections.KIND in drive.tables and (
        drive.objects is not None or RelativeSightings.KIND in drive.tables
    )
    of_the_car = drive.has_vehicle and not of_many
    if "gnss" not in drive.tables and of_the_car:
        yield fault("no-table", "gnss", "the drive has no gnss table",
                    "add gnss.csv: the graph needs fixes")  # fmt: skip
    if "imu" not in drive.tables and of_the_car:
        yield remark(
            "no-table", "imu",
            "the drive has no imu table: odometry, steering or the model of a steady velocity "
            "carries it from fix to fix",
            "add imu.csv if there is one: outages then cost less",
        )  # fmt: skip
    for name, table in drive.tables.items():
        if len(table) < 2:
            yield fault(
                "no-rows",
                name,
                f"the table has {len(table)} row(s)",
                "a rate needs two rows; was the recording cut?",
            )


def check_rates(drive: Drive) -> Iterator[Finding]:
    """Rates too slow for what a vehicle does."""
    for name, table in drive.tables.items():
        interval_s = usual_interval_s(table)
        rate_hz = 1 / interval_s if interval_s else np.inf
        if rate_hz < SLOWEST_HZ.get(name, 0.0):
            yield warning(
                "rate",
                name,
                f"comes at {rate_hz:.3g} Hz; below {SLOWEST_HZ[name]:g} Hz it misses motion",
                "record it at its full rate, or expect larger errors between rows",
            )


def check_gaps(drive: Drive) -> Iterator[Finding]:
    """Rows that are missing. Fixes are missing in every tunnel: that is a remark."""
    for name, table in drive.tables.items():
        interval_s = usual_interval_s(table)
        gap_s = np.diff(table.t_ns) / NS_PER_S
        wide = np.flatnonzero(gap_s > max(WIDE * interval_s, GAP_S))
        if not interval_s or not len(wide):
            continue
        longest = int(np.argmax(gap_s))
        if gap_s[longest] > _DAY_S:
            yield fault(
                "gap",
                name,
                f"t_ns jumps by {gap_s[longest] / _DAY_S:,.1f} days at "
                f"{rows_of(table, longest + 1)}",
                "one of the stamps before or after is of another clock or zero: correct or "
                "remove it",
            )
            continue
        what = (
            f"{len(wide)} gap(s), {gap_s[wide].sum():,.2f} s in all; the longest of "
            f"{gap_s[longest]:,.2f} s ends at {rows_of(table, longest + 1)}"
        )
        if name == "imu":
            yield warning(
                "gap",
                name,
                what,
                "look for lost messages in the recorder; a gap is bridged with unknown "
                "acceleration and turn rate",
            )
        else:
            yield remark(
                "gap",
                name,
                what,
                "none needed: the IMU carries the vehicle over it",
            )


def check_duplicates(drive: Drive) -> Iterator[Finding]:
    """Rows of an instant that another has told of already; what sees many objects is let be."""
    for name, table in drive.tables.items():
        if isinstance(table, NodeDetections | RelativeSightings):
            continue  # many are seen at once, and need not be numbered
        # Of one instant are the ranges to all anchors, the codes on all signs.
        told = np.stack([table.t_ns, *(getattr(table, what) for what in sorted(table.WHOLE))])
        _, first = np.unique(told, axis=1, return_index=True)
        repeats = np.setdiff1d(np.arange(len(table)), first)
        if len(repeats):
            yield warning(
                "duplicate",
                name,
                f"t_ns of an earlier row is repeated in {rows_of(table, repeats)}",
                "remove them, or stamp with more digits; of such rows only the first is used",
            )


def check_finite(drive: Drive) -> Iterator[Finding]:
    """Values that are no numbers; a covariance has a check of its own."""
    for name, table in drive.tables.items():
        bad = np.flatnonzero(~np.isfinite(values_of(table)).all(-1))
        if len(bad):
            severity = fault if len(bad) > len(table) / 2 else warning
            yield severity(
                "not-finite",
                name,
                f"NaN or infinity in {rows_of(table, bad)}",
                "remove these rows; they cannot be used",
            )


def check_stuck(drive: Drive) -> Iterator[Finding]:
    """An IMU that repeats itself to the last digit, for a while or on one axis throughout."""
    imu = drive.tables.get("imu")
    if not isinstance(imu, ImuSamples) or len(imu) <= STUCK_ROWS:
        return
    values = values_of(imu)
    for name, column in zip(IMU_CHANNELS, values.T, strict=True):
        if np.ptp(column) == 0:
            yield fault(
                "stuck",
                "imu",
                f"{name} is {column[0]:g} in every row",
                "is the column filled, and the axis recorded?",
            )
    first, length = longest_run((np.diff(values, axis=0) == 0).all(-1))
    lasts_s = (imu.t_ns[min(first + length, len(imu) - 1)] - imu.t_ns[first]) / NS_PER_S
    if STUCK_ROWS <= length < len(imu) - 1 and lasts_s >= STUCK_S:
        yield warning(
            "stuck",
            "imu",
            f"{length + 1:,} rows on end are equal in every digit, {lasts_s:,.2f} s from "
            f"{rows_of(imu, [first])} on",
            "the sensor or its driver hung and repeated its last value: remove these rows",
        )


def check_range(drive: Drive) -> Iterator[Finding]:
    """An IMU that hit the end of its range, or says what no IMU in a vehicle can."""
    imu = drive.tables.get("imu")
    if not isinstance(imu, ImuSamples) or len(imu) <= STUCK_ROWS:
        return
    for sensor, values, limit, unit in (
        ("accel", imu.accel_mps2, HARDEST_MPS2, "m/s^2"),
        ("gyro", imu.gyro_radps, HARDEST_RADPS, "rad/s"),
    ):
        wild = np.flatnonzero((np.abs(values) > limit).any(-1))
        if 0 < len(wild) < len(imu) / 10:
            yield warning(
                "spike",
                "imu",
                f"{sensor} beyond {limit:g} {unit} in {rows_of(imu, wild)}",
                "no vehicle does that: remove the rows",
            )
        for axis, column in zip("xyz", values.T, strict=True):
            finite = np.isfinite(column)
            yield from _clipped(imu.take(finite), f"{sensor}_{axis}", column[finite], unit)


def _clipped(imu: ImuSamples, name: str, column: Array, unit: str) -> Iterator[Finding]:
    if len(column) <= STUCK_ROWS:
        return
    middle = np.median(column)
    for end in (column.min(), column.max()):
        at_end = np.flatnonzero(column == end)
        _, length = longest_run(column == end)
        far = abs(end - middle) > CLIPPED_SIGMAS * robust_sigma(column - middle)
        if length >= CLIPPED_ROWS and far and len(at_end) < len(column) / 2:
            yield warning(
                "clipped",
                "imu",
                f"{name} stays at its extreme {end:.4g} {unit} in {rows_of(imu, at_end)}",
                "the sensor hit the end of its range: choose a wider range; until then raise its "
                "noise",
            )


def usable(drive: Drive) -> Drive:
    """The drive with those tables of which two rows or more are finite."""
    tables = {
        name: table
        for name, table in drive.tables.items()
        if np.isfinite(values_of(table)).all(-1).sum() > 1
    }
    return replace(drive, tables=tables)


def usual_interval_s(table: Table) -> float:
    """Median interval of a table's rows in s, 0 where it has none."""
    steps = np.diff(table.t_ns)
    steps = steps[steps > 0]
    return float(np.median(steps)) / NS_PER_S if len(steps) else 0.0


def values_of(table: Table) -> Array:
    """What a table measures (N, m), without what it need not tell; of fixes the position, since a
    receiver need not say more."""
    if isinstance(table, GnssFixes):
        return table.p_world_ant_m
    apart = {*STAMPS, *table.OPTIONAL}
    columns = [getattr(table, f.name) for f in fields(table) if f.name not in apart]
    return np.column_stack([column.reshape(len(table), column[:1].size or 1) for column in columns])


def longest_run(flags: NDArray[np.bool_]) -> tuple[int, int]:
    """First row and length of the longest run of true flags."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    starts, ends = edges[::2], edges[1::2]
    if not len(starts):
        return 0, 0
    longest = int(np.argmax(ends - starts))
    return int(starts[longest]), int(ends[longest] - starts[longest])
