"""The vehicle's factors against differences, against GTSAM, and against motions known by heart."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, K, V, W, X, Y, Z

from fgloc.factors import vehicle
from fgloc.frames import exp_so3

ARM = np.array([-0.5, 0.2, -0.4])
MOUNTING = np.array([0.01, -0.03])
SCALE = 1.02
PITCH = 0.02
SPEEDS = np.array([12.0, 0.4, 0.0, -3.0])


def states(n=4, seed=0):
    """Attitudes, velocities, rates and biases (n, ...)."""
    rng = np.random.default_rng(seed)
    return (exp_so3(rng.normal(size=(n, 3))), rng.normal(size=(n, 3)) * 8,
            rng.normal(size=(n, 3)) * 0.5, rng.normal(size=(n, 6)) * 0.02)  # fmt: skip


def residual(kind, R, v, rate, bias, mounting=MOUNTING, scale=SCALE, arm=ARM):
    u = vehicle.body_velocity(R, v, rate, bias, arm)
    turn = mounting + [PITCH, 0]
    if kind == "wheel":
        return vehicle.wheel(u, turn, scale, SPEEDS)
    return vehicle.non_holonomic(u, turn)


def solved(k, arm=ARM):
    """Values of one state with its auxiliary variables where their ties want them."""
    R, v, rate, bias = (column[k] for column in states())
    values, p = gtsam.Values(), np.array([5.0, -7.0, 1.0])
    w = v + R @ np.cross(rate - bias[3:], arm)
    values.insert(X(0), gtsam.Pose3(gtsam.Rot3(R), p))
    values.insert(V(0), v)
    values.insert(B(0), gtsam.imuBias.ConstantBias(bias[:3], bias[3:]))
    values.insert(Y(0), vehicle.car_pose(values.atPose3(X(0)), w, MOUNTING + [PITCH, 0]))
    values.insert(W(0), w)
    values.insert(K(0), vehicle.calibration([*MOUNTING, SCALE]))
    values.insert(Z(0), np.zeros(3))
    return values


def test_a_car_that_follows_its_axis_leaves_no_residual():
    R = exp_so3(np.array([[0.1, 0.2, 0.3]]))
    ahead = exp_so3(np.array([0, *MOUNTING]))[:, 0]
    v = 10 * SCALE * (R @ ahead)
    u = vehicle.body_velocity(R, v, np.zeros((1, 3)), np.zeros((1, 6)), ARM)
    assert vehicle.non_holonomic(u, MOUNTING).error == pytest.approx(0, abs=1e-12)
    assert vehicle.wheel(u, MOUNTING, SCALE, np.array([10.0])).error == pytest.approx(0, abs=1e-12)


def test_an_imu_ahead_of_the_axle_moves_sideways_in_a_bend():
    """Half a radian a second to the left, two metres ahead: the axle itself goes straight on."""
    rate, v = np.array([[0.0, 0.0, 0.5]]), np.array([[7.0, 1.0, 0.0]])
    u = vehicle.body_velocity(np.eye(3)[None], v, rate, np.zeros((1, 6)), [-2.0, 0, 0])
    np.testing.assert_allclose(u.value, [[7.0, 0.0, 0.0]], atol=1e-12)


@pytest.mark.parametrize("kind", ["non-holonomic", "wheel"])
@pytest.mark.parametrize("block", ["pose", "velocity", "bias", "mounting", "scale"])
def test_every_jacobian_equals_its_difference_quotient(kind, block):
    R, v, rate, bias = states()
    analytic = getattr(residual(kind, R, v, rate, bias), f"by_{block}")

    def error(d):
        if block == "pose":
            return residual(kind, R @ exp_so3(d[:3]), v, rate, bias).error
        if block == "velocity":
            return residual(kind, R, v + d, rate, bias).error
        if block == "bias":
            return residual(kind, R, v, rate, bias + d).error
        if block == "mounting":
            return residual(kind, R, v, rate, bias, mounting=MOUNTING + d).error
        return residual(kind, R, v, rate, bias, scale=SCALE + d[0]).error

    step = 1e-6
    numeric = np.stack(
        [(error(step * e) - error(-step * e)) / (2 * step) for e in np.eye(analytic.shape[2])], -1
    )
    np.testing.assert_allclose(analytic, numeric, atol=1e-7)


def test_late_wheels_tell_the_speed_that_was_true_at_their_stamp():
    """At rest at the stamp, 2 m/s^2 from then on: 0.1 s later the wheels tell 0.2 m/s."""
    still, told = np.zeros((1, 3)), np.array([0.0])
    u = vehicle.body_velocity(
        np.eye(3)[None], still + [0.2, 0, 0], still, np.zeros((1, 6)), [0] * 3
    )
    late, by_late = vehicle.late_wheel(u, [0, 0], 1.0, told, np.array([2.0]), 0.1)
    assert late.error == pytest.approx(0, abs=1e-12) and by_late == pytest.approx(2.0)


def test_what_late_wheels_say_changes_with_their_lateness_as_it_says():
    R, v, rate, bias = states()
    u, turn = vehicle.body_velocity(R, v, rate, bias, ARM), MOUNTING + [PITCH, 0]
    slope = np.array([1.0, -2.0, 0.5, 3.0])
    on_time, _ = vehicle.late_wheel(u, turn, SCALE, SPEEDS, slope, 0.0)
    late, by_late = vehicle.late_wheel(u, turn, SCALE, SPEEDS, slope, 0.3)
    np.testing.assert_array_equal(on_time.error, vehicle.wheel(u, turn, SCALE, SPEEDS).error)
    np.testing.assert_allclose(late.error - on_time.error, 0.3 * by_late[..., 0])


@pytest.mark.parametrize("k", range(4))
def test_the_native_constraint_has_the_error_of_the_numpy_residual(k):
    R, v, rate, bias = (column[k : k + 1] for column in states())
    ours = residual("non-holonomic", R, v, rate, bias).error[0]
    model = vehicle.car_model([0.1, 0.2])
    factor = vehicle.non_holonomic_factor(X(0), W(0), Y(0), Z(0), K(0), PITCH, model)
    native = factor.unwhitenedError(solved(k))
    np.testing.assert_allclose(native[7:], ours, atol=1e-6)
    cost = 0.5 * ((ours / [0.1, 0.2]) ** 2).sum()
    assert factor.error(solved(k)) == pytest.approx(cost, rel=1e-5)


@pytest.mark.parametrize("k", range(4))
def test_the_native_wheel_has_the_error_of_the_numpy_residual(k):
    ours = residual("wheel", *states()).error[k, 0]
    model = vehicle.wheel_model(0.05)
    factor = vehicle.wheel_factor(Y(0), Z(0), X(0), W(0), K(0), SPEEDS[k], model)
    assert factor.unwhitenedError(solved(k))[6] == pytest.approx(ours, abs=1e-6)
    assert factor.error(solved(k)) == pytest.approx(0.5 * (ours / 0.05) ** 2, rel=1e-6)


@pytest.mark.parametrize("k", range(4))
def test_the_auxiliary_velocity_is_that_of_the_point(k):
    rate = states()[2][k]
    factor = vehicle.point_velocity_factor(X(0), V(0), Y(0), W(0), B(0), rate, ARM)
    assert np.abs(factor.unwhitenedError(solved(k))[6:]).max() < 1e-6


def test_the_native_standstill_has_the_error_of_the_numpy_residual():
    _, v, rate, bias = states()
    ours = vehicle.standstill(v, bias, rate)
    sigmas, model = np.repeat([0.05, 1e-3], 3), gtsam.noiseModel.Isotropic.Sigma(3, 0.05)
    for k in range(4):
        factors = vehicle.standstill_factors(V(0), B(0), rate[k], model, 1e-3)
        native = sum(factor.error(solved(k)) for factor in factors)
        assert native == pytest.approx(0.5 * ((ours.error[k] / sigmas) ** 2).sum())
    moved = vehicle.standstill(v + [1, 2, 3], bias + np.arange(6), rate).error - ours.error
    by = ours.by_velocity @ [1, 2, 3] + ours.by_bias @ np.arange(6)
    np.testing.assert_allclose(moved, np.tile(by, (4, 1)), atol=1e-12)


def test_a_calibration_is_read_as_it_was_written():
    read = vehicle.read_calibration(vehicle.calibration([*MOUNTING, SCALE]))
    np.testing.assert_allclose(read, [*MOUNTING, SCALE])
