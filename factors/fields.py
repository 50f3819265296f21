"""Many small vectors and matrices at once, components first.

A field of vectors is an array (3, ...) and one of matrices (3, 3, ...), with a place for each time
or sample in the axes after. Numpy works through these several times faster than through stacks of
small arrays, whose components come last; `of` and `rows` turn one into the other.
"""

import numpy as np

from fgloc.measurements import Array


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
    small = square < 1e-6
    x2 = np.where(small, 1.0, square)
    x = np.sqrt(x2)
    sin, cos = np.sin(x), np.cos(x)
    sine = np.where(small, 1 - square / 6, sin / x)
    cosine = np.where(small, 0.5 - square / 24, (1 - cos) / x2)
    cubic = np.where(small, 1 / 6 - square / 120, (x - sin) / (x * x2))
    T, TT = _powers(theta, square)
    eye = _eye(square.ndim)
    return eye + sine * T + cosine * TT, eye - cosine * T + cubic * TT


def inverse_jacobian(theta: Array) -> tuple[Array, Array, Array]:
    """Jr^-1 (3, 3, ...) of rotation vectors (3, ...) in rad, and what `curvature` gives."""
    square = (theta * theta).sum(0)
    c, slope = curvature(square)
    T, TT = _powers(theta, square)
    return _eye(square.ndim) + T / 2 + c * TT, c, slope


def curvature(square: Array) -> tuple[Array, Array]:
    """c(x) = 1/x^2 - cot(x/2) / 2x of Jr^-1 = I + T/2 + c T^2, and c'(x) / x, by x^2."""
    s = square
    c = 1 / 12 + s * (1 / 720 + s * (1 / 30240 + s * (1 / 1209600 + s / 47900160)))
    slope = 1 / 360 + s * (1 / 7560 + s * (1 / 201600 + s / 5987520))
    if s.size and s.max() > 0.25:
        large = s > 0.25
        x = np.sqrt(s[large])
        tan = np.tan(x / 2)
        c[large] = 1 / x**2 - 1 / (2 * x * tan)
        slope[large] = (-2 / x**3 + 1 / (2 * x**2 * tan) + 1 / (4 * x * np.sin(x / 2) ** 2)) / x
    return c, slope


def _powers(theta: Array, square: Array) -> tuple[Array, Array]:
    """T = skew(theta) and T^2."""
    return skew(theta), theta[:, None] * theta - square * _eye(square.ndim)


def _eye(axes: int) -> Array:
    return np.eye(3).reshape(3, 3, *[1] * axes)
