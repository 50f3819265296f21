"""Preintegration of all intervals at once against GTSAM, one interval and sample at a time."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgloc.factors import imu
from fgloc.factors.preintegration import joined, preintegrate

GRAVITY = 9.8
ACCEL_NOISE, GYRO_NOISE = 0.02, 0.003


def samples(n, seed=0, turn_radps=0.7):
    rng = np.random.default_rng(seed)
    accel = rng.normal(size=(n, 3)) + [0, 0, GRAVITY]
    return accel, turn_radps * rng.normal(size=(n, 3)), rng.uniform(0.004, 0.016, n)


def by_gtsam(accel, gyro, dt_s, accel_noise=ACCEL_NOISE, gyro_noise=GYRO_NOISE):
    pim = gtsam.PreintegratedImuMeasurements(imu.parameters(accel_noise, gyro_noise, GRAVITY))
    imu.integrate(pim, accel, gyro, dt_s)
    return imu.table([imu.snapshot(pim)]).take(0)


def assert_same(ours, theirs, atol=1e-9):
    for name, column, expected in zip(ours._fields, ours, theirs, strict=True):
        scale = np.abs(expected).max() + 1e-30
        np.testing.assert_allclose(column / scale, expected / scale, atol=atol, err_msg=name)


@pytest.mark.parametrize("turn_radps", [1e-9, 0.1, 1.0, 6.0])
def test_sums_are_those_of_gtsam_for_intervals_of_any_length(turn_radps):
    measured = samples(400, turn_radps=turn_radps)
    first, stop = np.array([0, 100, 250, 7]), np.array([60, 200, 251, 300])
    ours = preintegrate(*measured, first, stop[None], ACCEL_NOISE, GYRO_NOISE)
    for n, (a, b) in enumerate(zip(first, stop, strict=True)):
        assert_same(ours.take((0, n)), by_gtsam(*(column[a:b] for column in measured)))


def test_a_long_turn_about_one_axis_is_that_of_gtsam_beyond_half_a_circle():
    accel, gyro, dt_s = samples(500)
    gyro = np.tile([0.1, 0.2, 0.8], (500, 1))
    ours = preintegrate(accel, gyro, dt_s, np.array([0]), np.array([[500]]), 0.02, 0.003)
    assert np.linalg.norm(ours.delta[0, 0, :3]) > np.pi
    assert_same(ours.take((0, 0)), by_gtsam(accel, gyro, dt_s))


def test_every_stop_of_an_interval_gets_its_own_sums():
    measured = samples(100)
    stops = np.array([[20, 60], [30, 61], [50, 100]])
    ours = preintegrate(*measured, np.array([0, 55]), stops, ACCEL_NOISE, GYRO_NOISE)
    for s in range(3):
        for n, a in enumerate((0, 55)):
            theirs = by_gtsam(*(column[a : stops[s, n]] for column in measured))
            assert_same(ours.take((s, n)), theirs)


def test_each_interval_may_have_its_own_noise():
    measured = samples(60)
    ours = preintegrate(
        *measured, np.array([0, 30]), np.array([[30, 60]]), np.array([0.1, 3]), np.array([0.01, 1])
    )
    assert_same(ours.take((0, 1)), by_gtsam(*(column[30:] for column in measured), 3, 1))


def test_an_interval_without_samples_is_no_motion():
    ours = preintegrate(*samples(9), np.array([4]), np.array([[4]]), ACCEL_NOISE, GYRO_NOISE)
    assert not any(column.any() for column in ours)


@settings(deadline=None)
@given(st.lists(st.integers(0, 40), min_size=1, max_size=30), st.integers(1, 200))
def test_portions_leave_nothing_out(lengths, at_once):
    """However the intervals are cut into portions, the lengths add up and the rows agree."""
    from fgloc.factors import preintegration

    ends = np.cumsum([0, *lengths])
    measured = samples(int(ends[-1]))
    whole = preintegrate(*measured, ends[:-1], ends[None, 1:], ACCEL_NOISE, GYRO_NOISE)
    before, preintegration.SAMPLES_AT_ONCE = preintegration.SAMPLES_AT_ONCE, at_once
    try:
        cut = preintegrate(*measured, ends[:-1], ends[None, 1:], ACCEL_NOISE, GYRO_NOISE)
    finally:
        preintegration.SAMPLES_AT_ONCE = before
    np.testing.assert_allclose(whole.dt_s.sum(), measured[2].sum())
    for one, other in zip(cut, whole, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)


def test_noise_that_is_not_alike_on_all_axes_is_that_of_gtsam():
    accel_noise, gyro_noise = np.array([1.5, 0.7, 0.1]), np.array([0.01, 0.02, 0.3])
    measured = samples(150)
    first, stop = np.array([0, 40]), np.array([[60, 150]])
    ours = preintegrate(*measured, first, stop, np.tile(accel_noise, (2, 1)),
                        np.tile(gyro_noise, (2, 1)))  # fmt: skip
    for n, (a, b) in enumerate(zip(first, stop[0], strict=True)):
        theirs = by_gtsam(*(column[a:b] for column in measured), accel_noise, gyro_noise)
        assert_same(ours.take((0, n)), theirs)


def test_axes_that_are_alike_may_be_told_one_by_one():
    measured, first, stop = samples(60), np.array([0]), np.array([[60]])
    one = preintegrate(*measured, first, stop, 0.2, 0.03)
    each = preintegrate(*measured, first, stop, np.full((1, 3), 0.2), np.full((1, 3), 0.03))
    np.testing.assert_allclose(each.cov, one.cov, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("turn_radps", [0.01, 0.1, 1.0])
def test_intervals_joined_are_the_whole(turn_radps):
    """To second order in a sample's turn, which the sum of the whole leaves out along its way."""
    measured = samples(120, turn_radps=turn_radps)
    begin, stop = np.array([0, 30, 50, 90, 95]), np.array([30, 50, 90, 95, 120])
    noise = ACCEL_NOISE, GYRO_NOISE
    parts = preintegrate(*measured, begin, stop[None], *noise).take(0)
    runs = np.array([0, 1, 3, 5])  # of one interval, of two and of two
    ends = np.append(begin, 120)[runs]
    whole = preintegrate(*measured, ends[:-1], ends[None, 1:], *noise).take(0)
    assert_same(joined(parts, runs), whole, atol=(3 * turn_radps * measured[2].max()) ** 2 / 2)
    assert_same(joined(parts, runs).take([0]), parts.take([0]), atol=1e-12)
