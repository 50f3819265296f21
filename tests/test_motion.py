"""What carries a drive's states: the IMU, or samples made up for one."""

import numpy as np
import pytest

from fgloc.config import load_config
from fgloc.drive import Drive, Rig
from fgloc.errors import DriveError
from fgloc.frames import Origin
from fgloc.measurements import GnssFixes, ImuSamples, Odometry, SteeringAngles, WheelSpeeds
from fgloc.motion import kind_of
from fgloc.sync import plan
from fgloc.verdicts import Verdict

T_NS = 1_760_000_000_000_000_000 + np.arange(11) * 100_000_000
N = len(T_NS)


def odometry(yaw_rate_radps=0.1, speed_mps=10.0, sigma_radps=0.02) -> Odometry:
    columns = (np.broadcast_to(c, N) for c in (speed_mps, yaw_rate_radps, 0.1, sigma_radps))
    return Odometry(T_NS, T_NS, *columns)


def drive_of(**tables) -> Drive:
    cov, none = np.tile(np.eye(3), (N, 1, 1)), np.full((N, 3), np.nan)
    gnss = GnssFixes(T_NS, T_NS, np.zeros((N, 3)), cov, none)
    return Drive("test", Origin(52.0, 9.0, 100.0), Rig(), {"gnss": gnss, **tables})


WHEEL = WheelSpeeds(T_NS, T_NS, np.full(N, 10.0), np.full(N, 0.1))
STEERING = SteeringAngles(T_NS, T_NS, np.full(N, 0.3))
IMU = ImuSamples(T_NS, T_NS, np.tile([0, 0, 9.8], (N, 1)), np.zeros((N, 3)))


def made(drive, **motion):
    return plan(drive, load_config(motion=motion))


def test_the_best_that_a_drive_has_carries_it():
    tables = {"wheel": WHEEL, "steering": STEERING}
    plain, with_wheelbase = load_config(), load_config(motion={"wheelbase_m": 2.7})
    assert kind_of(drive_of(), plain) == "constant-velocity"
    assert kind_of(drive_of(**tables), plain) == "constant-velocity"
    assert kind_of(drive_of(**tables), with_wheelbase) == "bicycle"
    assert kind_of(drive_of(**tables, odometry=odometry()), with_wheelbase) == "odometry"
    assert kind_of(drive_of(**tables, odometry=odometry(), imu=IMU), with_wheelbase) == "imu"


def test_a_constant_velocity_has_no_force_and_no_turn_from_the_first_row_to_the_last():
    samples = made(drive_of()).motion.samples
    assert samples.t_ns.tolist() == [T_NS[0], T_NS[-1]]
    assert not samples.accel_mps2.any() and not samples.gyro_radps.any()


def test_odometry_turns_and_is_held_in_its_bend():
    """10 m/s at 0.1 rad/s is 1 m/s^2 to the left; 0.02 rad/s ten times a second is
    0.02 sqrt(0.1 s) of density."""
    motion = made(drive_of(odometry=odometry())).motion
    np.testing.assert_allclose(motion.samples.accel_mps2, np.tile([0, 1.0, 0], (N, 1)))
    np.testing.assert_allclose(motion.samples.gyro_radps, np.tile([0, 0, 0.1], (N, 1)))
    density = motion.noise.gyro_noise_radps_per_sqrt_hz[2]
    assert density == pytest.approx(0.02 * np.sqrt(0.1))


def test_a_bicycle_turns_by_its_speed_steering_and_wheelbase():
    """tan(0.3 / 15) / 2.5 m = 0.0080011 per metre, at 10 m/s 0.080011 rad/s."""
    drive = drive_of(wheel=WHEEL, steering=STEERING)
    samples = made(drive, wheelbase_m=2.5, steering_ratio=15.0).motion.samples
    np.testing.assert_allclose(samples.gyro_radps[:, 2], 0.080011, rtol=1e-5)


def test_rows_that_are_not_sound_are_left_out_and_told():
    rate = np.full(N, 0.1)
    rate[4] = np.nan
    told = made(drive_of(odometry=odometry(rate))).verdicts["odometry"]
    assert told.is_(Verdict.INVALID).tolist() == np.isnan(rate).tolist()
    assert "not finite" in told.reason[4]


def test_yaw_rates_far_apart_leave_a_gap():
    table = odometry().take([0, 1, 2, 10])
    held = made(drive_of(odometry=table), gap_s=0.5)
    assert [event.kind for event in held.events] == ["motion", "imu gap"]
    assert held.events[0].text == "no IMU in use: states are carried by odometry"
    assert "no yaw rates for 0.80 s" in held.events[1].text
    assert held.epochs.in_gap.any()


def test_steering_beyond_any_wheel_names_the_ratio():
    wild = SteeringAngles(T_NS, T_NS, np.full(N, 30.0))
    with pytest.raises(DriveError, match="0 of its steering angles are sound"):
        made(drive_of(wheel=WHEEL, steering=wild), wheelbase_m=2.7)
