"""The drive as it arrives: iSAM2, whole or over a fixed lag.

Each keyframe is one update. What is written for an epoch is the estimate at the moment it was the
newest: after its update for a keyframe, carried there by the IMU for an output epoch. Fixes enter
when they were received, at the state of the instant when they were true.

Until the fixes show a course the yaw is unknown and nothing is gated; then the past is solved once
more from the right heading. A solver that fails is replaced by one grown anew over its window.
"""

from bisect import insort
from collections.abc import Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, B, C, V, X

from fgloc.factors import imu, noise
from fgloc.measurements import Array
from fgloc.result import Event
from fgloc.smoother.dense import fill
from fgloc.smoother.graph import Factors, GraphModel, Interval, State, read_state
from fgloc.smoother.guess import Guess, choose_yaw, guess, gyro_yaw, stretch
from fgloc.smoother.model import OBSERVED_YAW_RAD, YAW_SIGMA_RAD
from fgloc.smoother.online_car import OnlineCar, arrivals
from fgloc.smoother.solve import (
    explain_failure,
    first_values,
    optimize,
    singular,
    window_values,
)
from fgloc.smoother.states import StateLog, yaw_sigma_rad
from fgloc.smoother.tree import FixedLagTree, Stamps, WholeTree, as_graph, relinearized
from fgloc.verdicts import Verdict

UNKNOWN_YAW_SIGMA_RAD = float(np.pi / np.sqrt(3))
"""Of a heading uniform over the circle: the prior until the vehicle's course can be seen."""
SETTLED_YAW_RAD = 0.05
"""A fixed lag shortens to what was asked once the yaw's sigma is below this: marginalising around
a heading that is still moving makes a filter sure of what it does not know."""
ALIGN_WINDOW_S = 60.0
"""Until then it holds this much of the past."""
ALIGN_SIGMAS, ALIGN_DISTANCE_M, ALIGN_SPAN_S = 8.0, 2.0, 20.0
"""Two fixes show a course when so many sigmas, at least so far and at most so long apart."""
OPEN_ANYWAY = 2.0
"""After so many times the reset the gate opens to any fix, not only to two that agree."""
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
        self._turn_rad = gyro_yaw(model)
        self._aligned = False
        self._settled = False
        self._tree = self._new_tree(model.config.solver.factorization)
        self._intervals: dict[int, Interval] = {}
        self._states: dict[int, State] = {}
        self._covs: dict[int, Array] = {}
        self._accepted: list[int] = []
        self._accepted_s = 0.0
        self._refused: Array | None = None
        self._car = OnlineCar(model)
        self._harvested = 0

    def run(self) -> None:
        """Feed every keyframe; raises SolverError where even a rebuilt window cannot be solved."""
        model = self.model
        with_fix = np.flatnonzero(model.fix_of >= 0)
        received = model.fixes.received_ns[model.fix_of[with_fix]]
        arriving = arrivals(model.t_ns, with_fix, received)
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

    def _step(self, j: int, fixes: list[int]) -> None:
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
        self._states[j] = state
        new_bias = j == 0 or bool(model.bias_of[j] != model.bias_of[j - 1])
        model.insert(values, j, state, new_bias=new_bias)
        factors += self._car.take_in(j, state, predicted, values, self._tree, aligned=self._aligned)
        more, far = self._take_in(j, fixes, values, state.pose, predicted[:6, :6])
        self._harvest(j)
        self._update(j, [*factors, *more], values, EXTRA_UPDATES if far else 0)
        self._weigh(far)
        self._car.read(j, self._tree)
        if not self._aligned and fixes:
            self._try_to_align(j)
        self._note_yaw(j)
        self._forget(j)

    def _initial_state(self) -> State:
        model = self.model
        first = model.fixes.p_world_ant_m[model.fix_of[model.fix_of >= 0][0]]
        pose = gtsam.Pose3(gtsam.Rot3(), first - model.lever)
        return State(pose, np.zeros(3), gtsam.imuBias.ConstantBias())

    def _take_in(
        self, j: int, fixes: list[int], values: gtsam.Values, pose: gtsam.Pose3, predicted: Array
    ) -> tuple[Factors, list[int]]:
        """Factors of the fixes that are in time and pass the gate, and those that lie far."""
        factors: Factors = []
        far_keys = []
        for key in fixes:
            if self._is_late(key, j):
                continue
            there = pose if key == j else self._tree.pose(X(key))
            cov = predicted if key == j else self._tree.covariance([X(key)])
            accepted, far = self._gate(key, there, cov)
            if accepted:
                far_keys += [key] if far else []
                before = self._accepted[-1] if self._accepted else None
                self.model.insert_fix(values, key, there)
                factors += self.model.gnss_bias_factors(key, before)
                factors += self.model.fix_factors(key)
                insort(self._accepted, key)
                self._accepted_s = float(self.model.t_s[j])
        return factors, far_keys

    def _weigh(self, keys: list[int]) -> None:
        """Note which of the fixes that lay far the loss still weighs down, now that they are in."""
        model, c = self.model, self.model.config.gnss
        if model.has_gnss_bias:
            return
        for key in keys:
            row = model.fix_of[key]
            error = self._tree.pose(X(key)).transformFrom(model.lever)
            error = error - model.fixes.p_world_ant_m[row]
            norm = np.sqrt(error @ np.linalg.solve(model.cov_world_m2[row], error))
            weight = float(noise.weight(norm, c.loss, c.loss_width))
            if weight < 1:
                reason = f"{c.loss} weight {weight:.3g}"
                model.plan.verdicts["gnss"].set(row, Verdict.DOWN_WEIGHTED, reason)

    def _is_late(self, key: int, j: int) -> bool:
        """Give a fix its verdict where its state, or the bias chain, has passed it by."""
        passed = self.model.has_gnss_bias and bool(self._accepted) and key < self._accepted[-1]
        if key == j or (self._tree.holds(X(key)) and not passed):
            return False
        age_s = self.model.t_s[j] - self.model.t_s[key]
        why = "a later fix is in the bias chain" if passed else f"the lag is {self.lag_s:g} s"
        row = self.model.fix_of[key]
        self.model.plan.verdicts["gnss"].set(row, Verdict.LATE, f"{age_s:.2f} s old; {why}")
        return True

    def _gate(self, key: int, pose: gtsam.Pose3, cov: Array) -> tuple[bool, bool]:
        """Whether a fix is accepted, and whether it lies far from the prediction."""
        model, c, row = self.model, self.model.config.gnss, self.model.fix_of[key]
        R = pose.rotation().matrix()
        H = R @ model.antenna_by_pose
        error = pose.transformFrom(model.lever) - model.fixes.p_world_ant_m[row]
        R_fix = model.cov_world_m2[row]
        S = H @ cov @ H.T + R_fix + c.bias_sigma_m**2 * np.eye(3)
        nis = float(error @ np.linalg.solve(S, error))
        fits = nis <= model.gate_nis
        waited = float(model.t_s[key] - self._accepted_s) / c.gate_reset_s
        agrees = self._agrees_with_the_last(error, R_fix)
        opens = waited > (1 if agrees else OPEN_ANYWAY)
        accepted = fits or opens or not self._aligned
        self._refused = None if accepted else error
        verdicts = model.plan.verdicts["gnss"]
        if self._aligned:
            verdicts.nis[row], verdicts.dof[row], verdicts.threshold[row] = nis, 3, model.gate_nis
        far = float(error @ np.linalg.solve(R_fix, error)) > c.loss_width**2
        if not accepted:
            verdicts.set(row, Verdict.GATED, "does not fit the prediction")
        else:
            verdicts.set(row, Verdict.USED, "" if self._aligned else "before the yaw was aligned")
        if accepted and not fits and self._aligned:
            text = f"no fix accepted for {waited * c.gate_reset_s:.1f} s: the gate opened"
            self._event(key, "gate reset", text)
        return accepted, far

    def _agrees_with_the_last(self, error: Array, cov: Array) -> bool:
        """Whether a fix that does not fit errs as the one refused before it did: one that is wrong
        by itself must not move the state to where it is."""
        if self._refused is None:
            return False
        apart = error - self._refused
        return float(apart @ np.linalg.solve(2 * cov, apart)) <= self.model.gate_nis

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
        values = window_values(self.model, first, states, self._accepted, self._car.axes)
        try:
            self._regrow(first, j, self._window(first, j, prior), values, "qr")
        except RuntimeError as again:
            raise problem from again

    def _first_prior(self) -> Factors:
        """What the whole tree began with: before the alignment the yaw is not just any number."""
        if self._aligned:
            return self.model.prior_factors(0, self._states[0], YAW_SIGMA_RAD)
        return self.model.prior_factors(0, self._initial_state(), UNKNOWN_YAW_SIGMA_RAD)

    def _try_to_align(self, j: int) -> None:
        """Once the fixes show a course, start the yaw from it and solve the past again."""
        model = self.model
        first = self._window_start(j, None if self.lag_s is None else ALIGN_WINDOW_S)
        if not _shows_course(model, [k for k in self._accepted if k >= first]):
            return
        start = guess(model, first, j, self._turn_rad)
        if not start.yaw_known:
            return
        pose = gtsam.Pose3(gtsam.Rot3(start.R_world_veh[0]), start.p_world_m[0])
        base = State(pose, start.v_world_mps[0], gtsam.imuBias.ConstantBias())
        self._car.admit(first, j)
        groups = self._window(first, j, model.prior_factors(first, base, YAW_SIGMA_RAD))
        start = self._choose_yaw(start, groups)
        values = first_values(model, start, j + 1 - first, self._accepted)
        self._regrow(first, j, groups, values, model.config.solver.factorization)
        self._aligned = True
        self._event(
            j, "aligned", "the fixes show a course: yaw started from it, the past re-solved"
        )

    def _choose_yaw(self, start: Guess, groups: list[Factors]) -> Guess:
        """The guess turned to the heading that fits; `groups[k]` are of keyframe first + k."""
        model, n = self.model, stretch(start)
        graph = as_graph(factor for group in groups[:n] for factor in group)
        fixes = int((model.fix_of[start.first : start.first + n] >= 0).sum())

        def cost(turned: Guess) -> float:
            values = first_values(model, turned, n, self._accepted)
            return float(graph.error(optimize(graph, values, model)[0]))

        return choose_yaw(start, fixes, cost)

    def _window(self, first: int, j: int, prior: Factors) -> list[Factors]:
        """The factors of keyframes first..j, one list each, with the prior on the first."""
        groups = [prior]
        groups += [
            self.model.motion_factors(k, self._intervals[k].pim) for k in range(first + 1, j + 1)
        ]
        before = None
        for k in range(first, j + 1):
            groups[k - first] += self._car.factors(k)
        for k in sorted(k for k in self._accepted if k >= first):
            groups[k - first] = [
                *groups[k - first], *self.model.gnss_bias_factors(k, before),
                *self.model.fix_factors(k),
            ]  # fmt: skip
            before = k
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
        if self.model.has_gnss_bias:
            keys = [k for k in self._accepted if k >= first]
            stamps |= {key(k): float(self.model.t_s[k]) for k in keys for key in (A, C)}
        stamps |= self._car.stamps(first, j)
        return stamps | dict.fromkeys(self._alive(j), float(self.model.t_s[j]))

    def _alive(self, j: int) -> list[int]:
        """Variables that later factors will touch, whatever their age."""
        keys = [B(int(self.model.bias_of[j])), *self.model.shared_keys]
        if self.model.has_gnss_bias:
            keys += [C(k) for k in self._accepted[-1:]]
        return keys

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

    def _finish(self, fixes: list[int]) -> None:
        """Take in fixes that arrived after the last keyframe; read what is still to be read."""
        j, values = len(self.model) - 1, gtsam.Values()
        late, _ = self._take_in(j, fixes, values, self._states[j].pose, self._covs[j][:6, :6])
        late += self._car.finish(self._tree, aligned=self._aligned)
        if late:
            try:
                self._tree.update(late, values, self._stamps(j, j))
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
        while len(self._accepted) > 1 and self._accepted[0] < keep:
            del self._accepted[0]

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
        return FixedLagTree(kind, thresholds, self._held_s())

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


def _shows_course(model: GraphModel, keys: Sequence[int]) -> bool:
    """Whether the newest fix lies far enough from one of the last seconds to tell a direction."""
    if len(keys) < 3:
        return False
    recent = [k for k in keys if model.t_s[k] >= model.t_s[keys[-1]] - ALIGN_SPAN_S]
    rows = model.fix_of[recent]
    z = model.fixes.p_world_ant_m[rows][:, :2]
    variance = model.cov_world_m2[rows][:, :2, :2].trace(axis1=1, axis2=2) / 2
    distance = np.linalg.norm(z - z[-1], axis=1)
    need = np.maximum(ALIGN_DISTANCE_M, ALIGN_SIGMAS * np.sqrt(variance + variance[-1]))
    return bool((distance > need).any())


def _plain(state: State) -> tuple[Array, Array, Array]:
    """Attitude (3, 3), position (3,) and velocity (3,)."""
    return state.pose.rotation().matrix(), state.pose.translation(), state.velocity
