"""A velocity of the vehicle in the world: numpy's residual and the native factor."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import V

from fgloc.factors import velocity


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
