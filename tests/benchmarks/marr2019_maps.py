# ruff: noqa: T201
"""From pixels to the road on `marr2019/iea`: power, map and density of the calibration compared.

    python tests/benchmarks/marr2019_maps.py --seeds 20

Mean distance in m between what a map says of the first camera's boxes and the truth, by how far
the car is from the camera; and how many boxes the map knows no place for.
"""

import argparse

import numpy as np

from fgloc.datasets.marr2019_iea import (
    CAMERAS,
    DETECTION_HZ,
    HZ,
    P_VEH_ANT_M,
    box_sightings,
    calibration_set,
    iea_motion,
)
from fgloc.perception.idw import IdwMap
from fgloc.perception.pixel_maps import HomographyMap, LinearMap

BINS_M = ((0, 50), (50, 100), (100, 300))
PASSES = 12


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    seeds = range(parser.parse_args().seeds)
    print("map                        passes   0-50 m  50-100 m  >100 m  without a place")
    for power in (1.5, 2, 3, 5, 8, 20):
        row(f"IDW, p = {power:g}", PASSES, seeds, lambda c, p=power: IdwMap(c, p))
    row("linear (Delaunay)", PASSES, seeds, LinearMap)
    row("homography", PASSES, seeds, HomographyMap)
    for passes in (3, 6, 24):
        row("IDW, p = 5", passes, seeds, IdwMap)


def row(name, passes, seeds, kind) -> None:
    runs = [errors(seed, passes, kind) for seed in seeds]
    error, distance = (np.concatenate(part) for part in zip(*runs, strict=True))
    placed = np.isfinite(error)
    means = [error[placed & (distance >= low) & (distance < high)].mean() for low, high in BINS_M]
    told = "  ".join(f"{mean:7.2f}" for mean in means)
    print(f"{name:25s}  {passes:6d}  {told}  {int((~placed).sum()):6d} of {len(placed)}")


def errors(seed, passes, kind):
    """Errors (N,) of the first camera's boxes, and the car's distances (N,), in m."""
    frames = iea_motion(seed).every(HZ // DETECTION_HZ)
    seen = box_sightings(seed, 0, frames)
    true = (frames.p_world_m + frames.R_world_veh @ P_VEH_ANT_M)[seen.row, :2]
    found = kind(calibration_set(seed, 0, passes)).place(seen.u_px)
    away = np.linalg.norm(true - np.array(CAMERAS[0].p_world_m[:2]), axis=1)
    return np.linalg.norm(found - true, axis=1), away


if __name__ == "__main__":
    main()
