"""The IMU factor against differences, against GTSAM, and against closed-form motion."""

import gtsam
import numpy as np
import pytest

from fgloc.drive import ImuNoise
from fgloc.factors import imu
from fgloc.frames import exp_so3, log_so3

GRAVITY = 9.8


@pytest.fixture
def pim():
    rng = np.random.default_rng(3)
    params = imu.parameters(0.02, 0.002, GRAVITY)
    hat = gtsam.imuBias.ConstantBias(rng.normal(size=3) * 0.1, rng.normal(size=3) * 0.01)
    pim = gtsam.PreintegratedImuMeasurements(params, hat)
    accel = rng.normal(size=(60, 3)) + [0, 0, GRAVITY]
    imu.integrate(pim, accel, 0.4 * rng.normal(size=(60, 3)) + 0.3, np.full(60, 0.01))
    return pim


def states(rng, n):
    return (
        exp_so3(rng.normal(size=(n, 3))),
        rng.normal(size=(n, 3)) * 9,
        rng.normal(size=(n, 3)) * 5,
    )


def near(rng, deltas, state_i, bias):
    R, p, v = imu.predict(deltas, *state_i, bias, GRAVITY)
    n = len(R)
    return (R @ exp_so3(0.1 * rng.normal(size=(n, 3))), p + rng.normal(size=(n, 3)),
            v + rng.normal(size=(n, 3)))  # fmt: skip


def case(pim, seed=0):
    rng = np.random.default_rng(seed)
    deltas = imu.table([imu.snapshot(pim)])
    bias = deltas.bias_hat + 0.01 * rng.normal(size=(1, 6))
    state_i = states(rng, 1)
    return deltas, state_i, near(rng, deltas, state_i, bias), bias


def as_gtsam(state):
    return gtsam.Pose3(gtsam.Rot3(state[0][0]), state[1][0]), state[2][0]


def test_the_native_factor_has_the_error_of_the_numpy_residual(pim):
    deltas, state_i, state_j, bias = case(pim)
    factor = imu.factor((1, 2, 3, 4, 5), pim)
    native = factor.evaluateError(
        *as_gtsam(state_i), *as_gtsam(state_j), gtsam.imuBias.ConstantBias(bias[0, :3], bias[0, 3:])
    )
    ours = imu.residual(deltas, state_i, state_j, bias, GRAVITY).error[0]
    np.testing.assert_allclose(ours, native, atol=1e-12)


def test_the_native_factor_has_the_covariance_of_the_table(pim):
    whiten = imu.factor((1, 2, 3, 4, 5), pim).noiseModel().R()
    np.testing.assert_allclose(
        np.linalg.inv(whiten.T @ whiten),
        imu.table([imu.snapshot(pim)]).cov[0],
        rtol=1e-6,
        atol=1e-12,
    )


def retract(state, d):
    R, p, v = state
    return R @ exp_so3(d[None, :3]), p + (R @ d[3:6]), v + d[None, 6:]


@pytest.mark.parametrize(
    "block", ["by_pose_i", "by_velocity_i", "by_pose_j", "by_velocity_j", "by_bias"]
)
def test_every_jacobian_equals_its_difference_quotient(pim, block):
    deltas, state_i, state_j, bias = case(pim)
    analytic = getattr(imu.residual(deltas, state_i, state_j, bias, GRAVITY), block)[0]

    def error(d):
        full = np.zeros(9)
        if block == "by_bias":
            return imu.residual(deltas, state_i, state_j, bias + d, GRAVITY).error[0]
        full[:6] = d if "pose" in block else 0
        full[6:] = d if "velocity" in block else 0
        i, j = (
            retract(s, full) if block[-1] == e else s for s, e in ((state_i, "i"), (state_j, "j"))
        )
        return imu.residual(deltas, i, j, bias, GRAVITY).error[0]

    step = 1e-6
    numeric = np.stack(
        [(error(step * e) - error(-step * e)) / (2 * step) for e in np.eye(analytic.shape[1])], -1
    )
    np.testing.assert_allclose(analytic, numeric, atol=2e-8)


def test_errors_travel_as_the_transition_says(pim):
    deltas, state_i, _, bias = case(pim)
    F, G = imu.transition(deltas, state_i[0], bias)
    base = imu.predict(deltas, *state_i, bias, GRAVITY)

    def moved(state, b):
        R, p, v = imu.predict(deltas, *state, b, GRAVITY)
        return np.concatenate([log_so3(base[0][0].T @ R[0]), base[0][0].T @ (p - base[1])[0],
                               (v - base[2])[0]])  # fmt: skip

    step = 1e-6
    by_state = np.stack([moved(retract(state_i, step * e), bias) / step for e in np.eye(9)], -1)
    by_bias = np.stack([moved(state_i, bias + step * e) / step for e in np.eye(6)], -1)
    np.testing.assert_allclose(F[0], by_state, atol=2e-5)
    np.testing.assert_allclose(G[0], by_bias, atol=2e-5)


def test_a_car_on_a_circle_comes_back_to_where_it_started():
    speed, radius, n = 10.0, 20.0, 4000
    rate = speed / radius
    dt = 2 * np.pi / rate / n
    pim = gtsam.PreintegratedImuMeasurements(imu.parameters(0.01, 0.001, GRAVITY))
    imu.integrate(pim, np.tile([0, speed * rate, GRAVITY], (n, 1)), np.tile([0, 0, rate], (n, 1)),
                  np.full(n, dt))  # fmt: skip
    deltas, velocity = imu.table([imu.snapshot(pim)]), np.array([[speed, 0.0, 0.0]])
    start = np.eye(3)[None], np.zeros((1, 3)), velocity
    R, p, v = imu.predict(deltas, *start, np.zeros((1, 6)), GRAVITY)
    np.testing.assert_allclose(p[0], 0, atol=0.2)  # the held samples lag by half a step
    np.testing.assert_allclose(R[0], np.eye(3), atol=1e-9)
    np.testing.assert_allclose(v[0], [speed, 0, 0], atol=0.02)


def test_preintegrated_noise_is_that_of_simulated_samples():
    """Spread of 4,000 integrated noise runs at rest against the factor's covariance."""
    rng = np.random.default_rng(0)
    accel_density, gyro_density, dt, n, runs = 0.05, 0.01, 0.01, 50, 4000
    params = imu.parameters(accel_density, gyro_density, GRAVITY)
    ends = []
    for _ in range(runs):
        pim = gtsam.PreintegratedImuMeasurements(params)
        imu.integrate(
            pim, [0, 0, GRAVITY] + rng.normal(size=(n, 3)) * accel_density / np.sqrt(dt),
            rng.normal(size=(n, 3)) * gyro_density / np.sqrt(dt), np.full(n, dt),
        )  # fmt: skip
        ends.append(pim.preintegrated())
    spread = np.cov(np.array(ends).T)
    promised = imu.table([imu.snapshot(pim)]).cov[0]
    # A variance estimated from 4,000 runs has a relative sigma of sqrt(2 / 4000) = 2.2 %.
    np.testing.assert_allclose(np.diag(spread), np.diag(promised), rtol=0.1)


def test_the_bias_walk_grows_with_the_root_of_time():
    noise = ImuNoise(1, 1, 0.02, 0.003)
    np.testing.assert_allclose(imu.bias_walk_sigmas(noise, 4.0), [0.04] * 3 + [0.006] * 3)
