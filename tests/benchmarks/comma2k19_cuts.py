# ruff: noqa: T201
"""`comma2k19` with its GPS cut for 10 and for 20 s, with an IMU and without.

    python tests/benchmarks/comma2k19_cuts.py

Horizontal metres against the pose truth of the segment: over all of it, inside the cuts, and at
their ends. The receiver stamps its fixes late; how late is estimated once from the drive with its
IMU and its wheels, the cut fixes left out, and is what the other rows are given.
"""

import dataclasses

import numpy as np

import fgloc
from fgloc.datasets.degrade import Outage
from fgloc.evaluation import errors

WHOLE = Outage(first_s=1e4, length_s=1.0, period_s=2.0)
CUTS = {
    "none": WHOLE,
    "10 s, twice": Outage(first_s=12.0, length_s=10.0, period_s=24.0),
    "20 s": Outage(first_s=20.0, length_s=20.0, period_s=60.0),
}
CAR = ("vehicle.non_holonomic=true", "vehicle.wheel_speed=true")
STEERED = ("motion.wheelbase_m=2.7",)
METHODS = {
    "IMU, fixes as stamped": ((), ()),
    "IMU": ((), ()),
    "IMU, wheels, no slip": ((), CAR),
    "steering and wheels": (("imu",), STEERED),
    "wheels": (("imu", "steering"), ()),
    "constant velocity": (("imu", "steering", "wheel"), ()),
}
"""Tables left out, and settings. A wheelbase of 2.7 m is that of a common car; the segment does not
say which car it was, so it is not fitted."""


def cut(drive: fgloc.Drive, outage: Outage) -> fgloc.Drive:
    """The drive without the fixes inside an outage; its truth is the one it came with."""
    return drive.with_tables(gnss=drive.gnss.take(~outage.covers(drive.gnss)))


def without(drive: fgloc.Drive, names: tuple[str, ...]) -> fgloc.Drive:
    """The drive without some of its tables."""
    kept = {name: table for name, table in drive.tables.items() if name not in names}
    return dataclasses.replace(drive, tables=kept)


def figures(drive: fgloc.Drive, outage: Outage, settings: tuple[str, ...], mode: str) -> str:
    """RMSE over all, inside the cuts, and the mean error at their ends."""
    fixes = drive.gnss
    result = fgloc.smooth(cut(drive, outage), mode=mode, settings=list(settings))
    scored = errors(result.trajectory, drive.truth)
    number, since_s = np.divmod(
        (scored.t_ns - fixes.t_ns[0]) / 1e9 - outage.first_s, outage.period_s
    )
    inside = (number >= 0) & (number < outage.count(fixes)) & (since_s < outage.length_s)
    if not inside.any():
        return f"{rms(scored.horizontal_m):.2f}"
    error_m, number = scored.horizontal_m[inside], number[inside]
    ends_m = [error_m[number == k][-1] for k in np.unique(number)]
    return f"{rms(scored.horizontal_m):.2f} / {rms(error_m):.2f} / {np.mean(ends_m):.2f}"


def rms(x: np.ndarray) -> float:
    """Root of the mean square."""
    return float(np.sqrt((x**2).mean()))


def main() -> None:
    """Print the table."""
    drive = fgloc.load("comma2k19")
    print("| GPS cut | method | fixes late by s | `graph-batch` | `graph-lag` |")
    print("|---|---|---|---|---|")
    for name, outage in CUTS.items():
        estimated = fgloc.smooth(cut(drive, outage), settings=["clock.estimate=gnss", *CAR])
        late_s = estimated.summary["clock"]["gnss"]["late_s"]
        for method, (missing, settings) in METHODS.items():
            clock = () if "as stamped" in method else (f"clock.gnss_s={late_s:.4f}",)
            told = [
                figures(without(drive, missing), outage, (*settings, *clock), mode)
                for mode in ("batch", "fixed-lag")
            ]
            print(f"| {name} | {method} | {late_s if clock else 0:.3f} | {' | '.join(told)} |",
                  flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
