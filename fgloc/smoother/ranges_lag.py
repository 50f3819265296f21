"""The range graph over a fixed lag: what is older becomes a prior on what is left.

Each new epoch is predicted, the window is solved again, and the epoch that leaves it is eliminated
with all that hangs on it, at the point where it was last estimated.
"""

from dataclasses import dataclass

import numpy as np

from fgloc.measurements import Array
from fgloc.smoother.ranges_model import Blocks, WindowModel
from fgloc.smoother.ranges_solve import marginal_prior, newest_covariance, step

ITERATIONS = 2


@dataclass(eq=False)
class _Prior:
    """On the first state of the window and the globals: where (m,), (G,) it was taken, what it
    says there: information (m + G, m + G), gradient (m + G,)."""

    state: Array
    globals_: Array
    information: Array
    gradient: Array

    def add_to(self, blocks: Blocks, state: Array, globals_: Array) -> None:
        m = len(state)
        off = np.r_[state - self.state, globals_ - self.globals_]
        gradient = self.gradient + self.information @ off
        blocks.diagonal[0] += self.information[:m, :m]
        blocks.tied[0] += self.information[:m, m:]
        blocks.globals_ += self.information[m:, m:]
        blocks.gradient[0] += gradient[:m]
        blocks.gradient_globals += gradient[m:]


@dataclass(frozen=True, eq=False)
class LagRun:
    """States (K, m) when each was the newest, with covariances (K, m, m), at the epochs from
    `first` on; `last` (N, m) are the last estimates of all, `globals_` (G,) those at the end."""

    states: Array
    cov: Array
    first: int
    last: Array
    globals_: Array


def run_lag(model: WindowModel, states: Array, globals_: Array, lag_s: float) -> LagRun:
    """From the states (n, m) of the drive's first part on to its end."""
    keep = max(round(lag_s / model.interval_s), 2)
    n, total = len(states), len(model.epochs_ns)
    last = np.zeros((total, states.shape[1]))
    last[:n] = states
    prior, begin = _first_prior(model, states[0], globals_), 0
    told = []
    for k in range(n - 1, total):
        if k >= n:
            last[k] = model.motion.predict(last[k - 1], globals_, k - 1)
        while k - begin + 1 > keep:
            prior = _slide(model, last[begin : begin + 2], globals_, begin, prior)
            begin += 1
        window = slice(begin, k + 1)
        for _ in range(ITERATIONS):
            blocks = _blocks(model, last[window], globals_, begin, prior)
            d_states, d_globals = step(blocks)
            last[window] += d_states
            globals_ = globals_ + d_globals
        told.append((last[k].copy(), newest_covariance(blocks)))
    newest, cov = (np.array(part) for part in zip(*told, strict=True))
    return LagRun(newest, cov, n - 1, last, globals_)


def _blocks(
    model: WindowModel, states: Array, globals_: Array, first: int, prior: _Prior
) -> Blocks:
    blocks = model.linearize(states, globals_, first)
    prior.add_to(blocks, states[0], globals_)
    return blocks


def _first_prior(model: WindowModel, state: Array, globals_: Array) -> _Prior:
    mean, sigma = model.prior
    m = len(state)
    information = np.diag(np.r_[np.full(m, model.start_sigma**-2.0), sigma**-2.0])
    return _Prior(state, globals_, information, np.r_[np.zeros(m), (globals_ - mean) / sigma**2])


def _slide(model: WindowModel, pair: Array, globals_: Array, first: int, prior: _Prior) -> _Prior:
    """The prior on the second of two states, once the first has left the window."""
    blocks = _blocks(model, pair, globals_, first, prior)
    return _Prior(pair[1].copy(), globals_, *marginal_prior(blocks))
