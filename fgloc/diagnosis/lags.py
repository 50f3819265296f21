"""Checks of clocks against that of the fixes, by the motion that both tell of, or by the spans."""

from collections.abc import Iterator

import numpy as np

from fgloc.diagnosis.clocks import known_offset
from fgloc.diagnosis.finding import Finding, fault, remark, warning
from fgloc.diagnosis.lag import Lag, speed_lag
from fgloc.diagnosis.motion import Motion, Signal
from fgloc.diagnosis.witness import Witness
from fgloc.drive import Drive
from fgloc.measurements import Array, GnssFixes, Table, WheelSpeeds
from fgloc.timing import NS_PER_S

SMALLEST_LAG_S = 0.05
"""Below it a stamp is the sensor's own delay, and the lag costs a car in town less than 1 m."""
_MEETS_S = 1.0


def check_lags(drive: Drive, witness: Witness | None) -> Iterator[Finding]:
    """Clocks against that of the fixes, by the motion that both tell of, or by the spans."""
    if witness is not None and witness.lag is not None:
        yield from _lag("imu", drive, witness.lag)
    elif "imu" in drive.tables:
        yield from _spans("imu", drive, drive.tables["imu"])
    wheel, motion = drive.tables.get("wheel"), Motion.of(drive)
    if isinstance(wheel, WheelSpeeds) and motion is not None and len(wheel) > 1:
        finite = np.isfinite(wheel.speed_mps)
        speed = wheel.speed_mps[finite][:, None]
        lag = speed_lag(motion, Signal.of_level(wheel.t_ns[finite], speed, motion.start_ns))
        if lag is not None:
            yield from _lag("wheel", drive, lag)


def _lag(name: str, drive: Drive, lag: Lag) -> Iterator[Finding]:
    gnss = drive.gnss
    told = f"{abs(lag.lag_s):.2f} s (sigma {lag.sigma_s:.2f} s)"
    if not lag.is_significant or abs(lag.lag_s) < SMALLEST_LAG_S:
        yield remark(
            "lag",
            name,
            f"its clock and that of gnss agree as far as the motion tells: {told}",
            "none needed",
        )
        return
    late, early = (name, "gnss") if lag.lag_s > 0 else ("gnss", name)
    known = known_offset(abs(lag.lag_s), int(gnss.t_ns[0]), max(0.5, 3 * lag.sigma_s))
    off_m = abs(lag.lag_s) * float(np.median(_speed(drive)))
    severity = fault if abs(lag.lag_s) > 1 or off_m > 3 * _claimed_m(gnss) else warning
    yield severity(
        "lag",
        late,
        f"the same motion bears stamps {told} later than in {early}{known}; at the speed of this "
        f"drive that is {off_m:,.1f} m",
        f"take {abs(lag.lag_s):.2f} s off t_ns of {late}, or add it to {early}: stamps tell when "
        "a measurement was true, in UTC",
    )


def _spans(name: str, drive: Drive, table: Table) -> Iterator[Finding]:
    """Where motion does not tell: both ends of a table out by the same known offset."""
    gnss = drive.tables.get("gnss")
    if gnss is None or len(gnss) < 2 or len(table) < 2:
        return
    first_s, last_s = ((int(table.t_ns[i]) - int(gnss.t_ns[i])) / NS_PER_S for i in (0, -1))
    if table.t_ns[0] > gnss.t_ns[-1] or table.t_ns[-1] < gnss.t_ns[0]:
        return  # told of already
    known = known_offset((first_s + last_s) / 2, int(gnss.t_ns[0]), _MEETS_S)
    if abs(first_s - last_s) < _MEETS_S and abs(first_s) > _MEETS_S and known:
        yield warning(
            "lag",
            name,
            f"begins and ends {abs(first_s):,.1f} s {'after' if first_s > 0 else 'before'} "
            f"gnss{known}",
            "if both were recorded together, bring their stamps to UTC",
        )


def _speed(drive: Drive) -> Array:
    motion = Motion.of(drive)
    assert motion is not None  # or there would be no lag
    return motion.speed_mps[motion.steps]


def _claimed_m(gnss: GnssFixes) -> float:
    trace = gnss.cov_world_m2[:, 0, 0] + gnss.cov_world_m2[:, 1, 1]
    return float(np.sqrt(np.nanmedian(trace)))
