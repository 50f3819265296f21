"""Posts that sway, as a graph of their own: a chain of states, the wind as its noise, poses on it.

All factors are linear in vector states (`fgloc.factors.post`), so GTSAM solves a whole drive in one
step and iSAM2 never relinearises. Where a drive has vehicles as well, see `swaying`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from fgloc.config import SmoothConfig
from fgloc.drive import Drive
from fgloc.errors import InputError, SolverError
from fgloc.factors.noise import nis
from fgloc.factors.post import pose_factor, pose_jacobian, rest_factor, sway_factor
from fgloc.measurements import Array
from fgloc.result import Result
from fgloc.smoother.post_modes import with_modes
from fgloc.sway import post_states, result
from fgloc.verdicts import SourceVerdicts
from fgloc.watches import SOURCE, Watch, watches

if TYPE_CHECKING:
    import gtsam

Estimate = tuple[Array, Array]
"""States (k, 6) and their covariances (k, 6, 6)."""
_NEVER = 1e9  # what is linear need not be relinearised


def smooth_posts(drive: Drive, config: SmoothConfig, method: str) -> Result:
    """The states of every post at every pose's instant, as `config.mode` says.

    Raises DriveError where the drive has no poses of a post, InputError where a causal mode is to
    estimate frequencies, SolverError where GTSAM gives up.
    """
    refuse_search(config)
    found, verdicts = watches(drive, method)
    extra = {}
    if config.posts.estimate_mode:
        found, extra["posts_sought"] = with_modes(found)
    judged = verdicts[SOURCE]
    tables = [post_states(watch, *estimated(watch, config, judged)) for watch in found]
    factors = sum(len(watch.rows) + len(watch.t_ns) for watch in found)
    return result(
        drive, method, tables, verdicts, causal=config.mode != "batch", mode=config.mode,
        factors=factors, extra=extra, config=config.model_dump(exclude_none=True),
    )  # fmt: skip


def refuse_search(config: SmoothConfig) -> None:
    """Raise InputError where a causal mode is to seek the numbers of posts."""
    if config.posts.estimate_mode and config.mode != "batch":
        raise InputError(
            f"posts.estimate_mode looks at the whole drive and goes with mode batch, not with "
            f"{config.mode}; leave it out"
        )


def factors_of(watch: Watch, k: int) -> list[gtsam.NonlinearFactor]:
    """What the k-th state adds to the graph: how it was reached, and what is told of it."""
    slope = watch.post.tip_slope_per_m
    if k == 0:
        chain = rest_factor(_key(0), watch.post)
    else:
        chain = sway_factor(_key(k - 1), _key(k), watch.post, float(watch.steps_s[k - 1]))
    told = (pose_factor(_key(k), watch.told[i], watch.sigmas[i], slope) for i in watch.rows_of(k))
    return [chain, *told]


def estimated(watch: Watch, config: SmoothConfig, judged: SourceVerdicts) -> Estimate:
    """The states of one post, as the mode says; its rows get their NIS. SolverError as above."""
    solve = _batch if config.mode == "batch" else _online(config)
    try:
        estimate = solve(watch)
    except RuntimeError as err:
        raise SolverError(f"the post of node {watch.name!r} cannot be solved: {err}") from err
    judge(watch, estimate, judged)
    return estimate


def _batch(watch: Watch) -> Estimate:
    """Every state from all that is told of the post."""
    import gtsam

    graph, zero = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in range(len(watch.t_ns)):
        zero.insert(_key(k), np.zeros(6))
        for factor in factors_of(watch, k):
            graph.add(factor)
    solution = graph.linearize(zero).optimize()
    marginals = gtsam.Marginals(graph, zero)
    keys = range(len(watch.t_ns))
    states = np.array([solution.at(_key(k)) for k in keys])
    return states, np.array([marginals.marginalCovariance(_key(k)) for k in keys])


def _online(config: SmoothConfig) -> Callable[[Watch], Estimate]:
    """Every state as it was when it was the newest."""
    lag_s = config.lag_s if config.mode == "fixed-lag" else np.inf

    def solve(watch: Watch) -> Estimate:
        import gtsam

        params = gtsam.ISAM2Params()
        params.setRelinearizeThreshold(_NEVER)
        params.findUnusedFactorSlots = True
        smoother = gtsam.IncrementalFixedLagSmoother(lag_s, params)
        t_s = np.concatenate([[0.0], np.cumsum(watch.steps_s)])
        newest = [_added(smoother, watch, k, float(t_s[k])) for k in range(len(t_s))]
        states, covs = zip(*newest, strict=True)
        return np.array(states), np.array(covs)

    return solve


def _added(
    smoother: gtsam.IncrementalFixedLagSmoother, watch: Watch, k: int, t_s: float
) -> tuple[Array, Array]:
    """The k-th state and its covariance right after it came in."""
    import gtsam

    graph, zero = gtsam.NonlinearFactorGraph(), gtsam.Values()
    zero.insert(_key(k), np.zeros(6))
    for factor in factors_of(watch, k):
        graph.add(factor)
    smoother.update(graph, zero, {_key(k): t_s})
    return smoother.calculateEstimateVector(_key(k)), smoother.marginalCovariance(_key(k))


def judge(watch: Watch, estimate: Estimate, judged: SourceVerdicts) -> None:
    """NIS of every row against what is known without it.

    An estimate that holds a measurement gives it back: with the residual r, of covariance
    R - H P H', it is r' (R - H P H')^-1 r.
    """
    states, covs = (part[watch.state] for part in estimate)
    H = pose_jacobian(watch.post.tip_slope_per_m)
    known = np.isfinite(watch.told)
    # What is not told gets no residual and a variance so large that it counts nothing.
    error = np.where(known, states @ H.T - watch.told, 0.0)
    R = np.where(known, watch.sigmas, _NEVER)[:, :, None] ** 2 * np.eye(4)
    judged.nis[watch.rows] = nis(error, R - H @ covs @ H.T)
    judged.dof[watch.rows] = known.sum(-1)


def _key(k: int) -> int:
    import gtsam

    return gtsam.symbol("s", k)
