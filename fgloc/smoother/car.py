"""The vehicle's part of a model: constraints of a car's motion, and wheel speeds.

What all of them share is the calibration (3,): pitch and yaw in rad from the vehicle's axes to
those that the car follows, and the scale of the wheels.
"""

import numpy as np
from numpy.typing import NDArray

from fgloc.chi_square import chi2_quantile
from fgloc.config import SmoothConfig
from fgloc.constraints import NON_HOLONOMIC, STANDSTILL, wheel_of, wheel_source
from fgloc.drive import Drive, Noise
from fgloc.factors import noise, vehicle
from fgloc.measurements import Array
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
        self.velocities = Velocities(drive, plan, config.gnss)
        self.wheel_row = held.wheel_row[at]
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

    def worth(self, first: int, stop: int) -> int:
        """How many fixes have as many numbers as the velocities of keyframes first..stop - 1 and,
        without an IMU, what else there is ten times a second."""
        within = slice(first, stop)
        numbers = 3 * int((self.velocities.row[within] >= 0).sum())
        if not self.is_mounted:
            numbers += int((self.wheel_row[within] >= 0).sum() + 2 * self.in_force[within].sum())
        return numbers // 3

    def summary(self) -> dict[str, float]:
        """What was found of the wheels and of the mounting, where anything tells of them."""
        if not self.acts:
            return {}
        pitch_deg, yaw_deg = np.rad2deg(self.found[:2]).tolist()
        told = {"mounting_pitch_deg": pitch_deg, "mounting_yaw_deg": yaw_deg}
        told = told if self.config.non_holonomic and self.is_mounted else {}
        return told | ({"wheel_scale": float(self.found[2])} if (self.wheel_row >= 0).any() else {})

    def wheel_fits(
        self, j: int, R: Array, v: Array, bias: Array, calibration: Array, cov: Array
    ) -> bool:  # fmt: skip
        """Gate the wheel speed at keyframe j against a state with the covariance `cov` (9, 9) of
        pose and velocity, and note its verdict; the wheels' scale counts as known beforehand."""
        speed, sigma = self.speed(j)
        u = vehicle.body_velocity(R[None], v[None], self.rate_radps[[j]], bias[None], self.arm)
        turn = self.turn(calibration)
        told = vehicle.wheel(u, turn[j], calibration[2], np.array([speed]))
        H = np.concatenate([told.by_pose[0], told.by_velocity[0]], axis=1)
        spread = sigma**2 + (self.config.scale_sigma * speed) ** 2
        nis = float(noise.nis(told.error[0], H @ cov @ H.T + spread))
        return self._gate(self.wheel_source, int(self.wheel_row[j]), nis, 1)

    def note_slip(
        self, j: int, R: Array, v: Array, bias: Array, cov: Array, mounting_cov: Array
    ) -> None:  # fmt: skip
        """Note the NIS of the non-holonomic constraint at keyframe j against a state with the
        covariance `cov` (9, 9) of pose and velocity, and a mounting (2, 2) that is as well known.

        There is no gate: the constraint is nobody's measurement, and its loss weighs it down.
        """
        if not self.config.non_holonomic:
            return
        u = vehicle.body_velocity(R[None], v[None], self.rate_radps[[j]], bias[None], self.arm)
        told = vehicle.non_holonomic(u, self.turn(self.found)[j])
        H, M = np.concatenate([told.by_pose[0], told.by_velocity[0]], 1), told.by_mounting[0]
        S = H @ cov @ H.T + M @ mounting_cov @ M.T + np.diag(self.slip_sigmas_mps[j] ** 2)
        own, row = self.verdicts[NON_HOLONOMIC], int(self.slip_row[j])
        own.nis[row], own.dof[row] = float(noise.nis(told.error[0], S)), 2

    def still_fits(self, j: int, v: Array, cov: Array) -> bool:
        """Gate the standstill at keyframe j against a velocity with the covariance (3, 3)."""
        S = cov + self.config.still_speed_mps**2 * np.eye(3)
        return self._gate(STANDSTILL, int(self.still_row[j]), float(noise.nis(v, S)), 3)

    def _gate(self, source: str, row: int, nis: float, dof: int) -> bool:
        verdicts = self.verdicts[source]
        limit = chi2_quantile(self.gnss.gate_probability, dof) * self.gnss.gate_slack**2
        verdicts.nis[row], verdicts.dof[row], verdicts.threshold[row] = nis, dof, limit
        fits = nis <= limit
        reason = "" if fits else "does not fit the prediction"
        verdicts.set(row, Verdict.USED if fits else Verdict.GATED, reason)
        return fits

    def judge(self, R: Array, v: Array, bias: Array, calibration: Array) -> None:
        """Verdicts of a graph that was solved at once: what the losses weigh down, and the rest."""
        u = vehicle.body_velocity(R, v, self.rate_radps, bias, self.arm)
        self.found = calibration
        turn = self.turn(calibration)
        if self.config.non_holonomic:
            at = np.flatnonzero(self.in_force)
            slip = vehicle.non_holonomic(u, turn).error[at] / self.slip_sigmas_mps[at]
            self._weigh(NON_HOLONOMIC, self.slip_row[at], slip, SLIP_WIDTH)
        self.velocities.judge(v)
        if self.wheels is not None and (self.wheel_row >= 0).any():
            at = np.flatnonzero(self.wheel_row >= 0)
            rows = self.wheel_row[at]
            speed, sigma = np.zeros(len(R)), self.wheels.sigma_mps[rows]
            speed[at] = self.wheels.speed_mps[rows]
            miss = vehicle.wheel(u, turn, calibration[2], speed).error[at] / sigma[:, None]
            self._weigh(self.wheel_source, rows, miss, WHEEL_WIDTH)
        if self.stands.any():
            at = np.flatnonzero(self.stands)
            self._weigh(STANDSTILL, self.still_row[at], v[at] / self.config.still_speed_mps,
                        STILL_WIDTH)  # fmt: skip

    def _weigh(self, source: str, rows: NDArray[np.int64], whitened: Array, width: float) -> None:
        weight = noise.weight(np.linalg.norm(whitened, axis=1), "huber", width)
        verdicts = self.verdicts[source]
        verdicts.set(rows, Verdict.USED)
        for row, w in zip(rows[weight < 1], weight[weight < 1], strict=True):
            verdicts.set(row, Verdict.DOWN_WEIGHTED, f"huber weight {w:.3g}")

    def _slip_sigmas(self) -> Array:
        """Standard deviations (n, 2) of the speed to the left and up; none where not asked for."""
        c, sideways = self.config, np.abs(self.rate_radps[:, 2])
        lateral = np.hypot(c.lateral_sigma_mps, c.point_sigma_m * sideways)
        sigmas = np.stack([lateral, np.full(len(lateral), c.vertical_sigma_mps)], -1)
        return sigmas if c.non_holonomic else np.full_like(sigmas, np.inf)

    def turn(self, calibration: Array) -> Array:
        """Turn (n, 2) from the vehicle's axes to the car's at each keyframe: pitch and yaw, rad."""
        return calibration[:2] + np.outer(self.pitch_rad, [1.0, 0.0])

    def speed(self, j: int) -> tuple[float, float]:
        """The wheel speed at keyframe j and its sigma, m/s."""
        assert self.wheels is not None
        row = self.wheel_row[j]
        return float(self.wheels.speed_mps[row]), float(self.wheels.sigma_mps[row])
