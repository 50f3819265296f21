# ruff: noqa: T201
"""How well a node's LiDAR alone finds road users on the simulated street, by the distance.

    python tests/benchmarks/perception_lidar.py [--seeds 10] [--sway 0.05]

Every third frame of `street` at 10 Hz, 20 s a seed, the right-hand head of Lee's node 10 m above
the ground; the background is learnt from 50 frames of the same 20 s. A road user counts as found
where a cuboid's centre is within 3 m of a car's, 1.5 m of a person's. Errors are along and across
the line of sight: mean and standard deviation of the found ones, NEES by its dimension. Beside them
what Lee et al. (2021), (19), and sigma across would say, and the sigma of a_n d^2, Khamooshi (2023)
(3.16), fitted to these errors. Then the constants of the law of `cuboid_fit` as these errors give
them, and processor time.
"""

import argparse
import time
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import minimize

from fgloc.datasets.streets import make_street, plain_street
from fgloc.factors.detection import LEE2021_ACROSS_M, lee2021_sigma_m
from fgloc.measurements import PEDESTRIAN, VEHICLE
from fgloc.perception.lidar_detector import LidarDetector
from fgloc.perception.ray_cast import scan

HEAD, EVERY, DURATION_S = 1, 3, 20.0
FIRST_SEED = 100
"""The constants of `cuboid_fit` were fitted to seeds 0 to 7."""
NEAR_M = {VEHICLE: 3.0, PEDESTRIAN: 1.5}
BINS_M = range(10, 81, 10)
STAGES = ("background and ground", "clusters", "cuboids")


@dataclass
class Sums:
    """Rows of kind, distance, points that hit it, found, error along, across, NEES / 2, points."""

    rows: list[tuple[float, ...]] = field(default_factory=list)
    ghosts: int = 0
    frames: int = 0
    seconds: np.ndarray = field(default_factory=lambda: np.zeros(len(STAGES)))
    learn_s: list[float] = field(default_factory=list)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--sway", type=float, default=0.0, help="amplitude of the node's tip in m")
    given = parser.parse_args()
    sums = Sums()
    for seed in range(FIRST_SEED, FIRST_SEED + given.seeds):
        one_street(seed, given.sway, sums)
    rows = np.array(sums.rows)
    for kind, name in ((VEHICLE, "cars"), (PEDESTRIAN, "persons")):
        table(name, rows[rows[:, 0] == kind])
        law(name, rows[(rows[:, 0] == kind) & (rows[:, 3] == 1)])
    print(f"\nghosts: {sums.ghosts} in {sums.frames} frames")
    speed(sums)


def one_street(seed: int, sway_m: float, sums: Sums) -> None:
    recording, street = (
        make_street(seed, DURATION_S, sway_m),
        plain_street(seed, DURATION_S, sway_m),
    )
    t_ns, lidar = recording.clouds[HEAD].t_ns, recording.node.heads[HEAD].lidar
    learn = [recording.cloud(HEAD, k) for k in range(0, len(t_ns), len(t_ns) // 50)]
    began = time.process_time()
    detector = LidarDetector.learn(recording.node, HEAD, learn)
    sums.learn_s.append(time.process_time() - began)
    for frame in range(1, len(t_ns), EVERY):
        sweep = scan(street, lidar, int(t_ns[frame]), np.random.default_rng([seed, frame]))
        cloud = lidar.to_node(sweep.points_m)
        cuboids = timed(detector, cloud, frame, sums)
        matched(street, int(t_ns[frame]), sweep.hit, cuboids, sums)


def timed(detector, cloud, frame, sums):
    marks = [time.process_time()]
    points = detector.foreground(cloud)
    marks.append(time.process_time())
    labels = detector.clusters(points)
    marks.append(time.process_time())
    cuboids = detector.fit(points, labels, cloud, frame).cuboids
    marks.append(time.process_time())
    if sums.frames:  # the first brings in Open3D
        sums.seconds += np.diff(marks)
    sums.frames += 1
    return cuboids


def matched(street, t_ns, hit, cuboids, sums) -> None:
    """Each road user takes the nearest cuboid that none took; what is left are ghosts."""
    fixed, there = len(street.fixed), street.there(t_ns)
    centres = street.solids(t_ns).centre_m[fixed:, :2]
    left = np.ones(len(cuboids), bool)
    for number, (mover, centre) in enumerate(zip(there, centres, strict=True)):
        sight = centre / np.linalg.norm(centre)
        row = [mover.kind, np.linalg.norm(centre), np.sum(hit == fixed + number)]
        away = cuboids.centre_m[:, :2] - centre
        distance = np.where(left, np.linalg.norm(away, axis=-1), np.inf)
        if len(distance) == 0 or distance.min() > NEAR_M[mover.kind]:
            sums.rows.append((*row, 0, np.nan, np.nan, np.nan, 0))
            continue
        best = int(distance.argmin())
        left[best], error = False, away[best]
        nees = error @ np.linalg.solve(cuboids.cov_m2[best], error) / 2
        along, across = error @ sight, error @ [-sight[1], sight[0]]
        sums.rows.append((*row, 1, along, across, nees, cuboids.points[best]))
    sums.ghosts += int(left.sum())


def table(name: str, rows: np.ndarray) -> None:
    found = rows[rows[:, 3] == 1]
    a_n = [np.sum(found[:, c] ** 2 * found[:, 1] ** 2) / np.sum(found[:, 1] ** 4) for c in (4, 5)]
    print(f"\n{name}; a_n d^2 with a_n = {a_n[0]:.1e} and {a_n[1]:.1e} m^2/m^2")
    print("distance     n  found  of 4+ hits  points   along m           across m          NEES/2  "
          "(19) / across   a_n d^2: along, across")  # fmt: skip
    for middle in BINS_M:
        part = rows[np.abs(rows[:, 1] - middle) < 5]
        seen, hit = part[part[:, 3] == 1], part[part[:, 2] >= 4]
        if not len(seen):
            print(f"{middle:5d} m  {len(part):5d}   0.00")
            continue
        errors = "  ".join(f"{seen[:, c].mean():7.3f} ({seen[:, c].std():.3f})" for c in (4, 5))
        scaled = " ".join(f"{np.sqrt(a) * middle:.3f}" for a in a_n)
        rates = f"{part[:, 3].mean():.2f}        {hit[:, 3].mean():.2f}"
        print(f"{middle:5d} m  {len(part):5d}   {rates}"
              f"  {np.median(seen[:, 7]):6.0f}  {errors}  {seen[:, 6].mean():6.2f}  "
              f"{lee2021_sigma_m(middle, 0.0):6.3f} / {LEE2021_ACROSS_M:g}   {scaled}")  # fmt: skip


def law(name: str, found: np.ndarray) -> None:
    """The constants of greatest likelihood, errors taken for Gaussian."""
    for what, column in (("along", 4), ("across", 5)):
        error, points = found[:, column], found[:, 7]

        def loss(p, error=error, points=points):
            variance = p[0] ** 2 + p[1] ** 2 / points
            return np.mean(error**2 / variance + np.log(variance))

        base, each = np.abs(minimize(loss, [0.1, 0.5], method="Nelder-Mead").x)
        print(f"law of {name}, {what}: {base:.3f}^2 + {each:.3f}^2 / points")


def speed(sums: Sums) -> None:
    each = sums.seconds / (sums.frames - 1)
    print(f"\nlearning the background from 50 frames: {np.median(sums.learn_s):.2f} s")
    for name, seconds in zip(STAGES, each, strict=True):
        print(f"{name:24} {1e3 * seconds:6.1f} ms {1 / seconds:6.0f} frames/s")
    print(f"{'all':24} {1e3 * each.sum():6.1f} ms {1 / each.sum():6.0f} frames/s")


if __name__ == "__main__":
    main()
