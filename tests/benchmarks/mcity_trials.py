# ruff: noqa: T201
"""The documented EKF and the graph on real detections of the Mcity node.

    python tests/benchmarks/mcity_trials.py SOURCE [--seeds 20]

Trials 2, 3 and 13 with the importer's fixed defaults; GPS and odometry are simulated from the RTK,
anew with each seed. Latency, box offset and noise of the node were measured on trial 2 and are used
on all. Prints the means over the seeds: horizontal RMSE in m over the whole trial and where the
node saw the car (where `raw:detections` has a state within 0.1 s), its ratio to `lee2021-ekf`, and
how many detections were taken that are more than 3 m from the car's RTK, of all that were taken.
The graph also with half and double the slow error of the GPS that the importer states.
"""

import argparse
from collections.abc import Callable

import numpy as np

import fgloc
import fgloc.evaluation
from fgloc.config import load_config
from fgloc.datasets import import_recording
from fgloc.drive import Drive
from fgloc.positions import world_positions
from fgloc.result import Result
from fgloc.verdicts import Verdict

TRIALS = ((2, 0), (3, 0), (13, 0))
WRONG_M = 3.0
NEAR_NS = 100_000_000


def main() -> None:
    """Print a table for each trial."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("source")
    parser.add_argument("--seeds", type=int, default=20)
    asked = parser.parse_args()
    for trial, vehicle in TRIALS:
        drives = [
            import_recording("mcity-roadside", asked.source, trial=trial, vehicle=vehicle,
                             odometry=True, seed=seed)
            for seed in range(asked.seeds)
        ]  # fmt: skip
        print(f"trial {trial}, vehicle {vehicle}, {asked.seeds} seeds")
        table(drives)


def table(drives: list[Drive]) -> None:
    """Every method on the drives of one trial."""
    seen = [fgloc.baseline(drive, "raw:detections").trajectory.t_ns for drive in drives]
    first = None
    for name, method in methods().items():
        pairs = zip(drives, seen, strict=True)
        rows = np.array([score(method(drive), drive, t_ns) for drive, t_ns in pairs])
        whole, near = rows[:, :2].mean(0)
        first = first or whole
        taken, wrong = rows[:, 2:].sum(0)
        told = f"   {wrong:.0f} of {taken:.0f} detections wrong" if taken else ""
        ratio = whole / first
        print(f"  {name:28} whole {whole:6.3f}   where seen {near:6.3f}   ratio {ratio:5.2f}{told}",
              flush=True)  # fmt: skip


def methods() -> dict[str, Callable[[Drive], Result]]:
    """Methods by name, the documented filter first."""
    named = ("lee2021-ekf", "raw:gnss", "raw:detections")
    plain: dict[str, Callable[[Drive], Result]] = {
        name: (lambda drive, name=name: fgloc.baseline(drive, name)) for name in named
    }
    graphs = {"graph-batch": ("batch", 1.0), "graph-lag": ("fixed-lag", 1.0),
              "graph-batch, half the bias": ("batch", 0.5),
              "graph-batch, double the bias": ("batch", 2.0)}  # fmt: skip
    return plain | {
        name: (lambda drive, mode=mode, factor=factor: graph(drive, mode, factor))
        for name, (mode, factor) in graphs.items()
    }


def graph(drive: Drive, mode: str, factor: float) -> Result:
    """The graph with a multiple of the slow error that the drive states of its fixes."""
    bias = {"bias_sigma_m": factor * drive.rig.gnss_bias.sigma_m}
    return fgloc.smooth(drive, config=load_config(mode=mode, gnss=bias))


def score(result: Result, drive: Drive, seen_ns: np.ndarray) -> tuple[float, float, float, float]:
    """RMSE in m, whole and where seen; detections taken, and how many are not the car's."""
    found = fgloc.evaluation.errors(result.trajectory, drive.truth)
    next_to = np.searchsorted(seen_ns, found.t_ns).clip(1, len(seen_ns) - 1)
    apart_ns = np.minimum(*(np.abs(found.t_ns - seen_ns[next_to - k]) for k in (0, 1)))
    square, near = found.horizontal_m**2, apart_ns < NEAR_NS
    whole, inside = np.sqrt(square.mean()), np.sqrt(square[near].mean())
    verdicts = result.verdicts.get("detections")
    if verdicts is None or result.method.startswith("raw:gnss"):
        return whole, inside, 0, 0
    taken = verdicts.is_(Verdict.USED, Verdict.DOWN_WEIGHTED)
    seen = drive.tables["detections"]
    at = [np.interp(seen.t_ns[taken], drive.truth.t_ns, x) for x in drive.truth.p_world_m[:, :2].T]
    apart = np.linalg.norm(world_positions(drive, seen)[taken] - np.stack(at, -1), axis=1)
    return whole, inside, int(taken.sum()), int((apart > WRONG_M).sum())


if __name__ == "__main__":
    main()
