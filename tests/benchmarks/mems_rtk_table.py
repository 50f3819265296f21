# ruff: noqa: T201
"""The README's table: `mems-rtk`, cases A to C, causal and smoothed, beside what others reach.

    python tests/benchmarks/mems_rtk_table.py

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


def figure(drive: fgloc.Drive, outage: tuple[int, int, int] | None, mode: str) -> str:
    """RMSE, and for outages of a causal run the mean error at their end."""
    result = fgloc.smooth(drive, mode=mode)
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


def main() -> None:
    """Print the table."""
    print("| case | `graph-lag` | KF-GINS | OB_GINS | `graph-batch` | batch by hand |")
    print("|---|---|---|---|---|---|")
    for name, outage in CASES.items():
        drive = fgloc.load("mems-rtk")
        drive = degrade(drive, outage=outage) if outage else drive
        kf, ob, hand = OTHERS[name[0]]
        lag, batch = (figure(drive, outage, mode) for mode in ("fixed-lag", "batch"))
        print(f"| {name} | {lag} | {kf} | {ob} | {batch} | {hand} |")


if __name__ == "__main__":
    main()
