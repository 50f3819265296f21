"""A car placed by a swaying node: sway ignored, taken back by an observer, in the graph, absent.

The scenario is `khamooshi2023/sway-drive`. The graph is small, so that sway is all that differs:
cars are chains of position and velocity under white acceleration, with their fixes and the node's
detections; the post is the chain of `fgloc.factors.post`. All is linear but for the way from post
to detection, about which the rows are renewed. Cars with RTK may pass besides.
"""

from dataclasses import dataclass

import gtsam
import numpy as np

import fgloc
from fgloc.datasets.khamooshi2023_sway_drive import (
    IMU_HZ,
    SEEN_HZ,
    TRUTH_HZ,
    oval_motion,
    simulate_detections,
)
from fgloc.datasets.simulator import instants, stream
from fgloc.drive import Drive
from fgloc.factors.post import linear_factor
from fgloc.factors.sway import compensated, detection_factor, linear_row
from fgloc.measurements import Array, NodeDetections
from fgloc.smoother.posts import factors_of
from fgloc.watches import Watch, watches

ACCELERATION = 1.0  # density, (m/s^2)^2 / Hz, of what a car does beside going straight
START_M, START_MPS = 100.0, 20.0
RTK_SIGMA_M, RTK_PHASES_RAD = 0.02, (2.1, 4.2)
RANGES_M, WIDTH_M = (20.0, 40.0, 60.0), 5.0
ROUNDS = 2
PLACE = np.eye(2, 4)


@dataclass(frozen=True)
class Car:
    """Fixes (k, 2) with their sigma, the node's detections of it, and where it truly is (k, 2)."""

    fixes_m: Array
    sigma_m: float
    seen: NodeDetections
    true_m: Array


def ego(drive: Drive, sigma_m: float = 1.0) -> Car:
    """The scenario's car; its antenna stands above the middle of its box."""
    truth = drive.truth.take(slice(None, None, TRUTH_HZ // SEEN_HZ))
    true_m = truth.at_point(drive.rig.p_veh_box_m).p_world_m[:, :2]
    return Car(drive.gnss.p_world_ant_m[:, :2], sigma_m, drive.tables["detections"], true_m)


def rtk_cars(drive: Drive, seed: int) -> list[Car]:
    """Two cars elsewhere on the oval that know where they are to two centimetres."""
    cars, duration_s = [], (drive.end_ns - drive.start_ns) / 1e9
    for number, phase_rad in enumerate(RTK_PHASES_RAD, 1):
        rng = stream(seed, f"rtk {number}")
        motion = oval_motion(instants(drive.start_ns, duration_s, IMU_HZ), phase_rad)
        node = drive.infrastructure.nodes[0]
        seen = simulate_detections(motion, node, drive.post_truth, rng, number)
        at = motion.every(IMU_HZ // SEEN_HZ)
        box_m = (at.p_world_m + at.R_world_veh @ drive.rig.p_veh_box_m)[:, :2]
        fixes_m = box_m + RTK_SIGMA_M * rng.standard_normal(box_m.shape)
        cars.append(Car(fixes_m, RTK_SIGMA_M, seen, box_m))
    return cars


def estimate(drive: Drive, cars: list[Car], sway: Array | None, *, joint: bool) -> Array:
    """Places (k, 2) of the first car, from all data.

    sway   (k, 4) that is taken back from the detections beforehand; None believes them
    joint  the post's state is in the graph; with the drive's pose estimates, if it has any
    """
    post = np.zeros((len(cars[0].seen), 6)) if joint else None
    for _ in range(ROUNDS if joint else 1):
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for number, car in enumerate(cars):
            add_car(graph, values, car, number)
            add_detections(graph, drive, car, number, sway, post)
        if joint:
            add_post(graph, values, drive)
        solution = graph.linearize(values).optimize()
        steps = range(len(cars[0].seen))
        post = np.array([solution.at(gtsam.symbol("s", k)) for k in steps]) if joint else None
    return np.array([solution.at(car_key(0, k))[:2] for k in range(len(cars[0].seen))])


def car_key(number: int, k: int) -> int:
    """Of a car's state; each car has a letter of its own."""
    return gtsam.symbol("abc"[number], k)


def add_car(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, car: Car, number: int) -> None:
    """The chain of a car and its fixes."""
    dt = 1 / SEEN_HZ
    forward = np.kron([[1, dt], [0, 1]], np.eye(2))
    noise = ACCELERATION * np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], np.eye(2))
    root = np.linalg.inv(np.linalg.cholesky(noise))
    spread = np.diag(np.repeat([1 / START_M, 1 / START_MPS], 2))
    graph.add(linear_factor({car_key(number, 0): spread}, np.zeros(4)))
    for k, fix_m in enumerate(car.fixes_m):
        values.insert(car_key(number, k), np.zeros(4))
        here = car_key(number, k)
        graph.add(linear_factor({here: PLACE / car.sigma_m}, fix_m / car.sigma_m))
        if k:
            blocks = {car_key(number, k - 1): -root @ forward, here: root}
            graph.add(linear_factor(blocks, np.zeros(4)))


def add_detections(
    graph: gtsam.NonlinearFactorGraph, drive: Drive, car: Car, number: int, sway: Array | None,
    post: Array | None,
) -> None:  # fmt: skip
    """What the node reports of a car, tied to the car and, where it has states, to the post."""
    node, height_m = (
        drive.infrastructure.nodes[0],
        float(drive.infrastructure.nodes[0].p_world_m[2]),
    )
    seen_m = car.seen.p_node_m
    if sway is not None:
        seen_m = compensated(seen_m, sway, height_m, node.sensor)
    row = linear_row(seen_m, drive.infrastructure.posts[0], node, height_m, node.sensor, post)
    cov = node.R_world_node @ car.seen.cov_node_m2 @ node.R_world_node.T
    for k, (J, z) in enumerate(zip(*row, strict=True)):
        here = car_key(number, k)
        if post is not None:
            post_key = gtsam.symbol("s", k)
            graph.add(detection_factor(here, PLACE, post_key, J, z, cov[k]))
        else:
            root = np.linalg.inv(np.linalg.cholesky(cov[k]))
            graph.add(linear_factor({here: root @ PLACE}, root @ z))


def add_post(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, drive: Drive) -> None:
    """The chain of the post with the pose estimates, or the chain alone."""
    watch = chain(drive)
    for k in range(len(watch.t_ns)):
        values.insert(gtsam.symbol("s", k), np.zeros(6))
        for factor in factors_of(watch, k):
            graph.add(factor)


def chain(drive: Drive) -> Watch:
    """The watch of the post at the instants of the detections; rows without pose tell nothing."""
    if "node_poses" in drive.tables:
        return watches(drive, "graph")[0][0]
    t_ns = drive.tables["detections"].t_ns
    nothing, post = np.zeros((0, 4)), drive.infrastructure.posts[0]
    none = np.zeros(0, np.int64)
    return Watch(0, post.node, post, none, nothing, nothing, t_ns, none)


def observed_sway(drive: Drive) -> Array:
    """Displacement and tilt (k, 4) by the kinematic observer."""
    posts = fgloc.baseline(drive, "khamooshi2023-uio").posts
    return np.concatenate([posts.p_node_m, posts.tilt_rad], -1)


def five_ways(seed: int, sensor: str, duration_s: float = 84.0) -> dict[str, Array]:
    """RMSE of the car's place in m, overall and at 20, 40 and 60 m, by the way it was placed."""
    drive, still, bare = (
        fgloc.make(
            "khamooshi2023/sway-drive", seed=seed, sensor=sensor, duration_s=duration_s, **how
        )
        for how in ({}, {"sways": False}, {"poses": False})
    )
    car = ego(drive)
    ways = {
        "sway ignored": estimate(drive, [car], None, joint=False),
        "taken back by the observer": estimate(drive, [car], observed_sway(drive), joint=False),
        "graph with poses": estimate(drive, [car], None, joint=True),
        "graph, two RTK cars, no poses": estimate(bare, [car, *rtk_cars(bare, seed)], None,
                                                  joint=True),
        "no sway": estimate(still, [ego(still)], None, joint=False),
    }  # fmt: skip
    return {name: rmse(found_m, car, drive) for name, found_m in ways.items()}


def rmse(found_m: Array, car: Car, drive: Drive) -> Array:
    """Of the distance in plan: everywhere, then within 5 m of each range."""
    square = ((found_m - car.true_m) ** 2).sum(-1)
    range_m = np.linalg.norm(car.true_m - drive.infrastructure.nodes[0].p_world_m[:2], axis=-1)
    near = [np.abs(range_m - at_m) < WIDTH_M for at_m in RANGES_M]
    return np.sqrt([square.mean(), *(square[rows].mean() for rows in near)])


def removed_share(ways: dict[str, Array], name: str) -> Array:
    """Of what sway adds to the error, how much a way of placing the car removes."""
    ignored, without = ways["sway ignored"], ways["no sway"]
    return (ignored - ways[name]) / (ignored - without)
