"""The scenarios of Marr (2019): what is seen fits the truth, and errors grow as the thesis says."""

import dataclasses

import numpy as np
import pytest

from fgloc.datasets.drive_folder import read_drive, write_drive
from fgloc.datasets.lane_motion import LaneChange, lane_motion
from fgloc.datasets.marr2019_iea import P_VEH_ANT_M, calibration_set, iea_motion
from fgloc.datasets.marr2019_smart_code import LANES_M, SIGNS
from fgloc.datasets.registry import make
from fgloc.datasets.road_camera import PostCamera
from fgloc.errors import InputError
from fgloc.factors.smart_code import Reading, head_on, locate
from fgloc.timing import NS_PER_S


@pytest.fixture(scope="module")
def iea():
    return make("marr2019/iea", 0)


def errors_by_distance(drive, node=0):
    """Error and distance from the camera, in m, of one camera's detections."""
    seen, post = drive.tables["detections"], drive.infrastructure.nodes[node]
    mine = seen.take(seen.node == node)
    true = drive.truth.at_point(P_VEH_ANT_M).at(mine.t_ns).p_world_m[:, :2]
    error = post.to_world(mine.p_node_m) - true
    return error, np.linalg.norm(true - post.p_world_m[:2], axis=1), mine.cov_node_m2


def test_velocity_and_turn_are_the_derivatives_of_the_motion():
    t_ns = np.arange(0, 8 * NS_PER_S, NS_PER_S // 1000)
    motion = lane_motion(t_ns, np.zeros(3), 0.7, 10.0, [LaneChange(1.0, 3.0, 3.5)])
    v = np.gradient(motion.p_world_m, 1e-3, axis=0)[2:-2]
    np.testing.assert_allclose(motion.v_world_mps[2:-2], v, atol=1e-4)
    yaw = np.unwrap(np.arctan2(motion.v_world_mps[:, 1], motion.v_world_mps[:, 0]))
    rate = np.gradient(yaw, 1e-3)
    np.testing.assert_allclose(motion.w_veh_radps[2:-2, 2], rate[2:-2], atol=1e-3)
    a = np.gradient(motion.v_world_mps, 1e-3, axis=0)
    np.testing.assert_allclose(motion.a_world_mps2[2:-2], a[2:-2], atol=1e-2)
    turn_rate = np.gradient(motion.w_veh_radps[:, 2], 1e-3)
    within = slice(1010, 3990)  # it jumps where the lane change begins and ends
    np.testing.assert_allclose(motion.wdot_veh_radps2[within, 2], turn_rate[within], atol=1e-3)


def test_a_lane_change_ends_in_the_other_lane():
    t_ns = np.array([0, 5 * NS_PER_S])
    motion = lane_motion(t_ns, np.zeros(3), -np.pi / 2, 10.0, [LaneChange(1.0, 3.0, 3.5)])
    np.testing.assert_allclose(motion.p_world_m[1], [3.5, -50, 0], atol=1e-12)


def test_a_camera_that_looks_south_has_the_west_on_its_right_and_the_ground_below():
    camera = PostCamera((0, 0, 10), -np.pi / 2, 0.0, 1000.0, (1920, 1080))
    px, depth = camera.project(np.array([[0.0, -50, 10], [-5, -50, 10], [0, -50, 0]]))
    np.testing.assert_allclose(px, [[960, 540], [1060, 540], [960, 740]])
    np.testing.assert_allclose(depth, 50)


def test_the_car_changes_lanes_heading_south_for_200_m():
    p = iea_motion(3).p_world_m
    assert p[0, 1] - p[-1, 1] == pytest.approx(200)
    assert np.ptp(p[:, 0]) == pytest.approx(3.6, abs=1e-6)


def test_detections_err_as_in_figure_2_9(iea):
    error, distance_m, _ = errors_by_distance(iea)
    size = np.linalg.norm(error, axis=1)
    near, middle, far = (
        size[(distance_m >= low) & (distance_m < high)]
        for low, high in ((0, 50), (50, 100), (100, 300))
    )
    assert np.mean(near < 1) > 0.8
    assert 0.4 < np.mean(middle < 1) < np.mean(near < 1)
    assert far.max() > 5


def test_the_covariance_learnt_from_the_calibration_is_that_of_the_errors():
    nees = []
    for seed in range(4):
        drive = make("marr2019/iea", seed)
        for node in range(2):
            error, _, cov = errors_by_distance(drive, node)
            nees.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(cov), error) / 2)
    assert 0.5 < np.concatenate(nees).mean() < 1.6


def test_both_cameras_see_the_car_and_messages_arrive_late(iea):
    seen = iea.tables["detections"]
    assert set(seen.node) == {0, 1}
    assert (seen.received_ns - seen.t_ns == 50_000_000).all()


def test_the_calibration_drive_is_not_that_of_another_seed_or_camera():
    sizes = {len(calibration_set(seed, i, 3)) for seed in range(3) for i in range(2)}
    assert len(sizes) > 4


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("marr2019/iea", {"calibration_passes": 4}),
        ("marr2019/smart-code", {"path": "near"}),
        ("marr2019/smart-code", {"corners": True}),
    ],
)
def test_a_drive_is_the_same_from_its_seed_and_after_a_folder(tmp_path, name, options):
    drive = make(name, 5, **options)
    again = make(name, 5, **options)
    write_drive(drive, tmp_path / "drive")
    for other in (again, read_drive(tmp_path / "drive")):
        assert all(drive.tables[kind].same_as(other.tables[kind]) for kind in drive.tables)
        assert drive.truth.same_as(other.truth)
    assert not drive.gnss.same_as(make(name, 6, **options).gnss)


@pytest.mark.parametrize(
    ("name", "options", "says"),
    [
        ("marr2019/iea", {"calibration_passes": 1}, "calibration_passes = 1"),
        ("marr2019/iea", {"power": 1.0}, "power = 1.0"),
        ("marr2019/smart-code", {"path": "midle"}, "the nearest is 'middle'"),
        ("marr2019/smart-code", {"camera_yaw_deg": 90.0}, "camera_yaw_deg = 90"),
        ("marr2019/smart-code", {"corner_sigma_px": -1.0}, "corner_sigma_px = -1"),
    ],
)
def test_options_that_make_no_sense_are_refused(name, options, says):
    with pytest.raises(InputError, match=says):
        make(name, 0, **options)


def locate_all(drive):
    """Positions found by the camera's sightings, the true ones, and the sightings' signs."""
    seen, camera = drive.tables["smart_codes"], drive.rig.camera
    stamps, row = np.unique(seen.t_ns, return_inverse=True)
    true = drive.truth.at_point(camera.p_veh_cam_m).at(stamps).p_world_m[row]
    size_m, above_m = np.array(
        [(SIGNS[i].size_m, SIGNS[i].p_world_m[2] - camera.p_veh_cam_m[2]) for i in seen.sign]
    ).T
    distances = head_on(seen.height_px, seen.width_px, seen.centre_px, size_m, camera.focal_px,
                        camera.principal_px)  # fmt: skip
    found = locate(distances, above_m, False)
    p = [SIGNS[i].R_world_sign @ p + SIGNS[i].p_world_m[:2]
         for i, p in zip(seen.sign, found.p_sign_m, strict=True)]  # fmt: skip
    return found, np.array(p), true, seen.sign


@pytest.mark.parametrize("path", LANES_M)
@pytest.mark.parametrize("yaw_deg", [0.0, 30.0])
def test_without_noise_the_geometry_finds_the_camera(path, yaw_deg):
    drive = make("marr2019/smart-code", 0, path=path, camera_yaw_deg=yaw_deg,
                 corner_sigma_px=0.0, quantised=False)  # fmt: skip
    found, p, true, sign = locate_all(drive)
    far = found.range_m > 8  # nearer, the code's own size is no longer small
    range_m = np.linalg.norm(true - [SIGNS[i].p_world_m for i in sign], axis=1)
    np.testing.assert_allclose(found.range_m[far], range_m[far], atol=0.05)
    across = found.status == Reading.POSITION
    # Right in front of a sign its width hardly changes, so a position needs a side to it.
    aside = across & far & (np.abs(true[:, 0] - [SIGNS[i].p_world_m[0] for i in sign]) > 2)
    np.testing.assert_allclose(p[aside], true[aside, :2], atol=0.3)


def test_whole_pixels_lay_far_positions_on_a_few_straight_lines():
    drive = make("marr2019/smart-code", 0, path="near", camera_yaw_deg=0.0)
    seen = drive.tables["smart_codes"].take(drive.tables["smart_codes"].sign == 0)
    far = seen.height_px < 50
    lines = np.unique((seen.height_px - seen.width_px)[far])
    assert set(lines) <= {-1, 0, 1, 2}
    assert np.unique(make("marr2019/smart-code", 0, path="near", camera_yaw_deg=0.0,
                          quantised=False).tables["smart_codes"].width_px).size > 100  # fmt: skip


def test_corners_are_told_where_asked_for_and_change_nothing_else():
    plain, cornered = (make("marr2019/smart-code", 3, corners=told).tables["smart_codes"]
                       for told in (False, True))  # fmt: skip
    assert not plain.has_corners.any()
    assert cornered.has_corners.all()
    assert plain.same_as(dataclasses.replace(cornered, corners_px=plain.corners_px))
    np.testing.assert_allclose(cornered.centre_px, cornered.corners_px.mean(1))
    true = make("marr2019/smart-code", 3, corners=True, corner_sigma_px=0.0).tables["smart_codes"]
    # Noise may end the reading a frame earlier or later, but not of what is read in both.
    assert np.std(cornered.corners_px - true.corners_px) == pytest.approx(0.15, rel=0.05)


def test_small_signs_are_read_less_far_than_the_large_one():
    drive = make("marr2019/smart-code", 0, path="middle")
    found, _, _, sign = locate_all(drive)
    assert found.range_m[sign == 0].max() > 1.8 * found.range_m[sign != 0].max()
