"""A velocity of the vehicle in the world: numpy's residual and the native factor."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import M, T, V

from fgloc.factors import velocity
from fgloc.frames import yaw_matrix


def test_the_native_factor_has_the_cost_of_the_residual():
    v, z = np.array([[10.0, -2.0, 0.5]]), np.array([[9.0, -1.0, 0.5]])
    factor = velocity.factor(V(0), z[0], gtsam.noiseModel.Isotropic.Sigma(3, 0.5))
    values = gtsam.Values()
    values.insert(V(0), v[0])
    error = velocity.residual(v, z)[0]
    assert error.tolist() == [1.0, -1.0, 0.0]
    assert factor.error(values) == pytest.approx(0.5 * (error / 0.5) @ (error / 0.5))


def test_an_arm_to_the_origin_makes_a_turning_vehicle_less_sure():
    rate = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 2.0]])
    sigma = velocity.sigma_with_arm([0.3, 0.3], rate, np.array([0.2, 0.0, 0.5]))
    np.testing.assert_allclose(sigma, [0.3, 0.5])


def test_a_late_velocity_tells_what_was_true_at_its_stamp():
    """Braking by 3 m/s^2: the 10 m/s of the stamp are told as 9.4 m/s, 0.2 s later."""
    slope = np.array([[-3.0, 0.0, 0.0]])
    z = np.array([[10.0, 1.0, 0.0]])
    error, by_late = velocity.late_residual(z + 0.2 * slope, z, slope, 0.2)
    np.testing.assert_allclose(error, 0.0, atol=1e-12)
    assert by_late[0, :, 0].tolist() == [3.0, 0.0, 0.0]


def test_a_scale_and_a_turn_of_what_is_told_are_taken_back():
    """10 m/s told as 10.1 m/s and turned to the left by 0.01 rad: second order is left."""
    true = np.array([[10.0, 0.0, 0.4]])
    told = 1.01 * true @ yaw_matrix(0.01).T
    np.testing.assert_allclose(velocity.residual(true, told, [0.01, 0.01]), 0.0, atol=3e-3)
    assert np.abs(velocity.residual(true, told)).max() > 0.1


def test_errors_of_speed_and_direction_have_the_jacobian_of_the_residual():
    v, z = np.array([[3.0, 4.0, 0.5]]), np.array([[3.1, 4.2, 0.4]])
    by = velocity.by_errors(z)[0]
    for i, step in enumerate(np.eye(2)):
        change = velocity.residual(v, z, step) - velocity.residual(v, z)
        np.testing.assert_allclose(by[:, i], change[0], atol=1e-12)
    assert by.tolist() == [[3.1, -4.2], [4.2, 3.1], [0.4, 0.0]]


def test_the_native_factors_of_erring_velocities_have_the_cost_of_the_residual():
    v, z, errors = np.array([10.0, -2.0, 0.5]), np.array([9.0, -1.0, 0.5]), np.array([0.02, -0.01])
    model = gtsam.noiseModel.Isotropic.Sigma(3, 0.5)
    graph = gtsam.NonlinearFactorGraph()
    for factor in velocity.erring_factors(V(0), T(0), M(0), z, model):
        graph.add(factor)
    values = gtsam.Values()
    values.insert(V(0), v)
    values.insert(M(0), errors)
    values.insert(T(0), v + velocity.by_errors(z) @ errors)
    error = velocity.residual(v, z, errors) / 0.5
    assert graph.error(values) == pytest.approx(0.5 * error @ error)


def test_lasting_errors_taken_for_noise_grow_with_speed():
    v = np.array([[0.0, 0.0, 0.0], [6.0, 8.0, 0.0]])
    sigma = velocity.sigma_with_errors(0.3, v, [0.04, 0.01])
    np.testing.assert_allclose(sigma, [0.3, 0.5])
