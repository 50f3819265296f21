"""The drive as it arrives: iSAM2, whole or over a fixed lag.

Each keyframe is one update. What is written for an epoch is the estimate at the moment it was the
newest: after its update for a keyframe, carried there by the IMU for an output epoch.

Until the fixes or velocities show a course the yaw is unknown and nothing is gated; then the past
is solved once more from the right heading. A solver that fails is replaced by one grown anew over
its window.
"""

from collections.abc import Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, S, V, X

from fgloc.errors import SolverError
from fgloc.factors import imu
from fgloc.measurements import Array
from fgloc.result import Event
from fgloc.smoother.dense import fill
from fgloc.smoother.graph import Factors, GraphModel, Interval, State, read_state
from fgloc.smoother.guess import Guess, choose_yaw, guess, stretch, yaw_by_turns
from fgloc.smoother.model import OBSERVED_YAW_RAD, YAW_SIGMA_RAD
from fgloc.smoother.online_car import OnlineCar
from fgloc.smoother.online_positions import OnlinePositions
from fgloc.smoother.online_posts import OnlinePosts
from fgloc.smoother.solve import (
    explain_failure,
    first_values,
    optimize,
    singular,
    window_values,
)
from fgloc.smoother.states import StateLog, yaw_sigma_rad
from fgloc.smoother.tree import FixedLagTree, Stamps, WholeTree, as_graph, relinearized

UNKNOWN_YAW_SIGMA_RAD = float(np.pi / np.sqrt(3))
"""Of a heading uniform over the circle: the prior until the vehicle's course can be seen."""
SETTLED_YAW_RAD = 0.05
"""A fixed lag shortens to what was asked once the yaw's sigma is below this: marginalising around
a heading that is still moving makes a filter sure of what it does not know."""
ALIGN_WINDOW_S = 60.0
"""Until then it holds this much of the past."""
ALIGN_SIGMAS, ALIGN_DISTANCE_M, ALIGN_SPAN_S = 8.0, 2.0, 20.0
"""Two fixes show a course when so many sigmas, at least so far and at most so long apart."""
GROUP = 0.2
"""What leaves a fixed lag at once, as a share of the lag: it holds up to so much more."""
EXTRA_UPDATES = 3
"""More iterations where a fix moves the state far, as at the end of an outage."""
INFLATION = 10.0
"""A covariance that a rebuilt window starts from is widened by this."""


class Online:
    """One pass over the keyframes of a model; `lag_s` None keeps everything in the tree."""

    def __init__(self, model: GraphModel, lag_s: float | None) -> None:
        self.model, self.lag_s = model, lag_s
        self.log = StateLog(len(model.epochs))
        self.last = StateLog(len(model.epochs)) if model.config.smoothed else None
        self.bias = np.zeros((len(model), 6))
        self.events: list[Event] = []
        self.yaw_observable_ns: int | None = None
        self._turn_rad = yaw_by_turns(model)
        self._aligned = False
        self._settled = False
        self._tree = self._new_tree(model.config.solver.factorization)
        self._intervals: dict[int, Interval] = {}
        self._states: dict[int, State] = {}
        self._covs: dict[int, Array] = {}
        self._positions = OnlinePositions(model, self.events)
        self.posts = OnlinePosts(model)
        self._car = OnlineCar(model)
        self._harvested = 0

    def run(self) -> None:
        """Feed every keyframe; raises SolverError where even a rebuilt window cannot be solved."""
        model, arriving = self.model, self._positions.arriving
        for j in range(len(model)):
            try:
                self._step(j, arriving[j])
            except np.linalg.LinAlgError as err:
                raise singular(model, j) from err
        self._finish(arriving[-1])

    @property
    def factors(self) -> int:
        """Factors in the tree at the end."""
        return int(self._tree.isam.getFactorsUnsafe().nrFactors())

    def survey(self) -> tuple[dict[int, Array], dict[int, Array]]:
        """What each node's survey is off at the end (6,) and the sigmas (6,), by the number of its
        source; see `detection.by_survey`."""
        tree, sources = self._tree, self.model.sources
        own = [s for s, source in enumerate(sources) if source.surveyed and tree.holds(S(s))]
        sigmas = {s: np.sqrt(np.diag(tree.covariance([S(s)]))) for s in own}
        return {s: tree.vector(S(s)) for s in own}, sigmas

    def _step(self, j: int, rows: list[int]) -> None:
        """Carry the state to keyframe j, take in what has arrived, write the epochs."""
        model, values = self.model, gtsam.Values()
        if j == 0:
            state, predicted = self._initial_state(), np.eye(9)
            factors = self._first_prior()
            model.insert_shared(values)
        else:
            interval = self._intervals[j] = model.interval(j)
            self._write_inner(j, interval)
            state, predicted = _predict(interval.pim, self._states[j - 1], self._covs[j - 1])
            factors = model.motion_factors(j, interval.pim)
        self._states[j], self._covs[j] = state, predicted
        new_bias = j == 0 or bool(model.bias_of[j] != model.bias_of[j - 1])
        model.insert(values, j, state, new_bias=new_bias)
        factors += self._car.take_in(j, state, predicted, values, self._tree, aligned=self._aligned)
        factors += self.posts.take_in(j, values, self._tree)
        more, far = self._positions.take_in(
            j, rows, values, state.pose, self._covs, self._tree, self.posts, aligned=self._aligned
        )
        self._harvest(j)
        self._update(j, [*factors, *more], values, EXTRA_UPDATES if far else 0)
        self._positions.weigh(far, self._tree)
        self._car.read(j, self._tree)
        self.posts.read(j, self._tree)
        if not self._aligned and rows:
            self._try_to_align(j)
        self._note_yaw(j)
        self._forget(j)

    def _initial_state(self) -> State:
        model = self.model
        lever = model.levers[int(model.positions.source[model.guides[0]])]
        pose = gtsam.Pose3(gtsam.Rot3(), model.first_place_m - lever)
        return State(pose, np.zeros(3), gtsam.imuBias.ConstantBias())

    def _update(self, j: int, factors: Factors, values: gtsam.Values, extra: int) -> None:
        """One update of the tree and the newest state read from it; a failed tree is replaced."""
        now = float(self.model.t_s[j])
        stamps: Stamps = dict.fromkeys((*values.keys(), *self._alive(j)), now)
        try:
            self._tree.update(factors, values, stamps)
            for _ in range(extra):
                self._tree.iterate()
            self._read(j)
        except RuntimeError as err:
            self._recover(j, err)

    def _recover(self, j: int, err: Exception) -> None:
        """Grow a new tree, by QR, over the window that the failed one held."""
        problem = explain_failure(err, self.model)
        self._event(j, "solver", f"{problem}; the window was solved again")
        first = self._window_start(j, None if self.lag_s is None else self._held_s())
        prior = self._first_prior() if first == 0 else self.model.carried_prior_factors(
            first, self._states[first], self._covs[first] * INFLATION
        )  # fmt: skip
        states = [self._states[k] for k in range(first, j + 1)]
        rows = self._positions.since(first)
        values = window_values(self.model, first, states, rows, self._car.axes)
        self._insert_more(values, first, j + 1 - first)
        try:
            self._regrow(first, j, self._window(first, j, prior), values, "qr")
        except (RuntimeError, SolverError) as again:
            raise problem from again

    def _first_prior(self) -> Factors:
        """What the whole tree began with: before the alignment the yaw is not just any number."""
        if self._aligned:
            return self.model.prior_factors(0, self._states[0], YAW_SIGMA_RAD)
        return self.model.prior_factors(0, self._initial_state(), UNKNOWN_YAW_SIGMA_RAD)

    def _try_to_align(self, j: int) -> None:
        """Once a course is told, start the yaw from it and solve the past again."""
        model = self.model
        first = self._window_start(j, None if self.lag_s is None else ALIGN_WINDOW_S)
        rows = self._positions.since(first)
        if not (self._car.tells_course(first) or _shows_course(model, rows)):
            return
        start = guess(model, first, j, self._turn_rad)
        if not start.yaw_known:
            return
        pose = gtsam.Pose3(gtsam.Rot3(start.R_world_veh[0]), start.p_world_m[0])
        base = State(pose, start.v_world_mps[0], gtsam.imuBias.ConstantBias())
        self._car.admit(first, j)
        groups = self._window(first, j, model.prior_factors(first, base, YAW_SIGMA_RAD))
        start = self._choose_yaw(start, groups, rows)
        values = first_values(model, start, j + 1 - first, rows)
        self._insert_more(values, first, j + 1 - first)
        self._regrow(first, j, groups, values, model.config.solver.factorization)
        self._aligned = True
        self._event(j, "aligned", "a course is told: yaw started from it, the past re-solved")

    def _choose_yaw(self, start: Guess, groups: list[Factors], rows: list[int]) -> Guess:
        """The guess turned to the heading that fits; `groups[k]` are of keyframe first + k."""
        model, n = self.model, stretch(start)
        graph = as_graph(factor for group in groups[:n] for factor in group)
        fixes = len(model.fixed(start.first, start.first + n))
        fixes += model.car.worth(start.first, start.first + n)

        def cost(turned: Guess) -> float:
            values = first_values(model, turned, n, rows)
            self._insert_more(values, start.first, n)
            return float(graph.error(optimize(graph, values, model)[0]))

        return choose_yaw(start, fixes, cost)

    def _insert_more(self, values: gtsam.Values, first: int, n: int) -> None:
        """Put in what posts and velocities add to n keyframes whose states are there."""
        self.posts.insert(values, first, n)
        self._car.insert_velocities(values, first, n)

    def _window(self, first: int, j: int, prior: Factors) -> list[Factors]:
        """The factors of keyframes first..j, one list each, with the prior on the first."""
        groups = [prior]
        groups += [
            self.model.motion_factors(k, self._intervals[k].pim) for k in range(first + 1, j + 1)
        ]
        for k in range(first, j + 1):
            groups[k - first] += self._car.factors(k) + self.posts.factors(k, first)
        for k, factors in self._positions.factors(first):
            groups[k - first] += factors
        return groups

    def _regrow(
        self, first: int, j: int, groups: list[Factors], values: gtsam.Values, kind: str
    ) -> None:
        """Solve a window as a batch and put its solution into a new tree."""
        factors = [factor for group in groups for factor in group]
        solved, _ = optimize(as_graph(factors), values, self.model)
        self._tree = self._new_tree(kind)
        try:
            self._tree.update(factors, solved, self._stamps(first, j))
        except RuntimeError as err:
            if kind == "qr":
                raise
            self._event(j, "solver", f"{explain_failure(err, self.model)}; QR takes over")
            self._tree = self._new_tree("qr")
            self._tree.update(factors, solved, self._stamps(first, j))
        for k in range(first, j + 1):
            self._states[k] = read_state(solved, k, int(self.model.bias_of[k]))
        self._read(j)

    def _stamps(self, first: int, j: int) -> Stamps:
        """The time in s of every variable of a window: its last use."""
        stamps: Stamps = {}
        for k in range(first, j + 1):
            t = float(self.model.t_s[k])
            stamps |= {X(k): t, V(k): t, B(int(self.model.bias_of[k])): t}
        stamps |= self._positions.stamps(first) | self._car.stamps(first, j)
        stamps |= self.posts.stamps(first, j)
        return stamps | dict.fromkeys(self._alive(j), float(self.model.t_s[j]))

    def _alive(self, j: int) -> list[int]:
        """Variables that later factors will touch, whatever their age."""
        shared = self.model.shared_keys
        return [B(int(self.model.bias_of[j])), *shared, *self._positions.alive()]

    def _read(self, j: int) -> None:
        """Take the newest state and its covariance out of the tree and write its epoch."""
        keys = [X(j), V(j), B(int(self.model.bias_of[j]))]
        state = State(*self._tree.estimate(*keys))
        cov = self._covs[j] = self._tree.covariance(keys)
        self._states[j] = state
        self.bias[j] = state.bias.vector()
        self.log.put(self.model.epoch_of[j], *_plain(state), cov[:6, :6], self.bias[j, 3:])

    def _write_inner(self, j: int, interval: Interval) -> None:
        """Output epochs before keyframe j: what the IMU alone makes of the last state."""
        if not interval.inner:
            return
        state, cov = self._states[j - 1], self._covs[j - 1]
        R, p, v = (np.repeat(x[None], len(interval.inner), 0) for x in _plain(state))
        deltas, bias = imu.table(interval.inner), state.bias.vector()
        F, G = imu.transition(deltas, R, bias)
        R, p, v = imu.predict(deltas, R, p, v, bias, self.model.gravity_mps2)
        J = np.concatenate([F, G], axis=-1)[:, :6]
        first = self.model.epoch_of[j - 1] + 1
        for k in range(len(p)):
            spread = J[k] @ cov @ J[k].T + deltas.cov[k, :6, :6]
            self.log.put(first + k, R[k], p[k], v[k], spread, bias[3:])

    def _harvest(self, j: int) -> None:
        """Fixed lag: keep the last estimate of the states that are about to leave the window."""
        if self.last is None or self.lag_s is None:
            return
        while self._harvested < j and (
            self.model.t_s[self._harvested] < self.model.t_s[j] - self._held_s()
        ):
            self._keep_last(self._harvested, self._tree)
            self._harvested += 1

    def _keep_last(self, k: int, tree: WholeTree) -> None:
        assert self.last is not None
        state = State(*tree.estimate(X(k), V(k), B(int(self.model.bias_of[k]))))
        self.bias[k] = state.bias.vector()
        cov = tree.covariance([X(k)])
        self.last.put(self.model.epoch_of[k], *_plain(state), cov, self.bias[k, 3:])

    def _finish(self, rows: list[int]) -> None:
        """Take in what arrived after the last keyframe; read what is still to be read."""
        j, values = len(self.model) - 1, gtsam.Values()
        late = self.posts.take_in(j + 1, values, self._tree)
        late += self._positions.take_in(
            j, rows, values, self._states[j].pose, self._covs, self._tree, self.posts,
            aligned=self._aligned,
        )[0]  # fmt: skip
        self._positions.finish()
        late += self._car.finish(values, self._tree, aligned=self._aligned)
        if late:
            try:
                now = dict.fromkeys(values.keys(), float(self.model.t_s[j]))
                self._tree.update(late, values, now | self._stamps(j, j))
            except RuntimeError as err:
                self._recover(j, err)
        if self.last is None:
            return
        tree = relinearized(self._tree) if self.lag_s is None else self._tree
        for k in range(self._harvested, len(self.model)):
            self._keep_last(k, tree)
        fill(self.last, self.model, self.bias, *self.model.deltas())

    def _forget(self, j: int) -> None:
        """Fixed lag: drop what no later step can ask for, so that memory does not grow."""
        if self.lag_s is None:
            return
        keep = self._window_start(j, self._held_s()) - 1
        for store in (self._states, self._covs, self._intervals):
            while store and (oldest := next(iter(store))) < keep:
                del store[oldest]
        self._car.forget(keep)
        self._positions.forget(keep)
        self.posts.forget(keep)

    def _held_s(self) -> float:
        """How much of the past a fixed lag holds now, s."""
        assert self.lag_s is not None
        return self.lag_s if self._settled else max(self.lag_s, ALIGN_WINDOW_S)

    def _window_start(self, j: int, window_s: float | None) -> int:
        if window_s is None:
            return 0
        return int(np.searchsorted(self.model.t_s, self.model.t_s[j] - window_s))

    def _new_tree(self, kind: str) -> WholeTree:
        thresholds = self.model.thresholds
        if self.lag_s is None:
            return WholeTree(kind, thresholds)
        return FixedLagTree(kind, thresholds, self._held_s(), GROUP * self.lag_s)

    def _note_yaw(self, j: int) -> None:
        """Watch the yaw become observable, and settle."""
        if self._settled or not self._aligned:
            return
        sigma = yaw_sigma_rad(self._states[j].pose.rotation().matrix(), self._covs[j][:3, :3])
        if self.yaw_observable_ns is None and sigma < OBSERVED_YAW_RAD:
            self.yaw_observable_ns = int(self.model.t_ns[j])
        if sigma < SETTLED_YAW_RAD or self.model.plan.motion.forgets_yaw:
            self._settled = True
            if isinstance(self._tree, FixedLagTree):
                self._tree.shorten(self._held_s())

    def _event(self, j: int, kind: str, text: str) -> None:
        self.events.append(Event(int(self.model.t_ns[j]), kind, text))


def _predict(
    pim: gtsam.PreintegratedImuMeasurements, state: State, cov: Array
) -> tuple[State, Array]:
    """The state at the end of an interval, and the covariance (9, 9) of its pose and velocity."""
    by_state, by_bias = np.zeros((9, 9), order="F"), np.zeros((9, 6), order="F")
    nav = pim.predict(gtsam.NavState(state.pose, state.velocity), state.bias, by_state, by_bias)
    # GTSAM's navigation state has its velocity's tangent in the vehicle frame, ours in the world.
    to_world = np.eye(9)
    to_world[6:, 6:] = nav.pose().rotation().matrix()
    J = np.empty((9, 15))
    J[:, :9], J[:, 9:] = by_state, by_bias
    J[:, 6:9] = by_state[:, 6:] @ state.pose.rotation().matrix().T
    predicted = to_world @ (J @ cov @ J.T + pim.residualCovariance()) @ to_world.T
    return State(nav.pose(), nav.velocity(), state.bias), predicted


def _shows_course(model: GraphModel, rows: Sequence[int]) -> bool:
    """Whether the newest position lies far enough from one of the last seconds to tell a
    direction."""
    if len(rows) < 3:
        return False
    t_s = model.t_s[model.key_of[list(rows)]]
    recent = np.array(rows)[t_s >= t_s[-1] - ALIGN_SPAN_S]
    z = model.positions.z_world_m[recent][:, :2]
    variance = model.cov_world_m2[recent][:, :2, :2].trace(axis1=1, axis2=2) / 2
    distance = np.linalg.norm(z - z[-1], axis=1)
    need = np.maximum(ALIGN_DISTANCE_M, ALIGN_SIGMAS * np.sqrt(variance + variance[-1]))
    return bool((distance > need).any())


def _plain(state: State) -> tuple[Array, Array, Array]:
    """Attitude (3, 3), position (3,) and velocity (3,)."""
    return state.pose.rotation().matrix(), state.pose.translation(), state.velocity
