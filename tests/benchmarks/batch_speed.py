# ruff: noqa: T201
"""The whole process of `fgloc smooth` in batch mode against the whole process of bare_batch.py.

    python tests/benchmarks/batch_speed.py [--runs 5] [--loss none] [--cases ABCD]

Cases of the drive `mems-rtk`, 1 Hz of RTK in and the rest of the fixes as truth: A as it is; B with
outages of 15 s every 45 s; C of 30 s every 90 s; D with white noise of 1, 1, 2 m, seed 0. Both read
the same folder and write a trajectory; they run in turn. `--loss` is the bare script's.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from fgloc.datasets import open_drive
from fgloc.datasets.degrade import degrade
from fgloc.datasets.drive_folder import write_drive
from fgloc.datasets.trajectory_files import read_trajectory
from fgloc.evaluation import errors

HERE = Path(__file__).parent
CASES = {
    "A": {},
    "B": {"outage": (75.0, 15.0, 45.0)},
    "C": {"outage": (75.0, 30.0, 90.0)},
    "D": {"noise_enu_m": (1.0, 1.0, 2.0), "seed": 0},
}
SCORE_FROM_S = 75.0


def main() -> None:
    """Time every case and print medians and ratios."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--cases", default="ABCD")
    parser.add_argument("--loss", choices=["none", "huber"], default="none")
    args = parser.parse_args()
    print(f"{'case':4} {'fgloc s':>8} {'bare s':>8}   {'ratio, pair by pair':24}"
          f"{'fgloc rmse m':>13} {'bare rmse m':>12}")  # fmt: skip
    with tempfile.TemporaryDirectory() as temp:
        for case in args.cases:
            folder = make_case(case, Path(temp))
            pairs = [time_pair(folder, Path(temp), args.loss) for _ in range(args.runs)]
            print_case(case, pairs)


def make_case(case: str, temp: Path) -> Path:
    """The folder of a case."""
    drive, options = open_drive("mems-rtk"), CASES[case]
    write_drive(degrade(drive, **options) if options else drive, temp / case)
    return temp / case


def time_pair(folder: Path, temp: Path, loss: str) -> tuple[float, float, float, float]:
    """Seconds of fgloc and of the bare script, then the RMSE of each."""
    out = temp / f"out{time.monotonic_ns()}"
    smooth = [sys.executable, "-m", "fgloc", "smooth", folder, "--out", out]
    ours_s, _ = timed([*smooth, "--no-report", "--json"])
    bare = [sys.executable, HERE / "bare_batch.py", folder, "--loss", loss]
    theirs_s, printed = timed([*bare, "--out", out / "bare.csv"])
    return ours_s, theirs_s, rmse_m(folder, out), json.loads(printed)["horizontal_rmse_m"]


def timed(command: list) -> tuple[float, str]:
    """Wall time of a process and what it printed."""
    began = time.perf_counter()
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    wall_s = time.perf_counter() - began
    if done.returncode:
        sys.exit(done.stderr)
    return wall_s, done.stdout


def rmse_m(folder: Path, out: Path) -> float:
    """Horizontal RMSE of the trajectory that fgloc wrote."""
    drive = open_drive(folder)
    estimate = read_trajectory(out / "trajectory.csv")
    from_ns = int(drive.gnss.t_ns[0] + SCORE_FROM_S * 1e9)
    scored = errors(estimate, drive.truth, score_from_ns=from_ns)
    return float(np.sqrt((scored.p_world_m[:, :2] ** 2).sum(-1).mean()))


def print_case(case: str, pairs: list[tuple[float, float, float, float]]) -> None:
    """Medians, the ratio's median and range, and the RMSEs."""
    ours, theirs, our_rmse, their_rmse = np.array(pairs).T
    ratio = ours / theirs
    text = f"{np.median(ratio):.2f} ({ratio.min():.2f} to {ratio.max():.2f})"
    print(f"{case:4} {np.median(ours):8.3f} {np.median(theirs):8.3f}   {text:24}"
          f"{our_rmse[0]:13.4f} {their_rmse[0]:12.4f}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
