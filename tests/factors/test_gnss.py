"""The GNSS factor against differences, against GTSAM, and against its own noise model."""

import gtsam
import numpy as np
import pytest

from fgloc.factors import gnss, noise
from fgloc.frames import exp_so3

LEVER = np.array([1.2, -0.4, 1.5])


def poses(n, seed=0):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, 3)) * 50, exp_so3(rng.normal(size=(n, 3)))


def test_the_native_factor_has_the_error_of_the_numpy_residual():
    p, R = poses(5)
    z = p + 1.0
    ours = gnss.residual(p, R, z, LEVER).error
    for k in range(5):
        factor = gnss.position_factor(0, z[k], LEVER, gtsam.noiseModel.Unit.Create(3))
        native = factor.evaluateError(gtsam.Pose3(gtsam.Rot3(R[k]), p[k]))
        np.testing.assert_allclose(ours[k], native, atol=1e-12)


def test_the_jacobian_by_pose_equals_its_difference_quotient():
    p, R = poses(4)
    analytic = gnss.residual(p, R, p, LEVER).by_pose
    step = 1e-6
    for i, e in enumerate(np.eye(6)):
        plus, minus = (
            gnss.residual(p + s * R @ e[3:], R @ exp_so3(s * e[:3]), p, LEVER).error
            for s in (step, -step)
        )
        np.testing.assert_allclose(analytic[..., i], (plus - minus) / (2 * step), atol=1e-7)


def test_a_bias_variable_shifts_the_fix_by_itself():
    p, R = poses(1)
    z, bias = p[0] + R[0] @ LEVER + [1, 2, 3], np.array([1.0, 2, 3])
    model = gtsam.noiseModel.Isotropic.Sigma(3, 0.5)
    factors = gnss.linked_position_factors(0, 1, 2, z, model, {3: np.eye(3)})
    values = gtsam.Values()
    values.insert(0, gtsam.Pose3(gtsam.Rot3(R[0]), p[0]))
    values.insert(1, p[0] + R[0] @ LEVER)
    values.insert(2, LEVER)
    values.insert(3, bias)
    assert sum(f.error(values) for f in factors) == pytest.approx(0, abs=1e-18)
    assert gnss.residual(p, R, z[None], LEVER, bias).error == pytest.approx(0, abs=1e-12)


def test_the_native_bias_chain_tells_a_bias_from_the_position():
    """A level car known to a centimetre by one fix, then a fix 2 m off: the bias takes the 2 m."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    pose = gtsam.Pose3()
    graph.add(gtsam.PriorFactorPose3(0, pose, gtsam.noiseModel.Isotropic.Sigma(6, 1e-3)))
    graph.add(gtsam.PriorFactorPoint3(2, LEVER, gtsam.noiseModel.Isotropic.Sigma(3, 1e-4)))
    z = LEVER + [2, 0, 0]
    model = gtsam.noiseModel.Isotropic.Sigma(3, 0.1)
    for f in gnss.linked_position_factors(0, 1, 2, z, model, {3: np.eye(3)}):
        graph.add(f)
    graph.add(gtsam.PriorFactorVector(3, np.zeros(3), gtsam.noiseModel.Isotropic.Sigma(3, 5.0)))
    graph.add(gnss.bias_transition_factor(3, 4, 10.0, 5.0, 60.0))
    for key, value in ((0, pose), (1, LEVER), (2, LEVER), (3, np.zeros(3)), (4, np.zeros(3))):
        values.insert(key, value)
    result = gtsam.GaussNewtonOptimizer(graph, values).optimize()
    expected = 2 * 25 / (25 + 0.01)
    phi, _ = gnss.bias_transition(10.0, 5.0, 60.0)
    assert result.atVector(3)[0] == pytest.approx(expected, rel=1e-4)
    assert result.atVector(4)[0] == pytest.approx(phi * expected, rel=1e-4)


def test_a_gauss_markov_bias_keeps_its_stationary_variance():
    phi, sigma = gnss.bias_transition(7.0, 1.3, 60.0)
    assert phi**2 * 1.3**2 + sigma**2 == pytest.approx(1.3**2)


@pytest.mark.parametrize("loss", ["none", "huber", "cauchy"])
def test_our_weights_are_those_of_the_native_loss(loss):
    norms = np.array([0.1, 1.0, 3.4, 5.0, 40.0])
    model = noise.robust(gtsam.noiseModel.Isotropic.Sigma(3, 0.5), loss, 3.4)
    for norm, ours in zip(norms, noise.weight(norms, loss, 3.4), strict=True):
        native = 1.0 if loss == "none" else model.robust().weight(norm)
        assert ours == pytest.approx(native)


def test_nis_of_a_two_sigma_error_on_each_axis_is_eight():
    assert noise.nis([[2.0, 6.0]], [np.diag([1.0, 9.0])]) == pytest.approx(8.0)


@pytest.mark.parametrize("m", [1, 2, 3, 6])
def test_nis_of_many_is_that_of_each(m):
    rng = np.random.default_rng(m)
    root, error = rng.normal(size=(2, 20, m, m)), rng.normal(size=(2, 20, m))
    cov = root @ root.swapaxes(-1, -2) + 0.1 * np.eye(m)
    each = [float(noise.nis(e, S)) for e, S in zip(error.reshape(-1, m), cov.reshape(-1, m, m),
                                                   strict=True)]  # fmt: skip
    np.testing.assert_allclose(noise.nis(error, cov).ravel(), each, rtol=1e-9)


@pytest.mark.parametrize("loss", ["none", "huber", "cauchy"])
def test_weight_and_curvature_are_the_derivatives_of_the_cost(loss):
    norms, step = np.array([0.1, 1.0, 3.0, 5.0, 40.0]), 1e-3

    def cost(x):
        return noise.cost(x, loss, 3.4)

    slope = (cost(norms + step) - cost(norms - step)) / (2 * step)
    bend = (cost(norms + step) - 2 * cost(norms) + cost(norms - step)) / step**2
    np.testing.assert_allclose(noise.weight(norms, loss, 3.4) * norms, slope, rtol=1e-5)
    np.testing.assert_allclose(noise.curvature(norms, loss, 3.4), bend, atol=1e-5)


def late_case(v, R, bias, late_s, p):
    rate, z = np.array([[0.1, -0.2, 0.5]] * len(p)), np.zeros((len(p), 3))
    told = gnss.residual(p, R, z, LEVER)
    return gnss.late_residual(told, R, v, rate - bias, LEVER, late_s)


def test_a_late_fix_is_where_the_antenna_was():
    """Straight on at 10 m/s, stamped 0.1 s late: a metre behind; turning left, it also swings."""
    R, v = np.eye(3)[None], np.array([[10.0, 0, 0]])
    told = gnss.residual(np.zeros((1, 3)), R, np.zeros((1, 3)), [1.0, 0, 0])
    late = gnss.late_residual(told, R, v, np.array([[0, 0, 0.5]]), [1.0, 0, 0], 0.1)
    np.testing.assert_allclose(late.error, [[1 - 1.0, -0.05, 0]])


def test_the_jacobians_of_a_late_fix_equal_their_difference_quotients():
    p, R = poses(4)
    v, bias, late_s, step = np.random.default_rng(1).normal(size=(4, 3)) * 8, np.zeros(3), 0.2, 1e-6
    told = late_case(v, R, bias, late_s, p)

    def slope(moved):
        return (moved(step) - moved(-step)) / (2 * step)

    for i, e in enumerate(np.eye(6)):
        by_pose = slope(
            lambda s, e=e: (
                late_case(v, R @ exp_so3(s * e[:3]), bias, late_s, p + s * R @ e[3:]).error
            )
        )
        np.testing.assert_allclose(told.by_pose[..., i], by_pose, atol=1e-7)
    for i, e in enumerate(np.eye(3)):
        by_v = slope(lambda s, e=e: late_case(v + s * e, R, bias, late_s, p).error)
        by_bias = slope(lambda s, e=e: late_case(v, R, s * e, late_s, p).error)
        np.testing.assert_allclose(told.by_velocity[..., i], by_v, atol=1e-7)
        np.testing.assert_allclose(told.by_gyro_bias[..., i], by_bias, atol=1e-7)
    by_late = slope(lambda s: late_case(v, R, bias, late_s + s, p).error)
    np.testing.assert_allclose(told.by_late[..., 0], by_late, atol=1e-7)
