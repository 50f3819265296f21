"""Range: the distance from a tag on the vehicle to a surveyed anchor, up to scale, bias and noise.

Model: z = s |p_world_veh + R_world_veh l - a| + b + n, with l the tag in the vehicle frame, a the
anchor, s a scale (of the clock that times the signal) and b a constant delay.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fgloc.frames import skew
from fgloc.measurements import Array

if TYPE_CHECKING:
    import gtsam

LEAST_M = 1e-6
"""At the anchor itself a range has no direction; closer than this it is taken to have none."""


class RangeResidual(NamedTuple):
    """error (N, 1) in m; its Jacobians by pose (N, 1, 6), scale (N, 1, 1), bias (1, 1) and by the
    tag's position in the world (N, 1, 3)."""

    error: Array
    by_pose: Array
    by_scale: Array
    by_bias: Array
    by_tag: Array


def residual(
    p_world_m: Array, R_world_veh: Array, anchor_world_m: Array, range_m: ArrayLike,
    p_veh_tag_m: ArrayLike = (0.0, 0.0, 0.0), scale: float = 1.0, bias_m: ArrayLike = 0.0,
) -> RangeResidual:  # fmt: skip
    """Predicted minus measured range of poses (N, ...), anchors (N, 3) and ranges (N,)."""
    lever = np.asarray(p_veh_tag_m, float)
    distance, direction = distance_m(p_world_m + R_world_veh @ lever, anchor_world_m)
    error = scale * distance + np.asarray(bias_m, float) - np.asarray(range_m, float)
    by_tag = scale * direction[:, None, :]
    by_pose = np.concatenate([-by_tag @ R_world_veh @ skew(lever), by_tag @ R_world_veh], -1)
    return RangeResidual(error[:, None], by_pose, distance[:, None, None], np.eye(1), by_tag)


def distance_m(tag_world_m: Array, anchor_world_m: Array) -> tuple[Array, Array]:
    """Distances (N,) of tags (N, 3) from anchors (N, 3), and unit vectors (N, 3) towards the tags;
    these are zero where both are at one point."""
    apart = tag_world_m - anchor_world_m
    distance = np.linalg.norm(apart, axis=-1)
    direction = apart / np.maximum(distance, LEAST_M)[:, None]
    return distance, np.where(distance[:, None] > LEAST_M, direction, 0.0)


def range_factor(
    pose_key: int, anchor_key: int, range_m: float, p_veh_tag_m: ArrayLike,
    model: gtsam.noiseModel.Base,
) -> gtsam.RangeFactorWithTransform3D:  # fmt: skip
    """The native factor of `residual` without scale and bias; the anchor is a Point3 variable."""
    import gtsam

    T_veh_tag = gtsam.Pose3(gtsam.Rot3(), np.asarray(p_veh_tag_m, float))
    return gtsam.RangeFactorWithTransform3D(pose_key, anchor_key, range_m, model, T_veh_tag)


def biased_range_factor(
    pose_key: int, anchor_key: int, bias_key: int, range_m: float, p_veh_tag_m: ArrayLike,
    model: gtsam.noiseModel.Base,
) -> gtsam.RangeFactorWithTransformBias3D:  # fmt: skip
    """The native factor of `residual` with the bias as a variable, a number. GTSAM for Python has
    none with a scale: `fgloc.smoother.ranges` solves for it."""
    import gtsam

    T_veh_tag = gtsam.Pose3(gtsam.Rot3(), np.asarray(p_veh_tag_m, float))
    return gtsam.RangeFactorWithTransformBias3D(
        pose_key, anchor_key, bias_key, range_m, model, T_veh_tag
    )
