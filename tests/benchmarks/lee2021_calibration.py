# ruff: noqa: T201
"""Where `lee2021-ekf` lands on scenario `lee2021/mcity`, by process noise and bias directions.

    python tests/benchmarks/lee2021_calibration.py [--seeds 20]

Prints the mean error in m of each case over the seeds and its ratio to the fusion column of Table
III of Lee et al. (2021). First for values of R, which the paper does not give, then with the
biases of GPS and node in the passes turned from the directions in use: the magnitudes come from
Tables I and III, directions are free. Those in use were chosen by this table, looking at the EKF
alone.
"""

import argparse
from dataclasses import replace

import numpy as np
from lee2021_tables import TABLE_III_M, by_case

from fgloc.baselines import lee2021_ekf
from fgloc.datasets.lee2021 import simulate
from fgloc.datasets.lee2021_errors import PAPER, PaperErrors, Passes
from fgloc.drive import Drive
from fgloc.measurements import Array

PROCESS_SIGMAS_M = (0.01, 0.02, 0.03, 0.05, 0.1, 0.2, 0.3, 0.5)
TURNS_DEG = (-60.0, -30.0, 0.0, 30.0, 60.0)
PRINTED_M = np.array([mean for mean, _ in TABLE_III_M["fusion"]])


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    seeds = range(parser.parse_args().seeds)
    print(f"{'':36}" + "".join(f"  case {k}" for k in (1, 2, 3)) + "   ratios to the paper")
    drives = [simulate(seed) for seed in seeds]
    for sigma_m in PROCESS_SIGMAS_M:
        show(f"R = ({sigma_m:g} m)^2 each 0.1 s", ekf_cases_m(drives, sigma_m))
    for gps_deg in TURNS_DEG:
        for node_deg in TURNS_DEG:
            paper = turned(gps_deg, node_deg)
            drives = [simulate(seed, paper=paper) for seed in seeds]
            what = f"GPS turned by {gps_deg:g}, node by {node_deg:g} deg"
            show(what, ekf_cases_m(drives, lee2021_ekf.LEE2021.process_sigma_m))


def show(what: str, mean_m: Array) -> None:
    """One line: means of the cases and their ratios to the printed ones."""
    ratios = " ".join(f"{ratio:6.2f}" for ratio in mean_m / PRINTED_M)
    print(f"{what:36}" + "".join(f"{mean:8.2f}" for mean in mean_m) + f"   {ratios}", flush=True)


def ekf_cases_m(drives: list[Drive], process_sigma_m: float) -> Array:
    """(3,) mean error of the filter in each case, mean over the drives."""
    parameters = replace(lee2021_ekf.LEE2021, process_sigma_m=process_sigma_m)
    return np.mean([case_means_m(drive, parameters) for drive in drives], axis=0)


def case_means_m(drive: Drive, parameters: lee2021_ekf.Lee2021) -> Array:
    """(3,) mean horizontal error of the antenna in each case of one drive."""
    estimate = lee2021_ekf.run(drive, parameters).trajectory
    truth = drive.truth.at(estimate.t_ns).at_point(estimate.p_veh_point_m)
    error_m = np.hypot(*(estimate.p_world_m - truth.p_world_m)[:, :2].T)
    return by_case(drive, estimate.t_ns, error_m)[:, 0]


def turned(gps_deg: float, node_deg: float) -> PaperErrors:
    """The errors in use with the biases of the passes turned counter-clockwise."""
    return replace(
        PAPER,
        gps_passing_m=_turned(PAPER.gps_passing_m, gps_deg),
        gps_tunnel_m=_turned(PAPER.gps_tunnel_m, gps_deg),
        node_m=_turned(PAPER.node_m, node_deg),
    )


def _turned(biases_m: Passes, by_deg: float) -> Passes:
    c, s = np.cos(np.deg2rad(by_deg)), np.sin(np.deg2rad(by_deg))
    first, second, third = (np.array(biases_m) @ np.array([[c, s], [-s, c]])).tolist()
    return (first[0], first[1]), (second[0], second[1]), (third[0], third[1])


if __name__ == "__main__":
    main()
