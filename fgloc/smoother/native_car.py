"""The vehicle's part of the native graph.

A constraint at keyframe j adds the car's own axes Y(j) and, where its point is not the IMU's place,
that point's velocity W(j); all share K(0), the calibration, and Z(0), a zero: see
`factors.vehicle`. Where lasting errors of the velocities are estimated they are M(0), and what
should be told at keyframe j is T(j).
"""

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, K, M, T, V, W, X, Y, Z

from fgloc.constraints import STANDSTILL
from fgloc.factors import noise, vehicle, velocity
from fgloc.measurements import Array
from fgloc.smoother import velocities
from fgloc.smoother.car import SLIP_WIDTH, STILL_WIDTH, WHEEL_WIDTH, Car
from fgloc.smoother.states import Robustness

Factors = list[gtsam.NonlinearFactor]


class NativeCar(Car):
    """A car that builds its factors."""

    @property
    def keys(self) -> list[int]:
        """Shared variables."""
        return [K(0), Z(0)] * self.acts + [M(0)] * self.velocities.err

    def keys_at(self, j: int) -> list[int]:
        """Variables of the constraint at keyframe j."""
        return [Y(j), W(j)] if self.has_arm else [Y(j)]

    def prior_factors(self) -> Factors:
        """What is known of the shared variables beforehand."""
        factors: Factors = []
        if self.acts:
            c = self.config
            factors = [vehicle.calibration_prior(K(0), c.mounting_sigma_rad, c.scale_sigma),
                       vehicle.zero_prior(Z(0))]  # fmt: skip
        if self.velocities.err:
            known = gtsam.noiseModel.Diagonal.Sigmas(self.velocities.error_sigmas)
            factors.append(gtsam.PriorFactorVector(M(0), np.zeros(2), known))
        return factors

    def insert_shared(self, values: gtsam.Values) -> None:
        """Put in the variables that all constraints share."""
        if self.acts:
            values.insert(K(0), vehicle.calibration(self.found))
            values.insert(Z(0), np.zeros(3))
        if self.velocities.err:
            values.insert(M(0), self.velocities.found)

    def insert(
        self, values: gtsam.Values, j: int, pose: gtsam.Pose3, velocity: Array,
        bias: gtsam.imuBias.ConstantBias,
    ) -> None:  # fmt: skip
        """Put in the variables of the constraint at keyframe j, as its state and the calibration
        found so far have them."""
        rate = self.rate_radps[j] - bias.gyroscope()
        point = velocity + pose.rotation().matrix() @ np.cross(rate, self.arm)
        turn = self.turn(self.found)[j]
        values.insert(Y(j), vehicle.car_pose(pose, point, turn))
        if self.has_arm:
            values.insert(W(j), point)

    def axis_factors(self, j: int) -> Factors:
        """The axes that the car follows at keyframe j, and that it follows them if asked."""
        model = vehicle.car_model(self.slip_sigmas_mps[j])
        model = noise.robust(model, "huber", SLIP_WIDTH)
        slip = vehicle.non_holonomic_factor(
            X(j), self._point(j), Y(j), Z(0), K(0), float(self.pitch_rad[j]), model
        )
        if not self.has_arm:
            return [slip]
        keys = X(j), V(j), Y(j), W(j), B(int(self.bias_of[j]))
        return [slip, vehicle.point_velocity_factor(*keys, self.rate_radps[j], self.arm)]

    def wheel_factors(self, j: int) -> Factors:
        """The wheel speed at keyframe j, whose axes are in the graph."""
        model = vehicle.wheel_model(float(self.speed_sigma_mps[j]))
        model, speed = noise.robust(model, "huber", WHEEL_WIDTH), float(self.speed_mps[j])
        return [vehicle.wheel_factor(Y(j), Z(0), X(j), self._point(j), K(0), speed, model)]

    def still_factors(self, j: int) -> Factors:
        """The car stands at keyframe j."""
        bias, rate = B(int(self.bias_of[j])), self.mean_rate_radps[j]
        still = gtsam.noiseModel.Isotropic.Sigma(3, self.config.still_speed_mps)
        model = noise.robust(still, "huber", STILL_WIDTH)
        return vehicle.standstill_factors(V(j), bias, rate, model, self.still_rate_sigma)

    def velocity_keys(self, j: int) -> list[int]:
        """The variables that the velocity at keyframe j adds."""
        return [T(j)] * self.velocities.err

    def insert_velocity(self, values: gtsam.Values, j: int, v_world_mps: Array) -> None:
        """Put them in: what should be told at the velocity of a state."""
        told = self.velocities
        for key in self.velocity_keys(j):
            off = velocity.by_errors(told.v_world_mps[j]) @ told.found
            values.insert(key, v_world_mps + off)

    def velocity_factors(self, j: int) -> Factors:
        """The velocity at keyframe j."""
        told = self.velocities
        plain = gtsam.noiseModel.Isotropic.Sigma(3, told.sigma_mps[j])
        model = noise.robust(plain, "huber", velocities.WIDTH)
        if told.err:
            return velocity.erring_factors(V(j), T(j), M(0), told.v_world_mps[j], model)
        return [velocity.factor(V(j), told.v_world_mps[j], model)]

    def factors(self, j: int, robust: Robustness) -> Factors:
        """All that is known at keyframe j and not left out, for a graph that is built at once."""
        build = {self.wheel_source: self.wheel_factors, STANDSTILL: self.still_factors,
                 velocities.SOURCE: self.velocity_factors}  # fmt: skip
        factors = self.axis_factors(j) if self.in_force[j] else []
        for source, row in self.rows_of.items():
            if source in build and row[j] >= 0 and j not in robust.unheld.get(source, ()):
                factors += build[source](j)
        return factors

    def calibration(self, values: gtsam.Values) -> Array:
        """The calibration (3,) as a solution has it."""
        if not self.acts:
            return vehicle.STRAIGHT
        return vehicle.read_calibration(values.atConstantBias(K(0)))

    def velocity_errors(self, values: gtsam.Values) -> Array:
        """What speed and direction of the velocities are off (2,) as a solution has them."""
        return np.asarray(values.atVector(M(0))) if self.velocities.err else np.zeros(2)

    def _point(self, j: int) -> int:
        """The key of the velocity of the point that does not slide."""
        return W(j) if self.has_arm else V(j)
