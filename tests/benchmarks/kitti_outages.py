# ruff: noqa: T201
"""`kitti` with most of its fixes withheld, and how long the whole command takes.

    python tests/benchmarks/kitti_outages.py

Horizontal RMSE in metres at the withheld fixes, over the whole drive and over its second half,
which the noise in the importer has never seen (`fgloc.datasets.kitti.IMU_NOISE`). Outages last 30
and 60 s and return after as long again. The line beside it interpolates between fixes.
"""

import os
import subprocess
import sys
import tempfile
import time

import numpy as np

import fgloc
from fgloc.datasets.degrade import degrade
from fgloc.evaluation import errors

HALF_S = 235.0
CASES = {
    "every 10th fix": {"keep_every": 10},
    "outages of 30 s": {"outage": (30, 30, 60)},
    "outages of 60 s": {"outage": (30, 60, 120)},
}
ASKED_M = (3.3, 5.5, 17.0)


def rmse_m(trajectory: fgloc.Trajectory, drive: fgloc.Drive, from_s: float) -> float:
    """Horizontal, at the withheld fixes from a time on."""
    from_ns = int(drive.gnss.t_ns[0]) + round(from_s * 1e9)
    scored = errors(trajectory, drive.truth, score_from_ns=from_ns)
    return float(np.sqrt((scored.horizontal_m**2).mean()))


def line_m(drive: fgloc.Drive) -> float:
    """Of a straight line between the fixes that are left."""
    t, z, truth = drive.gnss.t_ns, drive.gnss.p_world_ant_m, drive.truth
    told = np.stack([np.interp(truth.t_ns, t, column) for column in z.T[:2]], -1)
    return float(np.sqrt(((told - truth.p_world_m[:, :2]) ** 2).sum(-1).mean()))


def time_command() -> None:
    """Print how long the whole command takes against the drive's 470 s."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "fgloc", "smooth", "kitti", "--no-report", "--out", folder]
        began, before = time.perf_counter(), os.times()
        subprocess.run(command, check=True, capture_output=True)
        wall_s, after = time.perf_counter() - began, os.times()
    cpu_s = sum(after[2:4]) - sum(before[2:4])
    fixes = fgloc.load("kitti").gnss.t_ns
    drive_s = float(fixes[-1] - fixes[0]) / 1e9
    print(f"whole command: {wall_s:.1f} s ({drive_s / wall_s:.0f} times real time), "
          f"{cpu_s:.1f} s of the processor ({drive_s / cpu_s:.0f} times)")  # fmt: skip


def main() -> None:
    """Print the table."""
    drive = fgloc.load("kitti")
    print("| withheld | `graph-batch` | second half | asked | straight line |")
    print("|---|---|---|---|---|")
    for (name, how), asked_m in zip(CASES.items(), ASKED_M, strict=True):
        worse = degrade(drive, **how)
        found = fgloc.smooth(worse).trajectory
        own = (rmse_m(found, worse, from_s) for from_s in (0.0, HALF_S))
        cells = [f"{value:.2f}" for value in (*own, asked_m, line_m(worse))]
        print(f"| {name} | {' | '.join(cells)} |", flush=True)
    time_command()


if __name__ == "__main__":
    main()
