# ruff: noqa: T201
"""Prints what sway of a node does to a car's position, and how much each way removes of it.

    python tests/benchmarks/sway_cars_table.py [SEEDS] [--causal] [--only KIND] [--level] [--cost]

`khamooshi2023/sway-drive` through `fgloc.smooth`, whole drive and within 5 m of 20, 40 and 60 m
from the node; fixes of 1 m at 10 Hz with the node's detections alone (a velocity that stays about
the same), and with the IMU. Root mean squares over the seeds; the share is (ignored - way) /
(ignored - no sway) of these. Kinds are a camera, a LiDAR that tells heights, and `flat`, one that
does not; below each table stands how well the graph without poses knows the post. `--causal` takes
the mode fixed-lag. Last, what following the post costs; `--cost` prints that alone. `--level` is of
a LiDAR that is not level, with two RTK cars and no poses.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from sway_cars import LEFT, SCENARIO, askew, drives, post_rmse, removed_share, rmse_m, ways

import fgloc

KINDS = {"camera": "a camera", "lidar": "a LiDAR", "flat": "a LiDAR without heights"}
MOTIONS = {"GPS and detections": "constant-velocity", "with the IMU": "imu"}


def table(what: str, seeds: int, settings: list[str]) -> None:
    """All ways with one kind of node."""
    sensor = "camera" if what == "camera" else "lidar"
    runs, posts = {motion: [] for motion in MOTIONS}, {motion: [] for motion in MOTIONS}
    for seed in range(seeds):
        of = drives(seed, sensor, heights=what != "flat")
        for motion, kind in MOTIONS.items():
            own = [f"motion.kind={kind}", *settings]
            runs[motion].append(ways(of, own))
            posts[motion].append([post_rmse(of[name], *own) for name in ("bare", "users")])
    for motion, each in runs.items():
        found = {name: np.sqrt(np.mean([run[name] ** 2 for run in each], 0)) for name in each[0]}
        print(f"\n{KINDS[what]}, {motion}, {seeds} seeds: RMSE in m, then the share removed")
        print(f"{'':36}" + "".join(f"{at:>8}" for at in 2 * ("all", "20 m", "40 m", "60 m")))
        for name, rmse in found.items():
            share = removed_share(found, name)
            print(f"{name:36}" + "".join(f"{x:8.4f}" for x in (*rmse, *share)), flush=True)
        for name, (mm, mrad) in zip(
            ("alone", "with two RTK cars"), np.sqrt(np.mean(np.square(posts[motion]), 0)),
            strict=True,
        ):  # fmt: skip
            print(f"the post without poses, {name}: {mm:.1f} mm, {mrad:.2f} mrad", flush=True)


def level(seeds: int) -> None:
    """A LiDAR's tilt as built in, taken for none and as an unknown."""
    for motion, kind in MOTIONS.items():
        for tilt_rad, sigma_rad in ((0, 0), (0.001, 0), (0.004, 0), (0, 0.005), (0.004, 0.005)):
            squares = []
            for seed in range(seeds):
                drive = fgloc.make(SCENARIO, seed=seed, sensor="lidar", poses=False, users=2)
                leans = askew(drive, tilt_rad, sigma_rad)
                squares.append(rmse_m(leans, f"motion.kind={kind}")[0] ** 2)
            told = f"{1e3 * tilt_rad:g} mrad, said to be level to {1e3 * sigma_rad:g} mrad"
            print(f"{motion}, {told}: {np.sqrt(np.mean(squares)):.4f} m", flush=True)


def cost(rounds: int = 2) -> None:
    """Least processor time per keyframe, with the post's states and factors and without."""
    drive = fgloc.make(SCENARIO, seed=0, duration_s=40.0)
    for mode in ("batch", "fixed-lag", "incremental"):
        least = []
        for settings in ((LEFT,), ()):
            took = []
            for _ in range(rounds):
                began = time.process_time()
                states = fgloc.smooth(drive, mode=mode, settings=settings).summary["states"]
                took.append(1e3 * (time.process_time() - began) / states)
            least.append(min(took))
        alone, both = least
        print(f"{mode}: {alone:.2f} ms a keyframe with the car alone, {both:.2f} with the post")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("seeds", type=int, nargs="?", default=20)
    parser.add_argument("--causal", action="store_true")
    parser.add_argument("--only", choices=KINDS)
    parser.add_argument("--cost", action="store_true")
    parser.add_argument("--level", action="store_true")
    asked = parser.parse_args()
    if asked.level:
        sys.exit(level(asked.seeds))
    for kind in () if asked.cost else [asked.only] if asked.only else KINDS:
        table(kind, asked.seeds, ["mode=fixed-lag"] if asked.causal else [])
    cost()
