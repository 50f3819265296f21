"""The vehicle's part of a model: constraints of a car's motion, and wheel speeds.

What all of them share is the calibration (3,): pitch and yaw in rad from the vehicle's axes to
those that the car follows, and the scale of the wheels.
"""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fgloc.config import SmoothConfig
from fgloc.constraints import NON_HOLONOMIC, STANDSTILL, wheel_of, wheel_source
from fgloc.drive import Drive, Noise
from fgloc.factors import noise, vehicle
from fgloc.measurements import Array
from fgloc.smoother import velocities
from fgloc.smoother.left_out import LeftOut
from fgloc.smoother.lines import slopes
from fgloc.smoother.velocities import Velocities
from fgloc.sync import Plan
from fgloc.verdicts import Verdict

SLIP_WIDTH, WHEEL_WIDTH, STILL_WIDTH = 3.0, 2.6, 3.4
"""Whitened norms where Huber's loss leaves the parabola: 99 % of errors of dimension 2, 1 and 3."""


class Car:
    """Which keyframes are constrained, by what numbers, and what became of it."""

    def __init__(
        self, drive: Drive, plan: Plan, config: SmoothConfig, bias_of: NDArray[np.int64],
        imu_noise: Noise,
    ) -> None:  # fmt: skip
        self.config, self.gnss = plan.motion.vehicle, config.gnss
        at, held = plan.epochs.keyframes, plan.constraints
        self.verdicts, self.bias_of = plan.verdicts, bias_of
        self.is_mounted = not plan.motion.is_made_up  # or there is no IMU to be askew
        self.wheels, self.wheel_source = wheel_of(drive), wheel_source(drive)
        self.velocities = Velocities(drive, plan, config)
        self.wheel_row = held.wheel_row[at]
        self.speed_mps, self.speed_sigma_mps = self._speeds()
        self.in_force, self.stands = held.in_force[at], held.stands[at]
        self.slip_row = np.where(self.in_force, np.cumsum(self.in_force) - 1, -1)
        self.still_row = np.where(self.stands, np.cumsum(self.stands) - 1, -1)
        self.rate_radps, self.mean_rate_radps = plan.epochs.rate_radps[at], held.rate_radps[at]
        self.arm = np.array(config.vehicle.p_veh_point_m) - plan.motion.T_veh_imu[:3, 3]
        self.has_arm = bool(self.arm.any())
        density = float(np.max(imu_noise.gyro_noise_radps_per_sqrt_hz))
        white = density / np.sqrt(self.config.still_window_s)
        self.still_rate_sigma = float(np.hypot(white, self.config.still_rate_radps))
        self.calibration_sigmas = np.array(
            [self.config.mounting_sigma_rad] * 2 + [self.config.scale_sigma]
        )
        self.found = vehicle.STRAIGHT  # the calibration as last estimated
        self.slip_sigmas_mps = self._slip_sigmas()
        self.pitch_rad = self.config.pitch_rad_per_mps2 * held.ahead_mps2[at]
        self.acts = bool(self.in_force.any())

    @cached_property
    def wheel_slope_mps2(self) -> Array:
        """How fast the wheels' speed changes (n,) at the keyframes that have one, else 0."""
        slope = np.zeros(len(self.wheel_row))
        if self.wheels is not None:
            at = np.flatnonzero(self.wheel_row >= 0)
            told = slopes(self.wheels.t_ns, self.wheels.speed_mps[:, None])[:, 0]
            slope[at] = told[self.wheel_row[at]]
        return slope

    @cached_property
    def rows_of(self) -> dict[str, NDArray[np.int64]]:
        """Of each of the vehicle's own sources in use, its row (n,) at keyframes; -1 for none."""
        rows = {
            NON_HOLONOMIC: np.where(bool(self.config.non_holonomic), self.slip_row, -1),
            self.wheel_source: self.wheel_row, STANDSTILL: self.still_row,
            velocities.SOURCE: self.velocities.row,
        }  # fmt: skip
        return {source: row for source, row in rows.items() if (row >= 0).any()}

    @cached_property
    def keys_of(self) -> dict[str, NDArray[np.int64]]:
        """The keyframes at which each of them tells something."""
        return {source: np.flatnonzero(row >= 0) for source, row in self.rows_of.items()}

    def worth(self, first: int, stop: int) -> int:
        """How many fixes have as many numbers as the velocities of keyframes first..stop - 1 and,
        without an IMU, what else there is ten times a second."""
        within = slice(first, stop)
        numbers = 3 * int((self.velocities.row[within] >= 0).sum())
        if not self.is_mounted:
            numbers += int((self.wheel_row[within] >= 0).sum() + 2 * self.in_force[within].sum())
        return numbers // 3

    def summary(self) -> dict[str, float]:
        """What was found of the wheels, the mounting and the velocities, where anything tells."""
        return self._calibration_summary() | self.velocities.summary()

    def _calibration_summary(self) -> dict[str, float]:
        if not self.acts:
            return {}
        pitch_deg, yaw_deg = np.rad2deg(self.found[:2]).tolist()
        told = {"mounting_pitch_deg": pitch_deg, "mounting_yaw_deg": yaw_deg}
        told = told if self.config.non_holonomic and self.is_mounted else {}
        return told | ({"wheel_scale": float(self.found[2])} if (self.wheel_row >= 0).any() else {})

    def wheel_fits(
        self, j: int, R: Array, v: Array, bias: Array, cov: Array, calibration_cov: Array
    ) -> bool:  # fmt: skip
        """Gate the wheel speed at keyframe j against a state with the covariance `cov` (9, 9) of
        pose and velocity, and a calibration (3, 3) that is as well known; note its verdict."""
        speed, sigma = float(self.speed_mps[j]), float(self.speed_sigma_mps[j])
        u = vehicle.body_velocity(R[None], v[None], self.rate_radps[[j]], bias[None], self.arm)
        told = vehicle.wheel(u, self.turn(self.found)[j], self.found[2], np.array([speed]))
        H = np.concatenate([told.by_pose[0], told.by_velocity[0]], axis=1)
        M = np.concatenate([told.by_mounting[0], told.by_scale[0]], axis=1)
        S = H @ cov @ H.T + M @ calibration_cov @ M.T + sigma**2
        nis = float(noise.nis(told.error[0], S))
        verdicts, limit = self.verdicts[self.wheel_source], self.limit(self.wheel_source, 1)
        return verdicts.gate(int(self.wheel_row[j]), nis, 1, limit)

    def note_slip(
        self, j: int, R: Array, v: Array, bias: Array, cov: Array, calibration_cov: Array
    ) -> None:  # fmt: skip
        """Note the NIS of the non-holonomic constraint at keyframe j against a state with the
        covariance `cov` (9, 9) of pose and velocity, and a calibration (3, 3) as well known.

        There is no gate: the constraint is nobody's measurement, and its loss weighs it down.
        """
        if not self.config.non_holonomic:
            return
        u = vehicle.body_velocity(R[None], v[None], self.rate_radps[[j]], bias[None], self.arm)
        told = vehicle.non_holonomic(u, self.turn(self.found)[j])
        H, M = np.concatenate([told.by_pose[0], told.by_velocity[0]], 1), told.by_mounting[0]
        S = (
            H @ cov @ H.T
            + M @ calibration_cov[:2, :2] @ M.T
            + np.diag(self.slip_sigmas_mps[j] ** 2)
        )
        own, row = self.verdicts[NON_HOLONOMIC], int(self.slip_row[j])
        own.nis[row], own.dof[row] = float(noise.nis(told.error[0], S)), 2

    def still_fits(self, j: int, v: Array, cov: Array) -> bool:
        """Gate the standstill at keyframe j against a velocity with the covariance (3, 3)."""
        S = cov + self.config.still_speed_mps**2 * np.eye(3)
        verdicts, nis = self.verdicts[STANDSTILL], float(noise.nis(v, S))
        return verdicts.gate(int(self.still_row[j]), nis, 3, self.limit(STANDSTILL, 3))

    def limit(self, source: str, dof: int) -> float:
        """The gate of one of its sources; none for the constraint that nobody measured, which its
        loss weighs down."""
        return np.inf if source == NON_HOLONOMIC else self.gnss.gate_nis(dof)

    def judge(self, source: str, told: LeftOut, limit: float, out: frozenset[int]) -> None:
        """Verdicts of a graph that was solved at once: what was left out at some keyframes, what
        the loss weighs down, and the rest."""
        own, rows = self.verdicts[source], self.rows_of[source][told.keys]
        own.nis[rows], own.dof[rows] = told.nis, told.error.shape[1]
        own.threshold[rows] = limit if np.isfinite(limit) else np.nan
        own.set(rows, Verdict.USED)
        light = told.weight < 1
        for row, weight in zip(rows[light], told.weight[light], strict=True):
            own.set(row, Verdict.DOWN_WEIGHTED, f"huber weight {weight:.3g}")
        gated = rows[np.isin(told.keys, list(out))]
        own.set(gated, Verdict.GATED, "does not fit all other measurements")

    def _slip_sigmas(self) -> Array:
        """Standard deviations (n, 2) of the speed to the left and up; none where not asked for."""
        c, sideways = self.config, np.abs(self.rate_radps[:, 2])
        lateral = np.hypot(c.lateral_sigma_mps, c.point_sigma_m * sideways)
        sigmas = np.stack([lateral, np.full(len(lateral), c.vertical_sigma_mps)], -1)
        return sigmas if c.non_holonomic else np.full_like(sigmas, np.inf)

    def turn(self, calibration: Array) -> Array:
        """Turn (n, 2) from the vehicle's axes to the car's at each keyframe: pitch and yaw, rad."""
        return calibration[:2] + np.outer(self.pitch_rad, [1.0, 0.0])

    def _speeds(self) -> tuple[Array, Array]:
        """Wheel speeds (n,) at the keyframes and their sigmas, m/s; 0 and 1 where there is none."""
        speed, sigma = np.zeros(len(self.wheel_row)), np.ones(len(self.wheel_row))
        at = np.flatnonzero(self.wheel_row >= 0)
        if self.wheels is not None:
            rows = self.wheel_row[at]
            speed[at] = self.wheels.speed_mps[rows]
            sigma[at] = self.config.wheel_sigma_scale * self.wheels.sigma_mps[rows]
        return speed, sigma
