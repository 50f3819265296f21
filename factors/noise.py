"""Noise models: Gaussian, and the robust losses laid over them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgloc.factors import fields
from fgloc.measurements import Array

if TYPE_CHECKING:
    import gtsam

Loss = Literal["none", "huber", "cauchy"]


def gaussian(cov: ArrayLike) -> gtsam.noiseModel.Base:
    """GTSAM's model of a covariance (m, m); raises RuntimeError where it is not positive."""
    import gtsam

    matrix = np.asarray(cov, float)
    variance = np.diagonal(matrix)
    if np.array_equal(matrix, np.diag(variance)):
        return gtsam.noiseModel.Diagonal.Variances(variance)
    return gtsam.noiseModel.Gaussian.Covariance(matrix)


def robust(model: gtsam.noiseModel.Base, loss: Loss, width: float) -> gtsam.noiseModel.Base:
    """The model with a loss on the norm of the whitened error; `width` in standard deviations."""
    if loss == "none":
        return model
    import gtsam

    estimators = gtsam.noiseModel.mEstimator
    create = {"huber": estimators.Huber.Create, "cauchy": estimators.Cauchy.Create}[loss]
    return gtsam.noiseModel.Robust.Create(create(width), model)


def weight(norm: ArrayLike, loss: Loss, width: float) -> Array:
    """Weight (...) that a loss gives to whitened errors of the given norms (...), 1 = full."""
    size = np.asarray(norm, float)
    if loss == "huber":
        return width / np.maximum(size, width)
    if loss == "cauchy":
        return 1 / (1 + (size / width) ** 2)
    return np.ones_like(size)


def cost(norm: ArrayLike, loss: Loss, width: float) -> Array:
    """What a loss charges for whitened errors of the given norms (...); half the square if none."""
    size = np.asarray(norm, float)
    if loss == "huber":
        return np.where(size <= width, size**2 / 2, width * (size - width / 2))
    if loss == "cauchy":
        return width**2 / 2 * np.log1p((size / width) ** 2)
    return size**2 / 2


def curvature(norm: ArrayLike, loss: Loss, width: float) -> Array:
    """Second derivative (...) of `cost` by the norm: 1 where there is no loss."""
    size = np.asarray(norm, float)
    if loss == "huber":
        return (size <= width).astype(float)
    if loss == "cauchy":
        square = (size / width) ** 2
        return (1 - square) / (1 + square) ** 2
    return np.ones_like(size)


def nis(error: ArrayLike, cov: ArrayLike) -> Array:
    """Normalised innovation squared e' S^-1 e of errors (..., m) with covariances (..., m, m)."""
    e, S = np.asarray(error, float), np.asarray(cov, float)
    if e.ndim > 1:
        return _nis_of_many(e, S)
    return np.asarray(e @ np.linalg.solve(S, e))


def _nis_of_many(e: Array, S: Array) -> Array:
    """By S = L D L' written out: LAPACK, which takes them one by one, is five times slower."""
    D: list[Array] = []
    z: list[Array] = []
    rows: list[list[Array]] = []
    for i in range(e.shape[-1]):
        row: list[Array] = []
        for j in range(i):
            known = (row[k] * rows[j][k] * D[k] for k in range(j))
            row.append((S[..., i, j] - sum(known)) / D[j])
        D.append(S[..., i, i] - sum(row[k] ** 2 * D[k] for k in range(i)))
        z.append(e[..., i] - sum(row[k] * z[k] for k in range(i)))
        rows.append(row)
    return np.asarray(sum(z_i**2 / D_i for z_i, D_i in zip(z, D, strict=True)))


def whitening(cov: Array) -> Array:
    """W (N, m, m) with W cov W' = I for covariances (N, m, m); none of those is finite that is not
    positive definite."""
    L = fields.cholesky(fields.of(np.asarray(cov, float)))
    with np.errstate(invalid="ignore", divide="ignore"):
        return fields.rows(fields.inverse_of_lower(L))


def inverse(matrices: Array) -> Array:
    """Inverses (N, m, m) of symmetric matrices, which as a rule are positive definite: by Cholesky,
    all side by side, where all are; LAPACK takes them one by one, ten times slower."""
    W = fields.of(whitening(matrices))
    if not np.isfinite(W).all():
        return np.asarray(np.linalg.inv(matrices))
    return fields.rows(fields.product(W.swapaxes(0, 1), W))


def positive_definite(matrices: Array, least: float = 0.0) -> NDArray[np.bool_]:
    """(N,) bool: which of symmetric matrices (N, m, m) have eigenvalues above `least` only.

    One factorisation of the whole stack decides the usual case, where all are definite.
    """
    if fields.positive(fields.cholesky(fields.of(matrices))).all():
        return np.ones(len(matrices), bool)
    return np.asarray(np.linalg.eigvalsh(matrices)[:, 0] > least)
