"""Many small vectors and matrices at once, components first.

A field of vectors is an array (3, ...) and one of matrices (3, 3, ...), with a place for each time
or sample in the axes after. Numpy works through these several times faster than through stacks of
small arrays, whose components come last; `of` and `rows` turn one into the other.
"""

import numpy as np
from numpy.typing import NDArray

from fgloc.measurements import Array

SERIES = 0.25
"""Up to this square of an angle in rad^2, a turn's coefficients are given by their series, to
1e-13."""


def of(stack: Array) -> Array:
    """The field (..., n) of a stack (n, ...)."""
    return np.ascontiguousarray(stack.transpose(*range(1, stack.ndim), 0))


def rows(field: Array) -> Array:
    """A field (..., n) seen as a stack (n, ...)."""
    return field.transpose(-1, *range(field.ndim - 1))


def product(A: Array, B: Array) -> Array:
    """A B of matrices (i, j, ...) and (j, k, ...)."""
    return np.einsum("ij...,jk...->ik...", A, B)


def apply(A: Array, b: Array) -> Array:
    """A b of matrices (i, j, ...) and vectors (j, ...)."""
    return np.einsum("ij...,j...->i...", A, b)


def cross(a: Array, b: Array) -> Array:
    """a x b of vectors."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
                     a[0] * b[1] - a[1] * b[0]])  # fmt: skip


def skew(vector: Array) -> Array:
    """Matrices with skew(a) b = a x b."""
    W = np.zeros((3, *vector.shape))
    W[2, 1], W[0, 2], W[1, 0] = vector
    W[1, 2], W[2, 0], W[0, 1] = -vector
    return W


def cholesky(A: Array) -> Array:
    """Lower triangular L (d, d, ...) with L L' = A, column by column; see `positive`."""
    L = np.zeros_like(A)
    with np.errstate(invalid="ignore", divide="ignore"):
        for j in range(len(A)):
            rest = A[j:, j]
            if j:
                rest = rest - np.einsum("ik...,k...->i...", L[j:, :j], L[j, :j])
            L[j, j] = np.sqrt(rest[0])
            L[j + 1 :, j] = rest[1:] / L[j, j]
    return L


def positive(L: Array) -> NDArray[np.bool_]:
    """(...) bool: where what `cholesky` gave L (d, d, ...) for was positive definite."""
    diagonal = L[range(len(L)), range(len(L))]
    return np.asarray((np.isfinite(diagonal) & (diagonal > 0)).all(0))


def inverse_of_lower(L: Array) -> Array:
    """Inverses of lower triangular matrices (d, d, ...), row by row."""
    X = np.zeros_like(L)
    for i in range(len(L)):
        X[i, i] = 1 / L[i, i]
        if i:
            X[i, :i] = -X[i, i] * np.einsum("k...,kj...->j...", L[i, :i], X[:i, :i])
    return X


def exp(theta: Array) -> tuple[Array, Array]:
    """Exp and its right Jacobian Jr (3, 3, ...) of rotation vectors (3, ...) in rad."""
    square = (theta * theta).sum(0)
    cosine, cubic = _turns(square)
    products = _products(theta, square)
    sine = 1 - square * cubic
    return _in_skew(theta, products, sine, cosine), _in_skew(theta, products, -cosine, cubic)


def inverse_jacobian(theta: Array) -> tuple[Array, Array, Array]:
    """Jr^-1 (3, 3, ...) of rotation vectors (3, ...) in rad, and what `curvature` gives."""
    square = (theta * theta).sum(0)
    c, slope = curvature(square)
    return _in_skew(theta, _products(theta, square), 0.5, c), c, slope


def _turns(square: Array) -> tuple[Array, Array]:
    """(1 - cos x) / x^2 and (x - sin x) / x^3, by x^2."""
    s = square
    cosine = (1 - s / 12 * (1 - s / 30 * (1 - s / 56 * (1 - s / 90 * (1 - s / 132))))) / 2
    cubic = (1 - s / 20 * (1 - s / 42 * (1 - s / 72 * (1 - s / 110 * (1 - s / 156))))) / 6
    if s.size and s.max() > SERIES:
        large = s > SERIES
        x = np.sqrt(s[large])
        cosine[large] = (1 - np.cos(x)) / s[large]
        cubic[large] = (x - np.sin(x)) / (x * s[large])
    return cosine, cubic


def curvature(square: Array) -> tuple[Array, Array]:
    """c(x) = 1/x^2 - cot(x/2) / 2x of Jr^-1 = I + T/2 + c T^2, and c'(x) / x, by x^2."""
    s = square
    c = 1 / 12 + s * (1 / 720 + s * (1 / 30240 + s * (1 / 1209600 + s / 47900160)))
    slope = 1 / 360 + s * (1 / 7560 + s * (1 / 201600 + s / 5987520))
    if s.size and s.max() > SERIES:
        large = s > SERIES
        x = np.sqrt(s[large])
        tan = np.tan(x / 2)
        c[large] = 1 / x**2 - 1 / (2 * x * tan)
        slope[large] = (-2 / x**3 + 1 / (2 * x**2 * tan) + 1 / (4 * x * np.sin(x / 2) ** 2)) / x
    return c, slope


def _products(theta: Array, square: Array) -> list[list[Array]]:
    """Entries of skew(theta)^2 = theta theta' - |theta|^2 I."""
    x, y, z = theta
    xy, xz, yz = x * y, x * z, y * z
    return [[x * x - square, xy, xz], [xy, y * y - square, yz], [xz, yz, z * z - square]]


def _in_skew(theta: Array, products: list[list[Array]], a: Array | float, b: Array) -> Array:
    """I + a T + b T^2 (3, 3, ...) of T = skew(theta), by the entries of T^2."""
    x, y, z = a * theta
    result = np.empty((3, *theta.shape))
    for i, j, turn in ((0, 1, z), (1, 2, x), (2, 0, y)):
        even = b * products[i][j]
        np.subtract(even, turn, out=result[i, j])
        np.add(even, turn, out=result[j, i])
        np.add(b * products[i][i], 1, out=result[i, i])
    return result
