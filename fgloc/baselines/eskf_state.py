"""State of the error-state filter, and how a measurement corrects it.

    R, p, v   attitude, position in m and velocity in m/s of a point of the vehicle, in the world
    bias      of the accelerometer in m/s^2 and of the gyro in rad/s
    slow      slowly varying errors: of the fixes, and of each node's survey and positions

Errors are (rotation, position) in the vehicle frame, as in the graph's tangent, then velocity and
slow errors in their own axes: truth = R Exp(e_rotation), p + R e_position, v + e_velocity, ...
"""

from dataclasses import dataclass, replace

import numpy as np

from fgloc.drive import Drive
from fgloc.factors.imu import Array
from fgloc.frames import exp_so3

ROTATION, POSITION, VELOCITY, BIAS = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 15)
CORE = 15
"""Errors before the slow ones."""
GNSS, PER_NODE = 3, 5


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
        x, y, z = lever_m
        H[:, ROTATION] = -self.R @ np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        H[:, POSITION] = self.R
        return self.p + arm, H


@dataclass(frozen=True, eq=False)
class Slow:
    """What varies slowly: a stationary sigma (m,) and a time (m,) over which it is forgotten.

    The error of the fixes comes first, East, North and up in m; then for each node the errors of
    its surveyed place (2, m) and yaw (rad), which stay, and of its positions along its own axes
    (2, m). What the drive does not state has a sigma of 0 and so stays at zero.
    """

    sigma: Array
    tau_s: Array

    @classmethod
    def of(cls, drive: Drive) -> "Slow":
        """As the drive states it."""
        bias = drive.rig.gnss_bias
        sigma, tau = [0.0 if bias is None else bias.sigma_m] * 3, [bias.tau_s if bias else 1.0] * 3
        for node in drive.infrastructure.nodes:
            sigma += [node.sigma_position_m] * 2 + [node.sigma_yaw_rad] + [node.bias_sigma_m] * 2
            tau += [np.inf] * 3 + [node.bias_tau_s] * 2
        return cls(np.array(sigma), np.array(tau))

    def step(self, dt_s: float) -> tuple[Array, Array]:
        """Factor and variance (m,) of a first-order Gauss-Markov process over dt seconds."""
        return np.exp(-dt_s / self.tau_s), -(self.sigma**2) * np.expm1(-2 * dt_s / self.tau_s)

    @staticmethod
    def of_node(number: int) -> int:
        """Where the errors of a node begin among all errors of the state."""
        return CORE + GNSS + PER_NODE * number
