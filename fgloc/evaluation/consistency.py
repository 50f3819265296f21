"""Does an estimator's covariance agree with its errors? NEES, its band, the ellipsoid's coverage.

Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation (2001),
section 5.4: the normalised estimation error squared e^T P^-1 e of a consistent estimator follows
chi-square with as many degrees of freedom as e has components.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from fgloc import chi_square
from fgloc.arrays import Array, finite_rows
from fgloc.errors import InputError
from fgloc.factors import fields

_SINGULAR = 1e-12
"""Smallest eigenvalue of a correlation matrix that still counts as positive definite."""


def chi2_quantile(probability: ArrayLike, dof: ArrayLike) -> Array:
    """Quantile of chi-square; `dof` may be fractional. 0.95 with 3 degrees gives 7.815."""
    return np.asarray(np.vectorize(chi_square.chi2_quantile, [float])(probability, dof), float)


def nees(error: Array, cov: Array) -> Array:
    """Normalised squared errors (N,) of errors (N, d) under covariances (N, d, d).

    NaN where an error is NaN or a covariance is not positive definite; the units of the
    components do not matter.
    """
    return leading_nees(error, cov, [error.shape[1]])[0]


def leading_nees(error: Array, cov: Array, sizes: Sequence[int]) -> list[Array]:
    """`nees` of the first so many components alone, for each of some sizes: one factorisation of
    the whole tells of all."""
    result = [np.full(len(error), np.nan) for _ in sizes]
    sigma = np.sqrt(np.maximum(np.diagonal(cov, axis1=-2, axis2=-1), 0.0))
    sound = np.asarray((sigma > 0).all(-1) & finite_rows(error))
    rows = np.flatnonzero(sound)
    correlation = cov[rows] / (sigma[rows, :, None] * sigma[rows, None, :])
    L = fields.cholesky(fields.of(correlation))
    if not fields.positive(L).all():  # else one factorisation has decided
        definite = np.linalg.eigvalsh(correlation)[:, 0] > _SINGULAR
        sound[rows[~definite]] = False
        L, rows = fields.cholesky(fields.of(correlation[definite])), rows[definite]
    z = fields.of(error[rows] / sigma[rows])
    for i in range(len(z)):  # forward substitution: what is left of z is L^-1 z
        z[i] = (z[i] - (L[i, :i] * z[:i]).sum(0)) / L[i, i]
    for told, size in zip(result, sizes, strict=True):
        told[rows] = (z[:size] ** 2).sum(0)
        if size < error.shape[1] and not sound.all():  # what the others spoil
            told[~sound] = nees(error[~sound, :size], cov[~sound, :size, :size])
    return result


def anees_band(n: float, dof: int, probability: float = 0.95) -> tuple[float, float]:
    """Interval that holds the mean NEES over `n` independent samples, divided by `dof`.

    A consistent estimator falls inside with the given probability. Samples along one drive are
    correlated, so counting every one of them as independent makes the band too narrow: give
    `effective_samples(nees)` as `n` there. Raises InputError where n or dof is not positive.
    """
    if n <= 0 or dof <= 0:
        raise InputError(f"a band needs samples and degrees of freedom, not n={n}, dof={dof}")
    tail = (1 - probability) / 2
    low, high = chi2_quantile([tail, 1 - tail], n * dof) / (n * dof)
    return float(low), float(high)


def effective_samples(x: Array) -> float:
    """How many independent samples a correlated series (N,) is worth for its mean, 1 to N.

    N / (1 + 2 sum of autocorrelations), summed in pairs of lags for as long as a pair is
    positive (Geyer 1992, the initial positive sequence), so that noise at long lags stays out.
    """
    n = len(x)
    rho = _autocorrelation(x)
    if n < 4 or rho is None:
        return float(n)
    pairs = rho[: n - n % 2].reshape(-1, 2).sum(-1)
    negative = np.flatnonzero(pairs <= 0)
    last = negative[0] if len(negative) else len(pairs)
    return float(np.clip(n / (2 * pairs[:last].sum() - 1), 1.0, n))


def _autocorrelation(x: Array) -> Array | None:
    """Autocorrelation (N,) of a series at lags 0 to N-1; None where it is constant."""
    centred = x - x.mean() if len(x) else x
    length = _quick_length(max(2 * len(x), 1))  # room for every lag
    covariance = np.fft.irfft(np.abs(np.fft.rfft(centred, length)) ** 2, length)[: len(x)]
    if len(x) == 0 or covariance[0] <= 1e-300 or np.ptp(x) == 0:
        return None
    return covariance / covariance[0]


def _quick_length(n: int) -> int:
    """The least length from n on of whose kind Fourier transforms are quick: few times a power of
    two."""
    return min(m << max(-(-n // m) - 1, 0).bit_length() for m in (1, 3, 5, 9))
