# ruff: noqa: T201
"""Smart Code geometry on `marr2019/smart-code`: errors by path, camera yaw, code and distance.

    python tests/benchmarks/marr2019_codes.py --seeds 5

Means over the sightings; 'no position' are sightings that give a range only, or are too near. The
last table takes the pixels as they are (`along_ray` False), as the thesis does.
"""

import argparse

import numpy as np

from fgloc.datasets.marr2019_smart_code import LANES_M, SIGNS, make_marr2019_smart_code
from fgloc.factors.smart_code import Reading, head_on, locate

YAWS_DEG = (0.0, 30.0, 45.0)
BINS_M = ((0, 10), (10, 20), (20, 40))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    seeds = range(parser.parse_args().seeds)
    for title, quantised, along_ray in (
        ("whole pixels", True, True),
        ("sub-pixel sizes", False, True),
        ("whole pixels, not brought to the ray", True, False),
    ):
        print(f"\n{title}\npath    yaw  code    distance in m  sightings  no position  "
              "position error  range error mean / std")  # fmt: skip
        for path in LANES_M:
            for yaw_deg in YAWS_DEG:
                table(path, yaw_deg, seeds, quantised, along_ray)


def table(path, yaw_deg, seeds, quantised, along_ray) -> None:
    rows = [located(path, yaw_deg, seed, quantised, along_ray) for seed in seeds]
    large, range_m, off_m, range_off_m, there = (
        np.concatenate(part) for part in zip(*rows, strict=True)
    )
    for name, chosen in (("22 in", large), ("5 in", ~large)):
        for low, high in BINS_M:
            here = chosen & (range_m >= low) & (range_m < high)
            if not here.any():
                continue
            placed = off_m[here & there]
            mean = f"{placed.mean():.2f}" if len(placed) else "-"
            print(f"{path:6s}  {yaw_deg:3.0f}  {name:6s}  {low:5d} to {high:3d}  {here.sum():9d}  "
                  f"{(here & ~there).sum():11d}  {mean:>14s}  "
                  f"{range_off_m[here].mean():7.2f} / {range_off_m[here].std():.2f}")  # fmt: skip


def located(path, yaw_deg, seed, quantised, along_ray):
    """Of each sighting: whether the code is large, its range, the errors of position and range in
    m, and whether it gives a position."""
    drive = make_marr2019_smart_code(seed, path, yaw_deg, quantised=quantised)
    seen, camera = drive.tables.get("smart_codes"), drive.rig.camera
    if seen is None:
        return (np.zeros(0, bool), *np.zeros((3, 0)), np.zeros(0, bool))
    stamps, row = np.unique(seen.t_ns, return_inverse=True)
    true = drive.truth.at_point(camera.p_veh_cam_m).at(stamps).p_world_m[row]
    place = np.array([sign.p_world_m for sign in SIGNS])[seen.sign]
    size_m = np.array([sign.size_m for sign in SIGNS])[seen.sign]
    found = locate(
        head_on(seen.height_px, seen.width_px, seen.centre_px, size_m, camera.focal_px,
                camera.principal_px, along_ray),
        place[:, 2] - camera.p_veh_cam_m[2], False,
    )  # fmt: skip
    R = SIGNS[0].R_world_sign  # all three face the same way
    off = found.p_sign_m @ R.T + place[:, :2] - true[:, :2]
    range_m = np.linalg.norm(true - place, axis=1)
    there = found.status == Reading.POSITION
    return size_m > 0.3, range_m, np.linalg.norm(off, axis=1), found.range_m - range_m, there


if __name__ == "__main__":
    main()
