# ruff: noqa: T201
"""How often Smart Codes are read, and how well they tell the range: rendered images by distance.

    python tests/benchmarks/smart_code_reading.py --images 20000

Half of the images show a 22 in code, half a 5 in code, at random places and turns, blurred by
0.6 px, with noise of 4 grey levels and bright clutter. Prints read rate, wrong reads, range errors.
"""

import argparse
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from perception.rendered import CODES, PRINCIPAL_PX, right_and_wrong, scene

from fgloc.datasets.marr2019_smart_code import FOCAL_PX, LARGE_M, SMALL_M
from fgloc.perception.smart_code_reader import MarkerReader
from fgloc.perception.smart_code_renderer import Look
from fgloc.perception.square_pose import square_poses

BINS_M = {LARGE_M: (4, 7, 10, 15, 20, 25, 30, 35), SMALL_M: (2, 4, 6, 8, 10, 12, 15)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--images", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    rng, reader = np.random.default_rng(given.seed), MarkerReader.smart_codes(CODES)
    print("code in m  distance in m  images  read in %  wrong  range error mean / std in m")
    for size_m, edges in BINS_M.items():
        count = given.images // 2 // (len(edges) - 1)
        for low, high in pairwise(edges):
            print(line(reader, size_m, low, high, count, rng), flush=True)


def line(reader, size_m, low, high, count, rng) -> str:
    read, wrong, errors = 0, 0, []
    for _ in range(count):
        one = scene(rng, size_m, rng.uniform(low, high), Look())
        found = reader.read(one.image)
        right, others = right_and_wrong(found, one.code)
        read, wrong = read + (right > 0), wrong + others
        if right:
            corners = found.corners_px[found.codes.index(one.code)] + one.offset_px
            poses = square_poses(corners, size_m, FOCAL_PX, PRINCIPAL_PX)
            errors.append(poses.range_m[0] - one.range_m)
    error = f"{np.mean(errors):8.3f} / {np.std(errors):.3f}" if errors else ""
    share = 100 * read / count
    return f"{size_m:9.4f}  {low:5d} to {high:3d}  {count:6d}  {share:9.1f}  {wrong:5d}  {error}"


if __name__ == "__main__":
    main()
