# ruff: noqa: T201
"""Accuracy over noise seeds: fgloc and bare GTSAM on the same noisy fixes, batch and fixed lag.

    python tests/benchmarks/noise_seeds.py [--seeds 20]

The drive is `mems-rtk` with white noise of 1, 1, 2 m on its fixes (case D), seeds 0 to 19. Prints
the horizontal RMSE in m of the antenna over all instants of truth from 75 s on.
"""

import argparse
import functools
import multiprocessing
import tempfile
from pathlib import Path

import bare_batch as bare
import bare_lag
import numpy as np

from fgloc.config import load_config
from fgloc.datasets import open_drive
from fgloc.datasets.degrade import degrade
from fgloc.datasets.drive_folder import write_drive
from fgloc.drive import Drive
from fgloc.evaluation import errors
from fgloc.smoother import smooth

NOISE_ENU_M = (1.0, 1.0, 2.0)
LAG_S = 5.0
COLUMNS = ("fgloc batch", "bare batch", "fgloc lag", "bare lag")


def main() -> None:
    """Run all seeds on two processes and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--loss", choices=["none", "huber"], default="none", help="of bare GTSAM")
    args = parser.parse_args()
    job = functools.partial(rmse_of_seed, loss=args.loss)
    print("seed " + " ".join(f"{name:>12}" for name in COLUMNS))
    rows = []
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        for seed, row in enumerate(pool.imap(job, range(args.seeds))):
            rows.append(row)
            print(f"{seed:4} " + " ".join(f"{value:12.4f}" for value in row), flush=True)
    mean = np.mean(rows, axis=0)
    print("mean " + " ".join(f"{value:12.4f}" for value in mean))
    batch, lag = mean[0] / mean[1], mean[2] / mean[3]
    print(f"ratio of means, fgloc / bare: batch {batch:.4f}, lag {lag:.4f}")


def rmse_of_seed(seed: int, loss: str) -> tuple[float, ...]:
    """RMSE in m of each column of the table."""
    drive = degrade(open_drive("mems-rtk"), noise_enu_m=NOISE_ENU_M, seed=seed)
    with tempfile.TemporaryDirectory() as temp:
        write_drive(drive, Path(temp) / "drive")
        rec = bare.read_recording(Path(temp) / "drive")
    line = bare.timeline(rec)
    batch, _ = bare.trajectory(line, bare.solve(rec, line, loss))
    lag = bare_lag.run(rec, line, LAG_S, loss).poses
    return (
        fgloc_rmse_m(drive, "batch"), bare.horizontal_rmse_m(rec, line.t_s, batch),
        fgloc_rmse_m(drive, "fixed-lag"), bare.horizontal_rmse_m(rec, line.t_s, lag),
    )  # fmt: skip


def fgloc_rmse_m(drive: Drive, mode: str) -> float:
    """RMSE in m of fgloc with its defaults."""
    estimate = smooth(drive, load_config(mode=mode, lag_s=LAG_S)).trajectory
    from_ns = int(drive.gnss.t_ns[0] + bare.SCORE_FROM_S * 1e9)
    scored = errors(estimate, drive.truth, score_from_ns=from_ns)
    return float(np.sqrt((scored.p_world_m[:, :2] ** 2).sum(-1).mean()))


if __name__ == "__main__":
    main()
