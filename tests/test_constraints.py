"""Where a vehicle's constraints act: one a second, at wheel speeds, and where the car stands."""

import dataclasses

import numpy as np
import pytest

from fgloc.config import MotionConfig, load_config
from fgloc.constraints import NON_HOLONOMIC, STANDSTILL, velocity_with_errors
from fgloc.datasets import make
from fgloc.drive import Drive, Rig, VelocityErrors
from fgloc.frames import Origin
from fgloc.measurements import EnuVelocities, GnssFixes, ImuSamples, WheelSpeeds
from fgloc.sync import plan

START_NS = 1_760_000_000_000_000_000


def ns(seconds):
    return START_NS + np.rint(np.asarray(seconds) * 1e9).astype(np.int64)


def drive_of(shakes_from_s=np.inf, speed_mps=0.0, wheel=None, received_s=0.0):
    """Ten seconds along x; from some time on the IMU shakes by 0.5 m/s^2."""
    t = np.arange(1001) * 0.01
    accel = np.tile([0.0, 0.0, 9.8], (len(t), 1))
    accel[t >= shakes_from_s, 0] += np.where(np.arange((t >= shakes_from_s).sum()) % 2, 0.5, -0.5)
    at = np.arange(11.0)
    p = np.stack([speed_mps * at, 0 * at, 0 * at], -1)
    gnss = GnssFixes(ns(at), ns(at + received_s), p, np.tile(np.eye(3) * 1e-4, (11, 1, 1)),
                     np.full((11, 3), np.nan))  # fmt: skip
    imu = ImuSamples(ns(t), ns(t), accel, np.tile([0.0, 0.0, 0.003], (len(t), 1)))
    tables = {"gnss": gnss, "imu": imu, **({} if wheel is None else {"wheel": wheel})}
    return Drive("test", Origin(52.0, 9.0, 0.0), Rig(), tables)


def wheels(t_s, speed_mps=0.0, **columns):
    n = len(t_s)
    return dataclasses.replace(
        WheelSpeeds(ns(t_s), ns(t_s), np.full(n, speed_mps), np.full(n, 0.1)), **columns
    )


def plan_of(drive, **vehicle):
    return plan(drive, load_config(vehicle={"wheel_speed": True, **vehicle}))


def seconds(made, where):
    return ((made.epochs.t_ns[where] - START_NS) / 1e9).tolist()


def test_nothing_is_taken_for_granted_unless_asked_for():
    made = plan_of(drive_of())
    held = made.constraints
    assert not held.in_force.any() and not held.stands.any()
    assert set(made.verdicts) == {"gnss", "imu"}


def test_a_car_is_constrained_once_in_an_interval_at_keyframes_of_its_own():
    made = plan_of(drive_of(), non_holonomic=True, interval_s=0.5)
    np.testing.assert_allclose(seconds(made, made.constraints.in_force), np.arange(21) / 2)
    assert made.epochs.is_keyframe[made.constraints.in_force].all()
    assert len(made.verdicts[NON_HOLONOMIC]) == 21


def test_one_wheel_speed_in_an_interval_is_taken_and_the_rest_are_unused():
    made = plan_of(drive_of(wheel=wheels(np.arange(0, 10, 0.02))))
    taken = made.constraints.wheel_row[made.constraints.wheel_row >= 0]
    assert taken.tolist() == list(range(0, 500, 50))
    told = made.verdicts["wheel"]
    assert (told.reason == "one in 1 s is taken").sum() == 490
    assert (told.reason[taken] == "not reached").all()


def test_a_wheel_speed_between_the_fixes_gets_a_keyframe_of_its_own():
    made = plan_of(drive_of(wheel=wheels([2.3, 2.6])))
    where = made.constraints.wheel_row >= 0
    assert seconds(made, where) == pytest.approx([2.3])
    assert made.epochs.is_keyframe[where].all()


def test_wheel_speeds_that_cannot_enter_say_why():
    table = wheels([-1, 1, 1, 2, 3, 11], speed_mps=np.nan)
    speed, sigma = np.zeros(6), np.full(6, 0.1)
    speed[3], sigma[4] = np.nan, 0.0
    table = dataclasses.replace(table, speed_mps=speed, sigma_mps=sigma)
    made = plan_of(drive_of(wheel=table)).verdicts["wheel"]
    assert made.verdict.tolist() == [
        "outside", "unused", "duplicate", "invalid", "invalid", "outside",
    ]  # fmt: skip


def test_a_car_stands_while_its_imu_is_quiet_and_until_it_shakes():
    made = plan_of(drive_of(shakes_from_s=5.5), zero_velocity=True)
    assert seconds(made, made.constraints.stands) == pytest.approx([1, 2, 3, 4, 5])
    rate = made.constraints.rate_radps[made.constraints.stands]
    np.testing.assert_allclose(rate, np.tile([0, 0, 0.003], (5, 1)), atol=1e-12)
    assert len(made.verdicts[STANDSTILL]) == 5


def test_a_car_that_the_fixes_see_cruising_does_not_stand_however_smooth_the_road():
    made = plan_of(drive_of(speed_mps=10.0), zero_velocity=True)
    assert not made.constraints.stands.any()


def test_fixes_that_have_yet_to_arrive_are_not_looked_at():
    made = plan_of(drive_of(speed_mps=10.0, received_s=60.0), zero_velocity=True)
    assert made.constraints.stands.any()


def test_wheels_that_turn_are_believed_more_than_a_quiet_imu():
    turning = plan_of(drive_of(wheel=wheels(np.arange(0, 10, 0.1), 0.5)), zero_velocity=True)
    resting = plan_of(drive_of(wheel=wheels(np.arange(0, 10, 0.1))), zero_velocity=True)
    assert not turning.constraints.stands.any()
    assert resting.constraints.stands.sum() == 10


def test_in_a_simulated_city_a_car_stands_only_where_it_does():
    drive = make("city", seed=1, duration_s=60.0)
    made = plan(drive, load_config(settings=["vehicle.zero_velocity=true"]))
    truth = drive.truth.at(made.epochs.t_ns[made.constraints.stands])
    assert len(truth) >= 3
    assert np.linalg.norm(truth.v_world_mps, axis=1).max() < 0.2


def test_lasting_errors_of_velocities_count_as_noise_for_who_has_no_state_for_them():
    """5 m/s that may err by 4 % are off by 0.2 m/s more; what is no sigma stays none."""
    t_ns, v = ns(np.arange(4.0)), np.tile([3.0, 4.0, 0.0], (4, 1))
    told = EnuVelocities(t_ns, t_ns, v, np.array([0.3, 0.3, 0.0, np.nan]))
    drive = dataclasses.replace(drive_of(), rig=Rig(velocity_errors=VelocityErrors(0.04, 0.01)))
    sigma = velocity_with_errors(drive.with_tables(velocity=told), MotionConfig()).sigma_mps
    np.testing.assert_allclose(sigma, [np.hypot(0.3, 0.2)] * 2 + [0.0, np.nan])
    assert velocity_with_errors(drive, MotionConfig()) is None
