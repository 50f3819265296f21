"""How the error-state filter moves from epoch to epoch: by an IMU, or by stated velocities."""

from dataclasses import replace
from typing import Protocol

import numpy as np

from fgloc.baselines.eskf_state import BIAS, CORE, POSITION, ROTATION, Slow, State
from fgloc.config import ImuConfig
from fgloc.drive import Drive, ImuNoise
from fgloc.errors import DriveError
from fgloc.factors import imu
from fgloc.factors.preintegration import preintegrate
from fgloc.frames import yaw_matrix
from fgloc.measurements import Array, EnuVelocities
from fgloc.sync import Epochs
from fgloc.timing import Instants, elapsed_s

MIN_SPEED_MPS = 1.5
"""Slower than this a velocity shows no course."""
SLIP_RAD = 0.03
"""How far a car's heading may be off its course."""
LEVEL_RAD = 0.05
"""How far a road is off level; of a start, and where nothing measures it."""


class Motion(Protocol):
    """What the filter asks of its motion; `p_veh_m` is the point of the vehicle it is about."""

    p_veh_m: Array

    def step(self, k: int, state: State) -> State:
        """The state at epoch k from that at epoch k - 1."""

    def told(self, k: int, state: State) -> State:
        """The state at epoch k as it is written."""


class Inertial:
    """The IMU, preintegrated from epoch to epoch, with the graph's equations."""

    def __init__(self, drive: Drive, epochs: Epochs, config: ImuConfig, slow: Slow) -> None:
        noise = drive.rig.imu_noise
        if noise is None:
            raise DriveError(f"drive {drive.name!r} has no [rig.imu_noise]; give it there")
        self.noise: ImuNoise = noise
        self.p_veh_m = np.array(drive.rig.T_veh_imu[:3, 3])
        self.gravity_mps2 = config.gravity_mps2 or drive.origin.gravity_mps2()
        self._slow = slow
        gap, e = epochs.in_gap[1:], epochs
        densities = (
            np.where(gap, config.gap_accel_mps2, noise.accel_noise_mps2_per_sqrt_hz),
            np.where(gap, config.gap_gyro_radps, noise.gyro_noise_radps_per_sqrt_hz),
        )
        told = preintegrate(e.accel_mps2, e.gyro_radps, e.dt_s, e.first_sample[1:-1],
                            e.first_sample[None, 2:], *densities)  # fmt: skip
        self._deltas = told.take(0)

    @property
    def bias_sigmas(self) -> Array:
        """How far the biases (6,) may be from zero at the start, m/s^2 and rad/s."""
        n = self.noise
        return np.array([n.accel_bias_sigma_mps2] * 3 + [n.gyro_bias_sigma_radps] * 3)

    def step(self, k: int, state: State) -> State:
        """Mechanisation, with the covariance that the preintegration gives."""
        deltas = self._deltas.take(slice(k - 1, k))
        R, bias = state.R[None], state.bias
        R_j, p, v = imu.predict(deltas, R, state.p[None], state.v[None], bias, self.gravity_mps2)
        by_state, by_bias = imu.transition(deltas, R, bias)
        dt_s = float(deltas.dt_s[0])
        phi, variance = self._slow.step(dt_s)
        F = np.diag(np.concatenate([np.ones(CORE), phi]))
        F[:9, :9], F[:9, BIAS] = by_state[0], by_bias[0]
        cov = F @ state.cov @ F.T
        cov[:9, :9] += imu.noise_world_velocity(deltas, R_j)[0]
        walk = imu.bias_walk_sigmas(self.noise, dt_s) ** 2
        cov[np.arange(9, len(cov)), np.arange(9, len(cov))] += np.concatenate([walk, variance])
        return State(R_j[0], p[0], v[0], bias, phi * state.slow, (cov + cov.T) / 2)

    def told(self, k: int, state: State) -> State:
        """As it is."""
        return state


class Planar:
    """Stated velocities, on a level road along their course; the vehicle's origin is the point.

    Their errors are white from row to row. Heading and velocity are those of the table at every
    epoch: only the position and the slow errors are filtered. What the heading errs turns lever
    arms by some cm, for long the same; were it taken for noise, new at each epoch, the filter would
    tell height from pitch by it. It is left out there and added to what is told.
    """

    p_veh_m = np.zeros(3)

    def __init__(self, velocity: EnuVelocities, t_ns: Instants, slow: Slow) -> None:
        have = elapsed_s(velocity.t_ns, int(t_ns[0]))
        self._t_s, self._slow = elapsed_s(t_ns, int(t_ns[0])), slow
        columns = [*velocity.v_world_mps.T, velocity.sigma_mps]
        *v, self._sigma = (np.interp(self._t_s, have, column) for column in columns)
        self.v = np.stack(v, -1)
        self._spacing_s = float(np.median(np.diff(have))) if len(have) > 1 else 0.1
        fast = np.hypot(*self.v[:, :2].T) >= MIN_SPEED_MPS
        self._course_at = np.maximum.accumulate(np.where(fast, np.arange(len(fast)), -1))

    def heading(self, k: int) -> tuple[Array, float] | None:
        """Attitude along the course at an epoch and the sigma of its yaw; while the vehicle is slow
        as it was last, None where it never moved."""
        at = int(self._course_at[k])
        if at < 0:
            return None
        speed = float(np.hypot(*self.v[at, :2]))
        R = yaw_matrix(np.arctan2(self.v[at, 1], self.v[at, 0]))
        return R, float(np.hypot(SLIP_RAD, self._sigma[at] / speed))

    def step(self, k: int, state: State) -> State:
        """Along the mean of two velocities."""
        dt_s = float(self._t_s[k] - self._t_s[k - 1])
        R, _ = self.heading(k) or (state.R, 0.0)
        phi, variance = self._slow.step(dt_s)
        F = np.diag(np.concatenate([np.zeros(CORE), phi]))
        F[POSITION, POSITION] = R.T @ state.R
        cov = F @ state.cov @ F.T
        cov[POSITION, POSITION] += self._sigma[k] ** 2 * self._spacing_s * dt_s * np.eye(3)
        cov[np.arange(CORE, len(cov)), np.arange(CORE, len(cov))] += variance
        p = state.p + (self.v[k] + self.v[k - 1]) / 2 * dt_s
        return State(R, p, self.v[k], state.bias, phi * state.slow, (cov + cov.T) / 2)

    def told(self, k: int, state: State) -> State:
        """With what the heading may err."""
        _, yaw_sigma = self.heading(k) or (state.R, np.pi)
        cov = state.cov.copy()
        cov[ROTATION, ROTATION] = np.diag([LEVEL_RAD, LEVEL_RAD, yaw_sigma]) ** 2
        return replace(state, cov=cov)
