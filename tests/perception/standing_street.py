"""A small node and a street of one car, as the tests of perception share them."""

import numpy as np

from fgloc.datasets.streets import START_NS
from fgloc.infrastructure import Node
from fgloc.measurements import VEHICLE
from fgloc.perception.heads import Camera, Head, Lidar, PerceptionNode
from fgloc.perception.paper_nodes import lidar_32, pinhole
from fgloc.perception.street import CAR_SIZE_M, Mover, Solids, Street, Sway

SURVEY = Node("n", np.array([100.0, 50.0, 10.0]), np.pi / 2)
"""It looks North; 10 m above the ground."""
RED = (0.0, 0.0, 255.0)


def camera(name: str = "camera", size_px: tuple[int, int] = (240, 150)) -> Camera:
    """Ahead and 21 deg down, with the papers' view of 80 deg across."""
    return pinhole(name, 0.0, focal_px=1144.0 * size_px[0] / 1920, size_px=size_px)


def lidar(sector_rad: float = np.deg2rad(60)) -> Lidar:
    return lidar_32("lidar", 0.0, sector_rad)


def node(survey: Node = SURVEY) -> PerceptionNode:
    return PerceptionNode(survey, (Head("head", (camera(),), lidar()),), 10.0)


def standing(
    x_m: float, y_m: float, yaw_rad: float = 0.0, number: int = 1, size_m=CAR_SIZE_M, kind=VEHICLE
) -> Mover:
    """A road user that stands for an hour, by its place and yaw along the node's axes."""
    t_ns = START_NS + np.array([0, 3600 * 10**9])
    p_m = SURVEY.to_world(np.array([[x_m, y_m]] * 2))
    return Mover(number, kind, t_ns, p_m, np.full(2, yaw_rad + SURVEY.yaw_rad), size_m, RED)


def driving(x_m: tuple[float, float], y_m: float, seconds: float, number: int = 1) -> Mover:
    """A car that drives along the node's x axis."""
    t_ns = START_NS + np.array([0, round(seconds * 1e9)])
    p_m = SURVEY.to_world(np.array([[x, y_m] for x in x_m]))
    yaw_rad = (0.0 if x_m[1] > x_m[0] else np.pi) + SURVEY.yaw_rad
    return Mover(number, VEHICLE, t_ns, p_m, np.full(2, yaw_rad), CAR_SIZE_M, RED)


def street(*movers: Mover, walls=(), sway: Sway | None = None) -> Street:
    """Movers, and walls as rows of lowest and highest x, y and z above the ground."""
    limits = np.array(walls, float).reshape(-1, 3, 2)
    centre_m, size_m = limits.mean(-1) - [0, 0, 10.0], np.ptp(limits, axis=-1)
    n = len(limits)
    return Street(
        node(), Solids(centre_m, size_m, np.zeros(n), np.full((n, 3), 200.0)), movers, sway
    )
