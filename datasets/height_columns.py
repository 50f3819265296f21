"""Heights of what nodes see and of what road users say, as columns of `detections` and `users`."""

from pathlib import Path

import numpy as np

from fgloc.datasets.columns import Columns, check_pairs, check_positive, place
from fgloc.infrastructure import Infrastructure
from fgloc.measurements import LEFT_OUT, Array

SEEN_HEIGHT, HEIGHT = ("z_m", "sigma_z_m"), ("up_m", "sigma_up_m")
"""Over the node, and in the world; each with its sigma."""


def height_columns(names: tuple[str, str], up_m: Array, sigma_up_m: Array) -> Columns:
    """Heights and their sigmas (N,) under two names, or no columns where no row tells any."""
    return {} if np.isnan(up_m).all() else dict(zip(names, (up_m, sigma_up_m), strict=True))


def heights(path: Path, columns: Columns, names: tuple[str, str]) -> tuple[Array, Array]:
    """Heights and sigmas (N,) in m of a table read from `path`; NaN where none are told.

    Raises DriveError naming the first row with one of both alone, or with a sigma that is none.
    """
    if names[0] not in columns:
        return LEFT_OUT, LEFT_OUT
    check_pairs(path, columns, names)
    check_positive(path, columns, names[1:])
    return columns[names[0]], columns[names[1]]


def seen_heights(
    path: Path, columns: Columns, infrastructure: Infrastructure
) -> tuple[Array, Array]:
    """The same over the node of each detection, from these or from heights in the world.

    Raises DriveError for the height that a camera tells, too.
    """
    names = HEIGHT if HEIGHT[0] in columns else SEEN_HEIGHT
    up_m, sigma_m = heights(path, columns, names)
    if up_m is LEFT_OUT:
        return up_m, sigma_m
    infrastructure.refuse_camera_heights(
        columns["node"], up_m, lambda row: f"{place(path, row)}: {names[0]}"
    )
    if names is HEIGHT:
        node_up_m = np.array([one.p_world_m[2] for one in infrastructure.nodes])
        up_m = up_m - node_up_m[columns["node"]]
    return up_m, sigma_m
