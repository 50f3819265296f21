# ruff: noqa: T201
"""What corners bring on `marr2019/smart-code`: the graphs with and without them, and the filter.

    python tests/benchmarks/marr2019_corners.py --seeds 0:20

For each path and camera yaw the mean error in the plane, over the instants that all of them tell
of, and the ANEES of the graphs in the plane over all of theirs; means over the seeds.
"""

import argparse

import numpy as np

from fgloc.baselines.marr2019_smart_code import run
from fgloc.datasets.marr2019_smart_code import make_marr2019_smart_code
from fgloc.evaluation.consistency import nees
from fgloc.smoother.codes import smooth_codes

CASES = (("left", 30.0), ("middle", 30.0), ("right", 30.0), ("left", 0.0), ("right", 0.0),
         ("near", 0.0))  # fmt: skip
LAG_S = 5.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="0:20", help="from:to, without the last")
    parser.add_argument("--corner-sigma-px", type=float, default=0.15)
    given = parser.parse_args()
    seeds = range(*map(int, given.seeds.split(":")))
    print(
        "path    yaw   mean error in m: filter, lag, batch; by corners lag, batch   ANEES of these"
    )
    for path, yaw_deg in CASES:
        told = [one_drive(seed, path, yaw_deg, given.corner_sigma_px) for seed in seeds]
        error_m, consistency = (np.mean(part, axis=0) for part in zip(*told, strict=True))
        print(
            f"{path:6s}  {yaw_deg:3.0f}   {numbers(error_m)}   {numbers(consistency)}", flush=True
        )


def one_drive(seed, path, yaw_deg, corner_sigma_px):
    """Mean errors (5,) in m, and ANEES (4,) of the graphs."""
    plain, cornered = (
        make_marr2019_smart_code(seed, path, yaw_deg, corner_sigma_px, corners=told)
        for told in (False, True)
    )
    graphs = [smooth_codes(one, lag_s).trajectory
              for one in (plain, cornered) for lag_s in (LAG_S, None)]  # fmt: skip
    told = [run(plain).trajectory, *graphs]
    first = max(one.t_ns[0] for one in told)
    last = min(plain.truth.t_ns[-1], *(one.t_ns[-1] for one in told))
    t_ns = told[0].t_ns[(told[0].t_ns >= first) & (told[0].t_ns <= last)]
    error_m = [np.linalg.norm(off_m(plain, one, t_ns), axis=1).mean() for one in told]
    return error_m, [consistency_of(plain, one) for one in graphs]


def consistency_of(drive, trajectory) -> float:
    t_ns = trajectory.t_ns[trajectory.t_ns <= drive.truth.t_ns[-1]]
    cov = trajectory.cov[: len(t_ns), :2, :2]
    return nees(off_m(drive, trajectory, t_ns), cov).mean() / 2


def off_m(drive, trajectory, t_ns) -> np.ndarray:
    """Errors (N, 2) East and North in m."""
    true = drive.truth.at_point(trajectory.p_veh_point_m).at(t_ns).p_world_m
    return (trajectory.at(t_ns).p_world_m - true)[:, :2]


def numbers(values) -> str:
    return "  ".join(f"{value:6.3f}" for value in values)


if __name__ == "__main__":
    main()
