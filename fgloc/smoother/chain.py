"""The graph of a drive as a chain: its optimum, and the covariance there, from a banded system."""

from dataclasses import replace
from functools import cached_property
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fgloc.errors import SolverError
from fgloc.factors import fields, gnss, imu, noise
from fgloc.frames import exp_so3
from fgloc.measurements import Array
from fgloc.parallel import each, portions
from fgloc.smoother import clocks, sketch
from fgloc.smoother.band import Band, BorderedFactor, Vector
from fgloc.smoother.guess import misfit
from fgloc.smoother.half import NotPositiveError, square
from fgloc.smoother.model import Model
from fgloc.smoother.newton import NEAR, Curvature, Descent
from fgloc.smoother.states import Robustness, SharedSigmas, Spread, States
from fgloc.smoother.term import BIAS, POSE, VELOCITY, Step, Term
from fgloc.smoother.terms import Terms, late_residual, measurement, position_residual, present
from fgloc.timing import iso_utc

BLOCKS_AT_ONCE = 3000
"""The drive is gone through in portions of so many keyframes, which fit the processor's cache; no
power of two, by which the columns of a field would all lie in the same few lines of it."""
POSITIONS_AT_ONCE = 8000
"""So many positions are predicted at a time."""
SECTIONS, LONG = 4, 8192
"""A chain from so many keyframes on is gone through in so many sections side by side."""


class Chain(Terms):
    """The first n keyframes of a model, ready to be solved; `converged` is of the last time."""

    converged = True
    _last: tuple[States, Robustness, BorderedFactor] | None = None
    _sketched: tuple["Chain", States, Robustness] | None = None

    @cached_property
    def damping(self) -> Vector:
        """One over the square of a large change: 1 rad, 1 m, 1 m/s, a bias's prior sigma.

        Not in proportion to the curvature: keyframes are tied so stiffly to each other that this
        would hold back a turn of them all.
        """
        slow = [self._slow(s).sigma_m for s in self.slow_at for _ in range(3)]
        scale = np.array([1.0] * 9 + [*self.model.bias_sigmas, *slow])
        swaying = self.model.swaying
        own = np.append(scale**-2, swaying.damping if swaying.slots else [])
        border = np.ones(self.border.size)
        if self.model.car.acts:
            border[self.border.car] = self.model.car.calibration_sigmas**-2
        if self.model.car.velocities.err:
            border[self.border.velocity] = self.model.car.velocities.error_sigmas**-2
        return Vector(own, border)

    def first(self, n: int) -> "Chain":
        """The same for the first n keyframes alone."""
        return Chain(self.model, self._prior, self.deltas.take(slice(n - 1)))

    def optimum(
        self, states: States, robust: Robustness, *, rough: bool = False
    ) -> tuple[States, float, int]:
        """The states of least cost, that cost and the iterations; `rough` stops when near, and may
        give the states and the cost of a sketch.

        Raises SolverError that names the state and its time.
        """
        self._last = None
        if rough and (sketched := self._sketch(states, robust)) is not None:
            return sketched
        solver = self.model.config.solver
        descent = Descent(self, robust, solver.max_iterations)
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                result, cost = descent.run(states, solver.cost_tolerance, NEAR if rough else 0.0)
        except NotPositiveError as err:
            raise self._failure(err.unknown) from err
        if not np.isfinite(cost):
            far = np.abs(position_errors(self.model, states, np.arange(self.rows))).max(-1)
            raise self._failure(int(self.key_of[np.nanargmax(far)]) * self.width)
        self.converged = descent.converged
        if descent.factor is not None:
            self._last = result, robust, descent.factor
        return result, cost, descent.iterations

    def _sketch(self, states: States, robust: Robustness) -> tuple[States, float, int] | None:
        """States, cost and iterations of a sketch, or None where there is none that fits."""
        if self._few is None:
            return None
        keys, deltas = self._few
        model = sketch.few_model(self.model, keys, robust.gated)
        few = Chain(model, self._prior, deltas)
        nothing = Robustness(np.zeros(few.rows, bool), np.inf, plain=True)
        try:
            # A sketch has no posts: nothing that it holds tells of them.
            start = replace(states.take(keys), posts=np.zeros((few.n, 0)))
            found, cost, iterations = few.optimum(start, nothing, rough=True)
        except SolverError:  # the whole chain may do better, or say where it fails
            return None
        if not cost <= misfit(few.rows):
            return None
        self._sketched = few, found, nothing
        g = self.model.gravity_mps2
        drawn = sketch.all_states(found, keys, self.deltas, self.bias_of, g)
        return replace(drawn, posts=states.posts), cost, iterations

    @cached_property
    def _few(self) -> tuple[NDArray[np.int64], imu.ImuDeltas] | None:
        """The keyframes of a sketch and the IMU between them, where a sketch is worth it."""
        keys = sketch.few_keyframes(self.model, self.n)
        return None if keys is None else (keys, sketch.few_deltas(self.deltas, keys))

    def rough_predictions(self, states: States, rows: NDArray[np.int64]) -> Array | None:
        """Covariances (m, 3, 3) in m^2 of what some positions (increasing) measure as predicted,
        about: from the last sketch, for each source the same from one of its keyframes to the next.
        None where there is none, or where more than the pose has a part in it."""
        if self._few is None or self._sketched is None or self.border.size or self.width > 15:
            return None
        (keys, _), (few, found, nothing) = self._few, self._sketched
        cov = Known(few._factor(found, nothing), POSE).blocks
        at = np.searchsorted(keys, self.key_of[rows], side="right") - 1
        predicted = np.empty((len(rows), 3, 3))
        for s in present(self.source[rows]):
            own = np.flatnonzero(self.source[rows] == s)
            begins = np.diff(at[own], prepend=-1) > 0
            some = own[begins]
            J = position_residual(self.model, states, rows[some], s).by_pose
            told = J @ cov[at[some]] @ J.swapaxes(-1, -2)
            predicted[own] = told[np.cumsum(begins) - 1]
        return predicted

    def moved(self, states: States, back: Vector) -> States:
        """The states after a step back along a vector of their tangents; copies stay alike."""
        step = -back.blocks
        first = np.searchsorted(self.bias_of, self.bias_of)
        calibration = states.calibration
        if self.model.car.acts:
            calibration = calibration - back.border[self.border.car]
        return States(
            states.R @ exp_so3(step[:, :3]),
            states.p + np.einsum("nij,nj->ni", states.R, step[:, 3:6]),
            states.v + step[:, VELOCITY],
            states.bias + step[first][:, BIAS],
            states.slow + step[:, 15 : self.post_first],
            states.late_s - back.border[self.border.late],
            calibration,
            states.offset - self._part(back.border, self.border.offset),
            self._resurveyed(states.survey, back.border),
            states.posts + step[:, self.post_first :],
            states.velocity_errors - self._part(back.border, self.border.velocity),
        )

    @staticmethod
    def _part(border: Array, at: slice) -> Array | float:
        """What stands at a place of the border; 0 where nothing does."""
        return border[at] if at.start < at.stop else 0.0

    def _resurveyed(self, survey: Array, back: Array) -> Array:
        """What the surveys are off after a step back."""
        moved = survey.copy()
        for s, at in self.border.survey.items():
            moved[s, : at.stop - at.start] -= back[at]
        return moved

    def linearize(
        self, states: States, robust: Robustness, curvature: Curvature, band: Band | None = None
    ) -> tuple[float, Band]:
        """The cost at some states, half a sum of squares under the loss, and its normal equations,
        in the memory of a band that is no longer needed if there is one.

        Under a loss the curvature is that of "newton", which converges in a few steps once it is
        near, or of reweighted least squares ("weights"), which never climbs far and is what
        covariances are taken from.
        """
        if band is None:
            band = Band(self.n, self.width, self.border.size)
        else:
            band.clear()
        told: Curvature | Literal["plain"] = "plain" if robust.plain else curvature

        def add(to: Band, first: int, stop: int) -> float:
            return sum(_add(to, term, told) for term in self.at(states, robust, first, stop))

        def section(blocks: range) -> tuple[Band, float]:
            part, some = band.section(), band.outward(blocks, BLOCKS_AT_ONCE)
            return part, sum(add(part, own.start, own.stop) for own in some)

        cost, ends = 0.0, _sections(self.n)
        # The last of a section is tied to the next one: it comes when all are done.
        inner = [range(a, b - (b < self.n)) for a, b in pairwise(ends)]
        for part, value in each(section, inner):
            band.join(part)
            cost += value
        cost += sum(add(band, b - 1, b) for b in ends[1:-1])
        self._share_biases(band.gradient.blocks)
        return cost, band

    def _share_biases(self, gradient: Array) -> None:
        """A bias's gradient belongs to its first copy: the others follow it."""
        first = np.flatnonzero(np.diff(self.bias_of, prepend=-1))
        total = np.add.reduceat(gradient[:, BIAS], first, axis=0)
        gradient[:, BIAS] = 0
        gradient[first[:, None], BIAS] = total

    def covariances(self, states: States, robust: Robustness) -> Spread:
        """Of poses and posts, and of what the positions and the vehicle's own sources measure."""
        factor = self._factor(states, robust)
        kinds = {s: np.flatnonzero(self.source == s) for s in self._sources_there}
        one = [self._positions(states, s, rows[:1], np.inf) for s, rows in kinds.items()]
        held = {name: self.held.term(name, states, at)
                for name, at in self.held_keys(0, self.n).items()}  # fmt: skip
        posts = np.arange(self.post_first, self.width)
        told = (term.at for term in (*one, *held.values()))
        at = np.unique(np.concatenate([POSE, posts, *told]))
        known = Known(factor, at)
        predicted = np.empty((self.rows, 3, 3))

        def predict(part: tuple[int, NDArray[np.int64]]) -> None:
            s, rows = part
            L = fields.rows(fields.cholesky(fields.of(self.model.cov_m2[rows])))
            told = known.predicted(self._positions(states, s, rows, np.inf))
            predicted[rows] = L @ told @ L.swapaxes(-1, -2)

        each(predict, [(s, rows[part]) for s, rows in kinds.items()
                       for part in portions(len(rows), POSITIONS_AT_ONCE)])  # fmt: skip
        by_source = {name: known.predicted(term) for name, term in held.items()}
        own = np.searchsorted(at, posts)
        return Spread(
            known.blocks[:, :6, :6], predicted, by_source, known.blocks[:, own[:, None], own]
        )

    def held_term(self, source: str, states: States, at: NDArray[np.int64]) -> Term:
        """What one of the vehicle's own sources says at some keyframes."""
        return self.held.term(source, states, at)

    def shared_sigmas(self, states: States, robust: Robustness) -> SharedSigmas:
        """Of what the drive shares and this graph estimates."""
        if not self.border.size:
            return SharedSigmas()
        sigma = np.sqrt(np.diagonal(self._factor(states, robust).cov_border))
        own = self.border
        return SharedSigmas(
            sigma[own.late],
            sigma[own.offset] if own.offset.start < own.offset.stop else None,
            {s: sigma[at] for s, at in own.survey.items()},
            sigma[own.velocity] if own.velocity.start < own.velocity.stop else None,
        )

    def _factor(self, states: States, robust: Robustness) -> BorderedFactor:
        """Of reweighted least squares at some states; of the optimum just found it is there."""
        if self._last is not None and self._last[0] is states and self._last[1] is robust:
            return self._last[2]
        _, band = self.linearize(states, robust, "weights")
        try:
            self._last = states, robust, band.factor()
        except NotPositiveError as err:
            raise self._failure(err.unknown) from err
        return self._last[2]

    def _failure(self, unknown: int) -> SolverError:
        """What to say where the normal equations cannot be solved."""
        if unknown >= self.n * self.width:
            return SolverError(
                "the solver failed at what the drive shares: a lateness, a calibration, the "
                "box's centre, errors of the velocities or a survey"
            )
        j, i = divmod(unknown, self.width)
        slow = [f"slow error of {self.model.sources[s].name}" for s in self.slow_at]
        name = ["attitude", "position", "velocity", "accelerometer bias", "gyro bias",
                *slow, *["post"] * (2 * self.model.swaying.slots)][i // 3]  # fmt: skip
        t_ns = int(self.model.t_ns[j])
        return SolverError(
            f"the solver failed at the {name} of keyframe {j}, t = {self.model.t_s[j]:.2f} s "
            f"({iso_utc(t_ns)}): nothing that was measured holds it, or a measurement is out of "
            "all bounds"
        )


class Known:
    """Covariances of the unknowns `at` (q,) of every block, and of the border."""

    def __init__(self, factor: BorderedFactor, at: NDArray[np.int64]) -> None:
        self.at, self.blocks = at, factor.inverse_blocks(at)
        self._across, self._border = factor.inverse_border(at), factor.cov_border

    def predicted(self, term: Term) -> Array:
        """Covariance (M, m, m) of what a term within blocks says, whitened."""
        own, keys, J = np.searchsorted(self.at, term.at), term.blocks, term.jacobian
        known = square(self.blocks[keys], own)
        if J.shape[2] > len(own):  # it also depends on what the drive shares
            side = self._across[keys][:, own]
            shared = np.broadcast_to(self._border, (len(keys), *self._border.shape))
            known = np.block([[known, side], [side.swapaxes(-1, -2), shared]])
        return np.asarray(J @ known @ J.swapaxes(-1, -2))


def position_errors(model: Model, states: States, rows: NDArray[np.int64]) -> Array:
    """Predicted minus measured positions (m, 3) of some rows, ENU m, lateness and all."""
    error, source = np.empty((len(rows), 3)), model.positions.source[rows]
    for s in present(source):
        own = np.flatnonzero(source == s)
        if len(clocks.acting(model.config, model.sources[s].table)) and states.late_s.any():
            told = position_residual(model, states, rows[own], s)
            error[own] = late_residual(model, states, rows[own], s, told).error
        else:
            error[own] = gnss.error(*measurement(model, states, rows[own], s))
    return error


def _sections(n: int) -> list[int]:
    """Where the sections of a chain of n begin that are gone through side by side, and n; as many
    on every machine, so that sums are the same."""
    return np.linspace(0, n, 1 + (SECTIONS if n >= LONG else 1)).astype(int).tolist()


def _add(band: Band, term: Term | Step, curvature: Curvature | Literal["plain"]) -> float:
    """Add what a term says to normal equations; its cost."""
    if isinstance(term, Step):
        band.add_steps(term.blocks, term.at, term.phi, term.change, term.sigma)
        return term.cost
    J, e = term.jacobian, term.error
    if term.loss == "none" or term.width == np.inf or curvature == "plain":
        band.add(term.blocks, term.at, J, np.matmul(e[:, None], J)[:, 0])
        return float((e * e).sum()) / 2
    cost, across, along = _loss(term)
    gradient = np.matmul((e * across)[:, None], J)[:, 0]
    J = _bent(J, e, across, along if curvature == "newton" else across)
    band.add(term.blocks, term.at, J, gradient)
    return cost


def _loss(term: Term) -> tuple[float, Array, Array]:
    """Cost of a term under its loss, and the weights (M, 1) of its errors across and along them."""
    norm = np.linalg.norm(term.error, axis=-1, keepdims=True)
    cost, across, along = (
        f(norm, term.loss, term.width) for f in (noise.cost, noise.weight, noise.curvature)
    )
    return float(cost.sum()), across, along


def _bent(J: Array, error: Array, across: Array, along: Array) -> Array:
    """Jacobians whose square has weights (M, 1) across the error's direction and along it."""
    if along is across:
        return np.asarray(np.sqrt(across)[..., None] * J)
    norm = np.linalg.norm(error, axis=-1, keepdims=True)
    direction = error / np.maximum(norm, 1e-300)
    shrink = np.sqrt(across) - np.sqrt(np.maximum(along, 0))
    radial = direction[..., None] * np.matmul(direction[:, None], J)
    return np.sqrt(across)[..., None] * J - shrink[..., None] * radial
