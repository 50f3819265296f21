"""Velocities from fixes, the smoothing that both sides share, and what relates two vectors."""

import dataclasses

import numpy as np
import pytest

import fgloc
from fgloc.diagnosis.finding import Finding, robust_sigma, rows_of
from fgloc.diagnosis.lag import Lag, inertial_lag, speed_lag
from fgloc.diagnosis.motion import Motion, Signal, fit, inertial, slopes
from fgloc.diagnosis.planar import Planar
from fgloc.measurements import WheelSpeeds
from fgloc.timing import seconds_to_ns


def test_the_slope_of_a_parabola_is_that_of_its_middle():
    t_s = np.arange(0, 20, 0.5)
    slope, sound = slopes(t_s, t_s[:, None] ** 2, np.array([10.0, 12.5]), 2.0)
    np.testing.assert_allclose(slope[:, 0], [20.0, 25.0])
    assert sound.all()


def test_no_slope_is_sound_beside_a_gap_or_at_the_ends():
    t_s = np.r_[np.arange(0, 10, 0.5), np.arange(14, 20, 0.5)]
    _, sound = slopes(t_s, t_s[:, None], np.array([0.0, 5.0, 9.5, 14.0, 17.0]), 2.0)
    assert sound.tolist() == [False, True, False, False, True]


def test_a_circle_turns_by_its_rate_and_pushes_to_its_inside():
    """10 m/s on a radius of 100 m: 0.1 rad/s, 1 m/s^2 to the left, less 3 % of smoothing."""
    t_s = np.arange(0, 60, 0.2)
    angle = 0.1 * t_s
    p = 100 * np.stack([np.sin(angle), 1 - np.cos(angle), 0 * angle], -1)
    drive = fixes_at(t_s, p)
    motion = Motion.of(drive)
    np.testing.assert_allclose(motion.turn_rad[1:-1], 0.1, atol=1e-6)
    np.testing.assert_allclose(motion.push_mps[1:-1, 0], 0.0, atol=1e-6)
    np.testing.assert_allclose(motion.push_mps[1:-1, 1], 1.0, rtol=0.03)


def test_a_signal_is_smoothed_as_the_fixes_are():
    """The speed of a braking vehicle, told by fixes and by a speedometer, is one and the same."""
    t_s = np.arange(0, 40, 0.1)
    speed = 12 + 4 * np.sin(0.3 * t_s)
    along = 12 * t_s - 4 / 0.3 * np.cos(0.3 * t_s)
    motion = Motion.of(fixes_at(t_s, np.stack([along, 0 * along, 0 * along], -1)))
    t_ns = motion.start_ns + np.round(t_s * 1e9).astype(np.int64)
    told = motion.smoothed(Signal.of_level(t_ns, speed[:, None], motion.start_ns))
    np.testing.assert_allclose(
        told[motion.sound, 0], motion.speed_mps[motion.sound], rtol=0, atol=5e-4
    )


def test_few_or_sparse_fixes_tell_no_motion():
    t_s = np.arange(0, 60, 3.0)
    assert Motion.of(fixes_at(t_s, np.zeros((len(t_s), 3)))) is None
    assert Motion.of(fixes_at(t_s[:5], np.zeros((5, 3)))) is None


def test_a_fit_passes_over_outliers():
    x = np.linspace(-1, 1, 40)[:, None]
    y = 3 * x[:, 0] + 1e-3 * np.sin(40 * x[:, 0])
    y[7] += 100
    (gain,), (sigma,) = fit(x, y)
    assert gain == pytest.approx(3, abs=1e-3)
    assert 0 < sigma < 1e-3


@pytest.mark.parametrize(
    ("M", "gain", "turn_deg", "mirrored"),
    [
        (np.eye(2) * 3.6, 3.6, 0, False),
        ([[0, -1], [1, 0]], 1, 90, False),
        ([[0, 1], [1, 0]], 1, 90, True),
        ([[1, 0], [0, -1]], 1, 0, True),
    ],
)
def test_what_relates_two_vectors(M, gain, turn_deg, mirrored):
    x = np.random.default_rng(1).standard_normal((80, 2))
    planar = Planar.of(x @ np.transpose(M) + [5, 6], x, constant=True)
    assert planar.gain == pytest.approx(gain)
    assert planar.turn_deg == pytest.approx(turn_deg)
    assert planar.mirrored is mirrored


def test_nothing_relates_noise():
    rng = np.random.default_rng(1)
    assert Planar.of(rng.standard_normal((80, 2)), rng.standard_normal((80, 2))) is None


@pytest.mark.parametrize("late_s", [-18.0, -3.0, 0.0, 2.0, 37.0])
def test_the_lag_of_an_imu_is_found_within_its_sigma(late_s):
    drive = fgloc.make("city", seed=5, duration_s=120.0)
    t_ns = drive.imu.t_ns + seconds_to_ns(late_s)
    drive = drive.with_tables(imu=dataclasses.replace(drive.imu, t_ns=t_ns))
    motion = Motion.of(drive)
    lag = inertial_lag(motion, inertial(drive, motion.start_ns), 1.2)
    assert lag.lag_s == pytest.approx(late_s, abs=3 * lag.sigma_s)
    assert lag.sigma_s < 0.3
    assert lag.is_significant is (late_s != 0)


def test_a_wheel_at_rest_tells_no_lag():
    drive = fgloc.make("city", seed=5, duration_s=60.0)
    wheel: WheelSpeeds = drive.tables["wheel"]
    motion = Motion.of(drive)
    still = Signal.of_level(wheel.t_ns, np.zeros((len(wheel), 1)), motion.start_ns)
    lag = speed_lag(motion, still)
    assert lag is None or not lag.is_significant


def test_a_near_lag_takes_a_minute_and_five_sigmas():
    assert Lag(0.5, 0.09, 15.0, 80).is_significant
    assert not Lag(0.5, 0.11, 10.0, 80).is_significant
    assert not Lag(0.5, 0.09, 15.0, 50).is_significant
    assert Lag(18.0, 0.5, 20.0, 30).is_significant
    assert not Lag(18.0, 0.1, 5.0, 80).is_significant


def test_rows_are_named_by_the_first_few():
    fixes = fixes_at(np.arange(10.0), np.zeros((10, 3))).gnss
    assert rows_of(fixes, 4) == "row 4, at 4.00 s"
    assert rows_of(fixes, [1, 2]) == "rows 1, 2, the first at 1.00 s"
    assert rows_of(fixes, [1, 2, 5, 6, 7]) == "rows 1, 2, 5 and 2 more, the first at 1.00 s"


def test_a_finding_is_its_fields():
    finding = Finding("fault", "gap", "imu", "a gap", "close it")
    assert finding.to_dict() == {
        "severity": "fault", "check": "gap", "source": "imu", "what": "a gap", "remedy": "close it",
    }  # fmt: skip


def test_a_robust_sigma_is_that_of_gaussian_values():
    values = np.random.default_rng(0).standard_normal(20_000) * 2.5
    values[:100] = 1e6
    assert robust_sigma(values) == pytest.approx(2.5, rel=0.03)


def fixes_at(t_s, p_world_m):
    """A drive of exact fixes alone."""
    t_ns = 1_760_000_000_000_000_000 + np.round(t_s * 1e9).astype(np.int64)
    n = len(t_ns)
    fixes = fgloc.GnssFixes(
        t_ns, t_ns, p_world_m, np.tile(np.eye(3), (n, 1, 1)), np.full((n, 3), np.nan)
    )
    return fgloc.Drive("fixes", fgloc.Origin(52, 9, 100), fgloc.Rig(), {"gnss": fixes})
