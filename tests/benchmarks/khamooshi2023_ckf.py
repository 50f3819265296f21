# ruff: noqa: T201
"""The node's constrained filter in its stages, next to the thesis (x / y RMSE in m of node 1).

    python tests/benchmarks/khamooshi2023_ckf.py [--seeds 100]

And the right turn: one node, the car's GNSS/INS, and both.
"""

import argparse

import numpy as np

from fgloc.baselines import run
from fgloc.baselines.khamooshi2023_ckf import Stages, run_stages
from fgloc.datasets import make

STAGES = {
    "measurements": (Stages("", False, False, "node-1"), "0.33 / 0.29"),
    "motion model": (Stages("velocity", False, False, "node-1"), "0.20 / 0.13"),
    "constraints too": (Stages("velocity", True, True, "node-1"), "0.19 / 0.08"),
    "hard alone": (Stages("velocity", True, False, "node-1"), ""),
    "soft alone": (Stages("velocity", False, True, "node-1"), ""),
    "bicycle, constraints": (Stages("bicycle", True, True, "node-1"), ""),
    "both nodes, constraints": (Stages(), ""),
}
TURN = {
    "node alone": Stages(gnss=False),
    "node and GNSS/INS": Stages(),
    "the same, bicycle": Stages("bicycle"),
}


def main() -> None:
    """Print a line for each stage."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=100)
    seeds = range(parser.parse_args().seeds)
    drives = [make("khamooshi2023/constant-velocity", seed) for seed in seeds]
    print("scenario 1                x / y RMSE      thesis       largest, mean of seeds  ANEES")
    for name, (stages, thesis) in STAGES.items():
        x, y, largest, anees, _ = figures([run_stages(d, stages) for d in drives], drives)
        print(f"{name:25s} {x:.3f} / {y:.3f}   {thesis:12s} {largest:.2f} {anees:24.2f}")
    turns = [make("khamooshi2023/right-turn", seed) for seed in seeds]
    print("right turn                x / y RMSE      deviation of the error")
    print_turn("GNSS alone", figures([run(d, "raw:gnss") for d in turns], turns))
    for name, stages in TURN.items():
        print_turn(name, figures([run_stages(d, stages) for d in turns], turns))


def print_turn(name: str, found: tuple[float, ...]) -> None:
    """A line of the second scenario."""
    print(f"{name:25s} {found[0]:.3f} / {found[1]:.3f}   {found[4]:.3f}")


def figures(results: list, drives: list) -> tuple[float, ...]:
    """RMSE in x and y, mean of the largest errors, ANEES in the plane, deviation of both."""
    errors = [
        (r.trajectory.p_world_m - d.truth.p_world_m)[:, :2]
        for r, d in zip(results, drives, strict=True)
    ]
    nees = [
        np.einsum("ni,nij,nj->n", e, np.linalg.inv(r.trajectory.cov[:, :2, :2]), e).mean() / 2
        for e, r in zip(errors, results, strict=True)
    ]
    x, y = np.sqrt(np.mean([np.mean(e**2, 0) for e in errors], 0))
    largest = np.mean([np.abs(e).max() for e in errors])
    return x, y, largest, float(np.mean(nees)), float(np.concatenate(errors).std())


if __name__ == "__main__":
    main()
