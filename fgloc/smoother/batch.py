"""The whole drive at once: guess, solve, gate what does not fit, and solve again."""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fgloc.errors import ConfigError, SolverError
from fgloc.factors import imu, noise
from fgloc.measurements import Array
from fgloc.result import Event
from fgloc.smoother.chain import Chain
from fgloc.smoother.dense import fill
from fgloc.smoother.guess import Guess, choose_yaw, guess, gyro_yaw, misfit, stretch
from fgloc.smoother.model import Model
from fgloc.smoother.states import Robustness, StateLog, States, yaw_sigma_rad
from fgloc.smoother.terms import fix_residual, late_fix_residual
from fgloc.verdicts import Verdict

MAX_ROUNDS = 5
"""Gating is repeated until no verdict changes, at most this often."""
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
        """Of the poses (n, 6, 6), and of what the fixes measure as predicted (fixes, 3, 3)."""

    def late_sigma_s(self, states: States, robust: Robustness) -> float | None:
        """Standard deviation in s of the fixes' lateness, None where it is not estimated."""


@dataclass(eq=False)
class BatchRun:
    """A solved drive: states of all epochs, what the solver did, and what there is to remark."""

    log: StateLog
    factors: int
    iterations: int
    cost: float
    yaw_sigma_rad: float
    events: tuple[Event, ...]
    late_s: float
    late_sigma_s: float | None


def run_batch(model: Model) -> BatchRun:
    """Solve the drive and fill the GNSS verdicts of the model's plan.

    A fix's NIS is that of leaving it out: the fix against all other measurements. Raises
    SolverError where the graph cannot be solved.
    """
    deltas, inner = model.deltas()
    start = guess(model, 0, len(model) - 1, gyro_yaw(model))
    solver = _solver(model, start, deltas)
    keys = np.flatnonzero(model.fix_of >= 0)
    states, robust, cost, iterations = _settle(model, solver, States.of(start), keys)
    if cost > misfit(len(keys)):
        turned = _turned(model, solver, start)
        if turned is not start:
            states, robust, cost, iterations = _settle(model, solver, States.of(turned), keys)
    gate_nis = 0.0
    for rounds in range(1, MAX_ROUNDS + 1):
        cov, P = solver.covariances(states, robust)
        nis, weight = _leave_one_out(model, states, P, keys, robust)
        gate = np.sqrt(model.gate_nis)
        gate_nis = gate_nis or model.gate_nis * _widening(gate, np.sqrt(nis)) ** 2
        beyond = nis > gate_nis
        if np.array_equal(beyond, robust.gated) or rounds == MAX_ROUNDS:
            break
        robust = replace(robust, gated=beyond)
        states, cost, count = solver.optimum(states, robust)
        iterations += count
    _judge(model, keys, robust, nis, gate_nis, weight)
    model.car.judge(states.R, states.v, states.bias, states.calibration)
    log = _log(model, states, cov)
    fill(log, model, states.bias, deltas, inner)
    begin = model.epoch_of[0]
    sigma = yaw_sigma_rad(log.R[begin], log.cov[begin, :3, :3])
    factors = solver.factors - int(robust.gated.sum())
    events = _remarks(model, solver, robust, gate_nis)
    late_sigma_s = solver.late_sigma_s(states, robust)
    return BatchRun(
        log, factors, iterations, cost, sigma, events, states.late_s, late_sigma_s
    )  # fmt: skip


def _settle(
    model: Model, solver: Solver, states: States, keys: NDArray[np.int64]
) -> tuple[States, Robustness, float, int]:
    """The optimum from a guess, and the loss that it took: first none, to come near.

    From afar every fix is an outlier, and a loss has no curvature to steer by.
    """
    nothing = np.zeros(len(keys), bool)
    states, cost, iterations = solver.optimum(
        states, Robustness(nothing, np.inf, plain=True), rough=True
    )
    width = np.inf
    if model.config.gnss.loss != "none" and not model.has_gnss_bias:
        norm = np.sqrt(noise.nis(fix_errors(model, states, keys), model.cov_of_fixes(keys)))
        width = model.config.gnss.loss_width
        width *= _widening(width, norm)
    robust = Robustness(nothing, width)
    states, cost, more = solver.optimum(states, robust)
    return states, robust, cost, iterations + more


def _widening(sigmas: float, values: Array) -> float:
    """By what a threshold must grow for no more than `MOST_OUTLIERS` of the values to exceed it."""
    exceeded = float(np.quantile(values, 1 - MOST_OUTLIERS))
    return min(max(exceeded / sigmas, 1.0), MOST_WIDENED)


def _remarks(
    model: Model, solver: Solver, robust: Robustness, gate_nis: float
) -> tuple[Event, ...]:
    """What a user should know of the solution and of noise that is not what the drive says."""
    texts, loss_width = [], model.config.gnss.loss_width
    if loss_width < robust.loss_width < np.inf:
        texts.append(f"loss from {robust.loss_width:.3g} on instead of {loss_width:g}")
    if gate_nis > model.gate_nis:
        texts.append(f"gate at an NIS of {gate_nis:.3g} instead of {model.gate_nis:.3g}")
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
    keys = np.flatnonzero(model.fix_of[:n] >= 0)
    begin = solver.first(n)

    def cost(turned: Guess) -> float:
        return _settle(model, begin, States.of(turned).first(n), keys)[2]

    return choose_yaw(start, len(keys), cost)


def fix_errors(model: Model, states: States, keys: NDArray[np.int64]) -> Array:
    """Predicted minus measured antenna positions (n, 3) of the fixes at some keyframes, ENU m."""
    told = fix_residual(model, states, keys)
    return late_fix_residual(model, states, keys, told).error if states.late_s else told.error


def _leave_one_out(
    model: Model, states: States, P: Array, keys: NDArray[np.int64], robust: Robustness
) -> tuple[Array, Array]:
    """NIS (n,) of every fix against all others, and its weight (n,) under the robust loss.

    With P the posterior of the fix's prediction, R_w the fix's covariance as it was weighted and r
    the residual, the prediction without the fix has the error R_w (R_w - P)^-1 r and the
    covariance R_w (R_w - P)^-1 R_w - R_w. NIS is 0 where the fix is all that holds the state.
    """
    R_fix, error = model.cov_of_fixes(keys), fix_errors(model, states, keys)
    whitened = np.sqrt(noise.nis(error, R_fix))
    loss = model.config.gnss.loss if np.isfinite(robust.loss_width) else "none"
    weight = noise.weight(whitened, loss, robust.loss_width)
    R_w = R_fix / weight[:, None, None]
    kept = ~robust.gated
    spread, left_out = P.copy(), error.copy()
    rest = R_w[kept] - P[kept]
    gain = R_w[kept] @ np.linalg.inv(rest)
    left_out[kept] = np.einsum("nij,nj->ni", gain, error[kept])
    spread[kept] = gain @ R_w[kept] - R_w[kept]
    result = noise.nis(left_out, spread + R_fix)
    informed = np.ones(len(keys), bool)
    informed[kept] = np.linalg.eigvalsh(rest)[:, 0] > 1e-9 * R_w[kept].trace(axis1=1, axis2=2)
    return np.where(informed, result, 0.0), weight


def _judge(
    model: Model, keys: NDArray[np.int64], robust: Robustness, nis: Array, gate_nis: float,
    weight: Array,
) -> None:  # fmt: skip
    """Write the verdicts on the fixes that had a keyframe."""
    verdicts, rows = model.plan.verdicts["gnss"], model.fix_of[keys]
    verdicts.nis[rows], verdicts.dof[rows], verdicts.threshold[rows] = nis, 3, gate_nis
    verdicts.set(rows, Verdict.USED)
    for row, w in zip(rows[weight < 1], weight[weight < 1], strict=True):
        verdicts.set(row, Verdict.DOWN_WEIGHTED, f"{model.config.gnss.loss} weight {w:.3g}")
    verdicts.set(rows[robust.gated], Verdict.GATED, "does not fit all other measurements")


def _log(model: Model, states: States, cov: Array) -> StateLog:
    """The keyframes as solved."""
    log = StateLog(len(model.epochs))
    at = model.epoch_of
    log.R[at], log.p[at], log.v[at], log.cov[at] = states.R, states.p, states.v, cov
    log.gyro_bias[at] = states.bias[:, 3:]
    if not np.isfinite(states.p).all():
        raise SolverError("the solver returned values that are not finite")
    return log
