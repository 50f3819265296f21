"""The sway scenarios: the motion that the paper reports, and noise of the size it reports."""

import numpy as np
import pytest

from fgloc.datasets import make
from fgloc.datasets.drive_folder import read_drive, write_drive
from fgloc.datasets.khamooshi2023_sway import START_NS
from fgloc.datasets.khamooshi2023_sway_drive import oval_motion
from fgloc.datasets.simulator import instants
from fgloc.datasets.wind import gusts, kaimal, sines
from fgloc.errors import InputError
from fgloc.factors.post import oscillator

LOW, HIGH = "khamooshi2023/sway-low", "khamooshi2023/sway-high"


@pytest.mark.parametrize("name", [LOW, HIGH])
def test_the_tip_moves_by_ten_and_fifteen_centimetres(name):
    truth = make(name, 3, duration_s=20.0).post_truth
    np.testing.assert_allclose(np.abs(truth.p_node_m).max(0), [0.10, 0.15])
    np.testing.assert_allclose(truth.tilt_rad[:, 1], 0.13765 * truth.p_node_m[:, 0], rtol=1e-4)
    np.testing.assert_allclose(truth.tilt_rad[:, 0], -0.13765 * truth.p_node_m[:, 1], rtol=1e-4)


@pytest.mark.parametrize(("name", "largest_m"), [(LOW, (0.04, 0.06)), (HIGH, (0.03, 0.07))])
def test_the_estimates_alone_err_as_the_paper_reports(name, largest_m):
    errors, angles = [], []
    for seed in range(7):
        drive = make(name, seed)
        poses, truth = drive.tables["node_poses"], drive.post_truth.take(slice(None, None, 20))
        errors.append(np.abs(poses.p_node_m - truth.p_node_m).max(0))
        angles.append(np.abs(poses.tilt_rad - truth.tilt_rad).max(0))
    np.testing.assert_allclose(np.median(errors, 0), largest_m, rtol=0.15)
    np.testing.assert_allclose(np.median(angles, 0), 0.02 * 0.13765 * np.array([0.15, 0.1]),
                               rtol=0.15)  # fmt: skip


def test_the_velocity_is_that_of_the_displacement():
    truth = make(HIGH, 1, duration_s=5.0).post_truth
    moved = (truth.p_node_m[2:] - truth.p_node_m[:-2]) * 100
    # A central difference over 10 ms errs by a sixth of (w dt)^2, at 10 Hz by 1.6 %.
    np.testing.assert_allclose(moved, truth.v_node_mps[1:-1], atol=0.01)


def test_a_load_answers_as_the_oscillator_amplifies():
    drive = make(LOW, 0)
    spectrum = np.abs(np.fft.rfft(drive.post_truth.p_node_m[:-1, 0]))
    half, one = spectrum[30], spectrum[60]  # of 60 s, at 0.5 and 1 Hz
    assert spectrum.sum() == pytest.approx(half + one, rel=0.02)
    A = oscillator(drive.infrastructure.posts[0].frequency_hz, 0.05)
    answer = [abs(np.linalg.inv(2j * np.pi * f * np.eye(2) - A)[0, 1]) for f in (0.5, 1.0)]
    assert half / one == pytest.approx(answer[0] / answer[1], rel=1e-3)


def test_gusts_have_their_spectrum():
    rng = np.random.default_rng(0)
    power = np.mean([np.abs(np.fft.rfft(gusts(2000, 20, rng)[:, 0])) ** 2 for _ in range(200)], 0)
    frequency_hz = np.fft.rfftfreq(2000, 1 / 20)
    share = power[1:-1] / kaimal(frequency_hz[1:-1])
    low, high = share[:300].mean(), share[-300:].mean()
    assert low / high == pytest.approx(1.0, abs=0.03)
    # Twelve times slower to fall than flat, then with the power of minus five thirds.
    assert kaimal(np.array([30.0]))[0] / kaimal(np.array([3.0]))[0] == pytest.approx(
        10 ** (-5 / 3), rel=0.03
    )


def test_ten_hertz_look_like_standing_still_to_ten_samples_a_second():
    load = sines(np.arange(100) / 10, (10.0,), np.random.default_rng(0))
    np.testing.assert_allclose(load, load[:1] * np.ones((100, 1)), atol=1e-9)


def test_seeds_and_options_make_the_drive():
    one, again, other = make(LOW, 1), make(LOW, 1), make(LOW, 2)
    assert one.post_truth.same_as(again.post_truth)
    assert not one.post_truth.same_as(other.post_truth)
    assert not make(LOW, 1, wind="kaimal").post_truth.same_as(one.post_truth)
    worse = make(LOW, 1, tilt_noise=10.0).tables["node_poses"]
    np.testing.assert_allclose(worse.sigma_tilt_rad, 10 * one.tables["node_poses"].sigma_tilt_rad)
    np.testing.assert_array_equal(worse.p_node_m, one.tables["node_poses"].p_node_m)


@pytest.mark.parametrize(
    ("options", "says"),
    [({"wind": "storm"}, "expected one of sines, kaimal"), ({"duration_s": 0.1}, "duration_s"),
     ({"tilt_noise": -1.0}, "a factor above 0")],
)  # fmt: skip
def test_options_that_cannot_be_are_refused(options, says):
    with pytest.raises(InputError, match=says):
        make(LOW, 0, **options)


def test_a_drive_without_a_vehicle_is_written_and_read(tmp_path):
    drive = make(HIGH, 4, duration_s=2.0)
    write_drive(drive, tmp_path / "sway")
    back = read_drive(tmp_path / "sway")
    assert back.tables["node_poses"].same_as(drive.tables["node_poses"])
    assert back.post_truth.same_as(drive.post_truth)
    assert back.infrastructure.posts == drive.infrastructure.posts


DRIVE = "khamooshi2023/sway-drive"


def test_the_oval_is_a_motion_that_fits_itself():
    motion = oval_motion(instants(START_NS, 60.0, 100), 0.3)
    for value, rate in ((motion.p_world_m, motion.v_world_mps),
                        (motion.v_world_mps, motion.a_world_mps2),
                        (motion.w_veh_radps, motion.wdot_veh_radps2)):  # fmt: skip
        np.testing.assert_allclose((value[2:] - value[:-2]) * 50, rate[1:-1], atol=1e-3)
    ahead = motion.R_world_veh[:, :, 0]
    speed = np.linalg.norm(motion.v_world_mps, axis=-1)
    np.testing.assert_allclose(ahead * speed[:, None], motion.v_world_mps, atol=1e-9)
    np.testing.assert_allclose([speed.min(), speed.max()], [2.25, 9.75], atol=0.01)


@pytest.mark.parametrize(("sensor", "far_m"), [("camera", 1.0), ("lidar", 0.01)])
def test_sway_shifts_what_a_camera_sees_far_away_most(sensor, far_m):
    swaying, still = (make(DRIVE, 2, sensor=sensor, sways=sways).tables["detections"]
                      for sways in (True, False))  # fmt: skip
    shift = np.linalg.norm(swaying.p_node_m - still.p_node_m, axis=-1)
    range_m = np.linalg.norm(still.p_node_m, axis=-1)
    assert np.sqrt(np.mean(shift[range_m > 55] ** 2)) > far_m
    assert np.sqrt(np.mean(shift[range_m < 15] ** 2)) < 0.25


def test_without_sway_the_detections_scatter_as_they_state():
    drive = make(DRIVE, 3, sways=False)
    seen, truth = drive.tables["detections"], drive.truth.take(slice(None, None, 2))
    box = truth.at_point(drive.rig.p_veh_box_m).p_world_m[:, :2]
    off = seen.p_node_m - drive.infrastructure.nodes[0].from_world(box)
    squares = np.einsum("ni,nij,nj->n", off, np.linalg.inv(seen.cov_node_m2), off)
    assert squares.mean() / 2 == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("sways", [True, False])
def test_a_lidar_tells_how_a_tilt_lifts_what_it_sees(sways):
    drive = make(DRIVE, 3, sensor="lidar", sways=sways)
    seen, true = drive.tables["detections"], drive.post_truth.take(slice(None, None, 20))
    assert seen.has_height.all()
    lifted = seen.p_node_m[:, 0] * true.tilt_rad[:, 1] - seen.p_node_m[:, 1] * true.tilt_rad[:, 0]
    off = (seen.up_node_m + drive.infrastructure.nodes[0].p_world_m[2] - lifted) / seen.sigma_up_m
    assert np.mean(off**2) == pytest.approx(1.0, abs=0.1)
    assert (np.abs(lifted).max() > 0.3) == sways


def test_heights_leave_all_else_as_it_is():
    high, flat = (make(DRIVE, 3, duration_s=5.0, sensor="lidar", users=2, heights=told)
                  for told in (True, False))  # fmt: skip
    assert not flat.tables["detections"].has_height.any()
    for name, column in (("detections", "p_node_m"), ("users", "p_world_m"), ("gnss", "t_ns"),
                         ("gnss", "p_world_ant_m"), ("imu", "gyro_radps")):  # fmt: skip
        np.testing.assert_array_equal(*(getattr(one.tables[name], column) for one in (high, flat)))
    users = high.tables["users"]
    assert np.mean((users.up_m / users.sigma_up_m) ** 2) == pytest.approx(1.0, abs=0.4)


def test_a_camera_tells_no_heights_nor_do_the_users_it_sees():
    drive = make(DRIVE, 3, duration_s=2.0, users=1)
    assert not drive.tables["detections"].has_height.any()
    assert np.isnan(drive.tables["users"].up_m).all()


def test_the_drive_is_written_and_read_with_its_sensor(tmp_path):
    drive = make(DRIVE, 1, duration_s=2.0, poses=False)
    assert "node_poses" not in drive.tables
    write_drive(drive, tmp_path / "drive")
    back = read_drive(tmp_path / "drive")
    assert back.infrastructure.nodes[0].sensor == "camera"
    assert back.tables["detections"].same_as(drive.tables["detections"])


@pytest.mark.parametrize(
    ("options", "says"),
    [({"sensor": "radar"}, "camera, lidar"), ({"gnss_sigma_m": 0.0}, "above 0")],
)
def test_a_drive_that_cannot_be_is_refused(options, says):
    with pytest.raises(InputError, match=says):
        make(DRIVE, 0, **options)
