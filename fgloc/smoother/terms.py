"""What every factor of a drive's graph says at some states: whitened errors and Jacobians in numpy.

The cost is that of the graph which `graph.py` builds for GTSAM; a test holds the two together. A
block of unknowns belongs to each keyframe: pose (rotation, then translation, in the vehicle frame),
velocity, IMU bias, the slow error of each source of positions that has one, and the states of the
posts that sway (`swaying.py`). A bias that several
keyframes share is kept once for each of them; the curvature sees a walk of next to nothing between
the copies, the cost none, so that the optimum is exact. What the whole drive shares stands in the
border: how late stamps are, the car's calibration, the centre of its box, what its velocities and
each node's survey are off.
"""

from collections.abc import Iterator
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fgloc.constraints import STANDSTILL
from fgloc.drive import GnssBias
from fgloc.factors import gnss, imu, vehicle
from fgloc.frames import log_so3, right_jacobian_inverse_so3, yaw_matrix, yaw_of
from fgloc.measurements import Array
from fgloc.positions import GNSS
from fgloc.smoother import clocks
from fgloc.smoother.beside import Beside, moved
from fgloc.smoother.guess import Guess
from fgloc.smoother.held import Held
from fgloc.smoother.model import (
    POSITION_SIGMA_M,
    SPEED_SIGMA_MPS,
    YAW_SIGMA_RAD,
    Model,
)
from fgloc.smoother.states import Robustness, States
from fgloc.smoother.term import (
    BIAS,
    POSE,
    STATE,
    VELOCITY,
    Border,
    Step,
    Term,
    whitened,
    whitening,
)

COPY_SHARE = 1e-5
"""Of a bias step's variance, the part that the curvature gives to each copy within an interval."""


class Terms:
    """The factors of the first n keyframes of a model."""

    def __init__(self, model: Model, prior: Guess, deltas: imu.ImuDeltas) -> None:
        """`deltas` has a row for each interval; the prior lies level around the guess's first."""
        n = len(deltas.dt_s) + 1
        self.model, self.deltas, self.n, self._prior = model, deltas, n, prior
        self.bias_of = model.bias_of[:n]
        self.slow_at = {s: 15 + 3 * c + np.arange(3) for c, s in enumerate(model.slow)}
        self.border = Border.of(model)
        self.held = Held(model, self.border)
        self.post_first = 15 + 3 * len(model.slow)
        self.width = self.post_first + model.swaying.width
        self.beside = Beside(model, self.border, n, self.width)
        self.rows = int(np.searchsorted(model.key_of, n))  # of the positions, they come first
        self.key_of, self.source = model.key_of[: self.rows], model.positions.source[: self.rows]
        self._prior_R = yaw_matrix(yaw_of(prior.R_world_veh[:1]))
        self._whiten_imu = whitening(model, deltas.cov, np.arange(n - 1))
        self._whiten_position = whitening(model, model.cov_m2[: self.rows], self.key_of)

    @property
    def factors(self) -> int:
        """How many measurements, steps and priors there are, a bias's copies not counted."""
        chains = 1 + len(self.slow_at)
        steps = (self.n - 1) * chains + int(self.bias_of[-1])
        held = sum(len(keys) * (1 + (source == STANDSTILL))
                   for source, keys in self.held_keys(0, self.n).items())  # fmt: skip
        late, car, offset, velocity, survey = self.border
        shared = late.stop + len(survey)
        shared += sum(at.start < at.stop for at in (car, offset, velocity))
        held += self.beside.factors
        return int(3 + chains + steps + shared + held) + self.rows

    def at(
        self, states: States, robust: Robustness, first: int, stop: int
    ) -> Iterator[Term | Step]:
        """The factors that begin at keyframes first..stop - 1: those of the motion come first."""
        intervals = slice(first, min(stop, self.n - 1))
        if intervals.start < intervals.stop:
            yield self._motion(states, intervals)
            yield from self._bias_steps(states, intervals)
        if first == 0:
            yield from self._priors(states)
        within = slice(*np.searchsorted(self.key_of, [first, stop]))
        kept = np.arange(within.start, within.stop)[~robust.gated[within]]
        for s in self._sources_there:
            if len(rows := kept[self.source[kept] == s]):
                yield self._positions(states, s, rows, robust.loss_width)
        yield from self.beside.references(states, first, stop)
        yield from self.beside.posts(states, first, min(stop, self.n))
        yield from self._held(states, robust, first, stop)

    def _priors(self, states: States) -> Iterator[Term]:
        """What is known of keyframe 0 before any measurement."""
        first = np.array([0])
        R, p = states.R[:1], states.p[:1]
        turn = log_so3(self._prior_R.swapaxes(-1, -2) @ R)
        tilt = np.array([self.model.level_sigma_rad] * 2 + [YAW_SIGMA_RAD])
        yield Term(first, POSE[:3], turn / tilt, right_jacobian_inverse_so3(turn) / tilt[:, None])
        yield Term(first, POSE[3:], (p - self.model.first_place_m) / POSITION_SIGMA_M,
                   R / POSITION_SIGMA_M)  # fmt: skip
        yield from self._shared_priors(states)
        for at, value, sigma in (
            (VELOCITY, states.v[:1], [SPEED_SIGMA_MPS] * 3),
            (BIAS, states.bias[:1], self.model.bias_sigmas),
            *(
                (at, states.slow[:1, at - 15], [self._slow(s).sigma_m] * 3)
                for s, at in self.slow_at.items()
            ),
        ):
            scale = 1 / np.array(sigma, float)
            yield Term(first, at, value * scale, np.diag(scale)[None])

    def _shared_priors(self, states: States) -> Iterator[Term]:
        """What is known of the unknowns of the whole drive before any measurement."""
        car, late = self.model.car, np.full(self.border.late.stop, self.model.config.clock.sigma_s)
        loose = max(source.point_sigma_m for source in self.model.sources)
        surveyed = self.model.survey_size
        for at, value, sigma in (
            (self.border.late, states.late_s + self.model.shifted_s, late),
            (self.border.car, states.calibration - vehicle.STRAIGHT, car.calibration_sigmas),
            (self.border.offset, states.offset, np.full(3, loose)),
            (self.border.velocity, states.velocity_errors, car.velocities.error_sigmas),
            *(
                (at, states.survey[s][:surveyed], self.model.sources[s].survey_sigmas[:surveyed])
                for s, at in self.border.survey.items()
            ),
        ):
            if at.start < at.stop:
                J = self.border.by(at, np.diag(1 / sigma)[None])
                yield Term(np.array([0]), POSE[:0], (value / sigma)[None], J)

    def _motion(self, states: States, rows: slice) -> Term:
        """The IMU between keyframes j and j + 1, for the j of a slice."""
        W, following = self._whiten_imu[rows], slice(rows.start + 1, rows.stop + 1)
        told = imu.residual(
            self.deltas.take(rows), (states.R[rows], states.p[rows], states.v[rows]),
            (states.R[following], states.p[following], states.v[following]), states.bias[rows],
            self.model.gravity_mps2,
        )  # fmt: skip
        at = np.concatenate([STATE, BIAS, self.width + STATE])
        keys = np.arange(rows.start, rows.stop)
        return Term(keys, at, whitened(W, told.error), W @ told.jacobian)

    def _bias_steps(self, states: States, rows: slice) -> Iterator[Step]:
        """The walk of the IMU's bias from keyframe to keyframe, and the sources' slow errors."""
        following = slice(rows.start + 1, rows.stop + 1)
        blocks = np.arange(rows.start, rows.stop)
        change = states.bias[following] - states.bias[rows]
        yield Step(blocks, BIAS, np.ones(len(change)), change, self._bias_sigmas[rows])
        for s, at in self.slow_at.items():
            phi, sigma = (column[rows] for column in self._slow_walks[s])
            now, before = states.slow[following][:, at - 15], states.slow[rows][:, at - 15]
            sigmas = np.repeat(sigma[:, None], 3, 1)
            yield Step(blocks, at, phi, now - phi[:, None] * before, sigmas)

    def _slow(self, s: int) -> GnssBias:
        """The slow error of a source that has one."""
        bias = self.model.sources[s].bias
        assert bias is not None
        return bias

    def _positions(self, states: States, s: int, rows: NDArray[np.int64], width: float) -> Term:
        """Those rows of the positions, all of source s; `width` is the fixes' loss's."""
        W, keys = self._whiten_position[rows], self.key_of[rows]
        told, R, source = position_residual(self.model, states, rows, s), states.R[keys], (
            self.model.sources[s])  # fmt: skip
        parts, at, error, border = [told.by_pose], POSE, told.error, []
        if len(acting := clocks.acting(self.model.config, source.table)):
            late = late_residual(self.model, states, rows, s, told)
            parts, error = [late.by_pose, late.by_velocity, late.by_gyro_bias], late.error
            at = np.concatenate([POSE, VELOCITY, BIAS[3:]])
            border = [self.border.by(acting, late.by_late)]
        if s in self.slow_at:
            parts, at = (
                [*parts, np.broadcast_to(np.eye(3), W.shape)],
                np.append(at, self.slow_at[s]),
            )
        if s in self.model.swaying.of_source:
            by_state, own = self.beside.by_post(states, s, self.model.positions.row[rows], keys)
            parts, at = [*parts, by_state], np.append(at, own)
        if source.point_sigma_m:
            border.append(self.border.by(self.border.offset, R))
        if s in self.border.survey:
            by = self.model.positions.by_survey(rows, source.p_world_m)
            by = -by[:, :, : self.model.survey_size]
            border.append(self.border.by(self.border.survey[s], by))
        if border:
            parts.append(np.sum(border, axis=0))
        J = W @ np.concatenate(parts, -1)
        width = width if source.table == GNSS else source.settings.loss_width
        return Term(keys, at, whitened(W, error), J, source.settings.loss, width)

    def held_keys(self, first: int, stop: int) -> dict[str, NDArray[np.int64]]:
        """At which of the keyframes first..stop - 1 each of the vehicle's own sources tells."""
        return {source: at[slice(*np.searchsorted(at, [first, min(stop, self.n)]))]
                for source, at in self.model.car.keys_of.items()}  # fmt: skip

    def _held(self, states: States, robust: Robustness, first: int, stop: int) -> Iterator[Term]:
        """What the vehicle's own sources say at keyframes first..stop - 1."""
        for source, keys in self.held_keys(first, stop).items():
            if len(at := robust.holds(source, keys)):
                yield self.held.term(source, states, at)
                if source == STANDSTILL:
                    yield self.held.still_rate(states, at)

    @cached_property
    def _sources_there(self) -> list[int]:
        """The sources that any of the positions is of."""
        return present(self.source)

    @cached_property
    def _bias_sigmas(self) -> Array:
        """(n - 1, 6): of a real step where a bias begins, of next to nothing between copies."""
        begins = np.diff(self.bias_of) > 0
        t_s = self.model.bias_t_s
        end_s = max(float(self.model.t_s[-1]), float(t_s[-1]) + 1e-3)
        length_s = np.diff(t_s, append=end_s)[self.bias_of[:-1]]
        walk = imu.bias_walk_sigmas(self.model.noise, 1.0) * np.sqrt(length_s)[:, None]
        return np.where(begins[:, None], walk, np.sqrt(COPY_SHARE) * walk)

    @cached_property
    def _slow_walks(self) -> dict[int, tuple[Array, Array]]:
        """phi and sigma in m (n - 1,) of each source's slow error over the intervals."""
        dt_s = np.diff(self.model.t_s[: self.n])
        return {s: gnss.bias_transition(dt_s, self._slow(s).sigma_m, self._slow(s).tau_s)
                for s in self.slow_at}  # fmt: skip


def present(numbers: NDArray[np.int64]) -> list[int]:
    """Which small numbers from 0 on occur among many, in order."""
    there: list[int] = np.flatnonzero(np.bincount(numbers)).tolist()
    return there


def position_residual(
    model: Model, states: States, rows: NDArray[np.int64], s: int
) -> gnss.GnssResidual:
    """Of some positions, all of source s, as if they were on time."""
    return gnss.residual(*measurement(model, states, rows, s))


def measurement(
    model: Model, states: States, rows: NDArray[np.int64], s: int
) -> tuple[Array, Array, Array, Array, Array]:
    """Of some positions (m,), all of source s, what `gnss.residual` takes: the poses' positions and
    attitudes, what was measured, the lever arm and the slow errors."""
    keys, z = model.key_of[rows], model.positions.z_world_m[rows]
    lever = model.levers[s]
    bias = np.zeros(3)
    if s in model.slow:
        bias = states.slow[keys][:, 3 * model.slow.index(s) :][:, :3]
    if model.sources[s].point_sigma_m:
        lever = lever + states.offset
    if model.sources[s].surveyed:
        z = z + model.positions.by_survey(rows, model.sources[s].p_world_m) @ states.survey[s]
    if s in model.swaying.of_source:
        z = z + moved(model, states, s, model.positions.row[rows], keys)
    return states.p[keys], states.R[keys], z, lever, bias


def late_residual(
    model: Model, states: States, rows: NDArray[np.int64], s: int, told: gnss.GnssResidual
) -> gnss.LateResidual:
    """What is `told` of the same positions, as late as the states have them."""
    keys = model.key_of[rows]
    rate = model.epochs.rate_radps[model.epoch_of[keys]] - states.bias[keys, 3:]
    lever = model.levers[s] + (states.offset if model.sources[s].point_sigma_m else 0.0)
    late_s = float(states.late_s[clocks.acting(model.config, model.sources[s].table)].sum())
    return gnss.late_residual(told, states.R[keys], states.v[keys], rate, lever, late_s)
