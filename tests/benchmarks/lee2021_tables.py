# ruff: noqa: T201
"""Tables I and III of Lee et al. (2021) against scenario `lee2021/mcity`, raw GPS and node.

    python tests/benchmarks/lee2021_tables.py [--seeds 20]

Prints the mean and standard deviation in m of the absolute errors of each epoch, averaged over
the seeds, and their ratios to the printed ones. Errors of the GPS are those of the antenna, along
and across the true heading; those of the node are of the box's centre. Then the time constant of a
first-order Gauss-Markov process that leaves means over some seconds as spread as the slow errors
do, from which the scenario's stated ones are.
"""

import argparse
from collections.abc import Sequence

import numpy as np
from scipy.optimize import brentq

from fgloc.datasets import lee2021_road as road
from fgloc.datasets import make
from fgloc.datasets.lee2021 import FUSION_HZ, NAME, cases, mcity_node
from fgloc.datasets.lee2021_errors import gps_slow_m, node_slow_m
from fgloc.datasets.lee2021_traffic import CAR_ID, FOLLOWER_ID
from fgloc.drive import Drive
from fgloc.measurements import Array, NodeDetections
from fgloc.timing import elapsed_s

TABLE_I_M = {"longitudinal": (1.17, 0.65), "lateral": (1.20, 1.05), "total": (1.91, 0.82)}
TABLE_III_M = {
    "GPS": ((2.09, 0.78), (2.30, 0.43), (1.15, 0.33)),
    "node": ((1.40, 0.50), (1.62, 0.53), (1.05, 0.59)),
    "fusion": ((1.05, 0.25), (0.89, 0.22), (0.92, 0.49)),
}
"""Mean and standard deviation of what the paper prints."""


def main() -> None:
    """Print both tables and the largest error."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    drives = [make(NAME, seed) for seed in range(parser.parse_args().seeds)]
    whole = np.mean([whole_run_m(drive) for drive in drives], axis=0)
    print("Table I, GPS, whole run      mean   std    ratio mean  std")
    for (name, printed), got in zip(TABLE_I_M.items(), whole, strict=True):
        show(name, got, printed)
    for name, per_case in (("GPS", gps_cases_m), ("node", node_cases_m)):
        rows = np.mean([per_case(drive) for drive in drives], axis=0)
        print(f"Table III, {name}")
        for k, (got, printed) in enumerate(zip(rows, TABLE_III_M[name], strict=True)):
            show(f"case {k + 1}", got, printed)
    print(f"largest error of the GPS: {np.mean([gps_error_m(d)[2].max() for d in drives]):.2f} m")
    gps_m, node_m = slow_errors_m(len(drives))
    print(f"time constant of the GPS: {time_constants(gps_m, (20, 40, 60, 80, 150, 300))}")
    print(f"time constant of the node: {time_constants(node_m, (5, 10, 14))}")


def slow_errors_m(seeds: int) -> tuple[list[Array], list[Array]]:
    """The slow errors of the GPS over whole drives and of the node over passes, one axis each."""
    epochs, node = road.motion().every(road.RATE_HZ // FUSION_HZ), mcity_node()
    t_s = elapsed_s(epochs.t_ns, road.START_NS)
    from_node_m = (epochs.p_world_m - node.p_world_m)[:, :2]
    gps_m, node_m = [], []
    for seed in range(seeds):
        gps_m += list(gps_slow_m(t_s, from_node_m, cases(), "paper", seed)[:, :2].T)
        error_m = node_slow_m(t_s, cases(), "paper", seed)
        for begin_s, end_s in (case.covered_s for case in cases()):
            node_m += list(error_m[(begin_s <= t_s) & (t_s <= end_s)].T)
    return gps_m, node_m


def time_constants(error_m: list[Array], over_s: Sequence[int]) -> str:
    """Of a process whose means over some seconds spread as those of some errors at 10 Hz."""
    sigma_m = np.sqrt(np.mean(np.concatenate(error_m) ** 2))
    told = [f"rms {sigma_m:.2f} m"]
    for span_s in over_s:
        n = FUSION_HZ * span_s
        means = np.concatenate([e[: len(e) // n * n].reshape(-1, n).mean(1) for e in error_m])
        share = float(np.mean(means**2) / sigma_m**2)
        tau_s = brentq(lambda tau_s, a=span_s, b=share: left(a / tau_s) - b, 0.01, 1e4)
        told.append(f"{tau_s:.1f} s by means over {span_s} s")
    return ", ".join(told)


def left(x: float) -> float:
    """The share of the variance that a mean over x time constants leaves."""
    return float(2 / x * (1 - (1 - np.exp(-x)) / x))


def show(name: str, got: Array, printed: tuple[float, float]) -> None:
    """One line: what was got in m, and its ratio to what the paper prints."""
    ratio = np.divide(got, printed)
    print(f"  {name:24} {got[0]:6.2f} {got[1]:6.2f}       {ratio[0]:6.2f} {ratio[1]:6.2f}")


def whole_run_m(drive: Drive) -> Array:
    """(3, 2) mean and std of the GPS's absolute errors: longitudinal, lateral, total."""
    return np.array([(e.mean(), e.std()) for e in gps_error_m(drive)])


def gps_cases_m(drive: Drive) -> Array:
    """(3, 2) mean and std of the GPS's error in each case."""
    return by_case(drive, drive.gnss.t_ns, gps_error_m(drive)[2])


def node_cases_m(drive: Drive) -> Array:
    """(3, 2) mean and std of the error of the node's detections of the car in each case."""
    table = drive.tables["detections"]
    assert isinstance(table, NodeDetections)
    table = table.take((table.object_id >= CAR_ID) & (table.object_id < FOLLOWER_ID))
    truth = drive.truth.at(table.t_ns).at_point(drive.rig.p_veh_box_m)
    seen_m = drive.infrastructure.nodes[0].to_world(table.p_node_m)
    return by_case(drive, table.t_ns, np.hypot(*(seen_m - truth.p_world_m[:, :2]).T))


def gps_error_m(drive: Drive) -> Array:
    """(3, N) absolute errors of the fixes: longitudinal, lateral, total."""
    truth = drive.truth.at(drive.gnss.t_ns).at_point(drive.rig.p_veh_ant_m)
    error_m = (drive.gnss.p_world_ant_m - truth.p_world_m)[:, :2]
    in_car_m = np.einsum("nji,nj->in", truth.attitude()[:, :2, :2], error_m)
    return np.array([*np.abs(in_car_m), np.hypot(*error_m.T)])


def by_case(drive: Drive, t_ns: Array, error_m: Array) -> Array:
    """(3, 2) mean and std of the errors (N,) within each case."""
    t_s = elapsed_s(t_ns, drive.start_ns)
    inside = [error_m[(t_s >= c.covered_s[0]) & (t_s <= c.covered_s[1])] for c in cases()]
    return np.array([(e.mean(), e.std()) for e in inside])


if __name__ == "__main__":
    main()
