"""The whole drive solved by GTSAM: for graphs that are no chain, and to hold the chain against."""

from collections.abc import Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, C, V, X

from fgloc.measurements import Array
from fgloc.smoother.graph import Factors, GraphModel, State
from fgloc.smoother.guess import Guess
from fgloc.smoother.model import YAW_SIGMA_RAD
from fgloc.smoother.solve import covariances, optimize, window_values
from fgloc.smoother.states import Robustness, States
from fgloc.smoother.tree import as_graph


class Whole:
    """The native graph of a drive's first keyframes; `converged` is of the last time."""

    converged = True

    def __init__(self, model: GraphModel, prior: Guess, groups: Sequence[Factors] = ()) -> None:
        """The prior lies level around the guess's first state; `groups` saves building factors."""
        self.model, self.prior = model, prior
        self.groups = list(groups) or _groups(model, prior)
        self.n = len(self.groups)
        self.fixed = np.flatnonzero(model.fix_of[: self.n] >= 0)

    @property
    def factors(self) -> int:
        """How many factors there are, with a measurement for every fix."""
        return sum(map(len, self.groups)) + len(self.fixed)

    def first(self, n: int) -> "Whole":
        """The same for the first n keyframes alone."""
        return Whole(self.model, self.prior, self.groups[:n])

    def optimum(
        self, states: States, robust: Robustness, *, rough: bool = False
    ) -> tuple[States, float, int]:
        """The states of least cost, that cost and the iterations; `rough` is all the same to it.

        Raises SolverError that names the state, its time and what is missing.
        """
        graph = self._graph(robust)
        values, iterations = optimize(graph, self._values(states), self.model)
        self.converged = iterations < self.model.config.solver.max_iterations
        return self._states(values), float(graph.error(values)), iterations

    def covariances(self, states: States, robust: Robustness) -> tuple[Array, Array]:
        """Of the poses (n, 6, 6), and of what the fixes measure as predicted (fixes, 3, 3)."""
        joint = covariances(self._graph(robust), self._values(states), self.model)
        cov = np.stack([joint([X(j)]) for j in range(self.n)])
        H, both = states.R[self.fixed] @ self.model.antenna_by_pose, cov[self.fixed]
        if self.model.has_gnss_bias:
            H = np.concatenate([H, np.broadcast_to(np.eye(3), (len(H), 3, 3))], -1)
            # GTSAM orders a joint covariance as it is asked to.
            both = np.stack([joint([X(j), C(j)]) for j in self.fixed.tolist()])
        return cov, H @ both @ H.swapaxes(-1, -2)

    def late_sigma_s(self, states: States, robust: Robustness) -> float | None:
        """None: GTSAM's graph does not estimate how late the fixes are."""
        return None

    def _graph(self, robust: Robustness) -> gtsam.NonlinearFactorGraph:
        graph = as_graph(factor for group in self.groups for factor in group)
        for j in self.fixed[~robust.gated].tolist():
            for factor in self.model.fix_factors(j, robust.loss_width):
                graph.add(factor)
        return graph

    def _values(self, states: States) -> gtsam.Values:
        self.model.car.found = states.calibration
        poses = (gtsam.Pose3(gtsam.Rot3(R), p) for R, p in zip(states.R, states.p, strict=True))
        plain = [
            State(pose, v, gtsam.imuBias.ConstantBias(b[:3], b[3:]))
            for pose, v, b in zip(poses, states.v, states.bias, strict=True)
        ]
        values = window_values(self.model, 0, plain[: self.n], set(self.fixed.tolist()))
        if self.model.has_gnss_bias:
            for j in self.fixed.tolist():
                values.update(C(j), states.gnss_bias[j])
        return values

    def _states(self, values: gtsam.Values) -> States:
        poses = [values.atPose3(X(j)) for j in range(self.n)]
        biases = [values.atConstantBias(B(m)).vector() for m in self.model.bias_of[: self.n]]
        gnss_bias = np.zeros((self.n, 3))
        if self.model.has_gnss_bias:
            gnss_bias[self.fixed] = [values.atVector(C(j)) for j in self.fixed.tolist()]
        return States(
            np.stack([pose.rotation().matrix() for pose in poses]),
            np.stack([pose.translation() for pose in poses]),
            np.stack([values.atVector(V(j)) for j in range(self.n)]), np.stack(biases), gnss_bias,
            calibration=self.model.car.calibration(values),
        )  # fmt: skip


def _groups(model: GraphModel, prior: Guess) -> list[Factors]:
    """The factors of each keyframe, all but the fixes'."""
    pose = gtsam.Pose3(gtsam.Rot3(prior.R_world_veh[0]), prior.p_world_m[0])
    state = State(pose, prior.v_world_mps[0], gtsam.imuBias.ConstantBias())
    groups = [model.prior_factors(0, state, YAW_SIGMA_RAD)]
    groups += [model.motion_factors(j, model.interval(j).pim) for j in range(1, len(model))]
    for j, group in enumerate(groups):
        group += model.car.factors(j)
    before: int | None = None
    for j in np.flatnonzero(model.fix_of >= 0).tolist():
        groups[j] += model.gnss_bias_factors(j, before)
        before = j
    return groups
