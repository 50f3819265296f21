"""Scenarios of Khamooshi (2023), sections 4.5 and 5.2: nodes, the ego car and others in one place.

Nodes see all objects in the world, the car sees the others in its own axes and has fixes of its
own place. Node, car and truth each number the objects in a way of their own. The variance of what
is seen grows with the square of the slant range, Eq. (3.16).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fgloc.datasets.khamooshi2023_node import GNSS_SIGMA_M, ORIGIN, RATE_HZ, START_NS
from fgloc.datasets.simulator import stream
from fgloc.drive import About, Drive, Rig
from fgloc.errors import InputError
from fgloc.frames import yaw_matrix
from fgloc.infrastructure import Infrastructure, Node
from fgloc.measurements import (
    PEDESTRIAN,
    VEHICLE,
    Array,
    GnssFixes,
    NodeDetections,
    ObjectTruth,
    RelativeSightings,
    Table,
)
from fgloc.timing import NS_PER_S, Instants
from fgloc.trajectory import Trajectory

A_NODE = 1.8e-4
"""Variance over the square of the slant range: camera and LiDAR of a node together."""
A_CAR = 1.8e-4
CAR_HEIGHT_M = 2.0
NODE_HEIGHT_M = 10.0
CAR_RANGE_M, NODE_RANGE_M = 80.0, 120.0
STEPS, STEPS_TWO_NODES = 40, 24
"""Not printed; over 4 s the car of 4.5.2 passes the node, over 2.4 s that of 4.5.3 passes both."""
EGO_FROM_M, OTHER_FROM_M = (-16.0, -3.7), (-25.0, 3.2)
_PERSON_M = 0.4  # half the width of what hides another behind it


@dataclass(frozen=True, eq=False)
class Scene:
    """What happens: object 0 is the ego car.

    p_world_m, v_world_mps  (N, K, 2) of K objects at N instants
    yaw_rad   (N,) heading of the ego car
    nodes_m   places of the nodes
    kinds     of each object
    hidden    (N, K) whom the car cannot see
    gnss      whether the car has fixes
    """

    p_world_m: Array
    v_world_mps: Array
    yaw_rad: Array
    nodes_m: tuple[tuple[float, float], ...]
    kinds: tuple[int, ...] = (VEHICLE, VEHICLE)
    hidden: NDArray[np.bool_] | None = field(default=None)
    gnss: bool = True
    node_range_m: float = NODE_RANGE_M


def make_one_node(
    seed: int = 0, onboard: bool = True, latency_s: float = 0.0, loss: float = 0.0
) -> Drive:
    """4.5.2: one node; the ego car at 20 m/s, another at 50 m/s.

    onboard    False leaves out what the car itself measures
    latency_s  of what nodes send; `loss` is the share of it that never arrives
    """
    scene = _along([(EGO_FROM_M, 20.0, 0.0), (OTHER_FROM_M, 50.0, 0.0)], ((20.0, 8.0),))
    return _drive("one-node", seed, scene, onboard, latency_s, loss)


def make_two_nodes(
    seed: int = 0, onboard: bool = True, latency_s: float = 0.0, loss: float = 0.0
) -> Drive:
    """4.5.3: two nodes 40 m apart, for an error that is even on the road; options as one-node."""
    cars = [(EGO_FROM_M, 30.0, 0.0), (OTHER_FROM_M, 30.0, 0.0)]
    scene = _along(cars, ((0.0, 8.0), (40.0, 8.0)), STEPS_TWO_NODES)
    return _drive("two-nodes", seed, scene, onboard, latency_s, loss)


def make_acceleration(
    seed: int = 0, onboard: bool = True, latency_s: float = 0.0, loss: float = 0.0
) -> Drive:
    """4.5.4: the ego from rest at 10 m/s^2, the other from 40 m/s at -10; options as one-node."""
    scene = _along([(EGO_FROM_M, 0.0, 10.0), (OTHER_FROM_M, 40.0, -10.0)], ((20.0, 8.0),))
    return _drive("acceleration", seed, scene, onboard, latency_s, loss)


def make_correspondence(
    seed: int = 0, onboard: bool = True, latency_s: float = 0.0, loss: float = 0.0
) -> Drive:
    """4.5.5: five objects, any heading, no fixes: the car finds itself among what a node tells.

    Options as one-node.
    """
    rng = stream(seed, "places")
    start, heading = rng.uniform(-30, 30, (5, 2)), rng.uniform(-math.pi, math.pi, 5)
    v = rng.uniform(3, 10, 5)[:, None] * np.stack([np.cos(heading), np.sin(heading)], -1)
    t = np.arange(STEPS + 1)[:, None, None] / RATE_HZ
    yaw = np.full(STEPS + 1, heading[0])
    p, v = start + v * t, np.broadcast_to(v, (STEPS + 1, 5, 2))
    scene = Scene(p, v, yaw, ((0.0, 0.0),), (VEHICLE,) * 5, gnss=False)
    return _drive("correspondence", seed, scene, onboard, latency_s, loss)


def make_intersection(
    seed: int = 0, onboard: bool = True, latency_s: float = 0.0, loss: float = 0.0
) -> Drive:
    """Chapter 5: a bus and a car stop for a pedestrian, who hides the car from the bus.

    The bus is the ego; occlusion from about step 60. Options as one-node.
    """
    t = np.arange(101) / RATE_HZ
    bus = _stopping(t, (4.4, 20.5), (0.0, -1.0), 4.0, 12.5)
    car = _stopping(t, (9.2, -14.1), (0.0, 1.0), 4.0, 12.0)
    walk = np.clip(t - 3.2, 0, None)  # not printed: so that the car is hidden from step 60 on
    pedestrian = np.stack([3.0 + 1.2 * walk, np.full(len(t), 2.8)], -1)
    p = np.stack([bus, car, pedestrian], 1)
    v = np.gradient(p, 1 / RATE_HZ, axis=0)
    hidden = np.zeros((len(t), 3), bool)
    hidden[:, 1] = _between(p[:, 0], p[:, 1], p[:, 2])
    yaw = np.full(len(t), -math.pi / 2)
    kinds = (VEHICLE, VEHICLE, PEDESTRIAN)
    scene = Scene(p, v, yaw, ((0.0, 0.0),), kinds, hidden, node_range_m=45.0)
    return _drive("intersection", seed, scene, onboard, latency_s, loss)


def _along(
    cars: list[tuple[tuple[float, float], float, float]],
    nodes_m: tuple[tuple[float, float], ...],
    steps: int = STEPS,
) -> Scene:
    """Cars on a road to the East: start, speed, acceleration; nobody drives backwards."""
    t = np.arange(steps + 1) / RATE_HZ
    p, v = np.zeros((len(t), len(cars), 2)), np.zeros((len(t), len(cars), 2))
    for k, (start, speed, acceleration) in enumerate(cars):
        p[:, k] = start
        p[:, k, 0] += speed * t + acceleration * t**2 / 2
        v[:, k, 0] = speed + acceleration * t
    return Scene(p, v, np.zeros(len(t)), nodes_m)


def _stopping(
    t_s: Array, start: tuple[float, float], ahead: tuple[float, float], speed: float, way_m: float
) -> Array:
    """(N, 2) a straight way that ends at rest: even speed, then even braking over half the way."""
    brake = speed**2 / way_m
    even_s = way_m / 2 / speed
    braking = np.clip(t_s - even_s, 0, speed / brake)
    along = speed * np.minimum(t_s, even_s) + speed * braking - brake * braking**2 / 2
    return np.asarray(start + along[:, None] * np.array(ahead))


def _between(a: Array, b: Array, c: Array) -> NDArray[np.bool_]:
    """(N,) whether c (N, 2) stands on the line of sight from a to b."""
    ray = b - a
    along = ((c - a) * ray).sum(-1) / (ray**2).sum(-1)
    off = np.linalg.norm(c - a - along[:, None] * ray, axis=-1)
    return np.asarray((along > 0) & (along < 1) & (off < _PERSON_M))


def _drive(
    name: str, seed: int, scene: Scene, onboard: bool, latency_s: float, loss: float
) -> Drive:
    """All tables of a scene. Without its own sensors, the car is what nodes number 0."""
    if not 0 <= loss < 1 or not 0 <= latency_s <= 10:
        raise InputError(f"loss = {loss}, latency_s = {latency_s}: expected 0 to 1 and 0 to 10 s")
    n, K, _ = scene.p_world_m.shape
    t_ns = START_NS + np.arange(n, dtype=np.int64) * (NS_PER_S // RATE_HZ)
    nodes = tuple(
        Node(f"node-{i}", np.array([*place, NODE_HEIGHT_M]), range_m=scene.node_range_m)
        for i, place in enumerate(scene.nodes_m, 1)
    )
    numbers: Callable[[str], NDArray[np.int64]] = lambda who: (  # noqa: E731
        stream(seed, who).permutation(K) + 1 if onboard else np.arange(K)
    )
    tables: dict[str, Table] = {"detections": _seen_by_nodes(
        t_ns, scene, nodes, numbers, stream(seed, "detections"), round(latency_s * NS_PER_S), loss
    )}  # fmt: skip
    if onboard:
        if scene.gnss:
            tables["gnss"] = _fixes(t_ns, scene, stream(seed, "gnss"))
        tables["relative"] = _seen_by_car(t_ns, scene, numbers("car"), stream(seed, "relative"))
    flat = [np.column_stack([x[:, 0], np.zeros(n)]) for x in (scene.p_world_m, scene.v_world_mps)]
    truth = Trajectory(t_ns, flat[0], yaw_matrix(scene.yaw_rad), flat[1])
    at = np.repeat(t_ns, K - 1)
    others = ObjectTruth(
        at, at, np.tile(np.arange(1, K), n), scene.p_world_m[:, 1:].reshape(-1, 2),
        scene.v_world_mps[:, 1:].reshape(-1, 2),
    )  # fmt: skip
    about = About(
        title=f"Khamooshi (2023), {name}, seed {seed}", licence="MIT", simulated=True,
        source=f"fgloc scenario khamooshi2023/{name}, seed {seed}",
    )  # fmt: skip
    return Drive(
        f"khamooshi2023/{name}", ORIGIN, Rig(), tables, truth, about, Infrastructure(nodes), others
    )


def _seen_by_nodes(
    t_ns: Instants, scene: Scene, nodes: tuple[Node, ...],
    numbers: Callable[[str], NDArray[np.int64]], rng: np.random.Generator, late_ns: int,
    loss: float,
) -> NodeDetections:  # fmt: skip
    """What arrives of each node at each instant: all of a message, or nothing."""
    n = len(t_ns)
    parts = []
    for i, node in enumerate(nodes):
        p = scene.p_world_m - node.p_world_m[:2]
        variance = A_NODE * ((p**2).sum(-1) + NODE_HEIGHT_M**2)
        seen = p + np.sqrt(variance)[..., None] * rng.standard_normal(p.shape)
        there = np.linalg.norm(seen, axis=-1) <= node.range_m
        there &= rng.random((n, 1)) >= loss
        step, k = np.nonzero(there)
        parts.append((step, np.full(len(step), i), numbers(node.name)[k], np.array(scene.kinds)[k],
                      seen[step, k], variance[step, k]))  # fmt: skip
    step, which, name, kind, seen, variance = (np.concatenate(x) for x in zip(*parts, strict=True))
    order = np.argsort(step, kind="stable")
    at = t_ns[step[order]]
    cov = variance[order, None, None] * np.eye(2)
    return NodeDetections(
        at, at + late_ns, which[order], name[order], kind[order], seen[order], cov
    )


def _seen_by_car(
    t_ns: Instants, scene: Scene, numbers: NDArray[np.int64], rng: np.random.Generator
) -> RelativeSightings:
    c, s = np.cos(scene.yaw_rad), np.sin(scene.yaw_rad)
    R = np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)
    p = (scene.p_world_m[:, 1:] - scene.p_world_m[:, :1]) @ R
    variance = A_CAR * ((p**2).sum(-1) + CAR_HEIGHT_M**2)
    seen = p + np.sqrt(variance)[..., None] * rng.standard_normal(p.shape)
    there = np.linalg.norm(p, axis=-1) <= CAR_RANGE_M
    if scene.hidden is not None:
        there &= ~scene.hidden[:, 1:]
    step, k = np.nonzero(there)
    cov = variance[step, k, None, None] * np.eye(2)
    kinds = np.array(scene.kinds)[1:]
    return RelativeSightings(t_ns[step], t_ns[step], numbers[1:][k], kinds[k], seen[step, k], cov)


def _fixes(t_ns: Instants, scene: Scene, rng: np.random.Generator) -> GnssFixes:
    n, sigma = len(t_ns), np.array(GNSS_SIGMA_M)
    p = np.column_stack([scene.p_world_m[:, 0], np.zeros(n)])
    cov = np.tile(np.diag(sigma**2), (n, 1, 1))
    p = p + sigma * rng.standard_normal((n, 3))
    return GnssFixes(t_ns, t_ns, p, cov, np.full((n, 3), np.nan))
