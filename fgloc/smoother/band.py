"""Normal equations of a chain, kept and factorised as LAPACK keeps banded matrices.

A chain of n blocks of d unknowns, each tied to the next one only, has a symmetric matrix whose
lower half lies within a band of 2 d. One banded Cholesky solves for all unknowns of an hour's drive
in a fraction of a second, and the blocks of the inverse follow from the factor. The k unknowns that
all blocks share stand in a border, [[H, B], [B', C]], and are solved for by its Schur complement.
"""

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgloc.measurements import Array

BLOCKS_AT_ONCE = 4096
"""The inverse is taken in portions of so many blocks, which bounds the memory."""
AT_A_TIME = 4
"""Blocks that numpy factorises in one call: fewer and the calls cost more than the arithmetic."""
MANY_BLOCKS = 2000
"""From here on LAPACK pays: a step through numpy for each block costs less than importing scipy, up
to about this many."""


Index = NDArray[np.int64] | slice


class NotPositiveError(Exception):
    """The matrix is not positive definite; `unknown` is the first that nothing holds."""

    def __init__(self, unknown: int) -> None:
        super().__init__(f"unknown {unknown} is not held")
        self.unknown = unknown


class Vector(NamedTuple):
    """Of all unknowns: those of the blocks (n, d) and those of the border (k,)."""

    blocks: Array
    border: Array

    def dot(self, other: "Vector") -> float:
        """The inner product."""
        return float((self.blocks * other.blocks).sum() + self.border @ other.border)


class Band:
    """Normal equations of n blocks of d unknowns and a border of k: terms are added, then solved.

    `columns[j, c, i]` is H between unknown c of block j and the unknown i places after it.
    """

    def __init__(self, n: int, d: int, k: int = 0) -> None:
        self.columns = np.zeros((n, d, 2 * d))
        self.border, self.corner = np.zeros((n, d, k)), np.zeros((k, k))
        self.gradient = Vector(np.zeros((n, d)), np.zeros(k))

    def add(
        self, blocks: NDArray[np.int64], at: NDArray[np.int64], curvature: Array, gradient: Array
    ) -> None:
        """Add M terms: one for each of some blocks (increasing, none twice).

        curvature is (M, q, q) and gradient (M, q), of the unknowns `at` (up to q,), increasing;
        they are counted from the start of the block, and on into the next block from d on. If q is
        more, the rest are the border's k.
        """
        d, m = self.columns.shape[1], len(at)
        here, after = _span(blocks), _span(blocks + 1)
        for c, unknown in enumerate(at.tolist()):
            rows, place = (here, unknown) if unknown < d else (after, unknown - d)
            further = _span(at[c:] - unknown)
            target = self.columns[:, place]
            target[_both(rows, further)] += curvature[:, c, c:m]
            self.gradient.blocks[rows, place] += gradient[:, c]
            self.border[rows, place] += curvature[:, c, m:] if m < curvature.shape[1] else 0.0
        self.corner += curvature[:, m:, m:].sum(0) if m < curvature.shape[1] else 0.0
        self.gradient.border[:] += gradient[:, m:].sum(0) if m < curvature.shape[1] else 0.0

    def factor(self, damping: Vector | None = None, *, often: bool = False) -> "BorderedFactor":
        """The Cholesky factor, with a damping (d,) and (k,) on the diagonal; H may be overwritten.

        `often` says that many are to come, which is worth importing scipy for. Raises
        NotPositiveError.
        """
        corner = self.corner
        if damping is not None:
            self.columns[:, :, 0] += damping.blocks
            corner = corner + np.diag(damping.border)
        few = len(self.columns) < MANY_BLOCKS and not often
        return BorderedFactor((_Blocks if few else _Lapack)(self.columns), self.border, corner)


class BorderedFactor:
    """The factor of a band and the Schur complement of its border."""

    def __init__(self, factor: "Factor", border: Array, corner: Array) -> None:
        self._factor, self._border = factor, border
        n, d, k = border.shape
        self._carried = factor.solve(border) if k else border
        schur = corner - np.tensordot(border, self._carried, ((0, 1), (0, 1)))
        try:
            np.linalg.cholesky(schur)
        except np.linalg.LinAlgError as err:
            raise NotPositiveError(n * d) from err
        self.cov_border = np.linalg.inv(schur)

    def solve(self, right: Vector) -> Vector:
        """x of [[H, B], [B', C]] x = right."""
        x = self._factor.solve(right.blocks[..., None])[..., 0]
        y = self.cov_border @ (right.border - np.tensordot(self._border, x, ((0, 1), (0, 1))))
        return Vector(x - self._carried @ y, y)

    def inverse_blocks(self, keep: NDArray[np.int64]) -> Array:
        """Rows and columns `keep` (q,) of the n diagonal blocks of the inverse, (n, q, q)."""
        own = self._factor.inverse_blocks(len(self._border), keep)
        carried = self._carried[:, keep]
        return own + carried @ self.cov_border @ carried.swapaxes(-1, -2)

    def inverse_border(self, keep: NDArray[np.int64]) -> Array:
        """Rows `keep` (q,) of every block of the inverse, in the border's columns: (n, q, k)."""
        return -self._carried[:, keep] @ self.cov_border


class Factor(ABC):
    """The Cholesky factor L of a band."""

    @abstractmethod
    def solve(self, right: Array) -> Array:
        """X (n, d, k) of H X = right (n, d, k)."""

    @abstractmethod
    def blocks(self, rows: slice) -> tuple[Array, Array]:
        """The inverses of L_jj and the L_j+1,j of some blocks, both (m, d, d)."""

    def inverse_blocks(self, n: int, keep: NDArray[np.int64]) -> Array:
        """Rows and columns `keep` (q,) of the n diagonal blocks of H^-1, (n, q, q).

        S_j = L_jj^-T (I + L_j+1,j' S_j+1 L_j+1,j) L_jj^-1 from the last block back (the selected
        inverse of Takahashi et al. 1973).
        """
        out = np.empty((n, len(keep), len(keep)))
        last: Array | None = None
        for stop in range(n, 0, -BLOCKS_AT_ONCE):
            rows = slice(max(stop - BLOCKS_AT_ONCE, 0), stop)
            inverse, across = self.blocks(rows)
            own = inverse.swapaxes(-1, -2) @ inverse
            carried = across @ inverse
            for j in reversed(range(len(own))):
                if last is not None:
                    C = carried[j]
                    own[j] += C.T @ last @ C
                last = own[j]
            out[rows] = own[:, keep[:, None], keep]
        return out


class _Lapack(Factor):
    """By LAPACK's banded Cholesky, in the place of H."""

    def __init__(self, columns: Array) -> None:
        from scipy.linalg import lapack

        n, d, width = columns.shape
        band, failed = lapack.dpbtrf(columns.reshape(n * d, width).T, lower=1, overwrite_ab=1)
        if failed:
            raise NotPositiveError(failed - 1)
        self.columns = band.T.reshape(n, d, width)

    def solve(self, right: Array) -> Array:
        from scipy.linalg import lapack

        n, d, width = self.columns.shape
        columns = right.reshape(n * d, -1)
        x, _ = lapack.dpbtrs(self.columns.reshape(n * d, width).T, columns, lower=1)
        return x.reshape(right.shape)

    def blocks(self, rows: slice) -> tuple[Array, Array]:
        L = _unfolded(self.columns[rows])
        d = L.shape[-1]
        return _inverse_of_lower(L[:, :d]), L[:, d:]


class _Blocks(Factor):
    """A few blocks at a time in numpy, each time with the next one, which takes what they leave."""

    def __init__(self, columns: Array) -> None:
        H = _unfolded(columns)
        n, d = len(H), H.shape[-1]
        m = -(-n // AT_A_TIME)
        windows = _windows(H, m)
        L = np.empty_like(windows)
        for c in range(m):
            try:
                L[c] = np.linalg.cholesky(windows[c])
            except np.linalg.LinAlgError as err:
                raise NotPositiveError(c * AT_A_TIME * d + _first_unheld(windows[c])) from err
            if c + 1 < m:
                left = L[c, -d:, -d:]
                windows[c + 1, :d, :d] = left @ left.T
        at = [slice(i * d, (i + 1) * d) for i in range(AT_A_TIME + 1)]
        own = np.stack([L[:, at[i], at[i]] for i in range(AT_A_TIME)], 1)
        across = np.stack([L[:, at[i + 1], at[i]] for i in range(AT_A_TIME)], 1)
        self._inverse = _inverse_of_lower(own.reshape(-1, d, d)[:n])
        self._across = across.reshape(-1, d, d)[:n]

    def solve(self, right: Array) -> Array:
        y = np.empty_like(right)
        carried: Array | float = 0.0
        for j in range(len(y)):
            y[j] = self._inverse[j] @ (right[j] - carried)
            carried = self._across[j] @ y[j]
        carried = 0.0
        for j in reversed(range(len(y))):
            y[j] = self._inverse[j].T @ (y[j] - carried)
            carried = self._across[j - 1].T @ y[j]
        return y

    def blocks(self, rows: slice) -> tuple[Array, Array]:
        return self._inverse[rows], self._across[rows]


def _windows(H: Array, m: int) -> Array:
    """m dense matrices of `AT_A_TIME` + 1 blocks each from those of `_unfolded`, the last of one
    being the first of the next; what lies beyond the end is the unit matrix."""
    n, width, d = H.shape
    padded = np.zeros((m * AT_A_TIME + 1, width, d))
    padded[:n], padded[n:, :d] = H, np.eye(d)
    windows = np.zeros((m, (AT_A_TIME + 1) * d, (AT_A_TIME + 1) * d))
    for i in range(AT_A_TIME):
        rows, columns = slice(i * d, (i + 2) * d), slice(i * d, (i + 1) * d)
        windows[:, rows, columns] = padded[i : m * AT_A_TIME : AT_A_TIME]
    windows[:, -d:, -d:] = padded[AT_A_TIME::AT_A_TIME, :d]
    return windows


def _first_unheld(matrix: Array) -> int:
    """The first unknown of a matrix whose leading part up to it is not positive definite."""
    for i in range(len(matrix)):
        try:
            np.linalg.cholesky(matrix[: i + 1, : i + 1])
        except np.linalg.LinAlgError:
            return i
    return len(matrix) - 1


def _unfolded(columns: Array) -> Array:
    """The band's blocks in full, lower triangle and what is below it: (m, 2 d, d)."""
    m, d, width = columns.shape
    full = np.zeros((m, width, d))
    for c in range(d):
        full[:, c:, c] = columns[:, c, : width - c]
    return full


def _inverse_of_lower(L: Array) -> Array:
    """Of lower triangular matrices (m, d, d), by forward substitution along the whole stack."""
    d = L.shape[-1]
    inverse = np.zeros_like(L)
    for i in range(d):
        row = -np.matmul(L[:, i : i + 1, :i], inverse[:, :i])[:, 0]
        row[:, i] += 1
        inverse[:, i] = row / L[:, i, i, None]
    return inverse


def _span(index: NDArray[np.int64]) -> Index:
    """An increasing index (n >= 1,), as a slice where it can be one: that is much quicker."""
    first, last = int(index[0]), int(index[-1])
    return slice(first, last + 1) if last - first == len(index) - 1 else index


def _both(rows: Index, columns: Index) -> tuple[Index, Index]:
    """An index of all rows in all columns."""
    if isinstance(rows, slice) or isinstance(columns, slice):
        return rows, columns
    return rows[:, None], columns
