"""A car placed by a swaying node through `fgloc.smooth`: sway ignored, taken back, followed, none.

The scenario is `khamooshi2023/sway-drive`; all ways have the same fixes, detections and settings.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

import fgloc
from fgloc.drive import Drive
from fgloc.factors.sway import compensated, reported
from fgloc.measurements import Array

SCENARIO = "khamooshi2023/sway-drive"
RANGES_M, WIDTH_M = (20.0, 40.0, 60.0), 5.0
LEFT = "posts.compensate=false"


def drives(
    seed: int, sensor: str, duration_s: float = 84.0, *, heights: bool = True
) -> dict[str, Drive]:
    """The drive of a seed with poses of the node, without sway, without poses, and without poses
    but with two more cars that have RTK; a LiDAR tells heights or does not."""
    made = {"poses": {}, "still": {"sways": False}, "bare": {"poses": False},
            "users": {"poses": False, "users": 2}}  # fmt: skip
    return {
        name: fgloc.make(
            SCENARIO, seed=seed, sensor=sensor, duration_s=duration_s, heights=heights, **how
        )
        for name, how in made.items()
    }


def ways(of: dict[str, Drive], settings: Sequence[str] = ()) -> dict[str, Array]:
    """RMSE of the car's place in m, overall and at 20, 40 and 60 m, by the way it was placed."""
    tried = {
        "sway ignored": (of["poses"], LEFT),
        "taken back by khamooshi2023-uio": (taken_back(of["poses"]), LEFT),
        "graph with poses": (of["poses"],),
        "graph without poses": (of["bare"],),
        "graph without poses, two RTK cars": (of["users"],),
        "no sway": (of["still"], LEFT),
    }
    return {name: rmse_m(drive, *more, *settings) for name, (drive, *more) in tried.items()}


def taken_back(drive: Drive) -> Drive:
    """The drive with the sway that the kinematic observer sees taken out of its detections."""
    posts, seen = fgloc.baseline(drive, "khamooshi2023-uio").posts, drive.tables["detections"]
    assert np.array_equal(posts.t_ns, seen.t_ns)
    node, post = drive.infrastructure.nodes[0], drive.infrastructure.posts[0]
    sway = np.concatenate([posts.p_node_m, posts.tilt_rad], -1)
    place_m = compensated(seen.place_node_m, sway, post.height_m, node.sensor)
    up_m = np.where(seen.has_height, place_m[:, 2], np.nan)
    still = dataclasses.replace(seen, p_node_m=place_m[:, :2], up_node_m=up_m)
    return drive.with_tables(detections=still)


def askew(drive: Drive, tilt_rad: float, sigma_level_rad: float = 0.0) -> Drive:
    """The drive of a LiDAR that was built in with so much roll and pitch, about which it sways, and
    that says how level it is."""
    (node,), seen = drive.infrastructure.nodes, drive.tables["detections"]
    turned = np.tile([0.0, 0.0, tilt_rad, tilt_rad], (len(seen), 1))
    place_m, _, _ = reported(seen.place_node_m, turned, node.sensor)
    said = dataclasses.replace(node, sigma_level_rad=sigma_level_rad)
    beside = dataclasses.replace(drive.infrastructure, nodes=(said,))
    leans = dataclasses.replace(seen, p_node_m=place_m[:, :2], up_node_m=place_m[:, 2])
    return dataclasses.replace(drive, infrastructure=beside).with_tables(detections=leans)


def rmse_m(drive: Drive, *settings: str) -> Array:
    """Of the middle of its box in plan: everywhere, then within 5 m of each range from the node."""
    found, truth = fgloc.smooth(drive, settings=settings).trajectory, drive.truth
    seen_ns = np.intersect1d(found.t_ns, drive.tables["gnss"].t_ns)
    box_m, true_m = (
        one.take(np.isin(one.t_ns, seen_ns)).at_point(drive.rig.p_veh_box_m).p_world_m[:, :2]
        for one in (found, truth)
    )
    square = ((box_m - true_m) ** 2).sum(-1)
    away_m = np.linalg.norm(true_m - drive.infrastructure.nodes[0].p_world_m[:2], axis=-1)
    near = [np.abs(away_m - at_m) < WIDTH_M for at_m in RANGES_M]
    return np.sqrt([square.mean(), *(square[rows].mean() for rows in near)])


def post_rmse(drive: Drive, *settings: str) -> Array:
    """Of the node's displacement in mm and of its tilt in mrad, each the length of two axes."""
    found, truth = fgloc.smooth(drive, settings=settings).posts, drive.post_truth
    rows = np.searchsorted(truth.t_ns, found.t_ns)
    off = found.p_node_m - truth.p_node_m[rows], found.tilt_rad - truth.tilt_rad[rows]
    return 1e3 * np.sqrt([(one**2).sum(-1).mean() for one in off])


def removed_share(found: dict[str, Array], name: str) -> Array:
    """Of what sway adds to the error, how much a way of placing the car removes."""
    ignored, without = found["sway ignored"], found["no sway"]
    return (ignored - found[name]) / (ignored - without)
