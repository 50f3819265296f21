"""What is told and known of swaying posts, as columns of `node_poses.csv` and `post_truth.csv`."""

from pathlib import Path

import numpy as np

from fgloc.datasets.columns import (
    Columns,
    Group,
    Layout,
    check_known,
    check_pairs,
    check_positive,
)
from fgloc.datasets.trajectory_columns import check_increasing, stack, unstack
from fgloc.infrastructure import Infrastructure
from fgloc.measurements import NodePoses
from fgloc.posts import PostStates

DISPLACEMENT, VELOCITY = ("x_m", "y_m"), ("vx_mps", "vy_mps")
TILT, SIGMA_TILT = ("roll_rad", "pitch_rad"), ("sigma_roll_rad", "sigma_pitch_rad")
SIGMA, SIGMA_VELOCITY = ("sigma_x_m", "sigma_y_m"), ("sigma_vx_mps", "sigma_vy_mps")
NODE = "node"

POSES = Layout((
    Group.of("t_ns"), Group.of("received_ns", required=False), Group.of(NODE),
    Group.of(*DISPLACEMENT), Group.of(*SIGMA),
    Group.of(*TILT, *SIGMA_TILT, required=False, may_be_empty=True),
))  # fmt: skip
TRUTH = Layout((
    Group.of("t_ns"), Group.of(NODE), Group.of(*DISPLACEMENT), Group.of(*VELOCITY), Group.of(*TILT),
))  # fmt: skip
"""Columns of pose estimates, and of how posts really swayed."""


def pose_columns(poses: NodePoses) -> Columns:
    """The columns of pose estimates, but for the times."""
    columns: Columns = {NODE: poses.node}
    columns |= unstack(DISPLACEMENT, poses.p_node_m) | unstack(SIGMA, poses.sigma_p_m)
    if not np.isnan(poses.tilt_rad).all():
        columns |= unstack(TILT, poses.tilt_rad) | unstack(SIGMA_TILT, poses.sigma_tilt_rad)
    return columns


def poses_from_columns(path: Path, columns: Columns, infrastructure: Infrastructure) -> NodePoses:
    """Pose estimates of a table read from `path`.

    Raises DriveError naming the first row of a node that the drive does not have, with a sigma
    that is none, or with an angle and no sigma for it.
    """
    check_increasing(path, columns["t_ns"], duplicates=True)
    check_known(path, columns, NODE, len(infrastructure.nodes))
    check_positive(path, columns, SIGMA)
    unknown = np.full((len(columns["t_ns"]), 2), np.nan)
    tilt, sigma_tilt = unknown, unknown
    if TILT[0] in columns:
        _check_tilts(path, columns)
        tilt, sigma_tilt = stack(columns, TILT), stack(columns, SIGMA_TILT)
    return NodePoses(
        columns["t_ns"], columns.get("received_ns", columns["t_ns"]), columns[NODE],
        stack(columns, DISPLACEMENT), tilt, stack(columns, SIGMA), sigma_tilt,
    )  # fmt: skip


def truth_columns(truth: PostStates) -> Columns:
    """The columns of how posts really swayed."""
    columns: Columns = {"t_ns": truth.t_ns, NODE: truth.node}
    columns |= unstack(DISPLACEMENT, truth.p_node_m) | unstack(VELOCITY, truth.v_node_mps)
    return columns | unstack(TILT, truth.tilt_rad)


def truth_from_columns(path: Path, columns: Columns, infrastructure: Infrastructure) -> PostStates:
    """The inverse of `truth_columns`; DriveError for a node that the drive does not have."""
    check_increasing(path, columns["t_ns"], duplicates=True)
    check_known(path, columns, NODE, len(infrastructure.nodes))
    t_ns, unknown = columns["t_ns"], np.full((len(columns["t_ns"]), 2), np.nan)
    return PostStates(
        t_ns, t_ns, columns[NODE], stack(columns, DISPLACEMENT), stack(columns, VELOCITY),
        stack(columns, TILT), unknown, unknown, unknown,
    )  # fmt: skip


def _check_tilts(path: Path, columns: Columns) -> None:
    """An angle comes with its sigma or not at all."""
    for names in zip(TILT, SIGMA_TILT, strict=True):
        check_pairs(path, columns, names)
    check_positive(path, columns, SIGMA_TILT)
