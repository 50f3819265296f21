"""How well predictions of withheld fixes went: their log-likelihood, and what it tells of noise.

The score of a fix with error e and covariance S is -log N(e; 0, S), without the constant: a proper
score, least in the mean for the noise that is true. Errors within a block are correlated; the
score takes each fix for itself (a composite likelihood, Varin, Reid and Firth 2011), which loses
some of the information and nothing of the truth, and the uncertainty is taken from the scatter
between stretches instead (their Godambe sandwich).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fgloc.factors import noise
from fgloc.measurements import Array
from fgloc.tuning.bench import Predictions

HEAVY_TAIL = 4.0
"""Degrees of freedom of the t-distribution while outliers are unknown: one of any size counts then
as two or three good fixes. Scaled so that Gaussian errors find the same noise as without it."""
HEAVY_SCALE = 1.1553
"""1 / E[(tail + 3) n / (3 (tail + n))] for n chi-square with 3 degrees of freedom, tail 4."""
HEAVY_CURVATURE = 0.5436
"""Curvature by the log of a sigma, as a share of the Gaussian one: HEAVY_SCALE tail (tail + 3) / 3
times E[n / (tail + n)^2] for the same n."""


def scores(told: Predictions, *, heavy: bool = False) -> Array:
    """Score (M,) of every prediction; less is better."""
    _, log_det = np.linalg.slogdet(told.cov)
    nis = noise.nis(told.error, told.cov)
    if heavy:
        nis = HEAVY_SCALE * (HEAVY_TAIL + 3) * np.log1p(nis / HEAVY_TAIL)
    return (log_det + nis) / 2


def weights(told: Predictions) -> Array:
    """Weight (M,) of each prediction: all lengths count alike, and the sum is 1.

    Where the IMU is not the white noise that the graph believes, no noise fits short and long gaps
    alike; the fixes in long ones must neither rule nor drown.
    """
    lengths, which, count = np.unique(told.fixes, return_inverse=True, return_counts=True)
    return 1.0 / (len(lengths) * count[which])


@dataclass(frozen=True, eq=False)
class Slope:
    """How the weighted score changes with the log of q settings.

    gradient    (q,)
    curvature   (q, q) expected (Fisher)
    informed    (q, q) the same summed over blocks, each taken for one fix: the information
    scatter     (q, q) covariance of the gradient, from that between stretches
    """

    gradient: Array
    curvature: Array
    informed: Array
    scatter: Array


def slope(
    told: Predictions, nudged: Sequence[Predictions], by: float, *, heavy: bool = False
) -> Slope:
    """From predictions with each of q settings larger by the factor exp(by)."""
    w, base = weights(told), scores(told, heavy=heavy)
    change = np.stack([scores(one, heavy=heavy) - base for one in nudged], -1) / by
    inverse = np.linalg.inv(told.cov)
    d_cov = [inverse @ (one.cov - told.cov) / by for one in nudged]
    d_error = [(one.error - told.error) / by for one in nudged]
    q = len(nudged)
    fisher = np.empty((len(w), q, q))
    for j in range(q):
        for k in range(q):
            fisher[:, j, k] = np.einsum("nab,nba->n", d_cov[j], d_cov[k]) / 2
            fisher[:, j, k] += np.einsum("na,nab,nb->n", d_error[j], inverse, d_error[k])
    gradient = w @ change
    parts = np.unique(told.stretch)
    each = np.stack([(w[:, None] * change)[told.stretch == part].sum(0) for part in parts])
    each -= gradient / len(parts)
    scatter = each.T @ each * len(parts) / max(len(parts) - 1 - q, 1)  # q were fitted to them
    fisher *= HEAVY_CURVATURE if heavy else 1.0
    return Slope(gradient, np.einsum("n,njk->jk", w, fisher),
                 np.einsum("n,njk->jk", 1.0 / told.fixes, fisher), scatter)  # fmt: skip
