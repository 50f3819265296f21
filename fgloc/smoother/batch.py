"""The whole drive at once: guess, solve, gate what does not fit, and solve again."""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fgloc.association import explanations, nearest
from fgloc.errors import ConfigError, SolverError
from fgloc.factors import imu, noise
from fgloc.measurements import Array
from fgloc.positions import DETECTIONS, GNSS
from fgloc.posts import PostStates
from fgloc.result import Event
from fgloc.smoother.chain import Chain, position_errors
from fgloc.smoother.dense import fill
from fgloc.smoother.guess import Guess, choose_yaw, guess, gyro_yaw, misfit, stretch
from fgloc.smoother.model import Model
from fgloc.smoother.post_results import judge_batch, post_table
from fgloc.smoother.states import Robustness, SharedSigmas, StateLog, States, yaw_sigma_rad
from fgloc.verdicts import Verdict

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

    def covariances(self, states: States, robust: Robustness) -> tuple[Array, Array]:
        """Of the poses (n, 6, 6), and of what the positions measure as predicted (rows, 3, 3)."""

    def post_covariances(self, states: States, robust: Robustness) -> Array:
        """Of the states of the posts in all slots, (n, q, q)."""

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
    posts: PostStates | None
    solver: Solver
    robust: Robustness


def run_batch(model: Model) -> BatchRun:
    """Solve the drive and fill the verdicts of the model's plan.

    A position's NIS is that of leaving it out: the position against all other measurements.
    Candidates join once the drive is solved without them. Raises SolverError where the graph
    cannot be solved.
    """
    deltas, inner = model.deltas()
    start = guess(model, 0, len(model) - 1, gyro_yaw(model))
    solver = _solver(model, start, deltas)
    states, robust, cost, iterations = _settle(model, solver, States.of(start, model))
    if cost > misfit(len(model.guides) + model.car.worth(0, len(model))):
        turned = _turned(model, solver, start)
        if turned is not start:
            states, robust, cost, iterations = _settle(model, solver, States.of(turned, model))
    limits = np.empty(0)
    for rounds in range(1, MAX_ROUNDS + 1):
        cov, P = solver.covariances(states, robust)
        nis, weight = _leave_one_out(model, states, P, robust)
        limits = limits if len(limits) else _limits(model, nis)
        gated = _gated(model, nis, limits)
        if np.array_equal(gated, robust.gated) or rounds == MAX_ROUNDS:
            break
        robust = replace(robust, gated=gated)
        states, cost, count = solver.optimum(states, robust)
        iterations += count
    settled = np.array_equal(gated, robust.gated)
    _judge(model, robust, nis, limits, weight)
    model.car.judge(states.R, states.v, states.bias, states.calibration)
    log = _log(model, states, cov)
    fill(log, model, states.bias, deltas, inner)
    begin = model.epoch_of[0]
    sigma = yaw_sigma_rad(log.R[begin], log.cov[begin, :3, :3])
    factors = solver.factors - int(robust.gated.sum())
    events = _remarks(model, solver, robust, limits, settled=settled)
    sigmas = solver.shared_sigmas(states, robust)
    posts_cov = solver.post_covariances(states, robust)
    judge_batch(model, states, posts_cov)
    posts = post_table(model, states.posts, posts_cov)
    return BatchRun(
        log, factors, iterations, cost, sigma, events, states, sigmas, posts, solver, robust
    )


def _settle(model: Model, solver: Solver, states: States) -> tuple[States, Robustness, float, int]:
    """The optimum from a guess, and the loss that it took: first none, to come near.

    From afar every fix is an outlier, and a loss has no curvature to steer by.
    """
    n = int(np.searchsorted(model.key_of, len(states.p)))
    nothing = model.positions.candidates[:n]
    states, cost, iterations = solver.optimum(
        states, Robustness(nothing, np.inf, plain=True), rough=True
    )
    width, fixes = np.inf, ~nothing
    if model.config.gnss.loss != "none" and fixes.any():
        error = position_errors(model, states, np.arange(n))[fixes]
        norm = np.sqrt(noise.nis(error, model.cov_m2[:n][fixes]))
        width = model.config.gnss.loss_width
        width *= _widening(width, norm)
    robust = Robustness(nothing, width)
    states, cost, more = solver.optimum(states, robust)
    return states, robust, cost, iterations + more


def _limits(model: Model, nis: Array) -> Array:
    """The gate (rows,) of every position; that of fixes is widened where more than some exceed."""
    gates = np.array([source.gate_nis for source in model.sources])
    limits = gates[model.positions.source]
    fixes = model.guides
    gate = np.sqrt(model.sources[0].gate_nis)
    limits[fixes] *= _widening(gate, np.sqrt(nis[fixes])) ** 2
    return limits


def _gated(model: Model, nis: Array, limits: Array) -> NDArray[np.bool_]:
    """What is left out (rows,): what does not fit, and of the candidates all but the car."""
    p, gated = model.positions, nis > limits
    own = np.flatnonzero(p.candidates)
    gated[own] = ~nearest(p.frame[own], p.source[own], p.object_id[own], nis[own], limits[own])
    return gated


def _widening(sigmas: float, values: Array) -> float:
    """By what a threshold must grow for no more than `MOST_OUTLIERS` of the values to exceed it."""
    exceeded = float(np.quantile(values, 1 - MOST_OUTLIERS))
    return min(max(exceeded / sigmas, 1.0), MOST_WIDENED)


def _remarks(
    model: Model, solver: Solver, robust: Robustness, limits: Array, *, settled: bool
) -> tuple[Event, ...]:
    """What a user should know of the solution and of noise that is not what the drive says."""
    texts, loss_width = [], model.config.gnss.loss_width
    gate_nis, stated = float(limits[model.guides[0]]), model.sources[0].gate_nis
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
    if model.config.clock.estimate != "none":
        raise ConfigError("clock.estimate goes with solver.batch = banded, not with gtsam")
    from fgloc.smoother.graph import GraphModel
    from fgloc.smoother.whole import Whole

    return Whole(GraphModel(model.drive, model.plan, model.config), prior)


def _turned(model: Model, solver: Solver, start: Guess) -> Guess:
    """The guess turned to the heading that fits; see `choose_yaw`."""
    n = stretch(start)
    begin = solver.first(n)

    def cost(turned: Guess) -> float:
        return _settle(model, begin, States.of(turned, model).first(n))[2]

    return choose_yaw(start, len(model.fixed(0, n)) + model.car.worth(0, n), cost)


def _leave_one_out(
    model: Model, states: States, P: Array, robust: Robustness
) -> tuple[Array, Array]:
    """NIS (rows,) of every position against all others, and its weight (rows,) under the loss.

    With P the posterior of the position's prediction, R_w its covariance as it was weighted and r
    the residual, the prediction without it has the error R_w (R_w - P)^-1 r and the covariance
    R_w (R_w - P)^-1 R_w - R_w. NIS is 0 where the position is all that holds the state.
    """
    R, error = model.cov_m2, position_errors(model, states, np.arange(len(P)))
    weight = _weights(model, np.sqrt(noise.nis(error, R)), robust.loss_width)
    R_w = R / weight[:, None, None]
    kept = ~robust.gated
    spread, left_out = P.copy(), error.copy()
    rest = R_w[kept] - P[kept]
    gain = R_w[kept] @ np.linalg.inv(rest)
    left_out[kept] = np.einsum("nij,nj->ni", gain, error[kept])
    spread[kept] = gain @ R_w[kept] - R_w[kept]
    result = noise.nis(left_out, spread + R)
    informed = np.ones(len(P), bool)
    informed[kept] = np.linalg.eigvalsh(rest)[:, 0] > 1e-9 * R_w[kept].trace(axis1=1, axis2=2)
    return np.where(informed, result, 0.0), weight


def _weights(model: Model, norm: Array, fix_width: float) -> Array:
    """The weight (rows,) that each source's loss gives to whitened errors of some norms (rows,)."""
    weight = np.ones(len(norm))
    for s, source in enumerate(model.sources):
        own = model.positions.source == s
        width = fix_width if source.table == GNSS else source.settings.loss_width
        loss = source.settings.loss if np.isfinite(width) else "none"
        weight[own] = noise.weight(norm[own], loss, width)
    return weight


def _judge(model: Model, robust: Robustness, nis: Array, limits: Array, weight: Array) -> None:
    """Write the verdicts on the positions that had a keyframe."""
    p = model.positions
    dof = np.array([source.dof for source in model.sources])[p.source]
    for table, among in ((GNSS, ~p.candidates), (DETECTIONS, p.candidates)):
        if not among.any():
            continue
        verdicts, own = model.plan.verdicts[table], np.flatnonzero(among)
        rows = p.row[own]
        verdicts.nis[rows], verdicts.dof[rows], verdicts.threshold[rows] = (
            nis[own], dof[own], limits[own])  # fmt: skip
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
