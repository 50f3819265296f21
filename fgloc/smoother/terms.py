"""What every factor of a drive's graph says at some states: whitened errors and Jacobians in numpy.

The cost is that of the graph which `graph.py` builds for GTSAM; a test holds the two together. A
block of unknowns belongs to each keyframe: pose (rotation, then translation, in the vehicle frame),
velocity, IMU bias, the slow error of each source of positions that has one, and the states of the
posts that sway (`swaying.py`). A bias that several
keyframes share is kept once for each of them; the curvature sees a walk of next to nothing between
the copies, the cost none, so that the optimum is exact. What the whole drive shares stands in the
border: how late stamps are, the car's calibration, the centre of its box, and what each node's
survey is off.
"""

from collections.abc import Iterator
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgloc.drive import GnssBias
from fgloc.errors import SolverError
from fgloc.factors import detection, gnss, imu, noise, vehicle
from fgloc.frames import log_so3, right_jacobian_inverse_so3, yaw_matrix, yaw_of
from fgloc.measurements import Array
from fgloc.positions import DETECTIONS, GNSS
from fgloc.smoother import velocities
from fgloc.smoother.car import SLIP_WIDTH, STILL_WIDTH, WHEEL_WIDTH
from fgloc.smoother.guess import Guess
from fgloc.smoother.model import (
    POSITION_SIGMA_M,
    SPEED_SIGMA_MPS,
    YAW_SIGMA_RAD,
    Model,
)
from fgloc.smoother.states import Robustness, States

POSE, VELOCITY, BIAS = np.arange(6), np.arange(6, 9), np.arange(9, 15)
STATE, FULL = np.arange(9), np.arange(15)
COPY_SHARE = 1e-5
"""Of a bias step's variance, the part that the curvature gives to each copy within an interval."""


class Term(NamedTuple):
    """M factors of one kind: whitened errors (M, m) and Jacobians (M, m, q).

    blocks  (M,) the keyframe that each begins at
    at      the unknowns it depends on, counted from that keyframe's first; what the Jacobian has
            beyond them is by the shared unknowns
    loss    that lies on it, from a whitened error of `width` on
    """

    blocks: NDArray[np.int64]
    at: NDArray[np.int64]
    error: Array
    jacobian: Array
    loss: noise.Loss = "none"
    width: float = np.inf


class Terms:
    """The factors of the first n keyframes of a model."""

    def __init__(self, model: Model, prior: Guess, deltas: imu.ImuDeltas) -> None:
        """`deltas` has a row for each interval; the prior lies level around the guess's first."""
        n = len(deltas.dt_s) + 1
        self.model, self.deltas, self.n, self._prior = model, deltas, n, prior
        self.bias_of = model.bias_of[:n]
        self.slow_at = {s: 15 + 3 * c + np.arange(3) for c, s in enumerate(model.slow)}
        self.post_first = 15 + 3 * len(model.slow)
        self.width = self.post_first + model.swaying.width
        self.late, self.car_at, self.offset_at, self.survey_at = self._layout(model)
        self.shared = max(self.survey_at.values(), key=_stop, default=self.offset_at).stop
        self.rows = int(np.searchsorted(model.key_of, n))  # of the positions, they come first
        self.key_of, self.source = model.key_of[: self.rows], model.positions.source[: self.rows]
        self._prior_R = yaw_matrix(yaw_of(prior.R_world_veh[:1]))
        self._whiten_imu = self._whitening(deltas.cov, np.arange(n - 1))
        self._whiten_position = self._whitening(model.cov_m2[: self.rows], self.key_of)
        self.told = int(np.searchsorted(model.reference_key, n))  # of the references
        cov = model.references.cov_world_m2[: self.told] + gnss.TIE_SIGMA_M**2 * np.eye(2)
        self._whiten_reference = self._whitening(cov, model.reference_key[: self.told])

    @staticmethod
    def _layout(model: Model) -> tuple[slice, slice, slice, dict[int, slice]]:
        """Where the unknowns that the drive shares stand in the border."""
        late = slice(0, int(model.config.clock.estimate != "none"))
        car = slice(late.stop, late.stop + 3 * model.car.acts)
        free = any(source.point_sigma_m for source in model.sources)
        offset = slice(car.stop, car.stop + 3 * free)
        surveyed = [s for s, source in enumerate(model.sources) if source.surveyed]
        survey = {s: slice(offset.stop + 3 * i, offset.stop + 3 * i + 3)
                  for i, s in enumerate(surveyed)}  # fmt: skip
        return late, car, offset, survey

    def _whitening(self, cov: Array, keys: NDArray[np.int64]) -> Array:
        """W (m, r, r) with W cov W' = I; SolverError names the keyframe where there is none."""
        try:
            return np.linalg.inv(np.linalg.cholesky(cov))
        except np.linalg.LinAlgError as err:
            sound = np.nan_to_num(cov, nan=-1.0, posinf=-1.0, neginf=-1.0)
            j = int(keys[np.argmin(np.linalg.eigvalsh(sound)[:, 0] > 0)])
            raise SolverError(
                f"the measurements at keyframe {j}, t = {self.model.t_s[j]:.2f} s, are out of all "
                "bounds: a covariance cannot be computed from them"
            ) from err

    @property
    def factors(self) -> int:
        """How many measurements, steps and priors there are, a bias's copies not counted."""
        chains = 1 + len(self.slow_at)
        steps = (self.n - 1) * chains + int(self.bias_of[-1])
        car = self.model.car
        held = (car.wheel_row[: self.n] >= 0).sum() + 2 * car.stands[: self.n].sum()
        if car.config.non_holonomic:
            held += car.in_force[: self.n].sum()
        shared = (self.late.stop > 0) + bool(car.acts) + len(self.survey_at)
        shared += self.offset_at.start < self.offset_at.stop
        held += (car.velocities.row[: self.n] >= 0).sum()
        swaying = self.model.swaying
        held += swaying.slots * self.n + np.searchsorted(swaying.pose_key, self.n) + self.told
        return int(3 + chains + steps + shared + held) + self.rows

    def at(self, states: States, robust: Robustness, first: int, stop: int) -> Iterator[Term]:
        """The factors that begin at keyframes first..stop - 1."""
        if first == 0:
            yield from self._priors(states)
        intervals = slice(first, min(stop, self.n - 1))
        if intervals.start < intervals.stop:
            yield self._motion(states, intervals)
            yield from self._bias_steps(states, intervals)
        within = slice(*np.searchsorted(self.key_of, [first, stop]))
        kept = np.arange(within.start, within.stop)[~robust.gated[within]]
        for s in np.unique(self.source[kept]).tolist():
            yield self._positions(states, s, kept[self.source[kept] == s], robust.loss_width)
        yield from self._references(states, first, stop)
        yield from self._posts(states, first, min(stop, self.n))
        if self.model.car.acts or self.model.car.stands.any():
            yield from self._constraints(states, first, stop)
        told = self.model.car.velocities
        if len(keys := told.keys[slice(*np.searchsorted(told.keys, [first, min(stop, self.n)]))]):
            eye = np.eye(3) / told.sigma_mps[keys, None, None]
            error = told.whitened(states.v, keys)
            yield Term(keys, VELOCITY, error, eye, "huber", velocities.WIDTH)

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
        late = np.array([self.model.config.clock.sigma_s])
        loose = max(source.point_sigma_m for source in self.model.sources)
        for at, value, sigma in (
            (self.late, np.array([states.late_s + self.model.shifted_s]), late),
            (self.car_at, states.calibration - vehicle.STRAIGHT, self.model.car.calibration_sigmas),
            (self.offset_at, states.offset, np.full(3, loose)),
            *(
                (at, states.survey[s], self.model.sources[s].survey_sigmas)
                for s, at in self.survey_at.items()
            ),
        ):
            if at.start < at.stop:
                J = self._border(1, at, np.diag(1 / sigma)[None])
                yield Term(np.array([0]), POSE[:0], (value / sigma)[None], J)

    def _border(self, n: int, at: slice, jacobian: Array) -> Array:
        """Jacobians (n, m, q) by some of the shared unknowns among those by all of them."""
        full = np.zeros((n, jacobian.shape[1], self.shared))
        full[:, :, at] = jacobian
        return full

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
        return Term(keys, at, _whitened(W, told.error), W @ told.jacobian)

    def _bias_steps(self, states: States, rows: slice) -> Iterator[Term]:
        """The walk of the IMU's bias from keyframe to keyframe, and the sources' slow errors."""
        following = slice(rows.start + 1, rows.stop + 1)
        change = states.bias[following] - states.bias[rows]
        yield self._step_term(rows, BIAS, change, np.ones(len(change)), self._bias_sigmas[rows])
        for s, at in self.slow_at.items():
            phi, sigma = (column[rows] for column in self._slow_walks[s])
            now, before = states.slow[following][:, at - 15], states.slow[rows][:, at - 15]
            sigmas = np.repeat(sigma[:, None], 3, 1)
            yield self._step_term(rows, at, now - phi[:, None] * before, phi, sigmas)

    def _slow(self, s: int) -> GnssBias:
        """The slow error of a source that has one."""
        bias = self.model.sources[s].bias
        assert bias is not None
        return bias

    def _step_term(
        self, rows: slice, at: NDArray[np.int64], change: Array, phi: Array, sigma: Array
    ) -> Term:
        """x_j+1 - phi x_j ~ N(0, sigma^2) for unknowns `at`; phi is (m,), the others (m, q)."""
        eye = np.eye(len(at))
        back = -phi[:, None, None] * eye
        J = np.concatenate([back, np.broadcast_to(eye, back.shape)], -1) / sigma[..., None]
        blocks = np.arange(rows.start, rows.stop)
        return Term(blocks, np.append(at, self.width + at), change / sigma, J)

    def _positions(self, states: States, s: int, rows: NDArray[np.int64], width: float) -> Term:
        """Those rows of the positions, all of source s; `width` is the fixes' loss's."""
        W, keys = self._whiten_position[rows], self.key_of[rows]
        told, R, source = position_residual(self.model, states, rows, s), states.R[keys], (
            self.model.sources[s])  # fmt: skip
        parts, at, error, border = [told.by_pose], POSE, told.error, []
        if late_source(self.model, s):
            late = late_residual(self.model, states, rows, s, told)
            parts, error = [late.by_pose, late.by_velocity, late.by_gyro_bias], late.error
            at = np.concatenate([POSE, VELOCITY, BIAS[3:]])
            border = [(self.late, late.by_late)]
        if s in self.slow_at:
            parts, at = (
                [*parts, np.broadcast_to(np.eye(3), W.shape)],
                np.append(at, self.slow_at[s]),
            )
        if s in self.model.swaying.of_source:
            by_state, own = self._by_post(states, s, self.model.positions.row[rows], keys)
            parts, at = [*parts, by_state], np.append(at, own)
        if source.point_sigma_m:
            border.append((self.offset_at, R))
        if s in self.survey_at:
            border.append((self.survey_at[s], -by_survey(self.model, rows, s)))
        if border:
            shared = [self._border(len(rows), where, by) for where, by in border]
            parts.append(np.sum(shared, axis=0))
        J = W @ np.concatenate(parts, -1)
        width = width if source.table == GNSS else source.settings.loss_width
        return Term(keys, at, _whitened(W, error), J, source.settings.loss, width)

    def _by_post(
        self, states: States, s: int, row: NDArray[np.int64], keys: NDArray[np.int64]
    ) -> tuple[Array, NDArray[np.int64]]:
        """Jacobians (m, 3, 6) of detections of source s by its post, and the unknowns they are by.

        What lies further along where the node says is less far along than the car.
        """
        swaying = self.model.swaying
        k = swaying.of_source[s]
        _, J = swaying.moved(s, row, swaying.states(states.posts, keys, k))
        own = self.post_first + swaying.at(int(swaying.slot[k]))
        return -np.pad(J, ((0, 0), (0, 1), (0, 0))), own

    def _references(self, states: States, first: int, stop: int) -> Iterator[Term]:
        """What nodes see of users whose places are known, at keyframes first..stop - 1."""
        model, found = self.model, self.model.references
        within = slice(*np.searchsorted(model.reference_key[: self.told], [first, stop]))
        kind = np.stack([found.source[within], model.reference_layer[within]], -1)
        for s, layer in np.unique(kind, axis=0).tolist():
            rows = within.start + np.flatnonzero((kind == [s, layer]).all(-1))
            keys, W = model.reference_key[rows], self._whiten_reference[rows]
            parts, at = [], POSE[:0]
            if s in model.swaying.of_source:
                by_post, at = self._by_post(states, s, found.row[rows], keys)
                parts = [by_post[:, :2]]
            if s in self.survey_at:
                z = np.pad(found.z_world_m[rows], ((0, 0), (0, 1)))
                by = detection.by_survey(z, model.sources[s].p_world_m)[:, :2]
                parts.append(self._border(len(rows), self.survey_at[s], -by))
            error, settings = reference_errors(model, states, rows, s), model.sources[s].settings
            J = W @ np.concatenate(parts, -1)
            width = settings.loss_width
            yield Term(keys, at, _whitened(W, error), J, settings.loss, width)

    def _posts(self, states: States, first: int, stop: int) -> Iterator[Term]:
        """How the posts go on, and what is told of them alone, at keyframes first..stop - 1."""
        swaying, before = self.model.swaying, max(first, 1)
        for c in range(swaying.slots):
            own = self.post_first + swaying.at(c)
            x = states.posts[:, swaying.at(c)]
            after, earlier = (block[:, c] for block in swaying.steps)
            if first == 0:
                yield Term(np.array([0]), own, _whitened(after[:1], x[:1]), after[:1])
            if before < stop:
                rows, back = slice(before, stop), slice(before - 1, stop - 1)
                error = _whitened(after[rows], x[rows]) + _whitened(earlier[rows], x[back])
                J = np.concatenate([earlier[rows], after[rows]], -1)
                at = np.append(own, self.width + own)
                yield Term(np.arange(before - 1, stop - 1), at, error, J)
        for c, keys, z, J in swaying.poses(first, stop):
            x = states.posts[keys][:, swaying.at(c)]
            yield Term(keys, self.post_first + swaying.at(c), _whitened(J, x) - z, J)

    def _constraints(self, states: States, first: int, stop: int) -> Iterator[Term]:
        """What the vehicle's constraints say at keyframes first..stop - 1."""
        car, within = self.model.car, slice(first, stop)
        turn = car.turn(states.calibration)
        if car.config.non_holonomic and len(at := first + np.flatnonzero(car.in_force[within])):
            told = vehicle.non_holonomic(self._body_velocity(states, at), turn[at])
            yield self._vehicle_term(at, told, car.slip_sigmas_mps[at], SLIP_WIDTH)
        if len(at := first + np.flatnonzero(car.wheel_row[within] >= 0)):
            speed, sigma = np.array([car.speed(j) for j in at.tolist()]).T
            u = self._body_velocity(states, at)
            told = vehicle.wheel(u, turn[at], float(states.calibration[2]), speed)
            yield self._vehicle_term(at, told, sigma[:, None], WHEEL_WIDTH)
        if len(at := first + np.flatnonzero(car.stands[within])):
            rate = car.mean_rate_radps[at]
            still = vehicle.standstill(states.v[at], states.bias[at], rate).error
            eye = np.broadcast_to(np.eye(3), (len(at), 3, 3))
            slow, quiet = car.config.still_speed_mps, car.still_rate_sigma
            yield Term(at, VELOCITY, still[:, :3] / slow, eye / slow, "huber", STILL_WIDTH)
            yield Term(at, BIAS[3:], still[:, 3:] / quiet, eye / quiet)

    def _body_velocity(self, states: States, at: NDArray[np.int64]) -> vehicle.BodyVelocity:
        car = self.model.car
        return vehicle.body_velocity(
            states.R[at], states.v[at], car.rate_radps[at], states.bias[at], car.arm
        )

    def _vehicle_term(
        self, at: NDArray[np.int64], told: vehicle.VehicleResidual, sigma: Array, width: float
    ) -> Term:
        """A constraint with standard deviations (m, rows) under Huber's loss."""
        by_calibration = np.concatenate([told.by_mounting, told.by_scale], -1)
        border = self._border(len(at), self.car_at, by_calibration)
        J = np.concatenate([told.by_pose, told.by_velocity, told.by_bias, border], -1)
        return Term(at, FULL, told.error / sigma, J / sigma[..., None], "huber", width)

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


def position_residual(
    model: Model, states: States, rows: NDArray[np.int64], s: int
) -> gnss.GnssResidual:
    """Of some positions, all of source s, as if they were on time."""
    keys, z = model.key_of[rows], model.positions.z_world_m[rows]
    lever = model.levers[s]
    bias = np.zeros(3)
    if s in model.slow:
        bias = states.slow[keys][:, 3 * model.slow.index(s) :][:, :3]
    if model.sources[s].point_sigma_m:
        lever = lever + states.offset
    if model.sources[s].surveyed:
        z = z + by_survey(model, rows, s) @ states.survey[s]
    if s in model.swaying.of_source:
        z[:, :2] += _moved(model, states, s, model.positions.row[rows], keys)
    return gnss.residual(states.p[keys], states.R[keys], z, lever, bias)


def reference_errors(model: Model, states: States, rows: NDArray[np.int64], s: int) -> Array:
    """Where users are less where node s sees them, (m, 2) East and North in m."""
    found = model.references
    z = found.z_world_m[rows]
    if model.sources[s].surveyed:
        by = detection.by_survey(np.pad(z, ((0, 0), (0, 1))), model.sources[s].p_world_m)[:, :2]
        z = z + by @ states.survey[s]
    if s in model.swaying.of_source:
        z = z + _moved(model, states, s, found.row[rows], model.reference_key[rows])
    return found.told_m[rows] - z


def _moved(
    model: Model, states: States, s: int, row: NDArray[np.int64], keys: NDArray[np.int64]
) -> Array:
    """How far sway moves detections (m, 2) of source s at some keyframes."""
    swaying = model.swaying
    own = swaying.states(states.posts, keys, swaying.of_source[s])
    return swaying.moved(s, row, own)[0]


def by_survey(model: Model, rows: NDArray[np.int64], s: int) -> Array:
    """How detections of node s move with what its survey is off (n, 3, 3)."""
    return detection.by_survey(model.positions.z_world_m[rows], model.sources[s].p_world_m)


def late_source(model: Model, s: int) -> bool:
    """Whether it is this source's lateness that is estimated; the IMU's shows in all sources."""
    late = {"gnss": GNSS, "nodes": DETECTIONS, "imu": model.sources[s].table, "none": ""}
    return model.sources[s].table == late[model.config.clock.estimate]


def late_residual(
    model: Model, states: States, rows: NDArray[np.int64], s: int, told: gnss.GnssResidual
) -> gnss.LateResidual:
    """What is `told` of the same positions, as late as the states have them."""
    keys = model.key_of[rows]
    rate = model.epochs.rate_radps[model.epoch_of[keys]] - states.bias[keys, 3:]
    lever = model.levers[s] + (states.offset if model.sources[s].point_sigma_m else 0.0)
    return gnss.late_residual(told, states.R[keys], states.v[keys], rate, lever, states.late_s)


def _whitened(W: Array, error: Array) -> Array:
    return np.einsum("nij,nj->ni", W, error)


def _stop(part: slice) -> int:
    return int(part.stop)
