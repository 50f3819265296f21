"""Frequency, damping and load of a post, from the poses alone: where these are likeliest.

The chain is linear and Gaussian, so the likelihood of all that is told is known in closed form once
the four numbers are given: it is the one of the poses under a chain of one axis, from the banded
Cholesky factor of its normal equations. A quasi-Newton search (L-BFGS-B) seeks the largest over the
logarithms of the numbers, held by wide priors about what the drive states, since a wind that does
not excite the post says nothing of its frequency. The load has to be a wind: under a sine the
likeliest post is one that swings at the sine's frequency.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from fgloc.factors.post import axis_spread, axis_step
from fgloc.infrastructure import Post
from fgloc.measurements import Array
from fgloc.watches import Watch

SOUGHT = ("frequency_hz", "damping", "load_sigma_n", "load_tau_s")
PRIOR_SIGMAS = (0.3, 1.0, 1.5, 1.5)
"""Of the logarithms: a third of the frequency, a factor of three in damping, of 4.5 in the load."""
_WIDTH = 5  # of the band: a state of three beside the next one
_DIFFERENCE = 0.02  # in the logarithms, for the curvature at the optimum


def with_modes(found: Sequence[Watch]) -> tuple[list[Watch], dict[str, Any]]:
    """The watches with posts as their poses want them, and what was found by the node's name.

    Of each number the value, what the drive states, and a standard error in parts of the value
    from the curvature of the likelihood with its priors.
    """
    watches, summary = [], {}
    for watch in found:
        post, errors = sought(watch.post, partial(log_likelihood, watch))
        watches.append(replace(watch, post=post))
        summary[watch.name] = summary_of(watch.post, post, errors)
    return watches, summary


def summary_of(stated: Post, post: Post, errors: Sequence[float]) -> dict[str, Any]:
    """What is told of a post that was sought."""
    return {
        name: {"value": getattr(post, name), "stated": getattr(stated, name),
               "relative_error": error}
        for name, error in zip(SOUGHT, errors, strict=True)
    }  # fmt: skip


def sought(
    stated: Post, density: Callable[[Post], float], tolerance: float = 1e-9
) -> tuple[Post, list[float]]:
    """The likeliest post, and the standard errors of the logarithms of its numbers.

    `density` is the logarithm of that of all measurements; a step that changes it by less than the
    share `tolerance` is the last.
    """
    from scipy.optimize import minimize

    def cost(change: Array) -> float:
        prior = float(np.sum((change / PRIOR_SIGMAS) ** 2)) / 2
        return prior - density(_changed(stated, change))

    best = minimize(cost, np.zeros(4), method="L-BFGS-B", bounds=[(-4.0, 4.0)] * 4,
                    options={"eps": 1e-5, "ftol": tolerance})  # fmt: skip
    curvature = _curvature(cost, best.x)
    return _changed(stated, best.x), np.sqrt(np.diag(np.linalg.pinv(curvature))).tolist()


def log_likelihood(watch: Watch, post: Post) -> float:
    """Natural logarithm of the density of what is told, over both axes."""
    slope = watch.post.tip_slope_per_m
    along_x = np.array([[1.0, slope]]), watch.told[:, [0, 3]], watch.sigmas[:, [0, 3]]
    along_y = np.array([[1.0, -slope]]), watch.told[:, [1, 2]], watch.sigmas[:, [1, 2]]
    band, log_noise = _chain(watch, post)
    return sum(_of_axis(watch, band, log_noise, *axis) for axis in (along_x, along_y))


def _chain(watch: Watch, post: Post) -> tuple[Array, float]:
    """Normal equations of one axis without poses, as lower bands (6, 3k), and half the logarithm of
    the determinant of its noise."""
    k = len(watch.t_ns)
    steps_s, which = np.unique(watch.steps_s, return_inverse=True)
    steps = [axis_step(post, dt_s) for dt_s in steps_s.tolist()]
    informations = np.array([np.linalg.inv(step.noise) for step in steps]).reshape(-1, 3, 3)
    transitions = np.array([step.transition for step in steps]).reshape(-1, 3, 3)[which]
    weights = np.concatenate([np.linalg.inv(axis_spread(post))[None], informations[which]])
    diagonal = weights.copy()
    below = -weights[1:] @ transitions
    diagonal[:-1] -= transitions.swapaxes(-1, -2) @ below
    band = np.zeros((_WIDTH + 1, 3 * k))
    for row in range(3):
        for column in range(row + 1):
            band[row - column, column::3] = diagonal[:, row, column]
        for column in range(3):
            band[3 + row - column, column : 3 * (k - 1) : 3] = below[:, row, column]
    return band, -float(np.linalg.slogdet(weights)[1].sum()) / 2


def _of_axis(
    watch: Watch, chain: Array, log_noise: float, J: Array, told: Array, sigmas: Array
) -> float:
    """log p(z) = log p(z, x) - log p(x | z), at the x that is likeliest given z."""
    from scipy.linalg import cho_solve_banded, cholesky_banded

    known = np.isfinite(told)
    weight = np.where(known, sigmas, np.inf) ** -2.0
    band, right = chain.copy(), np.zeros(chain.shape[1])
    np.add.at(band[0], 3 * watch.state, (weight * J**2).sum(-1))
    np.add.at(right, 3 * watch.state, (weight * J * np.nan_to_num(told)).sum(-1))
    factor = cholesky_banded(band, lower=True)
    solution = cho_solve_banded((factor, True), right)
    misfit = float((weight * np.nan_to_num(told) ** 2).sum() - right @ solution)
    log_poses = float(np.log(sigmas[known]).sum()) + known.sum() * np.log(2 * np.pi) / 2
    return -misfit / 2 - log_noise - log_poses - float(np.log(factor[0]).sum())


def _changed(post: Post, change: Array) -> Post:
    """The post with its numbers changed by factors e^change; the damping stays below 1."""
    values = {name: getattr(post, name) * float(np.exp(by))
              for name, by in zip(SOUGHT, change, strict=True)}  # fmt: skip
    values["damping"] = min(values["damping"], 0.99)
    return replace(post, **values)


def _curvature(cost: Any, at: Array) -> Array:
    """Second derivatives (4, 4) by differences."""
    n, steps = len(at), _DIFFERENCE * np.eye(len(at))
    result = np.zeros((n, n))
    for i, j in zip(*np.triu_indices(n), strict=True):
        a, b = steps[i], steps[j]
        bend = cost(at + a + b) - cost(at + a - b) - cost(at - a + b) + cost(at - a - b)
        result[i, j] = result[j, i] = bend / (4 * _DIFFERENCE**2)
    return result
