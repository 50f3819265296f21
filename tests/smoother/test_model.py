"""The graph's parts: which variables there are, and what the factors between them say."""

import dataclasses

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import A, B, C, L, V, X

from fgloc.config import load_config
from fgloc.errors import DriveError
from fgloc.smoother.graph import GraphModel, State
from fgloc.smoother.model import POSITION_SIGMA_M
from fgloc.smoother.sketch import few_model
from fgloc.sync import plan


@pytest.fixture
def model_of(city):
    def build(drive=None, **settings):
        drive, config = drive or city(0, 10.0), load_config(**settings)
        return GraphModel(drive, plan(drive, config), config)

    return build


def state_of(model, j):
    """The truth of keyframe j's IMU, without bias."""
    truth = model.drive.truth.at(model.t_ns[j : j + 1])
    pose = gtsam.Pose3(gtsam.Rot3(truth.R_world_veh[0]), truth.p_world_m[0])
    pose = pose * gtsam.Pose3(gtsam.Rot3(), model.p_veh_imu_m)
    return State(pose, truth.v_world_mps[0], gtsam.imuBias.ConstantBias())


def keys_of(factors):
    return [list(factor.keys()) for factor in factors]


def test_a_new_bias_begins_once_the_last_has_lasted_its_time(model_of):
    model = model_of(imu={"bias_interval_s": 0.25})
    assert model.bias_of[:8].tolist() == [0, 0, 0, 1, 1, 1, 2, 2]
    np.testing.assert_allclose(model.bias_t_s[:3], [0, 0.3, 0.6])


def test_keyframes_are_joined_by_the_imu_and_where_a_bias_begins_by_its_walk(model_of):
    model = model_of(imu={"bias_interval_s": 0.25})
    within, across = (model.motion_factors(j, model.interval(j).pim) for j in (2, 3))
    assert keys_of(within) == [[X(1), V(1), X(2), V(2), B(0)]]
    assert keys_of(across) == [[X(2), V(2), X(3), V(3), B(0)], [B(0), B(1)]]
    walk = np.linalg.inv(across[1].noiseModel().R()).diagonal()
    np.testing.assert_allclose(walk, np.sqrt(0.3) * np.repeat([2e-4, 4e-6], 3))


def test_the_imu_agrees_with_the_truth_up_to_its_noise_and_bias(model_of):
    model = model_of()
    i, j = state_of(model, 10), state_of(model, 11)
    (factor,) = model.motion_factors(11, model.interval(11).pim)
    error = factor.evaluateError(i.pose, i.velocity, j.pose, j.velocity, i.bias)
    allowed = np.repeat([0.02, 0.05, 0.5], 3) * 0.1  # rad/s, m/s, m/s^2 over a tenth of a second
    assert (np.abs(error) < allowed).all()


def test_a_fix_is_of_the_antenna(model_of):
    model = model_of()
    (factor,) = model.position_factors(20)
    z = model.positions.z_world_m[20]
    pose = gtsam.Pose3(gtsam.Rot3.Yaw(0.7), np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(factor.evaluateError(pose), pose.transformFrom(model.levers[0]) - z)
    moved = pose.retract(np.array([0, 0, 0, 1e-6, 0, 0])).transformFrom(model.levers[0])
    slope = (moved - pose.transformFrom(model.levers[0])) / 1e-6
    R = pose.rotation().matrix()
    np.testing.assert_allclose(slope, (R @ model.point_by_pose[0])[:, 3], atol=1e-6)


def test_a_bias_of_gnss_brings_its_own_variables(model_of):
    model = model_of(gnss={"bias_sigma_m": 2.0})
    assert keys_of(model.position_factors(3)) == [[L(0), X(3), A(3)], [A(3), C(3)]]
    assert keys_of(model.slow_factors(3, None)) == [[C(3)]]
    assert keys_of(model.slow_factors(3, 1)) == [[C(1), C(3)]]
    assert model_of().slow_factors(3, 1) == []


def test_sigma_scale_widens_every_fix(model_of):
    once, twice = model_of(), model_of(gnss={"sigma_scale": 2.0})
    np.testing.assert_allclose(twice.cov_m2, 4 * once.cov_m2)


def test_the_gate_is_a_quantile_times_the_slack_squared(model_of):
    gate = {"gate_probability": 0.95, "gate_slack": 2.0}
    assert model_of(gnss=gate).sources[0].gate_nis == pytest.approx(4 * 7.8147, rel=1e-4)
    assert model_of(gnss={"gate_probability": 1.0}).sources[0].gate_nis == np.inf


def test_a_gap_is_bridged_with_the_noise_of_not_knowing(model_of, city, altered):
    drive = altered.without_imu(city(0, 10.0), 4.0, 6.0)
    model = model_of(drive, imu={"gap_accel_mps2": 5.0, "gap_gyro_radps": 0.5})
    gap = np.flatnonzero(model.epochs.in_gap[model.epoch_of])
    span_s = model.t_s[gap[0]] - model.t_s[gap[0] - 1]
    cov = model.interval(int(gap[0])).pim.residualCovariance()
    np.testing.assert_allclose(cov.diagonal()[:3], 0.25 * span_s, rtol=1e-3)
    before = model.interval(int(gap[0]) - 1).pim.residualCovariance()
    assert before[0, 0] < 1e-4 * cov[0, 0]


def test_output_epochs_hold_the_sums_up_to_them(model_of):
    model = model_of(output_interval_s=0.02)
    interval = model.interval(5)
    assert [round(part.dt_s, 9) for part in interval.inner] == [0.02, 0.04, 0.06, 0.08]
    assert interval.pim.deltaTij() == pytest.approx(0.1)


def test_intervals_are_the_same_whether_all_have_as_many_output_epochs_or_not(model_of):
    model = model_of(output_interval_s=0.02)
    alike = np.ones(len(model), bool)
    alike[[6, 7]] = False  # the intervals that end there become one
    few = few_model(model, np.delete(np.arange(len(model)), 6), np.zeros(0, bool))
    (whole, inner), (merged, more) = model.deltas(), few.deltas()
    for column, other in zip(whole, merged, strict=True):
        np.testing.assert_allclose(column[alike[1:]], np.delete(other, 5, axis=0), atol=1e-14)
    for column, other in zip(inner, more, strict=True):  # four between two keyframes
        np.testing.assert_allclose(column[:24], other[:24], atol=1e-14)
        np.testing.assert_allclose(column[28:], other[29:], atol=1e-14)


def test_noise_of_the_configuration_goes_before_that_of_the_rig(model_of):
    noise = model_of(imu={"gyro_noise_radps_per_sqrt_hz": 0.5}).noise
    assert noise.gyro_noise_radps_per_sqrt_hz == 0.5
    assert noise.accel_noise_mps2_per_sqrt_hz == 2e-3


def test_a_drive_that_knows_no_noise_is_refused(model_of, city):
    drive = city(0, 10.0)
    drive = dataclasses.replace(drive, rig=dataclasses.replace(drive.rig, imu_noise=None))
    with pytest.raises(DriveError, match=r"no \[rig.imu_noise\]; give it there or as --set imu"):
        model_of(drive)


def test_gravity_is_that_of_the_place_unless_given(model_of):
    assert model_of().gravity_mps2 == pytest.approx(9.812, abs=1e-3)
    assert model_of(imu={"gravity_mps2": 9.79}).gravity_mps2 == 9.79


def test_the_prior_is_level_and_around_the_first_fix(model_of):
    model = model_of()
    tilted = gtsam.Pose3(gtsam.Rot3.Ypr(0.4, 0.2, 0.1), np.array([500.0, 0.0, 0.0]))
    state = State(tilted, np.ones(3), gtsam.imuBias.ConstantBias())
    values = gtsam.Values()
    first = model.first_place_m
    values.insert(X(0), gtsam.Pose3(gtsam.Rot3.Yaw(0.4), first + [0, 0, POSITION_SIGMA_M]))
    turn, place = model.prior_factors(0, state, 10.0)[:2]
    assert turn.error(values) == pytest.approx(0, abs=1e-20)
    assert place.error(values) == pytest.approx(0.5)
