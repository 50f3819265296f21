"""The simulated city drive: its truth, its sensors and their noise fit one another."""

import dataclasses

import numpy as np
import pytest

from fgloc import frames
from fgloc.datasets import city
from fgloc.datasets.city import ORIGIN, city_motion, city_rig, make_city
from fgloc.datasets.simulator import Motion, imu_errors, instants, predict_imu, simulate_imu, stream
from fgloc.drive import Rig
from fgloc.errors import InputError

GRAVITY_MPS2 = ORIGIN.gravity_mps2()


def imu_states(motion: Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Attitude, position and velocity of the IMU itself."""
    T = city_rig().T_veh_imu
    R, arm = motion.R_world_veh, T[:3, 3]
    velocity = motion.v_world_mps + np.einsum("nij,nj->ni", R, np.cross(motion.w_veh_radps, arm))
    return R @ T[:3, :3], motion.p_world_m + R @ arm, velocity


def dead_reckon(accel, gyro, R, p, v, dt_s):
    """Trapezoid rule: the mean of neighbouring samples over each interval."""
    gravity = np.array([0.0, 0.0, -GRAVITY_MPS2])
    for k in range(len(accel) - 1):
        R_next = R @ frames.exp_so3((gyro[k] + gyro[k + 1]) / 2 * dt_s)
        a = (R @ accel[k] + R_next @ accel[k + 1]) / 2 + gravity
        R, p, v = R_next, p + v * dt_s + a * dt_s**2 / 2, v + a * dt_s
    return R, p, v


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_noise_free_imu_reckons_a_minute_to_the_truth(seed):
    motion = city_motion(seed, 70.0)
    accel, gyro = predict_imu(motion, city_rig(), GRAVITY_MPS2)
    R, p, v = imu_states(motion)
    begin, end = 1000, 7000
    part = slice(begin, end + 1)
    R_end, p_end, v_end = dead_reckon(accel[part], gyro[part], R[begin], p[begin], v[begin], 0.01)
    assert np.linalg.norm(p_end - p[end]) < 0.002
    assert np.linalg.norm(v_end - v[end]) < 1e-4
    assert np.rad2deg(np.linalg.norm(frames.log_so3(R_end.T @ R[end]))) < 0.001


def test_velocity_is_the_slope_of_position_and_rate_that_of_attitude():
    motion = city_motion(4, 120.0)
    v = (motion.p_world_m[2:] - motion.p_world_m[:-2]) / 0.02
    np.testing.assert_allclose(v, motion.v_world_mps[1:-1], atol=1e-3)
    a = (motion.v_world_mps[2:] - motion.v_world_mps[:-2]) / 0.02
    np.testing.assert_allclose(a, motion.a_world_mps2[1:-1], atol=5e-3)
    R = motion.R_world_veh
    w = frames.log_so3(R[:-2].swapaxes(-1, -2) @ R[2:]) / 0.02
    np.testing.assert_allclose(w, motion.w_veh_radps[1:-1], atol=1e-3)
    wdot = (motion.w_veh_radps[2:] - motion.w_veh_radps[:-2]) / 0.02
    np.testing.assert_allclose(wdot, motion.wdot_veh_radps2[1:-1], atol=5e-3)


@pytest.mark.parametrize("seed", range(5))
def test_the_car_drives_like_a_car(seed):
    motion = city_motion(seed, 600.0)
    speed = np.linalg.norm(motion.v_world_mps, axis=1)
    a_veh = np.einsum("nji,nj->ni", motion.R_world_veh, motion.a_world_mps2)
    v_veh = np.einsum("nji,nj->ni", motion.R_world_veh, motion.v_world_mps)
    assert speed[:300].max() == 0  # it waits before it sets off
    assert 9 < speed.max() < 15.5
    assert (speed[1000:] == 0).any()  # a light somewhere
    assert np.abs(a_veh[:, :2]).max() < 3.0
    np.testing.assert_allclose(v_veh[:, 1:], 0, atol=1e-9)  # wheels do not slide
    assert np.ptp(np.unwrap(frames.yaw_of(motion.R_world_veh))) > np.pi / 2
    assert 0.005 < np.abs(motion.R_world_veh[:, 2, 0]).max() < 0.05


def test_the_hills_lie_where_the_height_says():
    motion = city_motion(1, 200.0)
    climbed = np.trapezoid(motion.v_world_mps[:, 2], dx=0.01)
    assert motion.p_world_m[-1, 2] == pytest.approx(climbed, abs=1e-4)


def test_equal_seeds_give_equal_drives_and_others_do_not():
    a, b, c = make_city(3, 10.0), make_city(3, 10.0), make_city(4, 10.0)
    assert all(a.tables[name].same_as(b.tables[name]) for name in a.tables)
    assert a.truth.same_as(b.truth)
    assert not any(a.tables[name].same_as(c.tables[name]) for name in a.tables)


def test_changing_one_sensor_leaves_the_others(monkeypatch):
    before = make_city(3, 10.0)
    monkeypatch.setattr(city, "GNSS_SIGMA_ENU_M", (3.0, 3.0, 6.0))
    after = make_city(3, 10.0)
    assert not after.gnss.same_as(before.gnss)
    assert after.imu.same_as(before.imu)
    assert after.tables["wheel"].same_as(before.tables["wheel"])


def test_a_longer_drive_begins_like_the_shorter_one():
    long, short = make_city(3, 60.0).truth, make_city(3, 20.0).truth
    np.testing.assert_allclose(long.p_world_m[: len(short)], short.p_world_m, atol=1e-9)


def test_gnss_scatters_about_the_antenna_as_its_covariance_says():
    drive = make_city(1, 600.0)
    truth = drive.truth.at_point(drive.rig.p_veh_ant_m).at(drive.gnss.t_ns)
    error = drive.gnss.p_world_ant_m - truth.p_world_m
    np.testing.assert_allclose(error.std(axis=0), city.GNSS_SIGMA_ENU_M, rtol=0.05)
    np.testing.assert_allclose(error.mean(axis=0), 0, atol=0.1)
    np.testing.assert_array_equal(drive.gnss.cov_world_m2[0], np.diag([1.0, 1.0, 4.0]))


def test_wheels_tell_the_speed_along_x():
    drive = make_city(1, 300.0)
    wheel = drive.tables["wheel"]
    truth = drive.truth.at(wheel.t_ns)
    error = wheel.speed_mps - np.linalg.norm(truth.v_world_mps, axis=1)
    assert error.std() == pytest.approx(city.WHEEL_SIGMA_MPS, rel=0.05)


def test_tables_run_at_their_rates_and_truth_stands_on_the_fixes():
    drive = make_city(0, 120.0)
    assert [len(table) for table in drive.tables.values()] == [1201, 12001, 6001]
    assert np.isin(drive.gnss.t_ns, drive.truth.t_ns).all()
    assert drive.about.simulated
    assert not drive.truth.p_veh_point_m.any()


def test_biases_start_at_a_draw_and_walk_as_the_rig_says():
    noise = dataclasses.replace(
        city.IMU_NOISE, accel_noise_mps2_per_sqrt_hz=1e-12, gyro_noise_radps_per_sqrt_hz=1e-12
    )
    ends, starts = [], []
    for seed in range(400):
        _, gyro = imu_errors(noise, 1001, 0.01, stream(seed, "test"))
        starts.append(gyro[0])
        ends.append(gyro[-1] - gyro[0])
    assert np.std(starts) == pytest.approx(noise.gyro_bias_sigma_radps, rel=0.1)
    walk = noise.gyro_bias_walk_radps2_per_sqrt_hz * np.sqrt(10.0)
    assert np.std(ends) == pytest.approx(walk, rel=0.1)


def test_white_noise_averages_down_as_its_density_says():
    noise = dataclasses.replace(
        city.IMU_NOISE, accel_bias_sigma_mps2=1e-12, accel_bias_walk_mps3_per_sqrt_hz=1e-12
    )
    accel, _ = imu_errors(noise, 400_000, 0.01, stream(0, "test"))
    per_second = accel.reshape(-1, 100, 3).mean(axis=1)
    density = noise.accel_noise_mps2_per_sqrt_hz
    assert per_second.std() == pytest.approx(density, rel=0.05)


def test_a_still_level_imu_reads_gravity():
    n = 3
    zero = np.zeros((n, 3))
    still = Motion(instants(0, 0.02, 100), zero, zero, zero, np.tile(np.eye(3), (n, 1, 1)),
                   zero, zero)  # fmt: skip
    accel, gyro = predict_imu(still, Rig(), 9.81)
    np.testing.assert_array_equal(accel, np.tile([0, 0, 9.81], (n, 1)))
    np.testing.assert_array_equal(gyro, zero)


def test_a_spinning_lever_arm_feels_the_centripetal_pull():
    spin = Motion(np.array([0]), np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 3)),
                  np.eye(3)[None], np.array([[0, 0, 2.0]]), np.array([[0, 0, 0.5]]))  # fmt: skip
    T = np.eye(4)
    T[:3, 3] = [1.5, 0, 0]
    accel, _ = predict_imu(spin, Rig(T_veh_imu=T), 9.81)
    np.testing.assert_allclose(accel, [[-(2.0**2) * 1.5, 0.5 * 1.5, 9.81]])


@pytest.mark.parametrize("duration_s", [0.0, -5.0, float("nan"), 1e9])
def test_an_impossible_duration_is_refused(duration_s):
    with pytest.raises(InputError, match=r"duration_s = .*: expected 1 to 86400 seconds"):
        make_city(0, duration_s)


@pytest.mark.parametrize("seed", [-1, 1.5, "3", True])
def test_an_impossible_seed_is_refused(seed):
    with pytest.raises(InputError, match="expected a whole number from 0"):
        make_city(seed, 5.0)


def test_an_imu_without_noise_in_the_rig_is_refused():
    with pytest.raises(InputError, match="imu_noise"):
        simulate_imu(city_motion(0, 1.0), Rig(), 9.81, stream(0, "imu"))
