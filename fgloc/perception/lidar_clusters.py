"""Points of a cloud that belong together, with reaches that fit how a raised LiDAR samples.

Lee et al. (2021), section III-B, and Khamooshi (2023), section 3.2, cluster the points that are not
background, and say no more. Here DBSCAN of Open3D finds the clusters in plan. Seen from h above a
level surface, beams of step s meet it r^2 s / h apart at the distance r, 2.8 m at 40 m, while
directions of one beam stay 0.2 deg apart. One reach for all would break a far car into its front
and its roof, or make two near ones one. So a point goes to

    ( integral of dr / reach(r),  azimuth / lateral_rad )

where points in reach of each other are at most 1 apart, along the line of sight as across.
"""

import numpy as np
from numpy.typing import NDArray

from fgloc.frames import wrap_pi
from fgloc.measurements import Array
from fgloc.perception.lidar_settings import LidarConfig
from fgloc.perception.point_clouds import import_open3d

NOISE = -1
"""Label of points of no cluster."""
_GRID_M = 0.25


def cluster(
    plan_m: Array, height_m: float, beam_step_rad: float, ahead_rad: float,
    config: LidarConfig | None = None,
) -> NDArray[np.int64]:  # fmt: skip
    """Label (N,) of each point, from 0, `NOISE` where it is of no cluster.

    plan_m         (N, 2) points from the LiDAR, seen from above
    height_m       of the LiDAR above the surfaces that it sees
    beam_step_rad  between two beams
    ahead_rad      azimuth of the LiDAR's x axis: clusters end at the opposite one

    Raises InputError where Open3D is missing.
    """
    if not len(plan_m):
        return np.empty(0, np.int64)
    o3d = import_open3d()
    at = _evened(plan_m, height_m, beam_step_rad, ahead_rad, config or LidarConfig())
    flat = o3d.utility.Vector3dVector(np.column_stack([at, np.zeros(len(at))]))
    core = (config or LidarConfig()).core_points
    return np.array(o3d.geometry.PointCloud(flat).cluster_dbscan(1.0, core), np.int64)


def _evened(
    plan_m: Array, height_m: float, beam_step_rad: float, ahead_rad: float, config: LidarConfig
) -> Array:
    """Points (N, 2) where those in reach of each other are at most 1 apart."""
    range_m = np.hypot(*plan_m.T)
    azimuth_rad = wrap_pi(np.arctan2(plan_m[:, 1], plan_m[:, 0]) - ahead_rad)
    grid_m = np.arange(0.0, range_m.max() + 2 * _GRID_M, _GRID_M)
    apart_m = grid_m**2 * beam_step_rad / height_m
    reach_m = np.clip(config.radial_beams * apart_m, config.radial_least_m, config.radial_most_m)
    steps = _GRID_M / reach_m
    even = np.cumsum(steps) - steps
    return np.column_stack([np.interp(range_m, grid_m, even), azimuth_rad / config.lateral_rad])
