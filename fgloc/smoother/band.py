"""Normal equations of a chain, kept and factorised as LAPACK keeps banded matrices.

A chain of n blocks of d unknowns, each tied to the next one only, has a symmetric matrix whose
lower half lies within a band of 2 d. One banded Cholesky solves for all unknowns of an hour's drive
in a fraction of a second, and the blocks of the inverse follow from the factor. The k unknowns that
all blocks share stand in a border, [[H, B], [B', C]], and are solved for by its Schur complement.
"""

from collections.abc import Callable
from copy import copy
from functools import cache
from importlib.machinery import PathFinder
from importlib.util import module_from_spec
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgloc.factors import fields
from fgloc.measurements import Array
from fgloc.parallel import each, portions

BLOCKS_AT_ONCE, PORTIONS_AT_ONCE, RUN = 1488, 4, 24
"""The inverse is taken in portions of so many blocks, which fit the processor's cache, and of these
so many side by side."""
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

    `panels[j, c, r]` is H between unknown c of block j and unknown r of the blocks j and j + 1.
    With d places left free after each panel its rows lie so that LAPACK reads the same memory as a
    band: row c of the panel from its diagonal on, then zeros where the next row's upper triangle
    stands.
    """

    def __init__(self, n: int, d: int, k: int = 0) -> None:
        self._columns = np.zeros((n * d, 2 * d + 1))
        self.panels = _panels(self._columns, n)
        self.border, self.corner = np.zeros((n, d, k)), np.zeros((k, k))
        self.gradient = Vector(np.zeros((n, d)), np.zeros(k))
        self._lowest = n  # nothing has been added to the blocks before this one

    def add(
        self, blocks: NDArray[np.int64], at: NDArray[np.int64], J: Array, gradient: Array
    ) -> None:
        """Add M terms: one for each of some blocks (increasing, none twice).

        J (M, m, q) is what the curvature is the square of, and gradient is (M, q), of the unknowns
        `at` (up to q,), increasing; they are counted from the start of the block, and on into the
        next block from d on. If q is more, the rest are the border's k.
        """
        d, m = self.gradient.blocks.shape[1], len(at)
        here, after = _span(blocks), _span(blocks + 1)
        untouched = self._touched(blocks)
        for own, first, squares in _pieces(tuple(at.tolist()), d):
            rows = here if first < d else after
            place = slice(first % d, first % d + own.stop - own.start)
            back = J[:, :, own].swapaxes(-1, -2)
            if squares[0][0] == own:  # numpy takes much longer for a matrix times itself
                back = J[:, :, own].copy().swapaxes(-1, -2)
            for other, further in squares:
                if untouched and first < d:  # what is all zeros need not be read
                    np.matmul(back, J[:, :, other], out=self.panels[rows, place, further])
                else:
                    self.panels[rows, place, further] += back @ J[:, :, other]
            self.gradient.blocks[rows, place] += gradient[:, own]
            if m < J.shape[2]:
                self.border[rows, place] += back @ J[:, :, m:]
        if m < J.shape[2]:
            self.corner += (J[:, :, m:].swapaxes(-1, -2) @ J[:, :, m:]).sum(0)
            self.gradient.border[:] += gradient[:, m:].sum(0)

    def add_steps(
        self, blocks: NDArray[np.int64], at: NDArray[np.int64], phi: Array, error: Array,
        sigma: Array,
    ) -> None:  # fmt: skip
        """Add M steps x_j+1 - phi x_j = error of the unknowns `at` (q,) from some blocks j to the
        next, each with a phi (M,) and sigmas (M, q): what `add` would, from diagonals alone."""
        self._touched(blocks)
        d, weight = self.gradient.blocks.shape[1], sigma**-2
        here, after, phi = _span(blocks), _span(blocks + 1), phi[:, None]
        for rows, place, value in (
            (here, at, phi**2 * weight), (here, d + at, -phi * weight), (after, at, weight),
        ):  # fmt: skip
            for k in range(len(at)):
                self.panels[rows, at[k], place[k]] += value[:, k]
        self.gradient.blocks[here, _span(at)] -= phi * weight * error
        self.gradient.blocks[after, _span(at)] += weight * error

    def _touched(self, blocks: NDArray[np.int64]) -> bool:
        """Note that something is added to some blocks and those after each; whether they follow
        each other, and nothing was added to them yet: so it is from the last portion back."""
        before, self._lowest = self._lowest, min(self._lowest, int(blocks[0]))
        return isinstance(_span(blocks), slice) and int(blocks[-1]) < before

    def section(self) -> "Band":
        """The same memory for somebody who adds to blocks that nobody else adds to meanwhile: from
        the last of them back; `join` ends it."""
        part = copy(self)
        part.corner = np.zeros_like(self.corner)
        part.gradient = Vector(self.gradient.blocks, np.zeros_like(self.gradient.border))
        return part

    def join(self, part: "Band") -> None:
        """Take over what a section has of the border."""
        self.corner += part.corner
        self.gradient.border[:] += part.gradient.border
        self._lowest = min(self._lowest, part._lowest)

    def factor(self, damping: Vector | None = None) -> "BorderedFactor":
        """The Cholesky factor, with a damping (d,) and (k,) on the diagonal, in the place of H.

        Raises NotPositiveError.
        """
        n, d = self.gradient.blocks.shape
        corner = self.corner
        if damping is not None:
            self._columns[:, 0].reshape(n, d)[:] += damping.blocks
            corner = corner + np.diag(damping.border)

        def clear(rows: slice) -> None:
            for c in range(1, d):
                self.panels[rows, c, :c] = 0

        each(clear, portions(n, 4 * BLOCKS_AT_ONCE))
        return BorderedFactor(Factor(self._columns, n), self.border, corner)


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
        if not len(self.cov_border):
            return own
        carried = self._carried[:, keep]
        return own + carried @ self.cov_border @ carried.swapaxes(-1, -2)

    def inverse_border(self, keep: NDArray[np.int64]) -> Array:
        """Rows `keep` (q,) of every block of the inverse, in the border's columns: (n, q, k)."""
        return -self._carried[:, keep] @ self.cov_border


class Factor:
    """The Cholesky factor L of a band of n blocks, in the place of H."""

    def __init__(self, columns: Array, n: int) -> None:
        band, failed = _lapack().dpbtrf(columns.T, lower=1, overwrite_ab=1)
        if failed:
            raise NotPositiveError(failed - 1)
        self._columns = band.T
        self._panels = _panels(self._columns, n)

    @property
    def log_determinant(self) -> float:
        """Natural logarithm of the determinant of H."""
        return 2 * float(np.log(self._columns[:, 0]).sum())

    def solve(self, right: Array) -> Array:
        """X (n, d, k) of H X = right (n, d, k)."""
        columns = right.reshape(len(self._columns), -1)
        x, _ = _lapack().dpbtrs(self._columns.T, columns, lower=1)
        return np.asarray(x).reshape(right.shape)

    def inverse_blocks(self, keep: NDArray[np.int64]) -> Array:
        """Rows and columns `keep` (q,) of the n diagonal blocks of H^-1, (n, q, q).

        S_j = L_jj^-T (I + L_j+1,j' S_j+1 L_j+1,j) L_jj^-1 from the last block back (the selected
        inverse of Takahashi et al. 1973). The blocks of a portion are cut into runs, which are
        gone through side by side: first as if nothing came after a run, and with the product of
        all L_k+1,k L_kk^-1 from each block to the run's end; that brings in, run by run from the
        last, what comes after.
        """
        n, d, _ = self._panels.shape
        out = np.empty((n, len(keep), len(keep)))
        after = np.zeros((d, d))
        portions = [slice(max(stop - BLOCKS_AT_ONCE, 0), stop)
                    for stop in range(n, 0, -BLOCKS_AT_ONCE)]  # fmt: skip
        for k in range(0, len(portions), PORTIONS_AT_ONCE):
            some = portions[k : k + PORTIONS_AT_ONCE]
            parts = []
            for rows, (S, C) in zip(some, each(self._steps, some), strict=True):
                follows = np.empty((len(S), d, d))
                for run in reversed(range(len(S))):
                    follows[run] = after
                    after = S[run, 0] + C[run, 0].T @ after @ C[run, 0]
                parts.append((rows, S, C, follows))
            each(lambda part: _bring_in(out, keep, *part), parts)
        return out

    def _steps(self, rows: slice) -> tuple[Array, Array]:
        """Of blocks in runs (runs, length, d, d), as if the last of each were the last of all:
        their S, and by what the S of the first block after the run comes in. Where the number does
        not divide, blocks that change nothing stand before the first."""
        L = self._panels[rows].swapaxes(-1, -2)
        m, d = len(L), L.shape[-1]
        length = min(m, RUN)
        runs = -(-m // length)
        S, C = np.empty((runs, length, d, d)), np.empty((runs, length, d, d))
        flat_S, flat_C, padding = S.reshape(-1, d, d), C.reshape(-1, d, d), runs * length - m
        flat_S[:padding], flat_C[:padding] = 0, np.eye(d)
        inverse = np.ascontiguousarray(fields.rows(fields.inverse_of_lower(fields.of(L[:, :d]))))
        # A stack of its own: see `Band.add`.
        back = np.ascontiguousarray(inverse.swapaxes(-1, -2))
        np.matmul(back, inverse, out=flat_S[padding:])
        np.matmul(L[:, d:], inverse, out=flat_C[padding:])
        for k in reversed(range(length - 1)):
            S[:, k] += C[:, k].swapaxes(-1, -2) @ S[:, k + 1] @ C[:, k]
            C[:, k] = C[:, k + 1] @ C[:, k]
        return S, C


def _bring_in(
    out: Array, keep: NDArray[np.int64], rows: slice, S: Array, C: Array, after: Array
) -> None:
    """Write blocks of the inverse: what `Factor._steps` gives, with what comes after each run."""
    C = np.ascontiguousarray(C[..., keep])
    brought = (C.swapaxes(-1, -2) @ after[:, None] @ C).reshape(-1, *out.shape[1:])
    blocks = slice(rows.start - rows.stop, None)
    out[rows] = square(S.reshape(-1, *S.shape[-2:])[blocks], keep) + brought[blocks]


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


def _panels(columns: Array, n: int) -> Array:
    """The panels (n, d, 2 d) in the memory of a band's columns; see `Band`."""
    d = len(columns) // n
    return columns.reshape(n, -1)[:, : 2 * d * d].reshape(n, d, 2 * d)


@cache
def _pieces(at: tuple[int, ...], d: int) -> list[tuple[slice, int, list[tuple[slice, slice]]]]:
    """How the unknowns `at` lie in panels: of each run of one block where it stands in `at`, its
    first unknown, and of every run from there on where it stands in `at` and in the rows of the
    panel."""
    pieces = []
    for own in _runs(at, lambda i: at[i] == d):
        first = at[own.start]
        block = first - first % d
        following = _runs(at[own.start :], lambda i: False)
        squares = [
            (slice(own.start + run.start, own.start + run.stop),
             slice(at[own.start + run.start] - block, at[own.start + run.stop - 1] + 1 - block))
            for run in following
        ]  # fmt: skip
        pieces.append((own, first, squares))
    return pieces


def _runs(at: tuple[int, ...], cut: Callable[[int], bool]) -> list[slice]:
    """Where unknowns follow each other without a gap and without a cut before one."""
    ends = [i for i in range(1, len(at)) if at[i] != at[i - 1] + 1 or cut(i)]
    return [slice(i, j) for i, j in pairwise([0, *ends, len(at)] if at else [])]


def square(blocks: Array, keep: NDArray[np.int64]) -> Array:
    """Rows and columns `keep` (q,), increasing, of matrices (n, d, d)."""
    own = _span(keep)
    return blocks[:, own, own] if isinstance(own, slice) else blocks[:, keep[:, None], keep]


def _span(index: NDArray[np.int64]) -> Index:
    """An increasing index (n >= 1,), as a slice where it can be one: that is much quicker."""
    first, last = int(index[0]), int(index[-1])
    return slice(first, last + 1) if last - first == len(index) - 1 else index
