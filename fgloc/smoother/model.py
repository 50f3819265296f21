"""The graph of a drive: which variables there are, and the native factors between them.

Batch, incremental and fixed lag all build their graphs here. Keyframe j has a pose X(j) and a
velocity V(j), of the IMU's place along the vehicle's axes: GTSAM's own way with a lever arm to the
IMU leaves out the tangential acceleration, which is 0.1 m/s^2 where a bend begins. Biases B(m) are
shared by the keyframes of `bias_interval_s`; with a GNSS bias each fix adds an antenna point A(j)
and a bias C(j), and L(0) is the lever arm; what the vehicle's constraints add is in `car`.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, B, C, L, V, X

from fgloc.chi_square import chi2_quantile
from fgloc.config import SmoothConfig
from fgloc.drive import Drive, ImuNoise
from fgloc.errors import DriveError
from fgloc.factors import gnss, imu, noise
from fgloc.frames import skew
from fgloc.measurements import Array
from fgloc.smoother.car import Car
from fgloc.smoother.tree import Thresholds
from fgloc.sync import Plan
from fgloc.timing import elapsed_s

Factors = list[gtsam.NonlinearFactor]

LEVEL_SIGMA_RAD = 0.2
"""A road vehicle is level to this at the start."""
YAW_SIGMA_RAD = 10.0
"""Nothing is known of the yaw: so wide that the guess it is laid around leaves no trace."""
POSITION_SIGMA_M = 100.0
"""Around the first fix."""
SPEED_SIGMA_MPS = 30.0
"""Around standstill."""
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


class Model:
    """Everything about a drive's graph that does not change while it is solved."""

    def __init__(self, drive: Drive, plan: Plan, config: SmoothConfig) -> None:
        self.drive, self.plan, self.config = drive, plan, config
        self.epochs = plan.epochs
        self.fixes = drive.gnss
        self.p_veh_imu_m = np.array(drive.rig.T_veh_imu[:3, 3])
        self.lever = drive.rig.p_veh_ant_m - self.p_veh_imu_m
        self.antenna_by_pose = np.hstack([-skew(self.lever), np.eye(3)])
        self.epoch_of = self.epochs.keyframes
        self.t_ns = self.epochs.t_ns[self.epoch_of]
        self.t_s = elapsed_s(self.t_ns, int(self.t_ns[0]))
        self.fix_of = self.epochs.fix_row[self.epoch_of]
        self.noise = _imu_noise(drive, config)
        self.gravity_mps2 = config.imu.gravity_mps2 or drive.origin.gravity_mps2()
        self.bias_of, self.bias_t_s = _bias_grid(self.t_s, config.imu.bias_interval_s)
        self.has_gnss_bias = config.gnss.bias_sigma_m > 0
        self.car = Car(drive, plan, config, self.bias_of, self.noise)
        self._fix_noises: dict[bytes, Any] = {}

    def __len__(self) -> int:
        return len(self.t_ns)

    @cached_property
    def cov_world_m2(self) -> Array:
        """(N, 3, 3) covariance of every fix as the graph believes it."""
        return self.fixes.cov_world_m2 * self.config.gnss.sigma_scale**2

    @cached_property
    def gate_nis(self) -> float:
        """NIS of a three-dimensional fix above which it is gated."""
        c = self.config.gnss
        return chi2_quantile(c.gate_probability, 3) * c.gate_slack**2

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
        c = self.config.imu
        return imu.parameters(c.gap_accel_mps2, c.gap_gyro_radps, self.gravity_mps2)

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
        tilt = [LEVEL_SIGMA_RAD, LEVEL_SIGMA_RAD, yaw_sigma_rad]
        n = self.noise
        bias = [n.accel_bias_sigma_mps2] * 3 + [n.gyro_bias_sigma_radps] * 3
        diagonal = gtsam.noiseModel.Diagonal.Sigmas
        fix = self.fixes.p_world_ant_m[self.fix_of[self.fix_of >= 0][0]] if j == 0 else None
        level = gtsam.Pose3(gtsam.Rot3.Yaw(state.pose.rotation().yaw()),
                            state.pose.translation() if fix is None else fix)  # fmt: skip
        return [
            gtsam.PriorFactorPose3(X(j), level, diagonal(np.r_[tilt, [POSITION_SIGMA_M] * 3])),
            gtsam.PriorFactorVector(V(j), np.zeros(3), diagonal(np.full(3, SPEED_SIGMA_MPS))),
            gtsam.PriorFactorConstantBias(
                B(self.bias_of[j]), gtsam.imuBias.ConstantBias(), diagonal(np.array(bias))
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

    def fix_factors(self, j: int) -> Factors:
        """The GNSS fix at keyframe j."""
        row = self.fix_of[j]
        z, model = self.fixes.p_world_ant_m[row], self._fix_noise(row)
        if not self.has_gnss_bias:
            return [gnss.position_factor(X(j), z, self.lever, model)]
        return gnss.biased_position_factors(X(j), A(j), L(0), C(j), z, model)

    def _fix_noise(self, row: int) -> Any:
        """The noise model of a fix, built once for all rows of the same covariance."""
        cov, c = self.cov_world_m2[row], self.config.gnss
        known = self._fix_noises.get(key := cov.tobytes())
        if known is None and self.has_gnss_bias:
            known = gtsam.noiseModel.Diagonal.Variances(np.diagonal(cov))
        elif known is None:
            known = noise.robust(noise.gaussian(cov), c.loss, c.loss_width)
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


def _imu_noise(drive: Drive, config: SmoothConfig) -> ImuNoise:
    """The rig's noise with the configuration's values laid over it."""
    given = {
        name: value
        for name in ImuNoise.__dataclass_fields__
        if (value := getattr(config.imu, name)) is not None
    }
    if drive.rig.imu_noise is not None:
        given = {**vars(drive.rig.imu_noise), **given}
    try:
        return ImuNoise(**given)
    except TypeError as err:
        raise DriveError(
            f"drive {drive.name!r} has no [rig.imu_noise]; give it there or as --set imu.*"
        ) from err


def _bias_grid(t_s: Array, interval_s: float) -> tuple[np.ndarray, Array]:
    """Index (n,) of each keyframe's bias, and the time in s (m,) at which each bias begins."""
    index, starts = np.zeros(len(t_s), int), [0.0]
    for j, t in enumerate(t_s):
        if t - starts[-1] >= interval_s - 1e-9:
            starts.append(float(t))
        index[j] = len(starts) - 1
    return index, np.array(starts)
