# ruff: noqa: T201
"""The optimum of the banded solver against GTSAM's on every embedded drive and scenario with a car.

    python tests/benchmarks/chain_optimum.py [NAME ...]

One line for each drive whose graph is a chain: seconds of the processor, and the largest
differences of the cost (share), of positions in m, of rotations in rad and of the covariances of
poses (share). Asked are 1e-6, 1e-4 m and 1e-3. What smoothing leaves out is left out of both. Where
the fixes' slow errors leave the position of the whole drive loose the cost is flat, so the
tolerance is tight.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

import fgloc
from fgloc.config import SmoothConfig
from fgloc.datasets import available
from fgloc.errors import FglocError
from fgloc.positions import DETECTIONS, GNSS
from fgloc.smoother import is_cooperative
from fgloc.sync import plan
from fgloc.verdicts import Verdict

sys.path.insert(0, str(Path(__file__).parents[1]))

from smoother.optima import apart


def main() -> None:
    """Solve each drive twice and print how far apart the two are."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    names = [info.name for info in available() if info.kind in ("real", "scenario")]
    parser.add_argument("names", nargs="*", default=names)
    print(f"{'drive':24} {'s':>6} {'cost':>8} {'p m':>8} {'turn rad':>8} {'cov':>8}")
    for name in parser.parse_args().names:
        began = time.process_time()
        drive = vehicle_chain(name)
        if drive is None:
            continue
        try:
            found = apart(drive, left_out(drive), solver={"cost_tolerance": 1e-9})
        except FglocError as err:
            print(f"{name:24} {err}", flush=True)
            continue
        shown = (found.cost, found.p_m, found.turn_rad, found.cov)
        text = " ".join(f"{value:8.1e}" for value in shown)
        print(f"{name:24} {time.process_time() - began:6.1f} {text}", flush=True)


def left_out(drive: fgloc.Drive) -> np.ndarray:
    """Numbers of the positions that smoothing gates: other cars, and what does not fit."""
    verdicts = fgloc.smooth(drive).verdicts
    positions = plan(drive, SmoothConfig()).positions
    kept = {
        table: verdicts[table].is_(Verdict.USED, Verdict.DOWN_WEIGHTED)
        for table in (GNSS, DETECTIONS)
        if table in verdicts
    }
    tables = np.where(positions.candidates, DETECTIONS, GNSS).tolist()
    used = [kept[table][row] for table, row in zip(tables, positions.row.tolist(), strict=True)]
    return np.flatnonzero(~np.array(used))


def vehicle_chain(name: str) -> fgloc.Drive | None:
    """The drive of a name; None if no car's chain is in it."""
    drive = fgloc.load(name)
    if not drive.has_vehicle or is_cooperative(drive) or "gnss" not in drive.tables:
        return None
    return drive


if __name__ == "__main__":
    main()
