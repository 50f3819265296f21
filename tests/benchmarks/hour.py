# ruff: noqa: T201
"""Whole processes of `fgloc smooth` and of bare_batch.py on simulated drives of some lengths.

    python tests/benchmarks/hour.py [--minutes 5 60 480] [--bare-up-to 60] [--runs 1]

The drive is `city`, seed 0: IMU at 100 Hz, GPS at 10 Hz, and at 10 Hz what one roadside node sees
of the car, with white errors. It is read from CSV and written as CSV, TUM and GeoJSON. Both read
the same folder, in turn, and solve the same problem: the bare script takes the robust loss that
fgloc has by default, and a column says how far apart the two costs are. It gets no drive longer
than `--bare-up-to`, and gives no verdicts, scores or intervals. Another run of fgloc tells in which
stage the time by the clock goes: `rest` is imports and what has no name. Peak memory is what the
system reports of the process. A run of fgloc before the others is not counted: after it Python's
compiled code is there and, on a virtual machine, the memory that its host had taken back. The first
of some processes waits for that, fgloc's hour for up to a second and a half.
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
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from fgloc.infrastructure import Node
    from fgloc.measurements import NodeDetections
    from fgloc.trajectory import Trajectory

HERE = Path(__file__).parent
FGLOC = sys.executable, "-m", "fgloc"
NODE_M, RANGE_M, SIGMA_M = (200.0, -300.0, 8.0), 1e6, 0.3
"""One node that sees the whole drive: what it costs is the rows, not where they are from."""
BOX_M = (1.4, 0.0, 0.8)
STAGES = {
    "read": ("fgloc.api", "prepare"),
    "plan": ("fgloc.smoother", "_model"),
    "preintegrate": ("fgloc.smoother.model", "Model.deltas"),
    "solve": ("fgloc.smoother.chain", "Chain.optimum"),
    "covariances": ("fgloc.smoother.chain", "Chain.covariances"),
    "score, write": ("fgloc.outputs", "write_result"),
}
"""Each stage's function; what another stage spends inside it is not counted twice."""


def main() -> None:
    """Make each drive, run both on it, print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, nargs="+", default=[5, 60, 480])
    parser.add_argument("--bare-up-to", type=float, default=60, metavar="MINUTES")
    parser.add_argument("--runs", type=int, default=1, help="pairs of each length")
    parser.add_argument("--made", nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--profiled", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.made:
        sys.exit(made(Path(args.made[0]), float(args.made[1])))
    if args.profiled:
        sys.exit(profiled(Path(args.profiled[0]), args.profiled[1:]))
    print(f"{'min':>5} {'fgloc s':>8} {'cpu s':>7} {'MB':>6} {'bare s':>8} {'cpu s':>7}", end=" ")
    print(f"{'MB':>6} {'ratio':>6} {'of cpu':>6} {'costs':>10}   ", end="")
    print(*(f"{name:>12}" for name in (*STAGES, "rest")))
    for minutes in args.minutes:
        with tempfile.TemporaryDirectory() as temp:
            make_drive(Path(temp) / "city", minutes)
            run([*FGLOC, *smoothing(Path(temp))])  # not counted
            for _ in range(args.runs):
                print_run(minutes, Path(temp), with_bare=minutes <= args.bare_up_to)


def make_drive(folder: Path, minutes: float) -> None:
    """The simulated drive, by a process of its own: this one's memory would count in all others."""
    run([sys.executable, __file__, "--made", folder, minutes])


def made(folder: Path, minutes: float) -> None:
    """Write the drive: `city` without its wheel speed, and seen by a node at each fix."""
    from fgloc import api
    from fgloc.datasets.drive_folder import write_drive
    from fgloc.infrastructure import Infrastructure, Node

    drive = api.make("city", seed=0, duration_s=60 * minutes)
    node = Node("pole", NODE_M, 0.4, range_m=RANGE_M)
    tables = {name: drive.tables[name] for name in ("gnss", "imu")}
    seen = seen_by(node, drive.truth.take(np.isin(drive.truth.t_ns, drive.gnss.t_ns)))
    rig = replace(drive.rig, p_veh_box_m=np.array(BOX_M))
    drive = replace(drive, rig=rig, infrastructure=Infrastructure((node,)))
    write_drive(replace(drive, tables=tables | {"detections": seen}), folder)


def seen_by(node: "Node", truth: "Trajectory") -> "NodeDetections":
    """The centre of the car's box at every state of the truth, under one number."""
    from fgloc.measurements import VEHICLE, NodeDetections

    n, rng = len(truth), np.random.default_rng(0)
    place = (truth.p_world_m + truth.R_world_veh @ BOX_M)[:, :2]
    number, cov_m2 = np.full(n, 7), np.tile(SIGMA_M**2 * np.eye(2), (n, 1, 1))
    return NodeDetections(
        truth.t_ns, truth.t_ns, np.zeros(n, int), number, np.full(n, VEHICLE),
        node.from_world(place + SIGMA_M * rng.standard_normal((n, 2))), cov_m2,
    )  # fmt: skip


def print_run(minutes: float, temp: Path, *, with_bare: bool) -> None:
    """Run fgloc, and the bare script if wanted, and print a line."""
    stages, smooth = temp / "stages.json", smoothing(temp)
    ours = run([*FGLOC, *smooth])
    again = run([sys.executable, __file__, "--profiled", stages, *smooth])
    told = json.loads(stages.read_text())
    bare = " " * 48
    if with_bare:
        command = [sys.executable, HERE / "bare_batch.py", temp / "city", "--loss", "huber"]
        theirs = run([*command, "--out", temp / "bare.csv"])
        ratios = f"{ours.wall_s / theirs.wall_s:6.3f} {ours.cpu_s / theirs.cpu_s:6.3f}"
        apart = json.loads(ours.text)["cost"] / json.loads(theirs.text)["cost"] - 1
        bare = f"{theirs} {ratios} {apart:10.1e}"
    spent = [*(told.get(name, 0.0) for name in STAGES), again.wall_s - sum(told.values())]
    print(f"{minutes:5g} {ours} {bare}   ", end="")
    print(*(f"{seconds:12.2f}" for seconds in spent), flush=True)


def smoothing(temp: Path) -> list:
    """The arguments with which fgloc smooths the drive in a folder."""
    return ["smooth", temp / "city", "--no-report", "--json", "--out", temp / "result"]


class Run(NamedTuple):
    """What a process took, and what it wrote on its standard output."""

    wall_s: float
    cpu_s: float
    peak_mb: float
    text: str

    def __str__(self) -> str:
        return f"{self.wall_s:8.2f} {self.cpu_s:7.2f} {self.peak_mb:6.0f}"


def run(command: list) -> Run:
    """Run a process to its end; leave with what it complains of if it fails."""
    began = time.perf_counter()
    with tempfile.TemporaryFile() as errors, tempfile.TemporaryFile() as output:
        process = subprocess.Popen(
            list(map(str, command)), stdout=output, stderr=errors,
            env={k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"},
        )  # fmt: skip
        _, status, usage = os.wait4(process.pid, 0)
        wall_s = time.perf_counter() - began
        process.returncode = os.waitstatus_to_exitcode(status)
        errors.seek(0)
        output.seek(0)
        if process.returncode:
            sys.exit(errors.read().decode())
        text = output.read().decode()
    peak_mb = usage.ru_maxrss / (1024**2 if sys.platform == "darwin" else 1024)
    return Run(wall_s, usage.ru_utime + usage.ru_stime, peak_mb, text)


def profiled(stages: Path, arguments: list[str]) -> int:
    """The command line in this process; the time of each stage goes to a file."""
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
