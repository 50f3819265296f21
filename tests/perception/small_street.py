"""A short street for a small node: one car drives away, another comes, somebody walks."""

from dataclasses import replace

import numpy as np

from fgloc.datasets.simulator import instants
from fgloc.datasets.street_recording import record, straight_solids
from fgloc.datasets.streets import ORIGIN, START_NS
from fgloc.infrastructure import Node
from fgloc.measurements import PEDESTRIAN, VEHICLE
from fgloc.perception.heads import Head, PerceptionNode
from fgloc.perception.paper_nodes import ASIDE_RAD, FOCAL_PX, SECTOR_RAD, SIZE_PX, lidar_32, pinhole
from fgloc.perception.recording import Recording
from fgloc.perception.street import PERSON_SIZE_M, Mover, Solids, Street
from fgloc.timing import NS_PER_S

NODE = Node("small", np.array([5.0, -3.0, 10.0]), 0.3)
CARS, PERSON = (1, 2), 3
CAR_SIZE_M = (4.3, 1.8, 1.45)


def small_head(
    name: str, ahead_rad: float, sector_rad: float = np.deg2rad(80), shrink: int = 2
) -> Head:
    """The papers' camera with smaller images, and a LiDAR with half the directions."""
    size_px = SIZE_PX[0] // shrink, SIZE_PX[1] // shrink
    camera = pinhole(f"{name}-camera", ahead_rad, size_px=size_px, focal_px=FOCAL_PX / shrink)
    lidar = lidar_32(f"{name}-lidar", ahead_rad, sector_rad)
    return Head(name, (camera,), replace(lidar, step_rad=np.deg2rad([0.4, 1.0])))


def small_node() -> PerceptionNode:
    """One head on the node."""
    return PerceptionNode(NODE, (small_head("head", 0.0),), NODE.p_world_m[2])


def two_small_heads(node: Node, height_m: float, ahead_rad: float) -> PerceptionNode:
    """Lee's node with small heads."""
    aside = (("left", ASIDE_RAD), ("right", -ASIDE_RAD))
    heads = tuple(small_head(name, ahead_rad + turn, SECTOR_RAD, 4) for name, turn in aside)
    return PerceptionNode(node, heads, height_m)


def small_recording(duration_s: float = 3.0, hz: int = 8, seed: int = 0) -> Recording:
    """A recording of it; the truth's numbers are `CARS` and `PERSON`."""
    node = small_node()
    span_ns = np.array([START_NS, START_NS + 10 * NS_PER_S])

    def mover(number, kind, from_m, to_m, **more):
        p_m = NODE.to_world(np.array([from_m, to_m], float))
        yaw = NODE.yaw_rad + np.arctan2(to_m[1] - from_m[1], to_m[0] - from_m[0])
        return Mover(number, kind, span_ns, p_m, np.full(2, yaw), **more)

    movers = (
        mover(CARS[0], VEHICLE, (20, 2.0), (120, 2.0), size_m=CAR_SIZE_M, colour=(40, 40, 220)),
        mover(CARS[1], VEHICLE, (52, -2.0), (-48, -2.0), size_m=CAR_SIZE_M,
              colour=(230, 230, 230)),
        mover(PERSON, PEDESTRIAN, (26, -10.0), (26, 5.0), size_m=PERSON_SIZE_M,
              colour=(20, 160, 60)),
    )  # fmt: skip
    wall = Solids(*straight_solids([(20, 90, 10, 14, 0, 6)], node.ground_m))
    t_ns = instants(START_NS, duration_s, hz)
    return record("small", Street(node, wall, movers), ORIGIN, t_ns, seed)
