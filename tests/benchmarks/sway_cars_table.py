# ruff: noqa: T201
"""Prints what sway of a node does to a car's position, and how much each way removes of it.

    python tests/benchmarks/sway_cars_table.py [SEEDS] [--causal]

`khamooshi2023/sway-drive` through `fgloc.smooth`, whole drive and within 5 m of 20, 40 and 60 m
from the node; fixes of 1 m at 10 Hz with the node's detections alone (a velocity that stays about
the same), and with the IMU. Root mean squares over the seeds; the share is (ignored - way) /
(ignored - no sway) of these. `--causal` takes the mode fixed-lag. Last, what following the post
costs; `--cost` prints that alone.
"""

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from sway_cars import LEFT, SCENARIO, drives, removed_share, ways

import fgloc

MOTIONS = {"GPS and detections": "constant-velocity", "with the IMU": "imu"}


def table(sensor: str, seeds: int, settings: list[str]) -> None:
    """All ways with one sensor."""
    runs = {motion: [] for motion in MOTIONS}
    for seed in range(seeds):
        of = drives(seed, sensor)
        for motion, kind in MOTIONS.items():
            runs[motion].append(ways(of, [f"motion.kind={kind}", *settings]))
    for motion, each in runs.items():
        found = {name: np.sqrt(np.mean([run[name] ** 2 for run in each], 0)) for name in each[0]}
        print(f"\n{sensor}, {motion}, {seeds} seeds: RMSE in m, then the share removed")
        print(f"{'':36}" + "".join(f"{at:>8}" for at in 2 * ("all", "20 m", "40 m", "60 m")))
        for name, rmse in found.items():
            share = removed_share(found, name)
            print(f"{name:36}" + "".join(f"{x:8.3f}" for x in (*rmse, *share)), flush=True)


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
    words = [word for word in sys.argv[1:] if not word.startswith("-")]
    causal = ["mode=fixed-lag"] if "--causal" in sys.argv else []
    for kind in () if "--cost" in sys.argv else ("camera", "lidar"):
        table(kind, int(words[0]) if words else 20, causal)
    cost()
