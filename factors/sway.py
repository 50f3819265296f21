"""What a swaying post does to the detections of its node.

A node reports where an object is along its axes as it was surveyed, while it is displaced by d and
turned by the rotation vector t = (roll, pitch, 0). An object at q, a height h below the node, is at

    s = Exp(-t) (q - d)

in the axes that the sensors really have. A LiDAR reports s, rigidly. A camera sees the direction
of s alone and follows it to the ground through the pose that is believed, so that it reports
-h s / s_z: a tilt of t moves that by h (1 + (x / h)^2) t along the line of sight, the rigid point
by h t. Along the node's level axes, in plan; the state of a post is that of `fgloc.factors.post`.

A graph that has the object's position as a variable needs no more than a linear row for each
detection, q + J state = z: `linear_row`. About a post at rest, where J is taken at what was
reported and z is that, it leaves out 6 % of the shift by 10 mrad at 60 m from a height of 10 m;
about an estimate of the state it is renewed and leaves out nothing.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from fgloc.errors import InputError
from fgloc.factors.post import pose_jacobian
from fgloc.frames import exp_so3, right_jacobian_so3, skew
from fgloc.infrastructure import Node, Post
from fgloc.measurements import Array

Sensor = Literal["camera", "lidar"]


class SwayResidual(NamedTuple):
    """error (N, 2) in m; Jacobians by the object's place (N, 2, 2) and by the post (N, 2, 6)."""

    error: Array
    by_point: Array
    by_post: Array


def residual(
    p_node_m: Array, reported_m: Array, states: Array, height_m: float, tip_slope_per_m: float,
    sensor: Sensor,
) -> SwayResidual:  # fmt: skip
    """Predicted minus reported places (N, 2) of objects truly at (N, 2), m along the node's axes.

    states    (N, 6) of the post at each detection
    height_m  of the node above the object's reference point; of a camera, above the ground
    """
    by_state = pose_jacobian(tip_slope_per_m)
    told, by_point, by_sway = reported(p_node_m, states @ by_state.T, height_m, sensor)
    return SwayResidual(told - reported_m, by_point, by_sway @ by_state)


def reported(
    p_node_m: Array, sway: Array, height_m: float, sensor: Sensor
) -> tuple[Array, Array, Array]:
    """What is reported of objects at (N, 2); Jacobians by place (N, 2, 2) and sway (N, 2, 4).

    `sway` (N, 4) holds displacement x, y in m, roll and pitch in rad. Raises InputError where a
    camera sees an object above its horizon.
    """
    turn = _turn(sway)
    R_back = exp_so3(-turn)
    moved = _below(p_node_m, height_m)
    moved[:, :2] -= sway[:, :2]
    s = np.einsum("nij,nj->ni", R_back, moved)
    by_turn = R_back @ skew(moved) @ right_jacobian_so3(-turn)
    by_sway = np.concatenate([-R_back[:, :, :2], by_turn[:, :, :2]], -1)
    seen, by_s = _seen(s, height_m, sensor)
    return seen, by_s @ R_back[:, :, :2], by_s @ by_sway


def compensated(reported_m: Array, sway: Array, height_m: float, sensor: Sensor) -> Array:
    """Where objects (N, 2) truly are that a node with a known sway (N, 4) reports: the inverse."""
    R = exp_so3(_turn(sway))
    if sensor == "camera":
        ray = np.einsum("nij,nj->ni", R, _below(reported_m, height_m))
        q = ray * (-height_m / ray[:, 2:])
    else:
        level = np.einsum("ni,ni->n", R[:, 2, :2], reported_m)
        s = np.column_stack([reported_m, (-height_m - level) / R[:, 2, 2]])
        q = np.einsum("nij,nj->ni", R, s)
    return np.asarray(q[:, :2] + sway[:, :2])


def linear_row(
    reported_m: Array, post: Post, node: Node, height_m: float, sensor: Sensor,
    states: Array | None = None,
) -> tuple[Array, Array]:  # fmt: skip
    """J (N, 2, 6) and z (N, 2) of the rows p_world + J state = z, along East and North in m.

    reported_m  (N, 2) in the node's axes
    height_m    of the node above the object's reference point; of a camera, above the ground
    states      (N, 6) of the post to be linear about; at rest without
    """
    about = np.zeros((len(reported_m), 6)) if states is None else states
    by_state = pose_jacobian(post.tip_slope_per_m)
    sway = about @ by_state.T
    p_node_m = compensated(reported_m, sway, height_m, sensor)
    _, by_point, by_sway = reported(p_node_m, sway, height_m, sensor)
    J = np.linalg.solve(by_point, by_sway @ by_state)
    z_node_m = p_node_m + np.einsum("nij,nj->ni", J, about)
    return np.asarray(node.R_world_node @ J), node.to_world(z_node_m)


def _turn(sway: Array) -> Array:
    """(N, 3): roll and pitch as a rotation vector; the post does not twist."""
    return np.concatenate([sway[:, 2:], np.zeros((len(sway), 1))], -1)


def _below(p_node_m: Array, height_m: float) -> Array:
    """Places (N, 2) as points (N, 3), so far below the node."""
    return np.concatenate([p_node_m, np.full((len(p_node_m), 1), -height_m)], -1)


def _seen(s: Array, height_m: float, sensor: Sensor) -> tuple[Array, Array]:
    """What a sensor reports of points (N, 3) in its axes, and the Jacobian (N, 2, 3)."""
    by_s = np.zeros((len(s), 2, 3))
    if sensor == "lidar":
        by_s[:, [0, 1], [0, 1]] = 1.0
        return s[:, :2], by_s
    if (s[:, 2] >= 0).any():
        row = int(np.argmax(s[:, 2] >= 0))
        raise InputError(
            f"detection {row}: the camera sees it above its horizon, where it meets no ground; is "
            "the tilt in rad?"
        )
    reach = -height_m / s[:, 2]
    by_s[:, [0, 1], [0, 1]] = reach[:, None]
    by_s[:, :, 2] = -reach[:, None] * s[:, :2] / s[:, 2:]
    return reach[:, None] * s[:, :2], by_s
