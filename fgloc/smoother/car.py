"""The vehicle's part of the graph: constraints of a car's motion, and wheel speeds.

A constraint at keyframe j adds the car's own axes Y(j) and, where its point is not the IMU's place,
that point's velocity W(j); all share K(0), the wheels' scale with the IMU's mounting, and Z(0), a
zero: see `factors.vehicle`.
"""

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, K, V, W, X, Y, Z
from numpy.typing import NDArray

from fgloc.chi_square import chi2_quantile
from fgloc.config import SmoothConfig
from fgloc.constraints import NON_HOLONOMIC, STANDSTILL, wheel_of
from fgloc.drive import Drive, ImuNoise
from fgloc.factors import noise, vehicle
from fgloc.measurements import Array
from fgloc.sync import Plan
from fgloc.verdicts import Verdict

Factors = list[gtsam.NonlinearFactor]

SLIP_WIDTH, WHEEL_WIDTH, STILL_WIDTH = 3.0, 2.6, 3.4
"""Whitened norms where Huber's loss leaves the parabola: 99 % of errors of dimension 2, 1 and 3."""


class Car:
    """Which keyframes are constrained, and the native factors that do it."""

    def __init__(
        self, drive: Drive, plan: Plan, config: SmoothConfig, bias_of: NDArray[np.int64],
        imu_noise: ImuNoise,
    ) -> None:  # fmt: skip
        self.config, self.gnss = config.vehicle, config.gnss
        at, held = plan.epochs.keyframes, plan.constraints
        self.verdicts, self.bias_of = plan.verdicts, bias_of
        self.wheels = wheel_of(drive)
        self.wheel_row = held.wheel_row[at]
        self.in_force, self.stands = held.in_force[at], held.stands[at]
        self.slip_row = np.where(self.in_force, np.cumsum(self.in_force) - 1, -1)
        self.still_row = np.where(self.stands, np.cumsum(self.stands) - 1, -1)
        self.rate_radps, self.mean_rate_radps = plan.epochs.rate_radps[at], held.rate_radps[at]
        self.arm = np.array(config.vehicle.p_veh_point_m) - drive.rig.T_veh_imu[:3, 3]
        self.has_arm = bool(self.arm.any())
        white = imu_noise.gyro_noise_radps_per_sqrt_hz / np.sqrt(self.config.still_window_s)
        self.still_rate_sigma = float(np.hypot(white, self.config.still_rate_radps))
        self.found = gtsam.imuBias.ConstantBias()  # scale and mounting as last estimated
        self.slip_sigmas_mps = self._slip_sigmas()
        self.pitch_rad = self.config.pitch_rad_per_mps2 * held.ahead_mps2[at]
        still = gtsam.noiseModel.Isotropic.Sigma(3, self.config.still_speed_mps)
        self._still_model = noise.robust(still, "huber", STILL_WIDTH)

    @property
    def keys(self) -> list[int]:
        """Shared variables."""
        return [K(0), Z(0)] if self.in_force.any() else []

    def keys_at(self, j: int) -> list[int]:
        """Variables of the constraint at keyframe j."""
        return [Y(j), W(j)] if self.has_arm else [Y(j)]

    def prior_factors(self) -> Factors:
        """What is known of the shared variables beforehand."""
        if not self.keys:
            return []
        c = self.config
        return [vehicle.calibration_prior(K(0), c.mounting_sigma_rad, c.scale_sigma),
                vehicle.zero_prior(Z(0))]  # fmt: skip

    def insert_shared(self, values: gtsam.Values) -> None:
        """Put in the variables that all constraints share."""
        if self.keys:
            values.insert(K(0), vehicle.calibration(np.zeros(2), 1.0))
            values.insert(Z(0), np.zeros(3))

    def insert(
        self, values: gtsam.Values, j: int, pose: gtsam.Pose3, velocity: Array,
        bias: gtsam.imuBias.ConstantBias,
        calibration: gtsam.imuBias.ConstantBias | None = None,
    ) -> None:  # fmt: skip
        """Put in the variables of the constraint at keyframe j, as its state and the calibration
        have them; without one, the IMU is taken to be mounted straight."""
        rate = self.rate_radps[j] - bias.gyroscope()
        point = velocity + pose.rotation().matrix() @ np.cross(rate, self.arm)
        turn, _ = self._turn(calibration or gtsam.imuBias.ConstantBias())
        values.insert(Y(j), vehicle.car_pose(pose, point, turn[j]))
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
        speed, sigma = self._speed(j)
        model = noise.robust(vehicle.wheel_model(sigma), "huber", WHEEL_WIDTH)
        return [vehicle.wheel_factor(Y(j), Z(0), X(j), self._point(j), K(0), speed, model)]

    def still_factors(self, j: int) -> Factors:
        """The car stands at keyframe j."""
        bias, rate = B(int(self.bias_of[j])), self.mean_rate_radps[j]
        return vehicle.standstill_factors(
            V(j), bias, rate, self._still_model, self.still_rate_sigma
        )

    def factors(self, j: int) -> Factors:
        """All that is known at keyframe j, for a graph that is built at once."""
        return [
            *(self.axis_factors(j) if self.in_force[j] else []),
            *(self.wheel_factors(j) if self.wheel_row[j] >= 0 else []),
            *(self.still_factors(j) if self.stands[j] else []),
        ]

    def calibration(self, values: gtsam.Values) -> gtsam.imuBias.ConstantBias:
        """Scale and mounting as a solution has them."""
        return values.atConstantBias(K(0)) if self.keys else gtsam.imuBias.ConstantBias()

    def summary(self) -> dict[str, float]:
        """What was found of the wheels and of the mounting, where anything tells of them."""
        if not self.keys:
            return {}
        mounting, scale = vehicle.read_calibration(self.found)
        pitch_deg, yaw_deg = np.rad2deg(mounting).tolist()
        told = {"mounting_pitch_deg": pitch_deg, "mounting_yaw_deg": yaw_deg}
        told = told if self.config.non_holonomic else {}
        return told | ({"wheel_scale": scale} if (self.wheel_row >= 0).any() else {})

    def wheel_fits(
        self, j: int, R: Array, v: Array, bias: Array, calibration: gtsam.imuBias.ConstantBias,
        cov: Array,
    ) -> bool:  # fmt: skip
        """Gate the wheel speed at keyframe j against a state with the covariance `cov` (9, 9) of
        pose and velocity, and note its verdict; the wheels' scale counts as known beforehand."""
        speed, sigma = self._speed(j)
        u = vehicle.body_velocity(R[None], v[None], self.rate_radps[[j]], bias[None], self.arm)
        turn, scale = self._turn(calibration)
        told = vehicle.wheel(u, turn[j], scale, np.array([speed]))
        H = np.concatenate([told.by_pose[0], told.by_velocity[0]], axis=1)
        spread = sigma**2 + (self.config.scale_sigma * speed) ** 2
        nis = float(noise.nis(told.error[0], H @ cov @ H.T + spread))
        return self._gate("wheel", int(self.wheel_row[j]), nis, 1)

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

    def judge(
        self, R: Array, v: Array, bias: Array, calibration: gtsam.imuBias.ConstantBias
    ) -> None:
        """Verdicts of a graph that was solved at once: what the losses weigh down, and the rest."""
        u = vehicle.body_velocity(R, v, self.rate_radps, bias, self.arm)
        self.found = calibration
        turn, scale = self._turn(calibration)
        if self.config.non_holonomic:
            at = np.flatnonzero(self.in_force)
            slip = vehicle.non_holonomic(u, turn).error[at] / self.slip_sigmas_mps[at]
            self._weigh(NON_HOLONOMIC, self.slip_row[at], slip, SLIP_WIDTH)
        if self.wheels is not None:
            at = np.flatnonzero(self.wheel_row >= 0)
            rows = self.wheel_row[at]
            speed, sigma = np.zeros(len(R)), self.wheels.sigma_mps[rows]
            speed[at] = self.wheels.speed_mps[rows]
            miss = vehicle.wheel(u, turn, scale, speed).error[at] / sigma[:, None]
            self._weigh("wheel", rows, miss, WHEEL_WIDTH)
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

    def _turn(self, calibration: gtsam.imuBias.ConstantBias) -> tuple[Array, float]:
        """Turn (n, 2) from the vehicle's axes to the car's at each keyframe, and the scale."""
        mounting, scale = vehicle.read_calibration(calibration)
        return mounting + np.outer(self.pitch_rad, [1.0, 0.0]), scale

    def _speed(self, j: int) -> tuple[float, float]:
        assert self.wheels is not None
        row = self.wheel_row[j]
        return float(self.wheels.speed_mps[row]), float(self.wheels.sigma_mps[row])

    def _point(self, j: int) -> int:
        """The key of the velocity of the point that does not slide."""
        return W(j) if self.has_arm else V(j)
