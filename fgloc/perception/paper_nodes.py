"""The nodes of the papers: Lee et al. (2021) with two heads, Khamooshi (2023) with two cameras.

| | Lee, section III-B | Khamooshi, chapter 3 | Khamooshi, chapter 5 |
|---|---|---|---|
| heads | 2 on one pole | 1 | 1 on a scissor lift |
| on each | non-spinning LiDAR, 5 MP camera | LiDAR, 2 cameras | RS-Helios, 2 cameras |
| camera | - | 1920 x 1200 px, f = 1144 px | 1920 x 1200 px, 90 deg across |
| LiDAR | - | 0.2 deg across, 0.03 m | 32 beams 1 deg apart, 360 deg by 0.2 deg |
| height | - | 10 m | 10 m |

What a paper leaves open (-) is taken from the others. Not printed anywhere: how far the sensors
look down, by how much the views overlap, the sector and reach of the non-spinning LiDAR.

# Differs from the paper: [80, 70] deg and [90, 76] deg do not belong to 1920 x 1200 square pixels,
# whose 80 deg across are 55 deg upright and whose 90 deg are 64; the angles across are kept.
"""

import numpy as np

from fgloc.frames import exp_so3
from fgloc.infrastructure import Node
from fgloc.measurements import Array
from fgloc.perception.heads import Camera, Head, Lidar, PerceptionNode

HEIGHT_M = 10.0
SIZE_PX = (1920, 1200)
FOCAL_PX = 1144.0
CHAPTER_5_FOCAL_PX = 960.0
"""Half of 1920 px by the tangent of half of 90 deg."""
BEAMS = 32
STEP_RAD = tuple(np.deg2rad([0.2, 1.0]).tolist())
RANGE_SIGMA_M = 0.03
RANGES_M = (0.5, 150.0)
"""Of an RS-Helios 1615, from its data sheet."""
SECTOR_RAD = np.deg2rad(120.0)
"""Of a non-spinning LiDAR."""
DOWN_RAD = np.deg2rad(21.0)
"""From 10 m up, beams from 5.5 to 36.5 deg downwards meet the ground 14 to 104 m away."""
ASIDE_RAD = np.deg2rad(40.0)
"""Each of two views is turned so far from the middle: cameras of 80 deg make up 160 deg, as the
thesis has it, those of 90 deg share 10, LiDARs of 120 deg share 40."""
ASIDE_M = 0.3

_OPTICAL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
"""Columns: right, down and ahead of a camera, along x ahead, y left, z up."""


def mount(yaw_rad: float, down_rad: float) -> Array:
    """(3, 3) axes x ahead, y left, z up of a sensor turned to the left, then tipped down."""
    return np.asarray(exp_so3([0, 0, yaw_rad]) @ exp_so3([0, down_rad, 0]))


def pinhole(
    name: str, yaw_rad: float, down_rad: float = DOWN_RAD, focal_px: float = FOCAL_PX,
    size_px: tuple[int, int] = SIZE_PX, p_node_cam_m: tuple[float, ...] = (0.0, 0.0, 0.0),
) -> Camera:  # fmt: skip
    """A camera without distortion, its optical axis through the middle of the image."""
    middle_px = (np.array(size_px) - 1) / 2
    return Camera(
        name, size_px, np.full(2, focal_px), middle_px, mount(yaw_rad, down_rad) @ _OPTICAL,
        np.array(p_node_cam_m),
    )  # fmt: skip


def lidar_32(
    name: str, yaw_rad: float, sector_rad: float, down_rad: float = DOWN_RAD,
    p_node_lidar_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Lidar:  # fmt: skip
    """A LiDAR of 32 beams, 1 deg by 0.2 deg apart, over a sector about its x axis."""
    up_rad = (BEAMS - 1) / 2 * STEP_RAD[1]
    sweep_rad = np.array([-0.5, 0.5]) * sector_rad
    return Lidar(
        name, mount(yaw_rad, down_rad), np.array(p_node_lidar_m), *RANGES_M, sweep_rad,
        np.array([-up_rad, up_rad]), np.array(STEP_RAD), RANGE_SIGMA_M,
    )  # fmt: skip


def lee2021_node(
    node: Node, height_m: float = HEIGHT_M, looking_rad: float = 0.0
) -> PerceptionNode:
    """Two heads of one camera and one non-spinning LiDAR each.

    looking_rad  from the node's x axis to the middle of what they see, counter-clockwise
    """
    heads = []
    for name, aside_rad in (("left", ASIDE_RAD), ("right", -ASIDE_RAD)):
        yaw_rad = looking_rad + aside_rad
        camera = pinhole(f"{name}-camera", yaw_rad)
        lidar = lidar_32(f"{name}-lidar", yaw_rad, SECTOR_RAD, p_node_lidar_m=(0, 0, -ASIDE_M))
        heads.append(Head(name, (camera,), lidar))
    return PerceptionNode(node, tuple(heads), height_m)


def khamooshi2023_node(
    node: Node, height_m: float = HEIGHT_M, looking_rad: float = 0.0
) -> PerceptionNode:
    """The node of chapter 5: one head, two cameras side by side, one LiDAR all around.

    looking_rad  from the node's x axis to the middle of what the cameras see, counter-clockwise
    """
    aside_m = exp_so3([0, 0, looking_rad]) @ [0.0, ASIDE_M / 2, 0.0]
    cameras = tuple(
        pinhole(
            f"{name}-camera", looking_rad + side * ASIDE_RAD, focal_px=CHAPTER_5_FOCAL_PX,
            p_node_cam_m=tuple(side * aside_m),
        )
        for name, side in (("left", 1), ("right", -1))
    )  # fmt: skip
    lidar = lidar_32("lidar", looking_rad, 2 * np.pi, p_node_lidar_m=(0.0, 0.0, -ASIDE_M))
    return PerceptionNode(node, (Head("head", cameras, lidar),), height_m)
