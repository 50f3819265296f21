"""What a swaying post does to the detections of its node.

A node reports where an object is along its axes as it was surveyed, while it is displaced by d and
turned by the rotation vector t = (roll, pitch, 0). An object at q is at

    s = Exp(-t) (q - d)

in the axes that the sensors really have. A LiDAR reports s, rigidly, with its height where it tells
one. A camera sees the direction of s alone and follows it to the ground, a height h below the node,
through the pose that is believed, so that it reports -h s / s_z. A tilt of t moves what is at a
distance x by x t in height, and in plan by h t if a LiDAR sees it and by h (1 + (x / h)^2) t along
the line of sight if a camera does. So of a tilt a LiDAR's heights tell most. The state of a post is
that of `fgloc.factors.post`; all is along the node's level axes.

A graph that has the object's place as a variable needs no more than linear rows for each detection,
q + J state = z: `linear_row`. Where no height is told the object is on the ground, h below. About a
post at rest, where J is taken at what was reported and z is that, they leave out 6 % of the shift
by 10 mrad at 60 m from a height of 10 m; about an estimate of the state they are renewed and leave
out nothing.
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
    """error (N, 3) in m; Jacobians by the object's place (N, 3, 3) and by the post (N, 3, 6)."""

    error: Array
    by_point: Array
    by_post: Array


def residual(
    p_node_m: Array, reported_m: Array, states: Array, tip_slope_per_m: float, sensor: Sensor
) -> SwayResidual:
    """Predicted minus reported places (N, 3) of objects truly at (N, 3), m along the node's axes.

    Heights are over the node; one that is not told is NaN and its row is zero. `states` (N, 6) are
    those of the post at each detection.
    """
    by_state = pose_jacobian(tip_slope_per_m)
    told, by_point, by_sway = reported(p_node_m, states @ by_state.T, sensor)
    untold = np.isnan(reported_m)
    by_point[untold], by_sway[untold] = 0.0, 0.0
    return SwayResidual(np.where(untold, 0.0, told - reported_m), by_point, by_sway @ by_state)


def reported(p_node_m: Array, sway: Array, sensor: Sensor) -> tuple[Array, Array, Array]:
    """What is reported (N, 3) of objects at (N, 3); Jacobians by place (N, 3, 3), sway (N, 3, 4).

    `sway` (N, 4) holds displacement x, y in m, roll and pitch in rad. What a camera sees is on the
    ground, whose height it gives back. Raises InputError where a camera sees an object above its
    horizon.
    """
    turn = _turn(sway)
    R_back = exp_so3(-turn)
    moved = p_node_m - _shift(sway)
    s = np.einsum("nij,nj->ni", R_back, moved)
    by_turn = R_back @ skew(moved) @ right_jacobian_so3(-turn)
    by_sway = np.concatenate([-R_back[:, :, :2], by_turn[:, :, :2]], -1)
    if sensor == "lidar":
        return s, R_back, by_sway
    seen, by_s, by_ground = _on_the_ground(s, p_node_m[:, 2])
    by_point = by_s @ R_back
    by_point[:, :, 2] += by_ground
    return seen, by_point, by_s @ by_sway


def compensated(reported_m: Array, sway: Array, height_m: float, sensor: Sensor) -> Array:
    """Where objects (N, 3) truly are that a node with a known sway (N, 4) reports: the inverse.

    Of a height that is not told, NaN, the object is on the ground, `height_m` below the node.
    """
    return _taken_back(reported_m, sway, height_m, sensor)[0]


def linear_row(
    reported_m: Array, post: Post, node: Node, height_m: float, sensor: Sensor,
    states: Array | None = None,
) -> tuple[Array, Array]:  # fmt: skip
    """J (N, 3, 6) and z (N, 3) of the rows p_world + J state = z, along East, North and up in m.

    reported_m  (N, 3) in the node's axes, NaN for a height that is not told: its row of J is zero
    height_m    of the node above the object's reference point where that is so; of a camera, above
                the ground
    states      (N, 6) of the post to be linear about; at rest without
    """
    about = np.zeros((len(reported_m), 6)) if states is None else states
    by_state = pose_jacobian(post.tip_slope_per_m)
    place, by_sway = _taken_back(reported_m, about @ by_state.T, height_m, sensor)
    J = -by_sway @ by_state
    z = node.place_to_world(place + np.einsum("nij,nj->ni", J, about))
    J[:, :2] = node.R_world_node @ J[:, :2]
    return J, z


def _taken_back(
    reported_m: Array, sway: Array, height_m: float, sensor: Sensor
) -> tuple[Array, Array]:
    """`compensated`, and its Jacobian by the sway (N, 3, 4)."""
    turn = _turn(sway)
    R = exp_so3(turn)
    s, slide = _sensed(reported_m, R, height_m, sensor)
    by_turn = -R @ skew(s) @ right_jacobian_so3(turn)
    by_sway = np.concatenate([np.broadcast_to(np.eye(3)[:, :2], (len(s), 3, 2)),
                              by_turn[:, :, :2]], -1)  # fmt: skip
    by_sway -= slide[:, :, None] * by_sway[:, 2:]
    return np.einsum("nij,nj->ni", R, s) + _shift(sway), by_sway


def _sensed(reported_m: Array, R: Array, height_m: float, sensor: Sensor) -> tuple[Array, Array]:
    """The points (N, 3) that were seen, in the sensor's axes, and how far each slides, along the
    node's axes (N, 3), for each metre that it must go up to stay on the ground; where its height is
    told it need not."""
    s, untold = reported_m.copy(), np.isnan(reported_m[:, 2])
    if sensor == "camera":
        s[:, 2] = -height_m
        ray = np.einsum("nij,nj->ni", R, s)
        return s * (-height_m / ray[:, 2:]), ray / ray[:, 2:]
    level = np.einsum("ni,ni->n", R[:, 2, :2], s[:, :2])
    s[untold, 2] = ((-height_m - level) / R[:, 2, 2])[untold]
    return s, untold[:, None] * R[:, :, 2] / R[:, 2:, 2]


def _turn(sway: Array) -> Array:
    """(N, 3): roll and pitch as a rotation vector; the post does not twist."""
    return np.concatenate([sway[:, 2:], np.zeros((len(sway), 1))], -1)


def _shift(sway: Array) -> Array:
    """(N, 3): the displacement; the tip stays at its height."""
    return np.concatenate([sway[:, :2], np.zeros((len(sway), 1))], -1)


def _on_the_ground(s: Array, ground_m: Array) -> tuple[Array, Array, Array]:
    """Where directions (N, 3) in a camera's axes meet the ground at heights (N,) over the node,
    (N, 3), and the Jacobians by both (N, 3, 3) and (N, 3)."""
    if (s[:, 2] >= 0).any():
        row = int(np.argmax(s[:, 2] >= 0))
        raise InputError(
            f"detection {row}: the camera sees it above its horizon, where it meets no ground; is "
            "the tilt in rad?"
        )
    reach = ground_m / s[:, 2]
    by_s = np.zeros((len(s), 3, 3))
    by_s[:, [0, 1], [0, 1]] = reach[:, None]
    by_s[:, :2, 2] = -reach[:, None] * s[:, :2] / s[:, 2:]
    return reach[:, None] * s, by_s, s / s[:, 2:]
