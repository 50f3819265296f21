"""The whole drive at once: guess, solve, gate what does not fit, and solve again."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fgloc.errors import SolverError
from fgloc.factors import gnss, imu, noise
from fgloc.measurements import Array
from fgloc.smoother.chain import Chain
from fgloc.smoother.dense import fill
from fgloc.smoother.guess import Guess, choose_yaw, guess, gyro_yaw, misfit, stretch
from fgloc.smoother.model import Model
from fgloc.smoother.states import StateLog, States, yaw_sigma_rad
from fgloc.verdicts import Verdict

MAX_ROUNDS = 5
"""Gating is repeated until no verdict changes, at most this often."""


class Solver(Protocol):
    """A drive's graph that can be solved: in numpy (`Chain`) or by GTSAM (`Whole`)."""

    @property
    def factors(self) -> int:
        """How many there are."""

    def first(self, n: int) -> "Solver":
        """The same for the first n keyframes alone."""

    def optimum(self, states: States, gated: NDArray[np.bool_]) -> tuple[States, float, int]:
        """The states of least cost without the gated fixes, that cost and the iterations."""

    def covariances(self, states: States, gated: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Of the poses (n, 6, 6), and of what the fixes measure as predicted (fixes, 3, 3)."""


@dataclass(eq=False)
class BatchRun:
    """A solved drive: states of all epochs, and what the solver did."""

    log: StateLog
    factors: int
    iterations: int
    cost: float
    yaw_sigma_rad: float


def run_batch(model: Model) -> BatchRun:
    """Solve the drive and fill the GNSS verdicts of the model's plan.

    A fix's NIS is that of leaving it out: the fix against all other measurements. Raises
    SolverError where the graph cannot be solved.
    """
    at = model.epoch_of
    deltas, inner = model.deltas()
    start = guess(model, 0, len(model) - 1, gyro_yaw(model))
    solver = _solver(model, start, deltas)
    keys = np.flatnonzero(model.fix_of >= 0)
    gated = np.zeros(len(keys), bool)
    states, cost, iterations = solver.optimum(States.of(start), gated)
    if cost > misfit(len(keys)):
        turned = _turned(model, solver, start)
        if turned is not start:
            states, cost, iterations = solver.optimum(States.of(turned), gated)
    for rounds in range(1, MAX_ROUNDS + 1):
        cov, P = solver.covariances(states, gated)
        nis, weight = _leave_one_out(model, states, P, keys, gated)
        beyond = nis > model.gate_nis
        if np.array_equal(beyond, gated) or rounds == MAX_ROUNDS:
            break
        gated = beyond
        states, cost, count = solver.optimum(states, gated)
        iterations += count
    _judge(model, keys, gated, nis, weight)
    log = _log(model, states, cov)
    fill(log, model, states.bias, deltas, inner)
    sigma = yaw_sigma_rad(log.R[at[0]], log.cov[at[0], :3, :3])
    return BatchRun(log, solver.factors - int(gated.sum()), iterations, cost, sigma)


def _solver(model: Model, prior: Guess, deltas: imu.ImuDeltas) -> Solver:
    """The chain, unless the configuration asks for GTSAM."""
    if model.config.solver.batch == "banded":
        return Chain(model, prior, deltas)
    from fgloc.smoother.graph import GraphModel
    from fgloc.smoother.whole import Whole

    return Whole(GraphModel(model.drive, model.plan, model.config), prior)


def _turned(model: Model, solver: Solver, start: Guess) -> Guess:
    """The guess turned to the heading that fits; see `choose_yaw`."""
    n = stretch(start)
    fixes = int((model.fix_of[:n] >= 0).sum())
    begin, nothing = solver.first(n), np.zeros(fixes, bool)

    def cost(turned: Guess) -> float:
        return begin.optimum(States.of(turned).first(n), nothing)[1]

    return choose_yaw(start, fixes, cost)


def _leave_one_out(
    model: Model, states: States, P: Array, keys: NDArray[np.int64], gated: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """NIS (n,) of every fix against all others, and its weight (n,) under the robust loss.

    With P the posterior of the fix's prediction, R_w the fix's covariance as it was weighted and r
    the residual, the prediction without the fix has the error R_w (R_w - P)^-1 r and the
    covariance R_w (R_w - P)^-1 R_w - R_w. NIS is 0 where the fix is all that holds the state.
    """
    R_fix, c = model.cov_of_fixes(keys), model.config.gnss
    z = model.fixes.p_world_ant_m[model.fix_of[keys]]
    error = gnss.residual(
        states.p[keys], states.R[keys], z, model.lever, states.gnss_bias[keys]
    ).error
    whitened = np.sqrt(noise.nis(error, R_fix))
    loss = "none" if model.has_gnss_bias else c.loss
    weight = noise.weight(whitened, loss, c.loss_width)
    R_w = R_fix / weight[:, None, None]
    kept = ~gated
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
    model: Model, keys: NDArray[np.int64], gated: NDArray[np.bool_], nis: Array, weight: Array
) -> None:
    """Write the verdicts on the fixes that had a keyframe."""
    verdicts, rows = model.plan.verdicts["gnss"], model.fix_of[keys]
    verdicts.nis[rows], verdicts.dof[rows], verdicts.threshold[rows] = nis, 3, model.gate_nis
    verdicts.set(rows, Verdict.USED)
    for row, w in zip(rows[weight < 1], weight[weight < 1], strict=True):
        verdicts.set(row, Verdict.DOWN_WEIGHTED, f"{model.config.gnss.loss} weight {w:.3g}")
    verdicts.set(rows[gated], Verdict.GATED, "does not fit all other measurements")


def _log(model: Model, states: States, cov: Array) -> StateLog:
    """The keyframes as solved."""
    log = StateLog(len(model.epochs))
    at = model.epoch_of
    log.R[at], log.p[at], log.v[at], log.cov[at] = states.R, states.p, states.v, cov
    log.gyro_bias[at] = states.bias[:, 3:]
    if not np.isfinite(states.p).all():
        raise SolverError("the solver returned values that are not finite")
    return log
