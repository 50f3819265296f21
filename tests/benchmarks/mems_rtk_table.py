# ruff: noqa: T201
"""The README's table: `mems-rtk`, cases A to C, causal and smoothed, beside what others reach.

    python tests/benchmarks/mems_rtk_table.py

The second table is of what the first leaves out: what is known of a car (no sideways slip, no
motion at rest), and an IMU that is stamped as late as a batch of the same drive finds.

Horizontal metres at the antenna, scored from 75 s on: A on the withheld fixes, B and C on those
inside the outages, with the mean error at an outage's last fix.
"""

import numpy as np

import fgloc
from fgloc.datasets.degrade import degrade
from fgloc.evaluation import errors

SCORE_FROM_NS = 75 * 10**9
DURATION_S = 542.0
CASES = {
    "A: a fix a second": None,
    "B: 11 outages of 15 s": (75, 15, 45),
    "C: 5 outages of 30 s": (75, 30, 90),
}
OTHERS = {
    "A": ("0.053", "0.062", "0.021"),
    "B": ("5.42 / 10.0", "5.38 / 10.1", "0.365"),
    "C": ("18.6 / 38.6", "18.8 / 38.8", "1.90"),
}
"""KF-GINS (causal), OB_GINS (causal, 30 s) and a batch by hand, as SOURCE.txt of the data says."""


CAR = ("vehicle.non_holonomic=true", "vehicle.zero_velocity=true")


def figure(
    drive: fgloc.Drive, outage: tuple[int, int, int] | None, mode: str, *settings: str
) -> str:
    """RMSE, and for outages of a causal run the mean error at their end."""
    result = fgloc.smooth(drive, mode=mode, settings=settings)
    start_ns = int(drive.gnss.t_ns[0])
    scored = errors(result.trajectory, drive.truth, score_from_ns=start_ns + SCORE_FROM_NS)
    if outage is None:
        return f"{rms(scored.horizontal_m):.4f}"
    first_s, length_s, period_s = outage
    number, since_s = np.divmod((scored.t_ns - start_ns) / 1e9 - first_s, period_s)
    whole = first_s + number * period_s + length_s <= DURATION_S
    inside = (since_s < length_s) & whole
    error_m, number = scored.horizontal_m[inside], number[inside]
    if mode == "batch":
        return f"{rms(error_m):.3f}"
    ends_m = [error_m[number == k][-1] for k in np.unique(number)]
    return f"{rms(error_m):.2f} / {np.mean(ends_m):.2f}"


def rms(x: np.ndarray) -> float:
    """Root of the mean square."""
    return float(np.sqrt((x**2).mean()))


def late_imu(drive: fgloc.Drive) -> str:
    """The setting for an IMU that is as late as a batch of this drive says."""
    found = fgloc.smooth(drive, settings=["clock.estimate=imu"]).summary["clock"]["imu"]
    return f"clock.imu_s={found['late_s']:.4f}"


def main() -> None:
    """Print the two tables."""
    drives = {
        name: degrade(fgloc.load("mems-rtk"), outage=outage) if outage else fgloc.load("mems-rtk")
        for name, outage in CASES.items()
    }
    print("| case | `graph-lag` | KF-GINS | OB_GINS | `graph-batch` | batch by hand |")
    print("|---|---|---|---|---|---|")
    for name, outage in CASES.items():
        kf, ob, hand = OTHERS[name[0]]
        lag, batch = (figure(drives[name], outage, mode) for mode in ("fixed-lag", "batch"))
        print(f"| {name} | {lag} | {kf} | {ob} | {batch} | {hand} |", flush=True)
    print()
    print("| case | method | as above | with the car | with the IMU's clock | with both |")
    print("|---|---|---|---|---|---|")
    for name, outage in CASES.items():
        clock = late_imu(drives[name])
        for method, mode in (("graph-lag", "fixed-lag"), ("graph-batch", "batch")):
            cells = [
                figure(drives[name], outage, mode, *settings)
                for settings in ((), CAR, (clock,), (*CAR, clock))
            ]
            print(f"| {name[0]} ({clock}) | `{method}` | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
