"""`objects.csv`: what a method says of other road users, one row per track and instant."""

from pathlib import Path

import numpy as np

from fgloc.datasets.columns import Columns
from fgloc.datasets.parquet_table import write_table
from fgloc.datasets.trajectory_columns import unstack
from fgloc.measurements import ObjectTracks

STATE = ("east_m", "north_m", "v_east_mps", "v_north_mps")
COVARIANCE = tuple(f"cov_{'xyuv'[i]}{'xyuv'[j]}" for i, j in zip(*np.triu_indices(4), strict=True))
"""x and y stand for East and North in m, u and v for the velocities in m/s."""


def write_tracks(path: Path, tracks: ObjectTracks) -> None:
    """Write tracks as a table: track_id, user_id, t_ns, state, upper triangle of its covariance."""
    columns: Columns = {
        "track_id": tracks.track_id, "user_id": tracks.user_id, "t_ns": tracks.t_ns,
    }  # fmt: skip
    columns |= unstack(STATE, tracks.state)
    columns |= unstack(COVARIANCE, tracks.cov[:, *np.triu_indices(4)])
    write_table(path, columns)
