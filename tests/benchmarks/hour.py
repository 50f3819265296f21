# ruff: noqa: T201
"""Whole processes of `fgloc smooth` and of bare_batch.py on simulated drives of some lengths.

    python tests/benchmarks/hour.py [--minutes 5 60 480] [--bare-up-to 60] [--runs 1]

The drive is `city`, seed 0 (IMU 100 Hz, GPS 10 Hz), read from CSV and written as CSV, TUM and
GeoJSON. Both read the same folder, in turn; the bare script gets no drive longer than
`--bare-up-to`. Of fgloc the table says in what stage the time goes: `rest` is imports and what has
no name. Peak memory is what the system reports of the process.
"""

import argparse
import functools
import importlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

HERE = Path(__file__).parent
STAGES = {
    "read": ("fgloc.api", "prepare"),
    "plan": ("fgloc.smoother", "_model"),
    "preintegrate": ("fgloc.smoother.model", "Model.deltas"),
    "solve": ("fgloc.smoother.chain", "Chain.optimum"),
    "covariances": ("fgloc.smoother.chain", "Chain.covariances"),
    "score": ("fgloc.outputs", "judge"),
    "write": ("fgloc.outputs", "write_result"),
}
"""Each stage's function; what another stage spends inside it is not counted twice."""


def main() -> None:
    """Make each drive, run both on it, print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, nargs="+", default=[5, 60, 480])
    parser.add_argument("--bare-up-to", type=float, default=60, metavar="MINUTES")
    parser.add_argument("--runs", type=int, default=1, help="pairs of each length")
    parser.add_argument("--profiled", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.profiled:
        sys.exit(profiled(Path(args.profiled[0]), args.profiled[1:]))
    print(f"{'min':>5} {'fgloc s':>8} {'cpu s':>7} {'MB':>6}", end=" ")
    print(f"{'bare s':>8} {'cpu s':>7} {'MB':>6} {'ratio':>6}   ", end="")
    print(*(f"{name:>12}" for name in (*STAGES, "rest")))
    for minutes in args.minutes:
        with tempfile.TemporaryDirectory() as temp:
            make_drive(Path(temp) / "city", minutes)
            for _ in range(args.runs):
                print_run(minutes, Path(temp), with_bare=minutes <= args.bare_up_to)


def make_drive(folder: Path, minutes: float) -> None:
    """The simulated drive, by a process of its own: this one's memory would count in all others."""
    arguments = ["city", "--seed", "0", "--set", f"duration_s={60 * minutes:g}", "--out", folder]
    run([sys.executable, "-m", "fgloc", "make", *arguments])


def print_run(minutes: float, temp: Path, *, with_bare: bool) -> None:
    """Run fgloc, and the bare script if wanted, and print a line."""
    stages, out = temp / "stages.json", temp / "result"
    smooth = ["smooth", temp / "city", "--no-report", "--json", "--out", out]
    wall_s, cpu_s, peak_mb = run([sys.executable, __file__, "--profiled", stages, *smooth])
    told = json.loads(stages.read_text())
    bare = " " * 30
    if with_bare:
        command = [sys.executable, HERE / "bare_batch.py", temp / "city"]
        bare_s, bare_cpu_s, bare_mb = run([*command, "--out", temp / "bare.csv"])
        bare = f"{bare_s:8.2f} {bare_cpu_s:7.2f} {bare_mb:6.0f} {wall_s / bare_s:6.3f}"
    spent = [*(told.get(name, 0.0) for name in STAGES), wall_s - sum(told.values())]
    print(f"{minutes:5g} {wall_s:8.2f} {cpu_s:7.2f} {peak_mb:6.0f} {bare}   ", end="")
    print(*(f"{seconds:12.2f}" for seconds in spent), flush=True)


def run(command: list) -> tuple[float, float, float]:
    """Wall time in s, processor time in s and peak memory in MB of a process."""
    began = time.perf_counter()
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(
            list(map(str, command)), stdout=subprocess.DEVNULL, stderr=errors
        )
        _, status, usage = os.wait4(process.pid, 0)
        wall_s = time.perf_counter() - began
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            errors.seek(0)
            sys.exit(errors.read().decode())
    cpu_s = usage.ru_utime + usage.ru_stime
    return wall_s, cpu_s, usage.ru_maxrss / (1024**2 if sys.platform == "darwin" else 1024)


def profiled(stages: Path, arguments: list[str]) -> int:
    """The command line in this process; seconds of each stage go to a file."""
    from fgloc.cli import main as command_line

    spent: Counter = Counter()
    inside = [0.0]  # of each call that is under way, what stages within it have taken
    for stage, (module, name) in STAGES.items():
        watch(importlib.import_module(module), name, stage, spent, inside)
    status = command_line(arguments)
    stages.write_text(json.dumps(spent))
    return status


def watch(owner: object, name: str, stage: str, spent: Counter, inside: list[float]) -> None:
    """Put a function in a function's place that counts its time."""
    *parents, name = name.split(".")
    owner = functools.reduce(getattr, parents, owner)
    function = getattr(owner, name)

    @functools.wraps(function)
    def timed(*args, **kwargs):
        inside.append(0.0)
        began = time.perf_counter()
        try:
            return function(*args, **kwargs)
        finally:
            took = time.perf_counter() - began
            spent[stage] += took - inside.pop()
            inside[-1] += took

    setattr(owner, name, timed)


if __name__ == "__main__":
    main()
