"""Where a node on a swaying post is: from points in its image, from a LiDAR scan, or from both.

Khamooshi (2023), section 3.5: PnP on surveyed points (3.5.1), ICP of a landmark's points against
those of the calibrated node (3.5.2), PnP with points that a LiDAR measured (3.5.3). Each pose comes
with the covariance that the noise of its input gives it to first order; `sway` turns it into what
the post's estimators take, displacement and tilt against the survey.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fgloc.errors import InputError
from fgloc.frames import is_rotation, log_so3, skew
from fgloc.infrastructure import Node
from fgloc.measurements import Array, NodePoses
from fgloc.perception.point_clouds import import_open3d
from fgloc.timing import Instants

LEAST_POINTS = 4
"""Three leave up to four poses."""
LEAST_MATCHES = 20
NORMAL_NEIGHBOURS = 20
FLAT_SHARE = 0.1
"""Neighbours lie in a plane where they spread across it by less than this share of the variance of
their smaller spread along it."""
TUKEY_SIGMAS = 6.0
_OPEN = 1e10
"""Condition number of the normal equations above which some motion is not seen."""
_ROTATION_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class SensorPose:
    """A sensor's pose, x_world = R_world_sensor x_sensor + p_world_m.

    cov  (6, 6) of position (m), then of the small rotation vector (rad) that turns the attitude
         from the world side
    """

    R_world_sensor: Array
    p_world_m: Array
    cov: Array


def project(pose: SensorPose, p_world_m: Array, focal_px: float, principal_px: ArrayLike) -> Array:
    """Pixels (N, 2) of points (N, 3); the camera's axes are right, down, ahead."""
    p = (p_world_m - pose.p_world_m) @ pose.R_world_sensor
    return np.asarray(focal_px * p[:, :2] / p[:, 2:] + np.asarray(principal_px, float))


def pose_from_points(
    p_world_m: ArrayLike, seen_px: ArrayLike, focal_px: float, principal_px: ArrayLike,
    sigma_px: float, sigma_world_m: float = 0.0,
) -> SensorPose:  # fmt: skip
    """The camera that sees points (N, 3) at pixels (N, 2): SQPNP, then least squares of the pixels.

    sigma_px       of a pixel, along each axis
    sigma_world_m  of a point, along each axis: 0 for a survey, the LiDAR's where it measured them

    Raises InputError for fewer than four points, shapes that do not fit, or points that no pose
    explains or that leave one open, as those in a line do.
    """
    world, pixels = np.asarray(p_world_m, float), np.asarray(seen_px, float)
    if world.shape != (len(pixels), 3) or pixels.shape != (len(world), 2):
        raise InputError(
            f"points of shape {world.shape} and pixels of shape {pixels.shape}: expected (N, 3) "
            "and (N, 2)"
        )
    if len(world) < LEAST_POINTS or not np.isfinite(np.hstack([world, pixels])).all():
        raise InputError(
            f"a pose needs {LEAST_POINTS} finite reference points, there are {len(world)}"
        )
    pose = _solved(world, pixels, focal_px, principal_px)
    return replace(pose, cov=_pnp_cov(pose, world, focal_px, sigma_px, sigma_world_m))


def _solved(world: Array, pixels: Array, focal_px: float, principal_px: ArrayLike) -> SensorPose:
    import cv2

    centre = world.mean(0)  # far from the origin single digits of a rotation are lost
    u, v = np.asarray(principal_px, float)
    K = np.array([[focal_px, 0, u], [0, focal_px, v], [0, 0, 1.0]])
    try:
        found, turn, place = cv2.solvePnP(world - centre, pixels, K, None, flags=cv2.SOLVEPNP_SQPNP)
        turn, place = cv2.solvePnPRefineLM(world - centre, pixels, K, None, turn, place)
    except cv2.error as err:
        raise InputError(f"no pose explains the {len(world)} reference points") from err
    if not found or not np.isfinite([turn, place]).all():
        raise InputError(f"no pose explains the {len(world)} reference points")
    R = cv2.Rodrigues(turn)[0].T
    return SensorPose(R, centre - R @ place[:, 0], np.zeros((6, 6)))


def _pnp_cov(
    pose: SensorPose, world: Array, focal_px: float, sigma_px: float, sigma_world_m: float
) -> Array:
    """What noise of pixels and points does to plain least squares of the pixels."""
    arm = world - pose.p_world_m
    p = arm @ pose.R_world_sensor
    by_sensor = np.zeros((len(p), 2, 3))
    by_sensor[:, [0, 1], [0, 1]] = (focal_px / p[:, 2])[:, None]
    by_sensor[:, :, 2] = -focal_px * p[:, :2] / p[:, 2:] ** 2
    by_world = by_sensor @ pose.R_world_sensor.T
    J = np.concatenate([-by_world, by_world @ skew(arm)], -1)
    noise = sigma_px**2 * np.eye(2) + sigma_world_m**2 * by_world @ by_world.swapaxes(-1, -2)
    length_m = float(np.linalg.norm(arm, axis=-1).mean())
    inverse = _inverse(np.einsum("nij,nik->jk", J, J), length_m, "the reference points")
    return np.asarray(inverse @ np.einsum("nij,nik,nkl->jl", J, noise, J) @ inverse)


def pose_from_clouds(
    calibrated_m: ArrayLike, seen_m: ArrayLike, sigma_m: float, *, reach_m: float = 0.5,
    guess: Array | None = None,
) -> SensorPose:  # fmt: skip
    """The sensor against where it was calibrated, from points (N, 3) then and points (M, 3) now.

    Point-to-plane ICP of Open3D on the calibrated points that have a flat neighbourhood: plain at
    first, then with Tukey's loss, so that what has no true partner does not pull. "World" of the
    pose is the calibrated sensor's frame.

    sigma_m  of a point along its surface's normal
    reach_m  points further from any calibrated one have no partner
    guess    (4, 4) first pose, by default that of the calibration

    The covariance takes the noise of both clouds for white. Raises InputError where too few points
    match or they leave the pose open, as a single clean wall does.
    """
    o3d = import_open3d()
    target, source = _flat_part(o3d, _cloud(o3d, calibrated_m)), _cloud(o3d, seen_m)
    T = np.eye(4) if guess is None else np.asarray(guess, float)
    matching = o3d.pipelines.registration
    ending = matching.ICPConvergenceCriteria(1e-9, 1e-9, 100)
    for loss in (matching.L2Loss(), matching.TukeyLoss(TUKEY_SIGMAS * sigma_m)):
        way = matching.TransformationEstimationPointToPlane(loss)
        found = matching.registration_icp(source, target, reach_m, T, way, ending)
        T = np.asarray(found.transformation)
    pairs = np.asarray(found.correspondence_set)
    normals = np.asarray(target.normals)[pairs[:, 1]]
    arm = np.asarray(source.points)[pairs[:, 0]] @ T[:3, :3].T
    off = ((arm + T[:3, 3] - np.asarray(target.points)[pairs[:, 1]]) * normals).sum(-1)
    near = np.abs(off) < TUKEY_SIGMAS * sigma_m
    if near.sum() < LEAST_MATCHES:
        raise InputError(
            f"{near.sum()} of {len(source.points)} points have a partner within {reach_m:g} m; "
            f"{LEAST_MATCHES} are needed: give a nearer guess or a longer reach_m"
        )
    cov = _icp_cov(normals[near], arm[near], pairs[near, 1], sigma_m)
    return SensorPose(T[:3, :3], T[:3, 3], cov)


def _icp_cov(normals: Array, arm: Array, partner: Array, sigma_m: float) -> Array:
    """Of the source's noise, one for each pair, and of the target's, one for each partner."""
    J = np.concatenate([normals, np.cross(arm, normals)], -1)
    inverse = _inverse(J.T @ J, float(np.abs(arm).mean()), "the landmark's points")
    of_partner = np.zeros((int(partner.max()) + 1, 6))
    np.add.at(of_partner, partner.astype(np.intp), J)
    return np.asarray(sigma_m**2 * (inverse + inverse @ (of_partner.T @ of_partner) @ inverse))


def _cloud(o3d: Any, points_m: ArrayLike) -> Any:
    points = np.asarray(points_m, float)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise InputError(f"a cloud of shape {points.shape}: expected finite numbers (N, 3)")
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))


def _flat_part(o3d: Any, cloud: Any) -> Any:
    """The points whose neighbours lie in a plane, with its normal: at an edge there is none."""
    near = o3d.geometry.KDTreeSearchParamKNN(NORMAL_NEIGHBOURS)
    cloud.estimate_normals(near)
    cloud.estimate_covariances(near)
    spread = np.linalg.eigvalsh(np.asarray(cloud.covariances))
    return cloud.select_by_index(np.flatnonzero(spread[:, 0] < FLAT_SHARE * spread[:, 1]))


def _inverse(information: Array, arm_m: float, what: str) -> Array:
    """Inverse (6, 6); InputError where a motion of the sensor is not seen. Turns count by what they
    move at the length of an arm."""
    scale = np.repeat([1.0, arm_m], 3)
    if np.linalg.cond(information / np.outer(scale, scale)) > _OPEN:
        raise InputError(f"{what} leave the pose open: add some that are not in a line or plane")
    return np.asarray(np.linalg.inv(information))


def sway(
    poses: Sequence[SensorPose], calibrated: SensorPose, node: Node, number: int, t_ns: Instants
) -> NodePoses:
    """Poses of a node's sensor as what a post's estimators take: displacement and tilt.

    `calibrated` is the sensor's pose when the node was surveyed. The tilt turns the node about its
    level axes; a turn about the upright is no sway and is left out. Of the covariance the variances
    are kept. Raises InputError where an attitude is no rotation.
    """
    R_node_world = np.eye(3)
    R_node_world[:2, :2] = node.R_world_node.T
    R = np.array([pose.R_world_sensor for pose in poses])
    if not is_rotation(R, _ROTATION_TOLERANCE).all():
        raise InputError("the attitude of a pose is not a rotation matrix")
    moved = np.array([pose.p_world_m for pose in poses]) - calibrated.p_world_m
    turned = log_so3(R @ calibrated.R_world_sensor.T)
    both = np.kron(np.eye(2), R_node_world)
    cov = both @ np.array([pose.cov for pose in poses]) @ both.T
    sigma = np.sqrt(np.diagonal(cov, axis1=-2, axis2=-1))
    return NodePoses(
        t_ns, t_ns, np.full(len(R), number), (moved @ R_node_world.T)[:, :2],
        (turned @ R_node_world.T)[:, :2], sigma[:, :2], sigma[:, 3:5],
    )  # fmt: skip
