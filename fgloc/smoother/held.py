"""What the vehicle's own sources say of the states: constraints, wheel speeds, velocities."""

import numpy as np
from numpy.typing import NDArray

from fgloc.constraints import NON_HOLONOMIC, STANDSTILL
from fgloc.factors import vehicle, velocity
from fgloc.measurements import Array
from fgloc.smoother import clocks, velocities
from fgloc.smoother.car import SLIP_WIDTH, STILL_WIDTH, WHEEL_WIDTH
from fgloc.smoother.model import Model
from fgloc.smoother.states import States
from fgloc.smoother.term import BIAS, FULL, VELOCITY, Border, Term


class Held:
    """Terms of a model's car, each of one source at some keyframes (m,)."""

    def __init__(self, model: Model, border: Border) -> None:
        self._model, self._car, self._border = model, model.car, border

    def term(self, source: str, states: States, at: NDArray[np.int64]) -> Term:
        """What a source says; of standstill the speed alone, its turn is in `still_rate`."""
        if source == NON_HOLONOMIC:
            u, turn = self._body_velocity(states, at), self._car.turn(states.calibration)[at]
            sigma = self._car.slip_sigmas_mps[at]
            return self._vehicle(at, vehicle.non_holonomic(u, turn), sigma, SLIP_WIDTH)
        if source == STANDSTILL:
            eye = np.broadcast_to(np.eye(3), (len(at), 3, 3)) / self._car.config.still_speed_mps
            error = states.v[at] / self._car.config.still_speed_mps
            return Term(at, VELOCITY, error, eye, "huber", STILL_WIDTH)
        if source == velocities.SOURCE:
            return self._velocity(states, at)
        return self._wheel(states, at)

    def still_rate(self, states: States, at: NDArray[np.int64]) -> Term:
        """That a car at rest does not turn."""
        rate, quiet = self._car.mean_rate_radps[at], self._car.still_rate_sigma
        error = vehicle.standstill(states.v[at], states.bias[at], rate).error[:, 3:]
        return Term(
            at, BIAS[3:], error / quiet, np.broadcast_to(np.eye(3), (len(at), 3, 3)) / quiet
        )

    def _wheel(self, states: States, at: NDArray[np.int64]) -> Term:
        car, late = self._car, clocks.acting(self._model.config, self._car.wheel_source)
        slope = car.wheel_slope_mps2[at] if len(late) else np.zeros(len(at))
        u, turn = self._body_velocity(states, at), car.turn(states.calibration)[at]
        scale, late_s = float(states.calibration[2]), float(states.late_s[late].sum())
        told, by_late = vehicle.late_wheel(u, turn, scale, car.speed_mps[at], slope, late_s)
        sigma = car.speed_sigma_mps[at][:, None]
        term = self._vehicle(at, told, sigma, WHEEL_WIDTH)
        term.jacobian[..., len(FULL) :] += self._border.by(late, by_late / sigma[..., None])
        return term

    def _velocity(self, states: States, at: NDArray[np.int64]) -> Term:
        told, late = self._car.velocities, clocks.acting(self._model.config, velocities.SOURCE)
        slope = told.slope_mps2[at] if len(late) else np.zeros((len(at), 3))
        error, by_late = velocity.late_residual(
            states.v[at], told.v_world_mps[at], slope, float(states.late_s[late].sum()),
            states.velocity_errors,
        )  # fmt: skip
        eye = np.broadcast_to(np.eye(3), (len(at), 3, 3))
        border = self._border.by(late, by_late)
        if told.err:
            border[:, :, self._border.velocity] = velocity.by_errors(told.v_world_mps[at])
        J = np.concatenate([eye, border], -1)
        sigma = told.sigma_mps[at][:, None]
        return Term(at, VELOCITY, error / sigma, J / sigma[..., None], "huber", velocities.WIDTH)

    def _body_velocity(self, states: States, at: NDArray[np.int64]) -> vehicle.BodyVelocity:
        return vehicle.body_velocity(
            states.R[at], states.v[at], self._car.rate_radps[at], states.bias[at], self._car.arm
        )

    def _vehicle(
        self, at: NDArray[np.int64], told: vehicle.VehicleResidual, sigma: Array, width: float
    ) -> Term:
        """A constraint with standard deviations (m, rows) under Huber's loss."""
        by_calibration = np.concatenate([told.by_mounting, told.by_scale], -1)
        border = self._border.by(self._border.car, by_calibration)
        J = np.concatenate([told.by_pose, told.by_velocity, told.by_bias, border], -1)
        return Term(at, FULL, told.error / sigma, J / sigma[..., None], "huber", width)
