"""State of the error-state filter, and how a measurement corrects it.

    R, p, v   attitude, position in m and velocity in m/s of a point of the vehicle, in the world
    bias      of the accelerometer in m/s^2 and of the gyro in rad/s
    slow      slowly varying errors of the sources, see `Slow`

Errors are (rotation, position) in the vehicle frame, as in the graph's tangent, then velocity and
slow errors in their own axes: truth = R Exp(e_rotation), p + R e_position, v + e_velocity, ...
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fgloc.drive import GnssBias
from fgloc.factors.detection import FLAT_SURVEY
from fgloc.factors.gnss import bias_transition
from fgloc.frames import exp_so3, skew
from fgloc.measurements import Array
from fgloc.positions import PositionSource

ROTATION, POSITION, VELOCITY, BIAS = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 15)
CORE = 15
"""Errors before the slow ones."""
PER_SOURCE = 6
"""Slow errors that a source of positions can have."""


@dataclass(frozen=True, eq=False)
class State:
    """An estimate: R (3, 3), p (3,), v (3,), bias (6,), slow (m,); cov (15 + m, 15 + m)."""

    R: Array
    p: Array
    v: Array
    bias: Array
    slow: Array
    cov: Array

    def innovation(self, H: Array, noise: Array) -> Array:
        """Covariance (n, n) of an innovation with Jacobian (n, 15 + m) and noise (n, n)."""
        S: Array = H @ self.cov @ H.T + noise
        return S

    def corrected(self, error: Array, H: Array, noise: Array) -> "State":
        """After a measurement with error (n,) predicted minus measured; Joseph's form."""
        K = np.linalg.solve(self.innovation(H, noise), H @ self.cov).T
        kept = np.eye(len(self.cov)) - K @ H
        cov = kept @ self.cov @ kept.T + K @ noise @ K.T
        step = -K @ error
        return State(
            self.R @ exp_so3(step[ROTATION]), self.p + self.R @ step[POSITION],
            self.v + step[VELOCITY], self.bias + step[BIAS], self.slow + step[CORE:],
            (cov + cov.T) / 2,
        )  # fmt: skip

    def loosened(self, sigma_m: float) -> "State":
        """With more doubt about the position, as after a reset."""
        cov = self.cov.copy()
        cov[POSITION, POSITION] += sigma_m**2 * np.eye(3)
        return replace(self, cov=cov)

    def point(self, lever_m: Array) -> tuple[Array, Array]:
        """Place (3,) of a point of the vehicle and its Jacobian (3, 15 + m)."""
        H = np.zeros((3, len(self.cov)))
        arm = self.R @ lever_m
        H[:, ROTATION] = -self.R @ skew(lever_m)
        H[:, POSITION] = self.R
        return self.p + arm, H


@dataclass(frozen=True, eq=False)
class Slow:
    """What varies slowly, or not at all: a stationary sigma (m,) and a time (m,) over which it is
    forgotten.

    Each source of positions has six such errors, if it has them: its slow bias, East, North and up
    in m, and those of its survey, East and North in m and yaw in rad, which stay. `active` says
    which of all these are unknown at all.
    """

    sigma: Array
    tau_s: Array
    active: NDArray[np.bool_]

    @classmethod
    def of(cls, sources: Sequence[PositionSource]) -> "Slow":
        """The slow errors of a drive's sources; a node's positions have no height to be wrong."""
        sigma, tau = [], []
        for source in sources:
            bias = source.bias or GnssBias(0.0, 1.0)
            axes = [bias.sigma_m] * source.dof + [0.0] * (3 - source.dof)
            sigma += [*axes, *source.survey_sigmas[:FLAT_SURVEY]]
            tau += [bias.tau_s] * 3 + [np.inf] * 3
        active = np.array(sigma) > 0
        return cls(np.array(sigma)[active], np.array(tau)[active], active)

    @property
    def of_fixes(self) -> int:
        """How many of them, the first, are of the fixes: 3 or none."""
        return int(self.active[:3].sum())

    def step(self, dt_s: float) -> tuple[Array, Array]:
        """Factor and variance (m,) of a first-order Gauss-Markov process over dt seconds."""
        phi, noise = bias_transition(dt_s / self.tau_s, 1.0, 1.0)
        return phi, (self.sigma * noise) ** 2
