"""The native graph of a drive: which variables there are, and the factors between them.

Batch, incremental and fixed lag all build their graphs here. Keyframe j has a pose X(j) and a
velocity V(j) as `model.py` says. Biases B(m) are shared. A position, row i of the positions, whose
source has errors to be estimated adds the measured point A(i), and C(i) where one of them is slow;
L(0) and L(1) are the lever arms to antenna and box, and S(s) is what the survey of source s is off.
What the vehicle's constraints add is in `native_car.py`, what posts that sway, `native_posts.py`.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, B, C, L, S, U, V, X
from numpy.typing import ArrayLike

from fgloc.config import SmoothConfig
from fgloc.drive import Drive
from fgloc.factors import detection, gnss, imu, noise
from fgloc.measurements import Array
from fgloc.positions import GNSS
from fgloc.smoother.model import (
    POSITION_SIGMA_M,
    SPEED_SIGMA_MPS,
    Model,
)
from fgloc.smoother.native_car import NativeCar
from fgloc.smoother.native_posts import NativePosts, told_factors
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
    swaying: NativePosts

    def __init__(self, drive: Drive, plan: Plan, config: SmoothConfig) -> None:
        super().__init__(drive, plan, config)
        self._noises: dict[int, tuple[bytes, float, Any]] = {}

    def _car(self) -> NativeCar:
        return NativeCar(self.drive, self.plan, self.config, self.bias_of, self.noise)

    def _swaying(self) -> NativePosts:
        return NativePosts(self.drive, self.plan.posts, self.t_ns)

    @cached_property
    def thresholds(self) -> Thresholds:
        """By how much a pose may turn and move before iSAM2 relinearises it; see `SolverConfig`."""
        c = self.config.solver
        variance = self.cov_m2[self.guides].trace(axis1=1, axis2=2) / 3
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
        place = self.first_place_m if j == 0 else state.pose.translation()
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

    def position_factors(self, i: int, fix_width: float | None = None) -> Factors:
        """The measured position of row i; `fix_width` is the width of the fixes' loss, if not the
        configuration's."""
        s, j = int(self.positions.source[i]), int(self.key_of[i])
        source, z = self.sources[s], self.positions.z_world_m[i]
        width = source.settings.loss_width
        if fix_width is not None and source.table == GNSS:
            width = fix_width
        model = self._position_noise(i, s, width)
        if not source.linked:
            return [gnss.position_factor(X(j), z, self.levers[s], model)]
        by = {C(i): np.eye(3)} if source.bias is not None else {}
        if source.surveyed:
            by[S(s)] = -self.positions.by_survey(np.array([i]), source.p_world_m)[0]
        if s in self.swaying.of_source:
            row = self.swaying.row(s, int(self.positions.row[i]), j)
            by[row.key], z = row.J, z + row.moved_m
        return gnss.linked_position_factors(X(j), A(i), self._lever_key(s), z, model, by)

    def reference_factors(self, i: int) -> Factors:
        """What a node sees of the user of row i of the references, whose place is known."""
        found = self.references
        s, z, by = int(found.source[i]), found.z_world_m[i], {}
        source = self.sources[s]
        model = noise.gaussian(found.cov_world_m2[i])
        model = noise.robust(model, source.settings.loss, source.settings.loss_width)
        if source.surveyed:
            by[S(s)] = -found.by_survey(np.array([i]), source.p_world_m)[0]
        if s in self.swaying.of_source:
            row = self.swaying.row(s, int(found.row[i]), int(self.reference_key[i]))
            by[row.key], z = row.J, z + row.moved_m
        return told_factors(i, found.told_m[i], z, model, by)

    def _position_noise(self, i: int, s: int, width: float) -> Any:
        """The noise model of a row, built once where a source's covariance stays the same."""
        cov = self.cov_world_m2[i]
        known = self._noises.get(s)
        if known is None or known[:2] != (cov.tobytes(), width):
            loss = self.sources[s].settings.loss if np.isfinite(width) else "none"
            model = noise.robust(noise.gaussian(cov), loss, width)
            known = self._noises[s] = (cov.tobytes(), width, model)
        return known[2]

    def slow_factors(self, i: int, before: int | None) -> Factors:
        """The link of a source's slow error at row i to that at an earlier row of the source."""
        bias = self.sources[int(self.positions.source[i])].bias
        if bias is None:
            return []
        if before is None:
            wide = gtsam.noiseModel.Isotropic.Sigma(3, bias.sigma_m)
            return [gtsam.PriorFactorVector(C(i), np.zeros(3), wide)]
        dt_s = float(self.t_s[self.key_of[i]] - self.t_s[self.key_of[before]])
        return [gnss.bias_transition_factor(C(before), C(i), dt_s, bias.sigma_m, bias.tau_s)]

    def position_keys(self, i: int) -> list[int]:
        """The variables that row i adds."""
        source = self.sources[int(self.positions.source[i])]
        return [A(i)] * source.linked + [C(i)] * (source.bias is not None)

    def _lever_key(self, s: int) -> int:
        return L(0 if self.sources[s].table == GNSS else 1)

    @property
    def _lever_keys(self) -> dict[int, int]:
        """The lever-arm variables that there are, with a source that has each."""
        return {self._lever_key(s): s for s, source in enumerate(self.sources) if source.linked}

    @property
    def _surveyed(self) -> list[int]:
        return [s for s, source in enumerate(self.sources) if source.surveyed]

    def insert(self, values: gtsam.Values, j: int, state: State, *, new_bias: bool) -> None:
        """Put a keyframe's first values in; the fix's variables come with `insert_fix`."""
        values.insert(X(j), state.pose)
        values.insert(V(j), state.velocity)
        if new_bias:
            values.insert(B(self.bias_of[j]), state.bias)

    def insert_position(
        self, values: gtsam.Values, i: int, slow: ArrayLike = (0, 0, 0),
        survey: ArrayLike = (0,) * detection.SURVEY,
    ) -> None:  # fmt: skip
        """Put in the variables that row i adds, where it adds any.

        `slow` is about what the source's slow error (3,) is, in m, and `survey` (6,) what its
        survey is off: the measured point is put where they say, so that the loss sees what remains.
        """
        s = int(self.positions.source[i])
        source, z = self.sources[s], self.positions.z_world_m[i]
        if source.surveyed:
            by = self.positions.by_survey(np.array([i]), source.p_world_m)[0]
            z = z + by @ np.asarray(survey, float)
        if s in self.swaying.of_source:
            row = self.swaying.row(s, int(self.positions.row[i]), int(self.key_of[i]))
            z = z + row.believed_m
        if source.linked:
            values.insert(A(i), z - np.asarray(slow, float))
        if source.bias is not None:
            values.insert(C(i), np.array(slow, float))

    def insert_reference(self, values: gtsam.Values, i: int, survey: Array) -> None:
        """Put in the place of the user of row i of the references: where the node sees it by what
        is believed of its post and its `survey` (6,), so that the loss sees what remains."""
        found, rows = self.references, np.array([i])
        s, z = int(found.source[i]), found.z_world_m[i]
        z = z + (found.by_survey(rows, self.sources[s].p_world_m) @ survey)[0]
        if s in self.swaying.of_source:
            row = self.swaying.row(s, int(found.row[i]), int(self.reference_key[i]))
            z = z + row.believed_m
        values.insert(U(i), z)

    def insert_shared(self, values: gtsam.Values) -> None:
        """Put in the variables that all keyframes share."""
        for key, s in self._lever_keys.items():
            values.insert(key, self.levers[s])
        for s in self._surveyed:
            values.insert(S(s), np.zeros(detection.SURVEY))
        self.car.insert_shared(values)

    @property
    def shared_keys(self) -> list[int]:
        """The variables that all keyframes share."""
        return [*self._lever_keys, *(S(s) for s in self._surveyed), *self.car.keys]

    def _shared_priors(self) -> Factors:
        factors: Factors = []
        for key, s in self._lever_keys.items():
            loose = self.sources[s].point_sigma_m or LEVER_SIGMA_M
            tight = gtsam.noiseModel.Isotropic.Sigma(3, loose)
            factors.append(gtsam.PriorFactorPoint3(key, self.levers[s], tight))
        for s in self._surveyed:
            known = gtsam.noiseModel.Diagonal.Sigmas(self.sources[s].survey_sigmas)
            factors.append(gtsam.PriorFactorVector(S(s), np.zeros(detection.SURVEY), known))
        return [*factors, *self.car.prior_factors()]


def read_state(values: gtsam.Values, j: int, bias: int) -> State:
    """Keyframe j as a solution has it."""
    return State(values.atPose3(X(j)), values.atVector(V(j)), values.atConstantBias(B(bias)))
