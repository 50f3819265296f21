# ruff: noqa: T201
"""An hour of fixed lag: fgloc's `Online` against the bare loop, time per keyframe and memory.

    python tests/benchmarks/lag_hour.py [--duration 3600] [--runs 1] [--factorization QR]

The drive is `city`, seed 0 (IMU 100 Hz, GPS 10 Hz). Each run is a process of its own, fgloc and
bare in turn. A step is everything done for one keyframe, preintegration included. The bare loop is
told the heading at the start (see bare_lag.py); fgloc has to find it. By Cholesky the bare loop
fails at the second keyframe of this drive, so both use QR.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
LAG_S = 5.0


def main() -> None:
    """Make the drive, run both in turn, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--duration", type=float, default=3600.0, help="s")
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument("--factorization", choices=["CHOLESKY", "QR"], default="QR",
                        help="of both")  # fmt: skip
    parser.add_argument("--fgloc", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.fgloc:
        print(json.dumps(run_fgloc(args.fgloc, args.factorization)))
        return
    with tempfile.TemporaryDirectory() as temp:
        folder = make_drive(Path(temp), args.duration)
        option = ["--factorization", args.factorization]
        commands = {
            "fgloc": [HERE / "lag_hour.py", "--fgloc", folder, *option],
            "bare": [HERE / "bare_lag.py", folder, "--lag", str(LAG_S), "--loss", "huber", *option],
        }
        for number in range(args.runs):
            print(f"run {number + 1}: {args.duration:g} s, {args.factorization}")
            print_table(*(run_script(command) for command in commands.values()))


def make_drive(folder: Path, duration_s: float) -> Path:
    """The simulated drive as a folder."""
    from fgloc.datasets import make
    from fgloc.datasets.drive_folder import write_drive

    write_drive(make("city", seed=0, duration_s=duration_s), folder / "city")
    return folder / "city"


def run_script(command: list) -> dict:
    """The JSON that a script prints."""
    done = subprocess.run([sys.executable, *map(str, command)], capture_output=True, text=True)
    if done.returncode:
        sys.exit(done.stderr)
    return json.loads(done.stdout)


def run_fgloc(folder: Path, factorization: str) -> dict:
    """fgloc on a folder in this process, every step timed."""
    from bare_lag import rss_mb, step_figures

    from fgloc.config import load_config
    from fgloc.datasets import open_drive
    from fgloc.evaluation import errors
    from fgloc.smoother import smooth
    from fgloc.smoother.online import Online

    drive = open_drive(folder)
    step, times, rss = Online._step, [], []

    def timed_step(self: Online, j: int, fixes: list[int]) -> None:
        began = time.perf_counter()
        step(self, j, fixes)
        times.append(time.perf_counter() - began)
        if j % 50 == 0:
            rss.append((j, rss_mb()))

    Online._step = timed_step
    settings = [f"solver.factorization={factorization.lower()}"]
    result = smooth(drive, load_config(mode="fixed-lag", lag_s=LAG_S, settings=settings))
    figures = step_figures(np.array(times), rss)
    scored = errors(result.trajectory, drive.truth, score_from_ns=drive.start_ns + 75 * 10**9)
    rmse = float(np.sqrt((scored.p_world_m[:, :2] ** 2).sum(-1).mean()))
    events = [event.kind for event in result.events]
    counts = {kind: events.count(kind) for kind in sorted(set(events))}
    return {"horizontal_rmse_m": rmse, **figures, "events": counts}


def print_table(fgloc: dict, bare: dict) -> None:
    """Each figure of both, and their ratio."""
    print(f"{'':18} {'fgloc':>10} {'bare':>10} {'ratio':>7}")
    for name, theirs in bare.items():
        ours = fgloc[name]
        print(f"{name:18} {ours:10.3f} {theirs:10.3f} {ours / theirs:7.2f}")
    for who, run in (("fgloc", fgloc), ("bare", bare)):
        growth = run["rss_last_mb"] - run["rss_first_mb"]
        slower = run["median_last_ms"] / run["median_first_ms"]
        print(f"{who}: last tenth to first: median step x{slower:.2f}, memory {growth:+.1f} MB")
    print(f"fgloc's events: {fgloc['events'] or 'none'}\n")


if __name__ == "__main__":
    main()
