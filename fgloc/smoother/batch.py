"""The whole drive at once: build, solve, gate what does not fit, and solve again."""

from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, B, C, V, X
from numpy.typing import NDArray

from fgloc.errors import SolverError
from fgloc.factors import gnss, noise
from fgloc.measurements import Array
from fgloc.smoother.dense import fill
from fgloc.smoother.guess import guess, gyro_yaw
from fgloc.smoother.model import YAW_SIGMA_RAD, Factors, Interval, Model, read_state
from fgloc.smoother.solve import (
    choose_yaw,
    covariances,
    first_values,
    misfit,
    optimize,
    yaw_sigma_rad,
)
from fgloc.smoother.states import StateLog
from fgloc.smoother.tree import as_graph
from fgloc.verdicts import Verdict

Joint = Callable[[list[int]], Array]
States = tuple[Array, Array, Array]
"""Attitudes, positions and velocities of all keyframes."""

MAX_ROUNDS = 5
"""Gating is repeated until no verdict changes, at most this often."""


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
    intervals = [None, *(model.interval(j) for j in range(1, len(model)))]
    start = guess(model, 0, len(model) - 1, gyro_yaw(model))
    with_fix = np.flatnonzero(model.fix_of >= 0)
    fixed = set(with_fix.tolist())
    groups = _groups(model, intervals, first_values(model, start, 1, fixed))
    gated = np.zeros(len(with_fix), bool)
    graph = _graph(model, groups, with_fix[gated])
    values, iterations = optimize(graph, first_values(model, start, len(model), fixed), model)
    if graph.error(values) > misfit(len(with_fix)):
        turned = choose_yaw(model, start, groups, fixed)
        if turned is not start:
            first = first_values(model, turned, len(model), fixed)
            values, iterations = optimize(graph, first, model)
    for rounds in range(1, MAX_ROUNDS + 1):
        joint = covariances(graph, values, model)
        cov = np.stack([joint([X(j)]) for j in range(len(model))])
        states = _arrays(model, values)
        nis, weight = _leave_one_out(model, values, states, joint, cov, with_fix, gated)
        beyond = nis > model.gate_nis
        if np.array_equal(beyond, gated) or rounds == MAX_ROUNDS:
            break
        gated = beyond
        graph = _graph(model, groups, with_fix[gated])
        values, count = optimize(graph, values, model)
        iterations += count
    _judge(model, with_fix, gated, nis, weight)
    R, _, v = states
    bias = np.stack([values.atConstantBias(B(m)).vector() for m in model.bias_of])
    model.car.judge(R, v, bias, model.car.calibration(values))
    log = _log(model, values, states, cov, intervals)
    begin = model.epoch_of[0]
    return BatchRun(
        log, graph.size(), iterations, graph.error(values),
        yaw_sigma_rad(log.R[begin], log.cov[begin, :3, :3]),
    )  # fmt: skip


def _groups(model: Model, intervals: list[Interval | None], values: gtsam.Values) -> list[Factors]:
    """The factors of each keyframe; a fix's own factors come last."""
    prior = model.prior_factors(0, read_state(values, 0, 0), YAW_SIGMA_RAD)
    groups: list[Factors] = [prior]
    for j in range(1, len(model)):
        interval = intervals[j]
        assert interval is not None
        groups.append(model.motion_factors(j, interval.pim))
    for j, group in enumerate(groups):
        group += model.car.factors(j)
    before: int | None = None
    for j in np.flatnonzero(model.fix_of >= 0).tolist():
        groups[j] += [*model.gnss_bias_factors(j, before), *model.fix_factors(j)]
        before = j
    return groups


def _graph(
    model: Model, groups: list[Factors], gated: NDArray[np.int64]
) -> gtsam.NonlinearFactorGraph:
    """All factors but the measurements of the gated keyframes."""
    left_out = set(gated.tolist())
    # The last factor of a fix's group is the measurement itself.
    return as_graph(
        factor
        for j, group in enumerate(groups)
        for factor in (group[:-1] if j in left_out else group)
    )


def _leave_one_out(
    model: Model, values: gtsam.Values, states: States, joint: Joint, cov: Array,
    keys: NDArray[np.int64], gated: NDArray[np.bool_],
) -> tuple[Array, Array]:  # fmt: skip
    """NIS (n,) of every fix against all others, and its weight (n,) under the robust loss.

    With P the posterior of the fix's prediction, R_w the fix's covariance as it was weighted and r
    the residual, the prediction without the fix has the error R_w (R_w - P)^-1 r and the
    covariance R_w (R_w - P)^-1 R_w - R_w. NIS is 0 where the fix is all that holds the state.
    """
    rows = model.fix_of[keys]
    R_fix = model.cov_world_m2[rows]
    error, P = _fix_residuals(model, values, states, joint, cov, keys)
    c = model.config.gnss
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


def _fix_residuals(
    model: Model, values: gtsam.Values, states: States, joint: Joint, cov: Array,
    keys: NDArray[np.int64],
) -> tuple[Array, Array]:  # fmt: skip
    """Predicted minus measured antenna position (n, 3) and the prediction's covariance."""
    R, p, _ = states
    z = model.fixes.p_world_ant_m[model.fix_of[keys]]
    told = gnss.residual(p[keys], R[keys], z, model.lever)
    if not model.has_gnss_bias:
        return told.error, told.by_pose @ cov[keys] @ told.by_pose.swapaxes(-1, -2)
    H = np.hstack([np.eye(3), np.eye(3)])
    both = np.stack([joint([A(j), C(j)]) for j in keys])
    bias = np.stack([values.atVector(C(j)) for j in keys])
    return told.error + bias, H @ both @ H.T


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


def _arrays(model: Model, values: gtsam.Values) -> States:
    """Attitudes (n, 3, 3), positions (n, 3) and velocities (n, 3) of all keyframes."""
    poses = [values.atPose3(X(j)) for j in range(len(model))]
    return (
        np.stack([pose.rotation().matrix() for pose in poses]),
        np.stack([pose.translation() for pose in poses]),
        np.stack([values.atVector(V(j)) for j in range(len(model))]),
    )


def _log(
    model: Model, values: gtsam.Values, states: States, cov: Array,
    intervals: list[Interval | None],
) -> StateLog:  # fmt: skip
    """Keyframes as solved and the output epochs between them."""
    R, p, v = states
    bias = np.stack([values.atConstantBias(B(m)).vector() for m in model.bias_of])
    log = StateLog(len(model.epochs))
    at = model.epoch_of
    log.R[at], log.p[at], log.v[at], log.cov[at] = R, p, v, cov
    log.gyro_bias[at] = bias[:, 3:]
    fill(log, model, intervals, bias)
    if not np.isfinite(log.p).all():
        raise SolverError("the solver returned values that are not finite")
    return log
