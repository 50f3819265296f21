"""Normal equations of a chain, kept and factorised as LAPACK keeps banded matrices.

A chain of n blocks of d unknowns, each tied to the next one only, has a symmetric matrix whose
lower half lies within a band of 2 d. One banded Cholesky solves for all unknowns of an hour's drive
in a fraction of a second, and the blocks of the inverse follow from the factor. The k unknowns that
all blocks share stand in a border, [[H, B], [B', C]], and are solved for by its Schur complement.
"""

from functools import cache
from importlib.machinery import PathFinder
from importlib.util import module_from_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgloc.measurements import Array

BLOCKS_AT_ONCE = 512
"""The inverse is taken in portions of so many blocks, which fit the processor's cache."""
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

    def factor(self, damping: Vector | None = None) -> "BorderedFactor":
        """The Cholesky factor, with a damping (d,) and (k,) on the diagonal, in the place of H.

        Raises NotPositiveError.
        """
        corner = self.corner
        if damping is not None:
            self.columns[:, :, 0] += damping.blocks
            corner = corner + np.diag(damping.border)
        return BorderedFactor(Factor(self.columns), self.border, corner)


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

    @property
    def log_determinant(self) -> float:
        """Natural logarithm of the determinant of [[H, B], [B', C]]."""
        return self._factor.log_determinant - float(np.linalg.slogdet(self.cov_border)[1])

    def inverse_blocks(self, keep: NDArray[np.int64]) -> Array:
        """Rows and columns `keep` (q,) of the n diagonal blocks of the inverse, (n, q, q)."""
        own = self._factor.inverse_blocks(keep)
        carried = self._carried[:, keep]
        return own + carried @ self.cov_border @ carried.swapaxes(-1, -2)

    def inverse_border(self, keep: NDArray[np.int64]) -> Array:
        """Rows `keep` (q,) of every block of the inverse, in the border's columns: (n, q, k)."""
        return -self._carried[:, keep] @ self.cov_border


class Factor:
    """The Cholesky factor L of a band, in the place of H."""

    def __init__(self, columns: Array) -> None:
        n, d, width = columns.shape
        band, failed = _lapack().dpbtrf(columns.reshape(n * d, width).T, lower=1, overwrite_ab=1)
        if failed:
            raise NotPositiveError(failed - 1)
        self._columns = band.T.reshape(n, d, width)

    @property
    def log_determinant(self) -> float:
        """Natural logarithm of the determinant of H."""
        return 2 * float(np.log(self._columns[:, :, 0]).sum())

    def solve(self, right: Array) -> Array:
        """X (n, d, k) of H X = right (n, d, k)."""
        n, d, width = self._columns.shape
        columns = right.reshape(n * d, -1)
        x, _ = _lapack().dpbtrs(self._columns.reshape(n * d, width).T, columns, lower=1)
        return np.asarray(x).reshape(right.shape)

    def inverse_blocks(self, keep: NDArray[np.int64]) -> Array:
        """Rows and columns `keep` (q,) of the n diagonal blocks of H^-1, (n, q, q).

        S_j = L_jj^-T (I + L_j+1,j' S_j+1 L_j+1,j) L_jj^-1 from the last block back (the selected
        inverse of Takahashi et al. 1973). The blocks of a portion are cut into runs, which are
        gone through side by side: first as if nothing came after a run, and with the product of
        all L_k+1,k L_kk^-1 from each block to the run's end; that brings in, run by run from the
        last, what comes after.
        """
        n, d, _ = self._columns.shape
        out = np.empty((n, len(keep), len(keep)))
        after = np.zeros((d, d))
        for stop in range(n, 0, -BLOCKS_AT_ONCE):
            rows = slice(max(stop - BLOCKS_AT_ONCE, 0), stop)
            S, C = self._steps(rows)
            for run in reversed(range(len(S))):
                S[run] += C[run].swapaxes(-1, -2) @ after @ C[run]
                after = S[run, 0]
            blocks = S.reshape(-1, d, d)[rows.start - rows.stop :]
            out[rows] = blocks[:, keep[:, None], keep]
        return out

    def _steps(self, rows: slice) -> tuple[Array, Array]:
        """Of blocks in runs (runs, length, d, d), as if the last of each were the last of all:
        their S, and by what the S of the first block after the run comes in. Where the number does
        not divide, blocks that change nothing stand before the first."""
        L = _unfolded(self._columns[rows])
        m, d = len(L), L.shape[-1]
        length = max(int(np.sqrt(m)), 1)
        runs = -(-m // length)
        S, C = np.zeros((runs, length, d, d)), np.zeros((runs, length, d, d))
        C[:] = np.eye(d)
        inverse = _inverse_of_lower(L[:, :d])
        S.reshape(-1, d, d)[-m:] = np.ascontiguousarray(inverse.swapaxes(-1, -2)) @ inverse
        C.reshape(-1, d, d)[-m:] = L[:, d:] @ inverse
        for k in reversed(range(length - 1)):
            S[:, k] += C[:, k].swapaxes(-1, -2) @ S[:, k + 1] @ C[:, k]
            C[:, k] = C[:, k + 1] @ C[:, k]
        return S, C


@cache
def _lapack() -> Any:
    """scipy's LAPACK by itself: all of scipy.linalg takes longer to import than this to run."""
    import scipy

    spec = PathFinder.find_spec("_flapack", [str(Path(scipy.__file__).parent / "linalg")])
    if spec is None or spec.loader is None:
        from scipy.linalg import lapack

        return lapack
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


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
