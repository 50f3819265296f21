"""The whole drive solved by GTSAM: for graphs that are no chain, and to hold the chain against."""

from collections.abc import Callable, Sequence
from functools import cached_property

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, C, L, S, V, X
from numpy.typing import NDArray

from fgloc.factors import imu
from fgloc.measurements import Array
from fgloc.smoother.chain import Chain
from fgloc.smoother.graph import Factors, GraphModel, State
from fgloc.smoother.guess import Guess
from fgloc.smoother.model import YAW_SIGMA_RAD
from fgloc.smoother.solve import covariances, optimize, window_values
from fgloc.smoother.states import Robustness, SharedSigmas, Spread, States
from fgloc.smoother.term import Term
from fgloc.smoother.tree import as_graph
from fgloc.smoother.velocities import SOURCE

EVERYTHING = Robustness(np.zeros(0, bool), np.inf)
ROUNDS, STILL = 5, 1e-6
"""Detections of nodes that sway are made linear anew until the posts' states change by less, in
their units."""


class Whole:
    """The native graph of a drive's first keyframes; `converged` is of the last time."""

    converged = True

    def __init__(
        self, model: GraphModel, prior: Guess, deltas: imu.ImuDeltas, groups: Sequence[Factors] = ()
    ) -> None:
        """The prior lies level around the guess's first state; `groups` saves building factors."""
        self.model, self.prior, self._deltas = model, prior, deltas
        self.groups = list(groups) or _groups(model, prior)
        self.n = len(self.groups)
        self.rows = int(np.searchsorted(model.key_of, self.n))
        self.told = int(np.searchsorted(model.reference_key, self.n))

    @property
    def factors(self) -> int:
        """How many factors there are, with a measurement for every position."""
        car = self.model.car
        held = sum(len(car.factors(j, EVERYTHING)) for j in range(self.n))
        return sum(map(len, self.groups)) + held + self.rows + self.told

    def first(self, n: int) -> "Whole":
        """The same for the first n keyframes alone."""
        return Whole(self.model, self.prior, self._deltas, self.groups[:n])

    def optimum(
        self, states: States, robust: Robustness, *, rough: bool = False
    ) -> tuple[States, float, int]:
        """The states of least cost, that cost and the iterations; `rough` is all the same to it.

        Raises SolverError that names the state, its time and what is missing.
        """
        total = 0
        for _ in range(ROUNDS):
            values, graph = self._values(states, robust), self._graph(robust)
            solved, iterations = optimize(graph, values, self.model)
            before, states = states, self._states(solved, robust, states)
            total += iterations
            if np.abs(states.posts - before.posts).max(initial=0.0) < STILL:
                break
        self.converged = iterations < self.model.config.solver.max_iterations
        return states, float(graph.error(solved)), total

    def rough_predictions(self, states: States, rows: NDArray[np.int64]) -> None:
        """None: GTSAM solves no sketch."""

    def covariances(self, states: States, robust: Robustness) -> Spread:
        """Of poses and posts, and of what the positions and the vehicle's own sources measure."""
        values = self._values(states, robust)  # which sets what detections are linear about
        joint = covariances(self._graph(robust), values, self.model)
        cov = np.stack([joint([X(j)]) for j in range(self.n)])
        predicted = np.empty((self.rows, 3, 3))
        for i in range(self.rows):
            predicted[i] = self._predicted(i, states, cov, joint, in_graph=not robust.gated[i])
        held = self._chain.covariances(states, robust).held
        return Spread(cov, predicted, held, self._posts(joint))

    def held_term(self, source: str, states: States, at: NDArray[np.int64]) -> Term:
        """What one of the vehicle's own sources says at some keyframes."""
        return self._chain.held_term(source, states, at)

    @cached_property
    def _chain(self) -> Chain:
        """The same graph in numpy: of poses, velocities, biases and the calibration together GTSAM
        gives one joint covariance in 30 ms, and there are as many as wheel speeds."""
        return Chain(self.model, self.prior, self._deltas.take(slice(self.n - 1)))

    def _predicted(
        self, i: int, states: States, cov: Array, joint: Callable[[list[int]], Array], *,
        in_graph: bool,
    ) -> Array:  # fmt: skip
        """Covariance (3, 3) of what row i measures; of a slow error that is not in the graph what
        the source states."""
        model, j = self.model, int(self.model.key_of[i])
        s = int(model.positions.source[i])
        source, R = model.sources[s], states.R[j]
        keys, parts = [X(j)], [R @ model.point_by_pose[s]]
        if source.bias is not None and in_graph:
            keys, parts = [*keys, C(i)], [*parts, np.eye(3)]
        if source.point_sigma_m:
            keys, parts = [*keys, L(1)], [*parts, R]
        if source.surveyed:
            J = model.positions.by_survey(np.array([i]), source.p_world_m)[0]
            keys, parts = [*keys, S(s)], [*parts, -J]
        if s in model.swaying.of_source:
            row = model.swaying.row(s, int(model.positions.row[i]), j)
            keys, parts = [*keys, row.key], [*parts, row.J]
        H = np.hstack(parts)
        # GTSAM orders a joint covariance as it is asked to.
        P = H @ (joint(keys) if len(keys) > 1 else cov[j]) @ H.T
        alone = 0.0 if source.bias is None or in_graph else source.bias.sigma_m**2
        return P + alone * np.eye(3)

    def _posts(self, joint: Callable[[list[int]], Array]) -> Array:
        """Of the states of the posts (n, q, q); those of different slots count as independent."""
        swaying = self.model.swaying
        cov = np.zeros((self.n, swaying.width, swaying.width))
        for j in range(self.n):
            for c, key in enumerate(swaying.keys_at(j)):
                own = swaying.at(c)
                cov[j, own[:, None], own] = joint([key])
        return cov

    def shared_sigmas(self, states: States, robust: Robustness) -> SharedSigmas:
        """None: they are read from the chain only."""
        return SharedSigmas()

    def _graph(self, robust: Robustness) -> gtsam.NonlinearFactorGraph:
        graph = as_graph(factor for group in self.groups for factor in group)
        for j in range(self.n):
            for factor in self.model.car.factors(j, robust):
                graph.add(factor)
        before: dict[int, int] = {}
        for i in self._kept(robust):
            s = int(self.model.positions.source[i])
            factors = self.model.slow_factors(i, before.get(s))
            factors += self.model.position_factors(i, robust.loss_width)
            for factor in factors:
                graph.add(factor)
            before[s] = i
        for i in range(self.told):
            for factor in self.model.reference_factors(i):
                graph.add(factor)
        return graph

    def _kept(self, robust: Robustness) -> list[int]:
        """Rows of the positions that are in the graph."""
        kept: list[int] = np.flatnonzero(~robust.gated[: self.rows]).tolist()
        return kept

    def _values(self, states: States, robust: Robustness) -> gtsam.Values:
        model = self.model
        model.car.found = states.calibration
        model.car.velocities.found = states.velocity_errors
        model.swaying.about[: self.n] = states.posts[: self.n]
        poses = (gtsam.Pose3(gtsam.Rot3(R), p) for R, p in zip(states.R, states.p, strict=True))
        plain = [
            State(pose, v, gtsam.imuBias.ConstantBias(b[:3], b[3:]))
            for pose, v, b in zip(poses, states.v, states.bias, strict=True)
        ]
        values = window_values(model, 0, plain[: self.n], ())
        for i in self._kept(robust):
            s, slow = int(model.positions.source[i]), np.zeros(3)
            if s in model.slow:
                slow = states.slow[int(model.key_of[i]), 3 * model.slow.index(s) :][:3]
            model.insert_position(values, i, slow, states.survey[s])
        for j in range(self.n):
            model.swaying.insert(values, j, states.posts[j])
        told = model.car.velocities.keys
        for j in robust.holds(SOURCE, told[told < self.n]).tolist():
            model.car.insert_velocity(values, j, states.v[j])
        for i in range(self.told):
            model.insert_reference(values, i, states.survey[int(model.references.source[i])])
        return values

    def _states(self, values: gtsam.Values, robust: Robustness, before: States) -> States:
        model = self.model
        poses = [values.atPose3(X(j)) for j in range(self.n)]
        biases = [values.atConstantBias(B(m)).vector() for m in model.bias_of[: self.n]]
        slow, survey = before.slow.copy(), before.survey.copy()
        for i in self._kept(robust):
            if (s := int(model.positions.source[i])) in model.slow:
                at = 3 * model.slow.index(s)
                slow[int(model.key_of[i]), at : at + 3] = values.atVector(C(i))
        for s, source in enumerate(model.sources):
            if source.surveyed:
                survey[s] = values.atVector(S(s))
        offset = np.zeros(3)
        if any(source.point_sigma_m for source in model.sources):
            offset = values.atPoint3(L(1)) - model.levers[-1]
        return States(
            np.stack([pose.rotation().matrix() for pose in poses]),
            np.stack([pose.translation() for pose in poses]),
            np.stack([values.atVector(V(j)) for j in range(self.n)]), np.stack(biases), slow,
            calibration=model.car.calibration(values), offset=offset, survey=survey,
            posts=model.swaying.read(values, self.n),
            velocity_errors=model.car.velocity_errors(values),
        )  # fmt: skip


def _groups(model: GraphModel, prior: Guess) -> list[Factors]:
    """The factors of each keyframe, all but the positions'."""
    pose = gtsam.Pose3(gtsam.Rot3(prior.R_world_veh[0]), prior.p_world_m[0])
    state = State(pose, prior.v_world_mps[0], gtsam.imuBias.ConstantBias())
    groups = [model.prior_factors(0, state, YAW_SIGMA_RAD)]
    groups += [model.motion_factors(j, model.interval(j).pim) for j in range(1, len(model))]
    for j, group in enumerate(groups):
        group += model.swaying.factors(j)
    return groups
