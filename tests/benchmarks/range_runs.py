# ruff: noqa: T201
"""The range graph on real ranges: 2-D RMSE in m beside what the authors reached.

    python tests/benchmarks/range_runs.py ../shared/data/outdoor_uwb

Each run of the UWB-dataset is scored in its authors' window; theirs are least squares and an
error-state filter that also had an IMU. Plaza 1 and 2 come from the gtsam wheel. One set of
settings for all, tuned on none; no truth is used.
"""

import argparse
import re
from pathlib import Path

import numpy as np

from fgloc.datasets.registry import import_recording
from fgloc.smoother.ranges import smooth_ranges

LAG_S = 10.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    print("run                        batch  10 s lag  least squares  ESKF  scale of the ranges")
    for run in ("1", "2"):
        line(f"Plaza{run}", import_recording("plaza", run), {})
    for path in sorted(parser.parse_args().folder.glob("*/*/Case_*")):
        line("/".join(path.parts[-3:]), import_recording("outdoor-uwb", path), published(path))


def line(name, drive, others) -> None:
    runs = [smooth_ranges(drive, lag_s) for lag_s in (None, LAG_S)]
    batch, lag = (rmse_m(drive, run) for run in runs)
    theirs = "  ".join(f"{others[k]:.3f}" if k in others else "    -" for k in ("LS", "ESKF"))
    scale = runs[0].summary["ranges"]["scale"]
    print(f"{name:25s}  {batch:.3f}  {lag:8.3f}  {theirs}  {scale:.4f}", flush=True)


def published(path) -> dict[str, float]:
    text = (path / "RMSD_results.txt").read_text()
    return {k: float(v) for k, v in re.findall(r"(\w+) RMSE_2d: ([0-9.]+)", text)}


def rmse_m(drive, result) -> float:
    told, t_ns = result.trajectory, drive.truth.t_ns
    inside = (t_ns >= told.t_ns[0]) & (t_ns <= told.t_ns[-1])
    off = told.at(t_ns[inside]).p_world_m[:, :2] - drive.truth.p_world_m[inside, :2]
    return float(np.sqrt((off**2).sum(1).mean()))


if __name__ == "__main__":
    main()
