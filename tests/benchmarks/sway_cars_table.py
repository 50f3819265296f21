# ruff: noqa: T201
"""Prints what sway of a node does to a car's position, and how much each way removes of it.

    python tests/benchmarks/sway_cars_table.py [SEEDS]

`khamooshi2023/sway-drive`, whole drive and within 5 m of 20, 40 and 60 m from the node; fixes of
1 m. Root mean squares over the seeds; the share is (ignored - way) / (ignored - no sway) of these.
"""

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from sway_cars import ROUNDS, ego, estimate, five_ways, removed_share

import fgloc


def table(sensor: str, seeds: int) -> None:
    """All ways with one sensor."""
    runs = [five_ways(seed, sensor) for seed in range(seeds)]
    ways = {name: np.sqrt(np.mean([run[name] ** 2 for run in runs], 0)) for name in runs[0]}
    print(f"\n{sensor}, {seeds} seeds: RMSE in m, then the share removed")
    print(f"{'':32}" + "".join(f"{at:>8}" for at in 2 * ("all", "20 m", "40 m", "60 m")))
    for name, rmse in ways.items():
        share = removed_share(ways, name)
        print(f"{name:32}" + "".join(f"{x:8.3f}" for x in (*rmse, *share)), flush=True)


def cost(rounds: int = 5) -> None:
    """Time a detection that the post's states and factors add, built and solved in a batch."""
    drive = fgloc.make("khamooshi2023/sway-drive", seed=0)
    car, took = ego(drive), {}
    for joint in (False, True):
        began = time.perf_counter()
        for _ in range(rounds):
            estimate(drive, [car], None, joint=joint)
        took[joint] = (time.perf_counter() - began) / rounds / len(car.seen)
    each = took[True] / ROUNDS
    print(f"\ncar alone {1e6 * took[False]:.0f} us a detection, with the post {1e6 * each:.0f} us")


if __name__ == "__main__":
    for kind in ("camera", "lidar"):
        table(kind, int(sys.argv[1]) if len(sys.argv) > 1 else 20)
    cost()
