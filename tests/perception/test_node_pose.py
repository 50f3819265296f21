"""Poses of a swaying node: exact where input is exact, and covariances that noise confirms."""

import sys
from pathlib import Path

import numpy as np
import pytest

from fgloc.errors import InputError
from fgloc.frames import exp_so3, log_so3
from fgloc.infrastructure import Node
from fgloc.perception.node_pose import (
    SensorPose,
    pose_from_clouds,
    pose_from_points,
    project,
    sway,
)

FOCAL_PX, PRINCIPAL_PX, SIGMA_PX = 1144.0, (960.0, 600.0), 1.0
RANGE_SIGMA_M, STEP_RAD = 0.03, np.deg2rad(0.2)
NODE = Node("isn-1", np.array([10.0, 5.0, 10.0]), np.pi / 2)
SCANS = Path(__file__).parents[2] / "../shared/data/lidar_pair_small_gicp"
RNG = np.random.default_rng(0)
CORNERS = np.column_stack([RNG.uniform(25, 60, 24), RNG.uniform(-20, 20, 24),
                           RNG.uniform(0, 14, 24)]) + [10.0, 5.0, 0.0]  # fmt: skip
"""Edges of buildings, 25 to 60 m to the East of the node."""


def camera(moved_m=(0.0, 0.0, 0.0), turned_rad=(0.0, 0.0, 0.0)) -> SensorPose:
    """A camera at the node that looks East and a little down, once it has moved and turned."""
    looking = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # right, down, ahead in world
    R = exp_so3(np.array(turned_rad)) @ exp_so3(np.array([0, 0.1, 0])) @ looking
    return SensorPose(R, NODE.p_world_m + moved_m, np.zeros((6, 6)))


def error(found: SensorPose, true: SensorPose) -> np.ndarray:
    turn = log_so3(found.R_world_sensor @ true.R_world_sensor.T)
    return np.concatenate([found.p_world_m - true.p_world_m, turn])


def mean_nees(errors: list[np.ndarray], covs: list[np.ndarray]) -> float:
    parts = [e @ np.linalg.solve(cov, e) for e, cov in zip(errors, covs, strict=True)]
    return float(np.mean(parts)) / 6


def test_exact_pixels_give_the_pose_exactly():
    true = camera((0.1, -0.15, 0.0), (0.02, 0.014, 0.0))
    pixels = project(true, CORNERS, FOCAL_PX, PRINCIPAL_PX)
    found = pose_from_points(CORNERS, pixels, FOCAL_PX, PRINCIPAL_PX, SIGMA_PX)
    np.testing.assert_allclose(error(found, true), 0, atol=1e-5)


@pytest.mark.parametrize("sigma_world_m", [0.0, RANGE_SIGMA_M])
def test_noise_of_pixels_and_points_confirms_the_covariance_of_pnp(sigma_world_m):
    rng, true = np.random.default_rng(1), camera((0.1, 0, 0), (0, 0.01, 0))
    pixels = project(true, CORNERS, FOCAL_PX, PRINCIPAL_PX)
    errors, covs = [], []
    for _ in range(300):
        seen = pixels + SIGMA_PX * rng.standard_normal(pixels.shape)
        points = CORNERS + sigma_world_m * rng.standard_normal(CORNERS.shape)
        found = pose_from_points(points, seen, FOCAL_PX, PRINCIPAL_PX, SIGMA_PX, sigma_world_m)
        errors.append(error(found, true))
        covs.append(found.cov)
    # Of 300 means of six squares the mean is within 7 % of 1, at three sigmas of it 10 %.
    assert mean_nees(errors, covs) == pytest.approx(1.0, abs=0.1)
    np.testing.assert_allclose(np.std(errors, 0), np.sqrt(np.diag(covs[0])), rtol=0.2)


def test_too_few_points_and_points_in_a_line_are_refused():
    pixels = project(camera(), CORNERS, FOCAL_PX, PRINCIPAL_PX)
    with pytest.raises(InputError, match="needs 4 finite reference points, there are 3"):
        pose_from_points(CORNERS[:3], pixels[:3], FOCAL_PX, PRINCIPAL_PX, SIGMA_PX)
    with pytest.raises(InputError, match=r"expected \(N, 3\) and \(N, 2\)"):
        pose_from_points(CORNERS, pixels[:5], FOCAL_PX, PRINCIPAL_PX, SIGMA_PX)
    line = np.array([40.0, 5, 3]) + np.arange(6)[:, None] * np.array([0.0, 1, 0])
    seen = project(camera(), line, FOCAL_PX, PRINCIPAL_PX)
    with pytest.raises(InputError, match=r"leave the pose open|no pose explains"):
        pose_from_points(line, seen, FOCAL_PX, PRINCIPAL_PX, SIGMA_PX)


def house(rng: np.random.Generator, pose: SensorPose) -> np.ndarray:
    """Two walls and the ground as a LiDAR at the pose sees them, in its frame, range noise along
    each ray; the rays are as far apart as the thesis's, and jittered."""
    azimuth, elevation = np.meshgrid(
        np.arange(-0.5, 0.5, 4 * STEP_RAD), np.linspace(-0.5, 0.05, 25)
    )
    azimuth = azimuth + STEP_RAD * rng.uniform(-2, 2, azimuth.shape)
    ray = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth),
                    np.sin(elevation)], -1).reshape(-1, 3) @ pose.R_world_sensor.T  # fmt: skip
    walls = ((np.array([1.0, 0.4, 0]), 28.0), (np.array([1.0, -0.5, 0]), 30.0),
             (np.array([0, 0, -1.0]), 10.0))  # fmt: skip
    with np.errstate(divide="ignore"):
        ranges = np.array([(d - n @ pose.p_world_m) / (ray @ n) for n, d in walls])
    nearest = np.where(ranges > 0, ranges, np.inf).min(0)
    nearest = nearest + RANGE_SIGMA_M * rng.standard_normal(len(nearest))
    return (nearest[:, None] * ray) @ pose.R_world_sensor


def lidar(moved_m=(0.0, 0.0, 0.0), turned_rad=(0.0, 0.0, 0.0)) -> SensorPose:
    return SensorPose(exp_so3(np.array(turned_rad)), np.array(moved_m, float), np.zeros((6, 6)))


def test_noise_of_ranges_confirms_the_covariance_of_icp():
    rng, true = np.random.default_rng(2), lidar((0.1, -0.15, 0.0), (0.02, 0.014, 0.0))
    errors, covs = [], []
    for _ in range(16):
        found = pose_from_clouds(house(rng, lidar()), house(rng, true), RANGE_SIGMA_M)
        errors.append(error(found, true))
        covs.append(found.cov)
    # Six squares of 16 scans each: three sigmas of their mean are 0.43.
    assert mean_nees(errors, covs) == pytest.approx(1.0, abs=0.43)


def test_two_real_scans_are_matched_to_their_known_pose():
    if not SCANS.exists():
        pytest.skip("data not here")
    from fgloc.perception.point_clouds import import_open3d

    o3d = import_open3d()
    scans = [o3d.io.read_point_cloud(str(SCANS / f"{name}.ply")).voxel_down_sample(0.25)
             for name in ("target", "source")]  # fmt: skip
    true = np.loadtxt(SCANS / "T_target_source.txt")
    target, source = (np.asarray(scan.points) for scan in scans)
    found = pose_from_clouds(target, source, RANGE_SIGMA_M)
    off = error(found, SensorPose(true[:3, :3], true[:3, 3], np.zeros((6, 6))))
    # Plain ICP is known to reach 0.009 m and 0.29 deg on this pair.
    assert np.linalg.norm(off[:3]) < 0.012
    assert np.linalg.norm(off[3:]) < np.deg2rad(0.35)


def test_one_wall_or_a_far_cloud_is_refused():
    rng = np.random.default_rng(3)
    wall = np.column_stack([np.full(500, 20.0), rng.uniform(-5, 5, (500, 2))])
    with pytest.raises(InputError, match="leave the pose open"):
        pose_from_clouds(wall, wall, RANGE_SIGMA_M)
    with pytest.raises(InputError, match=r"0 of 500 points have a partner within 0.5 m"):
        pose_from_clouds(wall, wall + [5, 0, 0], RANGE_SIGMA_M)
    with pytest.raises(InputError, match=r"shape \(500, 2\)"):
        pose_from_clouds(wall, wall[:, :2], RANGE_SIGMA_M)


def test_a_missing_open3d_is_told_with_its_remedy(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(InputError, match=r"pip install 'fgloc\[lidar\]'"):
        pose_from_clouds(np.zeros((5, 3)), np.zeros((5, 3)), RANGE_SIGMA_M)


def test_a_pose_becomes_displacement_and_tilt_along_the_nodes_axes():
    # The node looks North: a step to the East is one to its right, minus y; a turn about East,
    # which lowers what lies North, is one about minus y, a pitch up.
    cov = np.diag([1.0, 4, 9, 16, 25, 36])
    moved = camera((0.1, 0.2, 0.0), (0.01, 0.0, 0.0))
    told = sway([SensorPose(moved.R_world_sensor, moved.p_world_m, cov)], camera(), NODE, 3,
                np.array([7]))  # fmt: skip
    np.testing.assert_allclose(told.p_node_m, [[0.2, -0.1]], atol=1e-12)
    np.testing.assert_allclose(told.tilt_rad, [[0.0, -0.01]], atol=1e-12)
    np.testing.assert_allclose(told.sigma_p_m, [[2, 1]])
    np.testing.assert_allclose(told.sigma_tilt_rad, [[5, 4]])
    assert told.node.tolist() == [3]
