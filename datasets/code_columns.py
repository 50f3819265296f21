"""Sightings of Smart Codes as columns of `smart_codes.csv`.

A sighting tells its code's height and width, and its middle or its corners or both: `u_px,v_px` is
the middle, `u0_px,v0_px` to `u3_px,v3_px` are the corners, clockwise from the upper left one. The
corners of a row are given all or none. Without `u_px,v_px` the middle is the mean of the corners.
"""

from pathlib import Path

import numpy as np

from fgloc.datasets.columns import Columns, Group, Layout, check_known, check_positive, place
from fgloc.datasets.trajectory_columns import check_increasing, stack, unstack
from fgloc.errors import DriveError
from fgloc.factors.corners import code_size_px
from fgloc.infrastructure import Infrastructure
from fgloc.measurements import Array, SmartCodeSightings

SIGN, SIZE, MIDDLE = "sign", ("height_px", "width_px"), ("u_px", "v_px")
CORNERS = tuple(f"{axis}{i}_px" for i in range(4) for axis in "uv")
CODES = Layout((
    Group.of("t_ns"), Group.of("received_ns", required=False), Group.of(SIGN), Group.of(*SIZE),
    Group.of(*MIDDLE, required=False), Group.of(*CORNERS, required=False, may_be_empty=True),
))  # fmt: skip


def code_columns(table: SmartCodeSightings) -> Columns:
    """The columns of sightings, but for the times."""
    columns: Columns = {SIGN: table.sign} | {name: getattr(table, name) for name in SIZE}
    columns |= unstack(MIDDLE, table.centre_px)
    if table.has_corners.any():
        columns |= unstack(CORNERS, table.corners_px.reshape(-1, 8))
    return columns


def smart_codes_from_columns(
    path: Path, columns: Columns, infrastructure: Infrastructure
) -> SmartCodeSightings:
    """Smart Codes of a table read from `path`.

    Raises DriveError naming the first row of a sign that the drive does not have, of no size, with
    some corners and not all, with corners in another order, or of which nothing tells the middle.
    """
    check_increasing(path, columns["t_ns"], duplicates=True)
    check_known(path, columns, SIGN, len(infrastructure.signs))
    check_positive(path, columns, SIZE, "a size")
    corners, t_ns = _corners(path, columns), columns["t_ns"]
    height_px, width_px = (columns[name] for name in SIZE)
    return SmartCodeSightings(
        t_ns, columns.get("received_ns", t_ns), columns[SIGN], height_px, width_px,
        _middle(path, columns, corners), corners,
    )  # fmt: skip


def _corners(path: Path, columns: Columns) -> Array:
    """(N, 4, 2), NaN where none are given."""
    if CORNERS[0] not in columns:
        return np.full((len(columns["t_ns"]), 4, 2), np.nan)
    told = stack(columns, CORNERS)
    absent = np.isnan(told)
    partly = absent.any(-1) & ~absent.all(-1)
    if partly.any():
        row = int(np.argmax(partly))
        raise DriveError(
            f"{place(path, row)}: {CORNERS[int(np.argmax(absent[row]))]} is empty but other "
            "corners are not; give all four corners of the code or none"
        )
    corners = told.reshape(-1, 4, 2)
    turned = np.minimum(*code_size_px(corners)) <= 0
    if turned.any():
        row = int(np.argmax(turned))
        raise DriveError(
            f"{place(path, row)}: the corners {corners[row].tolist()} px are not those of an "
            "upright code; give them clockwise from the upper left one, right and down in px"
        )
    return corners


def _middle(path: Path, columns: Columns, corners: Array) -> Array:
    """(N, 2), by the corners where the table has no columns for it."""
    if MIDDLE[0] in columns:
        return stack(columns, MIDDLE)
    middle = corners.mean(1)
    unknown = np.isnan(middle[:, 0])
    if unknown.any():
        row = int(np.argmax(unknown))
        raise DriveError(
            f"{place(path, row)}: neither the code's middle nor its corners; give "
            f"{','.join(MIDDLE)} in every row, or all of {','.join(CORNERS)}"
        )
    return middle
