"""The whole drive at once: guess, solve, gate what does not fit, and solve again."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fgloc.association import explanations, nearest
from fgloc.errors import ConfigError, SolverError
from fgloc.factors import imu, noise
from fgloc.following import Strays, followed
from fgloc.measurements import Array
from fgloc.positions import DETECTIONS, GNSS, numbered
from fgloc.posts import PostStates
from fgloc.result import Event
from fgloc.smoother.chain import Chain, position_errors
from fgloc.smoother.dense import fill
from fgloc.smoother.guess import Guess, choose_yaw, guess, misfit, stretch, yaw_by_turns
from fgloc.smoother.left_out import LeftOut, leave_out
from fgloc.smoother.model import Model
from fgloc.smoother.post_results import judge_batch, post_table
from fgloc.smoother.states import (
    Robustness,
    SharedSigmas,
    Spread,
    StateLog,
    States,
    yaw_sigma_rad,
)
from fgloc.smoother.term import Term
from fgloc.timing import elapsed_s
from fgloc.verdicts import Verdict

POSITIONS = "positions"
"""The name under which fixes and detections are left out together."""
STEADY_S = 5.0
"""Over which the error of a solution by fixes forgets itself, where they state no slow error."""
MAX_ROUNDS = 8
"""Gating, and which candidates are the car, is gone through until nothing changes, at most this
often."""
MOST_OUTLIERS, MOST_WIDENED = 0.1, 10.0
"""Gate and loss may act on this share of the fixes. Where more do not fit, the noise is probably
claimed too small, of the fixes or of the IMU, and both are widened, up to so many sigmas for one: a
gate that believed the noise would drop good fixes."""


class Solver(Protocol):
    """A drive's graph that can be solved: in numpy (`Chain`) or by GTSAM (`Whole`)."""

    converged: bool

    @property
    def factors(self) -> int:
        """How many there are."""

    def first(self, n: int) -> "Solver":
        """The same for the first n keyframes alone."""

    def optimum(
        self, states: States, robust: Robustness, *, rough: bool = False
    ) -> tuple[States, float, int]:
        """The states of least cost, that cost and the iterations; `rough` may stop when near."""

    def rough_predictions(self, states: States, rows: NDArray[np.int64]) -> Array | None:
        """Covariances (m, 3, 3) in m^2 of what some positions measure as predicted at the states
        of a rough optimum; None where they take as long as the whole."""

    def covariances(self, states: States, robust: Robustness) -> Spread:
        """Of poses and posts, and of what the positions and the vehicle's own sources measure."""

    def held_term(self, source: str, states: States, at: NDArray[np.int64]) -> Term:
        """What one of the vehicle's own sources says at some keyframes."""

    def shared_sigmas(self, states: States, robust: Robustness) -> SharedSigmas:
        """Of what the drive shares and the graph estimates."""


@dataclass(eq=False)
class BatchRun:
    """A solved drive: states of all epochs, what the solver did, and what there is to remark."""

    log: StateLog
    factors: int
    iterations: int
    cost: float
    yaw_sigma_rad: float
    events: tuple[Event, ...]
    states: States
    sigmas: SharedSigmas
    left_out: Mapping[str, LeftOut]
    posts: PostStates | None
    solver: Solver
    robust: Robustness


def run_batch(model: Model) -> BatchRun:
    """Solve the drive and fill the verdicts of the model's plan.

    A measurement's NIS is that of leaving it out: itself against all others. Candidates join once
    the drive is solved without them, the plain ones roughly. Raises SolverError where the graph
    cannot be solved.
    """
    deltas, inner = model.deltas()
    start = guess(model, 0, len(model) - 1, yaw_by_turns(model))
    solver = _solver(model, start, deltas)
    states, robust, cost, iterations = _settle(model, solver, States.of(start, model))
    if cost > misfit(int((~robust.gated).sum()) + model.car.worth(0, len(model))):
        turned = _turned(model, solver, start)
        if turned is not start:
            states, robust, cost, iterations = _settle(model, solver, States.of(turned, model))
    limits: dict[str, Array] = {}
    near = _wait(model, robust)
    for rounds in range(1, MAX_ROUNDS + 1):
        spread = solver.covariances(states, robust)
        told = {POSITIONS: _positions(model, states, spread.positions, robust),
                **_held(model, solver, states, spread, robust)}  # fmt: skip
        limits = limits or _limits(model, told)
        gated = _gated(model, told[POSITIONS].nis, limits[POSITIONS])
        if near:
            among = np.flatnonzero(model.positions.candidates)
            gated[among] = ~_followed(model, states, among, spread.positions[among])
        unheld = _unheld(told, limits)
        settled = np.array_equal(gated, robust.gated) and unheld == robust.unheld
        if rounds == MAX_ROUNDS or (settled and not near):
            break
        robust, near = replace(robust, gated=gated, unheld=unheld), False
        states, cost, count = solver.optimum(states, robust)
        iterations += count
    _judge(model, robust, told[POSITIONS], limits[POSITIONS])
    model.car.found = states.calibration
    for source in model.car.rows_of:
        out = robust.unheld.get(source, frozenset())
        model.car.judge(source, told[source], float(limits[source]), out)
    log = _log(model, states, spread.poses)
    fill(log, model, states.bias, deltas, inner)
    begin = model.epoch_of[0]
    sigma = yaw_sigma_rad(log.R[begin], log.cov[begin, :3, :3])
    factors = solver.factors - int(robust.gated.sum()) - sum(map(len, robust.unheld.values()))
    events = _remarks(model, solver, robust, limits, settled=settled)
    sigmas = solver.shared_sigmas(states, robust)
    model.car.velocities.found = states.velocity_errors
    if sigmas.velocity_errors is not None:
        model.car.velocities.found_cov = np.diag(sigmas.velocity_errors**2)
    judge_batch(model, states, spread.posts)
    posts = post_table(model, states.posts, spread.posts)
    return BatchRun(log, factors, iterations, cost, sigma, events, states, sigmas, told, posts,
                    solver, robust)  # fmt: skip


def _settle(
    model: Model, solver: Solver, states: States, *, join: bool = True
) -> tuple[States, Robustness, float, int]:
    """The optimum from a guess, and the loss that it took: first none, to come near.

    From afar every fix is an outlier, and a loss has no curvature to steer by. Candidates that
    `_followed` finds join if they are to. While all of them wait, near is enough: what they say of
    the states is more than what is left.
    """
    n = int(np.searchsorted(model.key_of, len(states.p)))
    left_out = model.positions.candidates[:n]
    states, cost, iterations = solver.optimum(
        states, Robustness(left_out, np.inf, plain=True), rough=True
    )
    width, fixes = np.inf, ~left_out
    if model.config.gnss.loss != "none" and fixes.any():
        error = position_errors(model, states, np.arange(n))[fixes]
        norm = np.sqrt(noise.nis(error, model.cov_m2[:n][fixes]))
        width = model.config.gnss.loss_width
        width *= _widening(width, norm)
    among = np.flatnonzero(left_out)
    if join and len(among) and (P := solver.rough_predictions(states, among)) is not None:
        left_out = left_out.copy()
        left_out[among] = ~_followed(model, states, among, P)
        states, _, more = solver.optimum(
            states, Robustness(left_out, np.inf, plain=True), rough=True
        )
        iterations += more
    robust = Robustness(left_out, width)
    states, cost, more = solver.optimum(states, robust, rough=join and _wait(model, robust))
    return states, robust, cost, iterations + more


def _wait(model: Model, robust: Robustness) -> bool:
    """Whether there are candidates, and none is in."""
    among = model.positions.candidates[: len(robust.gated)]
    return bool(among.any()) and bool(robust.gated[among].all())


def _limits(model: Model, told: Mapping[str, LeftOut]) -> dict[str, Array]:
    """The gate of every position (rows,), and of each of the vehicle's own sources; those of fixes
    and of the vehicle are widened where more than some exceed them."""
    limits, fixes, nis = model.gate_nis.copy(), model.guides, told[POSITIONS].nis
    gate = np.sqrt(model.sources[0].gate_nis)
    limits[fixes] *= _widening(gate, np.sqrt(nis[fixes])) ** 2
    of_all = {POSITIONS: limits}
    for source in model.car.rows_of:
        one = told[source]
        gate = np.sqrt(model.car.limit(source, one.error.shape[1]))
        of_all[source] = np.array(gate * _widening(gate, np.sqrt(one.nis))) ** 2
    return of_all


def _gated(model: Model, nis: Array, limits: Array) -> NDArray[np.bool_]:
    """What is left out (rows,): what does not fit, and of the candidates all but the car."""
    p, gated = model.positions, nis > limits
    own = np.flatnonzero(p.candidates)
    # A height that is told must not make a candidate look further away: less what it adds in mean.
    extra = p.dof[own] - 2
    gated[own] = ~nearest(
        p.frame[own], p.source[own], p.object_id[own], nis[own] - extra, limits[own] - extra
    )
    return gated


def _followed(
    model: Model, states: States, among: NDArray[np.int64], P: Array
) -> NDArray[np.bool_]:
    """Which of some candidates (m,) are the car, by all that is known without them; P (m, 3, 3) is
    the covariance of what they measure as predicted."""
    p, drift = model.positions, model.sources[0].bias
    order = np.lexsort((p.frame[among], p.t_ns[among]))
    own, plane = among[order], np.s_[:, :2, :2]
    chosen = np.zeros(len(among), bool)
    chosen[order] = followed(Strays(
        elapsed_s(p.t_ns[own], int(model.t_ns[0])), p.frame[own],
        np.where(p.object_id[own] < 0, -1, numbered(p.source[own], p.object_id[own])),
        position_errors(model, states, own)[:, :2], P[order][plane], model.cov_m2[own][plane],
        drift.tau_s if drift else STEADY_S, model.gate_in_plane[own],
    ))  # fmt: skip
    return chosen


def _unheld(told: Mapping[str, LeftOut], limits: Mapping[str, Array]) -> dict[str, frozenset[int]]:
    """The keyframes at which each of the vehicle's own sources does not fit all others."""
    out = {
        source: frozenset(one.keys[one.nis > limits[source]].tolist())
        for source, one in told.items()
        if source != POSITIONS
    }
    return {source: keys for source, keys in out.items() if keys}


def _widening(sigmas: float, values: Array) -> float:
    """By what a threshold must grow for no more than `MOST_OUTLIERS` of the values to exceed it."""
    exceeded = float(np.quantile(values, 1 - MOST_OUTLIERS))
    return min(max(exceeded / sigmas, 1.0), MOST_WIDENED)


def _remarks(
    model: Model, solver: Solver, robust: Robustness, limits: Mapping[str, Array], *, settled: bool
) -> tuple[Event, ...]:
    """What a user should know of the solution and of noise that is not what the drive says."""
    texts, loss_width = [], model.config.gnss.loss_width
    gate_nis, stated = float(limits[POSITIONS][model.guides[0]]), model.sources[0].gate_nis
    if loss_width < robust.loss_width < np.inf:
        texts.append(f"loss from {robust.loss_width:.3g} on instead of {loss_width:g}")
    if gate_nis > stated:
        texts.append(f"gate at an NIS of {gate_nis:.3g} instead of {stated:.3g}")
    start_ns, events = int(model.t_ns[0]), []
    if texts:
        text = (
            f"more than {MOST_OUTLIERS:.0%} of the fixes do not fit: noise is claimed too small, "
        )
        text += f"or they are wrong; {', '.join(texts)}"
        events.append(Event(start_ns, "noise", text))
    if not solver.converged:
        most = model.config.solver.max_iterations
        text = f"stopped after {most} iterations, before the optimum; do not trust the covariances"
        events.append(Event(start_ns, "solver", text))
    if not settled:
        text = f"which measurements fit was still changing after {MAX_ROUNDS} rounds"
        events.append(Event(start_ns, "association", text))
    return tuple(events)


def _solver(model: Model, prior: Guess, deltas: imu.ImuDeltas) -> Solver:
    """The chain, unless the configuration asks for GTSAM."""
    if model.config.solver.batch == "banded":
        return Chain(model, prior, deltas)
    if model.config.clock.estimate:
        raise ConfigError("clock.estimate goes with solver.batch = banded, not with gtsam")
    from fgloc.smoother.graph import GraphModel
    from fgloc.smoother.whole import Whole

    return Whole(GraphModel(model.drive, model.plan, model.config), prior, deltas)


def _turned(model: Model, solver: Solver, start: Guess) -> Guess:
    """The guess turned to the heading that fits; see `choose_yaw`."""
    n = stretch(start)
    begin = solver.first(n)

    def cost(turned: Guess) -> float:
        return _settle(model, begin, States.of(turned, model).first(n), join=False)[2]

    return choose_yaw(start, len(model.fixed(0, n)) + model.car.worth(0, n), cost)


def _positions(model: Model, states: States, P: Array, robust: Robustness) -> LeftOut:
    """Every position as all others predict it, from the covariances (rows, 3, 3) of predictions."""
    R, error = model.cov_m2, position_errors(model, states, np.arange(len(P)))
    weight = _weights(model, np.sqrt(noise.nis(error, R)), robust.loss_width)
    return leave_out(model.key_of, error, P, R, weight, ~robust.gated)


def _held(
    model: Model, solver: Solver, states: States, spread: Spread, robust: Robustness
) -> dict[str, LeftOut]:
    """What each of the vehicle's own sources says as all others predict it, whitened."""
    told = {}
    for source, keys in model.car.keys_of.items():
        term = solver.held_term(source, states, keys)
        own = np.broadcast_to(np.eye(term.error.shape[1]), spread.held[source].shape)
        weight = noise.weight(np.linalg.norm(term.error, axis=1), "huber", term.width)
        kept = np.isin(keys, robust.holds(source, keys))
        told[source] = leave_out(keys, term.error, spread.held[source], own, weight, kept)
    return told


def _weights(model: Model, norm: Array, fix_width: float) -> Array:
    """The weight (rows,) that each source's loss gives to whitened errors of some norms (rows,)."""
    weight = np.ones(len(norm))
    for s, source in enumerate(model.sources):
        own = model.positions.source == s
        width = fix_width if source.table == GNSS else source.settings.loss_width
        loss = source.settings.loss if np.isfinite(width) else "none"
        weight[own] = noise.weight(norm[own], loss, width)
    return weight


def _judge(model: Model, robust: Robustness, told: LeftOut, limits: Array) -> None:
    """Write the verdicts on the positions that had a keyframe."""
    p, nis, weight = model.positions, told.nis, told.weight
    for table, among in ((GNSS, ~p.candidates), (DETECTIONS, p.candidates)):
        if not among.any():
            continue
        verdicts, own = model.plan.verdicts[table], np.flatnonzero(among)
        rows = p.row[own]
        verdicts.nis[rows], verdicts.dof[rows], verdicts.threshold[rows] = (
            nis[own], p.dof[own], limits[own])  # fmt: skip
        verdicts.set(rows, Verdict.USED)
        for i in own[(weight[own] < 1) & ~robust.gated[own]].tolist():
            loss = model.sources[int(p.source[i])].settings.loss
            verdicts.set(p.row[i], Verdict.DOWN_WEIGHTED, f"{loss} weight {weight[i]:.3g}")
        verdicts.set(p.row[own[robust.gated[own]]], Verdict.GATED,
                     "does not fit all other measurements")  # fmt: skip
    explain(model, ~robust.gated, nis <= limits, p.candidates)


def explain(
    model: Model, used: NDArray[np.bool_], fits: NDArray[np.bool_], among: NDArray[np.bool_]
) -> None:
    """Say of each candidate that was left out what it was instead.

    `among` are the rows that were weighed at all; the others keep their verdicts.
    """
    p = model.positions
    own = np.flatnonzero(among)
    if not len(own):
        return
    verdicts = model.plan.verdicts[DETECTIONS]
    told = explanations(p.frame[own], p.source[own], p.object_id[own], used[own], fits[own])
    for i, (other, why) in zip(own[~used[own]].tolist(), told, strict=True):
        verdicts.set(p.row[i], Verdict.OTHER if other else Verdict.GATED, why)


def _log(model: Model, states: States, cov: Array) -> StateLog:
    """The keyframes as solved."""
    log = StateLog(len(model.epochs))
    at = model.epoch_of
    log.R[at], log.p[at], log.v[at], log.cov[at] = states.R, states.p, states.v, cov
    log.gyro_bias[at] = states.bias[:, 3:]
    if not np.isfinite(states.p).all():
        raise SolverError("the solver returned values that are not finite")
    return log
