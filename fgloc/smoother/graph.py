"""The native graph of a drive: which variables there are, and the factors between them.

Batch, incremental and fixed lag all build their graphs here. Keyframe j has a pose X(j) and a
velocity V(j) as `model.py` says. Biases B(m) are shared; with a GNSS bias each fix adds an antenna
point A(j) and a bias C(j), and L(0) is the lever arm. What the vehicle's constraints add is in
`native_car.py`.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, B, C, L, V, X

from fgloc.config import SmoothConfig
from fgloc.drive import Drive
from fgloc.factors import gnss, imu, noise
from fgloc.measurements import Array
from fgloc.smoother.model import (
    POSITION_SIGMA_M,
    SPEED_SIGMA_MPS,
    Model,
)
from fgloc.smoother.native_car import NativeCar
from fgloc.smoother.tree import Thresholds
from fgloc.sync import Plan

Factors = list[gtsam.NonlinearFactor]

LEVER_SIGMA_M = 1e-4


@dataclass(frozen=True)
class State:
    """One keyframe's values: pose, velocity in m/s (3,), IMU bias."""

    pose: gtsam.Pose3
    velocity: Array
    bias: gtsam.imuBias.ConstantBias

    def nav(self) -> gtsam.NavState:
        """Pose and velocity as GTSAM's navigation state."""
        return gtsam.NavState(self.pose, self.velocity)


@dataclass(frozen=True)
class Interval:
    """IMU between keyframes j - 1 and j: the native sums at the end and at output epochs before."""

    pim: gtsam.PreintegratedImuMeasurements
    inner: tuple[imu.Snapshot, ...]


class GraphModel(Model):
    """A model that builds its factors."""

    car: NativeCar

    def __init__(self, drive: Drive, plan: Plan, config: SmoothConfig) -> None:
        super().__init__(drive, plan, config)
        self._fix_noises: dict[tuple[bytes, float], Any] = {}

    def _car(self) -> NativeCar:
        return NativeCar(self.drive, self.plan, self.config, self.bias_of, self.noise)

    @cached_property
    def thresholds(self) -> Thresholds:
        """By how much a pose may turn and move before iSAM2 relinearises it; see `SolverConfig`."""
        c = self.config.solver
        variance = self.cov_world_m2[self.fix_of[self.fix_of >= 0]].trace(axis1=1, axis2=2) / 3
        fix_m = float(np.sqrt(np.median(variance)))
        return Thresholds(c.relinearize_rad, c.relinearize_m or min(0.1, fix_m))

    @cached_property
    def _params(self) -> gtsam.PreintegrationParams:
        n = self.noise
        return imu.parameters(
            n.accel_noise_mps2_per_sqrt_hz, n.gyro_noise_radps_per_sqrt_hz, self.gravity_mps2
        )

    @cached_property
    def _gap_params(self) -> gtsam.PreintegrationParams:
        return imu.parameters(*self.gap_noise, self.gravity_mps2)

    def interval(self, j: int) -> Interval:
        """The samples between keyframes j - 1 and j, preintegrated at zero bias."""
        first, last = self.epoch_of[j - 1] + 1, self.epoch_of[j]
        params = self._gap_params if self.epochs.in_gap[last] else self._params
        pim = gtsam.PreintegratedImuMeasurements(params)
        inner = []
        for epoch in range(first, last + 1):
            imu.integrate(pim, *self.epochs.samples(epoch))
            if epoch < last:
                inner.append(imu.snapshot(pim))
        return Interval(pim, tuple(inner))

    def prior_factors(self, j: int, state: State, yaw_sigma_rad: float) -> Factors:
        """What is known before any measurement, laid on keyframe j around a guessed state."""
        tilt = np.array([self.level_sigma_rad] * 2 + [yaw_sigma_rad])
        diagonal = gtsam.noiseModel.Diagonal.Sigmas
        level = gtsam.Rot3.Yaw(state.pose.rotation().yaw())
        place = self.first_fix_m if j == 0 else state.pose.translation()
        return [
            gtsam.PoseRotationPrior3D(X(j), level, diagonal(tilt)),
            gtsam.PoseTranslationPrior3D(X(j), place, diagonal(np.full(3, POSITION_SIGMA_M))),
            gtsam.PriorFactorVector(V(j), np.zeros(3), diagonal(np.full(3, SPEED_SIGMA_MPS))),
            gtsam.PriorFactorConstantBias(
                B(self.bias_of[j]), gtsam.imuBias.ConstantBias(), diagonal(self.bias_sigmas)
            ),
            *self._shared_priors(),
        ]

    def carried_prior_factors(self, j: int, state: State, cov: Array) -> Factors:
        """A Gaussian prior (15, 15) of pose, velocity and bias on keyframe j, to go on from."""
        full = gtsam.noiseModel.Gaussian.Covariance
        return [
            gtsam.PriorFactorPose3(X(j), state.pose, full(cov[:6, :6])),
            gtsam.PriorFactorVector(V(j), state.velocity, full(cov[6:9, 6:9])),
            gtsam.PriorFactorConstantBias(B(self.bias_of[j]), state.bias, full(cov[9:, 9:])),
            *self._shared_priors(),
        ]

    def motion_factors(self, j: int, pim: gtsam.PreintegratedImuMeasurements) -> Factors:
        """From keyframe j - 1 to j: the IMU, and a step of the bias where a new one begins."""
        i, b = j - 1, int(self.bias_of[j - 1])
        factors: Factors = [imu.factor((X(i), V(i), X(j), V(j), B(b)), pim)]
        if self.bias_of[j] != b:
            sigmas = imu.bias_walk_sigmas(self.noise, self.bias_t_s[b + 1] - self.bias_t_s[b])
            walk = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
            still = gtsam.imuBias.ConstantBias()
            factors.append(gtsam.BetweenFactorConstantBias(B(b), B(b + 1), still, walk))
        return factors

    def fix_factors(self, j: int, loss_width: float | None = None) -> Factors:
        """The GNSS fix at keyframe j; without a width of the loss, the configuration's."""
        row = self.fix_of[j]
        z = self.fixes.p_world_ant_m[row]
        model = self._fix_noise(row, loss_width or self.config.gnss.loss_width)
        if not self.has_gnss_bias:
            return [gnss.position_factor(X(j), z, self.lever, model)]
        return gnss.biased_position_factors(X(j), A(j), L(0), C(j), z, model)

    def _fix_noise(self, row: int, width: float) -> Any:
        """The noise model of a fix, built once for all rows of the same covariance."""
        cov = self.cov_world_m2[row]
        known = self._fix_noises.get(key := (cov.tobytes(), width))
        if known is None and self.has_gnss_bias:
            known = gtsam.noiseModel.Diagonal.Variances(np.diagonal(cov))
        elif known is None:
            loss = self.config.gnss.loss if np.isfinite(width) else "none"
            known = noise.robust(noise.gaussian(cov), loss, width)
        self._fix_noises = {key: known}
        return known

    def gnss_bias_factors(self, j: int, before: int | None) -> Factors:
        """The bias chain's link to the fix at keyframe j from the fix at an earlier keyframe."""
        if not self.has_gnss_bias:
            return []
        c = self.config.gnss
        if before is None:
            wide = gtsam.noiseModel.Isotropic.Sigma(3, c.bias_sigma_m)
            return [gtsam.PriorFactorVector(C(j), np.zeros(3), wide)]
        dt_s = self.t_s[j] - self.t_s[before]
        return [gnss.bias_transition_factor(C(before), C(j), dt_s, c.bias_sigma_m, c.bias_tau_s)]

    def insert(self, values: gtsam.Values, j: int, state: State, *, new_bias: bool) -> None:
        """Put a keyframe's first values in; the fix's variables come with `insert_fix`."""
        values.insert(X(j), state.pose)
        values.insert(V(j), state.velocity)
        if new_bias:
            values.insert(B(self.bias_of[j]), state.bias)

    def insert_fix(self, values: gtsam.Values, j: int, pose: gtsam.Pose3) -> None:
        """Put in the variables that a fix at keyframe j adds, where it adds any."""
        if self.has_gnss_bias:
            values.insert(A(j), pose.transformFrom(self.lever))
            values.insert(C(j), np.zeros(3))

    def insert_shared(self, values: gtsam.Values) -> None:
        """Put in the variables that all keyframes share."""
        if self.has_gnss_bias:
            values.insert(L(0), self.lever)
        self.car.insert_shared(values)

    @property
    def shared_keys(self) -> list[int]:
        """The variables that all keyframes share."""
        return [L(0), *self.car.keys] if self.has_gnss_bias else self.car.keys

    def _shared_priors(self) -> Factors:
        if not self.has_gnss_bias:
            return self.car.prior_factors()
        tight = gtsam.noiseModel.Isotropic.Sigma(3, LEVER_SIGMA_M)
        lever = gtsam.PriorFactorPoint3(L(0), self.lever, tight)
        return [lever, *self.car.prior_factors()]


def read_state(values: gtsam.Values, j: int, bias: int) -> State:
    """Keyframe j as a solution has it."""
    return State(values.atPose3(X(j)), values.atVector(V(j)), values.atConstantBias(B(bias)))
