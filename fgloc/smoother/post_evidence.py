"""Frequency, damping and load of posts beside a car: where everything that the graph holds is
likeliest.

The graph of a car is close to linear about its solution, so the density of all measurements is
Laplace's: with the states at their best, c the cost there, H its curvature and W the whitened steps
of the posts,

    log p = -c - log det H / 2 + log det W + what does not depend on the numbers of the posts.

For each trial the posts' steps alone change; the states follow by one Newton step. Poses, the car's
detections and those of users who say where they are all count, so that no pose estimator is needed.
"""

from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np

from fgloc.config import SmoothConfig
from fgloc.errors import ConfigError
from fgloc.infrastructure import Post
from fgloc.smoother.chain import Chain
from fgloc.smoother.model import Model
from fgloc.smoother.post_modes import sought, summary_of
from fgloc.smoother.states import Robustness, States
from fgloc.smoother.swaying import Swaying

TOLERANCE = 1e-7
"""Of the search: the share of the log density below which a step is the last."""


def refuse_gtsam(config: SmoothConfig) -> None:
    """Raise ConfigError where posts are to be sought in a batch that GTSAM solves."""
    if config.posts.estimate_mode and config.solver.batch != "banded":
        raise ConfigError("posts.estimate_mode goes with solver.batch = banded, not with gtsam")


def likelier(
    model: Model, solver: Chain, states: States, robust: Robustness
) -> tuple[Model, dict[str, Any]]:
    """The model with each post in turn as it is likeliest, and what was found, by node's name."""
    watches, summary = list(model.plan.posts), {}
    for k, watch in enumerate(watches):

        def density(post: Post, k: int = k) -> float:
            tried = [*watches[:k], replace(watches[k], post=post), *watches[k + 1 :]]
            return log_density(with_posts(solver, tuple(tried)), states, robust)

        post, errors = sought(watch.post, density, TOLERANCE)
        watches[k] = replace(watch, post=post)
        summary[watch.name] = summary_of(watch.post, post, errors)
    plan = replace(model.plan, posts=tuple(watches))
    found = type(model)(model.drive, plan, model.config)
    found.shifted_s = model.shifted_s
    return found, summary


def with_posts(chain: Chain, watches: tuple[Any, ...]) -> Chain:
    """The chain with posts that have other numbers."""
    other, model = copy(chain), copy(chain.model)
    model.swaying = Swaying(model.drive, watches, model.t_ns)
    other.model, other.beside = model, other.beside.of(model)
    return other


def log_density(chain: Chain, states: States, robust: Robustness) -> float:
    """Natural logarithm of the density of all measurements near a solution, up to a constant."""
    cost, band = chain.linearize(states, robust, "weights")
    factor = band.factor()
    gain = factor.solve(band.gradient).dot(band.gradient) / 2
    after, _ = chain.model.swaying.steps
    steps = float(np.linalg.slogdet(after[: chain.n])[1].sum())
    return gain - cost - factor.log_determinant / 2 + steps
