"""Half of a banded system, eliminated from the outermost block inward to the middle one."""

from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgloc.factors import fields
from fgloc.measurements import Array
from fgloc.parallel import portions
from fgloc.smoother import lapack

BLOCKS_AT_ONCE, RUN = 1488, 24
"""Blocks are gone through in portions of so many, which fit the processor's cache."""
Index = NDArray[np.int64] | slice


class NotPositiveError(Exception):
    """The matrix is not positive definite; `unknown` is the first that nothing holds."""

    def __init__(self, unknown: int) -> None:
        super().__init__(f"unknown {unknown} is not held")
        self.unknown = unknown


class Half:
    """The rows of H of some blocks of d unknowns each, from the outermost one inward to the middle
    one, of which the other half has a share too; and then their Cholesky factor L.

    `panels[i, c, r]` is H between unknown c of the i-th block and unknown r of it and, from d on,
    of the next one inward. With d places left free after each panel its rows lie so that LAPACK
    reads the same memory as a band: row c of the panel from its diagonal on, then zeros where the
    next row's upper triangle stands.
    """

    def __init__(self, blocks: range, d: int) -> None:
        n = len(blocks)
        self.blocks, self._columns = blocks, np.zeros((n * d, 2 * d + 1))
        self.panels = self._columns.reshape(n, -1)[:, : 2 * d * d].reshape(n, d, 2 * d)
        self._outermost = n  # nothing has been added to the panels before this one

    def clear(self) -> None:
        """Take out all that was added, in the same memory."""
        self._columns.fill(0)
        self._outermost = len(self.panels)

    @property
    def diagonal(self) -> Array:
        """That of H (n, d)."""
        return self._columns[:, 0].reshape(self.panels.shape[:2])

    @property
    def outer(self) -> slice:
        """Where in all blocks those stand that come before the middle one, in their order."""
        return slice(self.blocks[0], self.blocks[-1], self.blocks.step)

    @property
    def _backward(self) -> bool:
        """Whether the next block inward is the one before, not the one after."""
        return self.blocks.step < 0

    def add(self, blocks: NDArray[np.int64], at: NDArray[np.int64], J: Array) -> None:
        """Add the curvature J' J of M terms with J (M, m, q or more): see `Band.add`."""
        d = self.panels.shape[1]
        outer = int(self._backward and at.max(initial=0) >= d)
        panels, spans, untouched = self._touch(blocks, outer)
        for piece, squares in _products(tuple(at.tolist()), d, self._backward):
            back = J[:, :, piece.columns].swapaxes(-1, -2)
            if squares[0][0] == piece.columns:  # numpy takes long for a matrix times itself
                back = J[:, :, piece.columns].copy().swapaxes(-1, -2)
            for columns, rows in squares:
                place = spans[piece.block], piece.unknowns, rows
                if untouched and piece.block == outer:  # what is all zeros need not be read
                    np.matmul(back, J[:, :, columns], out=panels[place])
                else:
                    panels[place] += back @ J[:, :, columns]

    def add_steps(
        self, blocks: NDArray[np.int64], at: NDArray[np.int64], phi: Array, weight: Array
    ) -> None:
        """Add the curvature of M steps with phi (M, 1) and weights (M, q): see `Band.add_steps`."""
        outer = int(self._backward)
        panels, spans, _ = self._touch(blocks, outer)
        across = self.panels.shape[1] + at
        for block, rows, value in (
            (0, at, phi**2 * weight), (outer, across, -phi * weight), (1, at, weight),
        ):  # fmt: skip
            for k in range(len(at)):
                panels[spans[block], at[k], rows[k]] += value[:, k]

    def _touch(
        self, blocks: NDArray[np.int64], outer: int
    ) -> tuple[Array, tuple[Index, Index], bool]:
        """Note that something is added to the panels of each of some blocks or, if `outer`, of the
        one after it, and to the next one inward. The panels by increasing block; where in them
        these blocks are, and those after each; and whether they follow each other and nothing was
        added to them yet: so it is from the middle outward."""
        at = blocks - min(self.blocks[0], self.blocks[-1])
        spans = span(at), span(at + 1)
        first, last = int(at[0]) + outer, int(at[-1]) + outer
        if self._backward:
            first, last = len(self.panels) - 1 - last, len(self.panels) - 1 - first
        untouched = isinstance(spans[0], slice) and last < self._outermost
        self._outermost = min(self._outermost, first)
        return self.panels[:: self.blocks.step], spans, untouched

    def join(self, part: "Half") -> None:
        """Note what was added by somebody else with the same memory."""
        self._outermost = min(self._outermost, part._outermost)

    def eliminate(self) -> Array:
        """Put L in the place of H for all blocks but the middle one; what is left of that (d, d),
        in the lower triangle. Raises NotPositiveError."""
        n, d = self.panels.shape[:2]
        for rows in portions(n, BLOCKS_AT_ONCE):
            for c in range(1, d):
                self.panels[rows, c, :c] = 0
        middle = self.panels[-1, :, :d].T
        if n == 1:
            return middle
        if failed := lapack.factorize(self._columns[:-d], 2 * d - 1):
            i, unknown = divmod(failed - 1, d)
            raise NotPositiveError(self.blocks[i] * d + unknown)
        last = self.panels[-2]
        last[:, d:] = np.linalg.solve(last[:, :d].T, last[:, d:])
        return middle - last[:, d:].T @ last[:, d:]

    @property
    def log_determinant(self) -> float:
        """Natural logarithm of the determinant of L."""
        return float(np.log(self.diagonal[:-1]).sum())

    def forward(self, right: Array) -> tuple[Array, Array]:
        """y of L y = right for right (n - 1, d, k), as columns (k, (n - 1) d), and what it takes
        away from the right of the middle block (d, k)."""
        d, k = right.shape[1:]
        y = np.array(right.reshape(-1, k).T, order="C")
        if not y.size:
            return y, np.zeros((d, k))
        lapack.substitute(self._columns[:-d], 2 * d - 1, y)
        return y, self.panels[-2, :, d:].T @ y[:, -d:].T

    def backward(self, y: Array, middle: Array) -> Array:
        """x (n - 1, d, k) of L' x = y for what `forward` gives, which it overwrites, and the middle
        block's x (d, k)."""
        d, k = middle.shape
        if y.size:
            y[:, -d:] -= (self.panels[-2, :, d:] @ middle).T
            lapack.substitute(self._columns[:-d], 2 * d - 1, y, transposed=True)
        return y.T.reshape(-1, d, k)

    def inverse_blocks(self, out: Array, keep: NDArray[np.int64], middle: Array) -> None:
        """Write rows and columns `keep` (q,) of the diagonal blocks of the inverse into `out`
        (n - 1, q, q), given the middle one (d, d).

        S_i = L_ii^-T (I + L_i+1,i' S_i+1 L_i+1,i) L_ii^-1 from the middle outward (the selected
        inverse of Takahashi et al. 1973). The blocks of a portion are cut into runs, which are
        gone through side by side: first as if nothing came after a run, and with the product of
        all L_k+1,k L_kk^-1 from each block to the run's end; that brings in, run by run from the
        last, what comes after.
        """
        after = middle
        for stop in range(len(out), 0, -BLOCKS_AT_ONCE):
            rows = slice(max(stop - BLOCKS_AT_ONCE, 0), stop)
            S, C = self._steps(rows)
            follows = np.empty((len(S), *middle.shape))
            for run in reversed(range(len(S))):
                follows[run] = after
                after = S[run, 0] + C[run, 0].T @ after @ C[run, 0]
            C = np.ascontiguousarray(C[..., keep])
            brought = (C.swapaxes(-1, -2) @ follows[:, None] @ C).reshape(-1, *out.shape[1:])
            own = slice(rows.start - rows.stop, None)
            out[rows] = square(S.reshape(-1, *middle.shape)[own], keep) + brought[own]

    def _steps(self, rows: slice) -> tuple[Array, Array]:
        """Of blocks in runs (runs, length, d, d), as if the last of each were the last of all:
        their S, and by what the S of the first block after the run comes in. Where the number does
        not divide, blocks that change nothing stand before the first."""
        L = self.panels[rows].swapaxes(-1, -2)
        m, d = len(L), L.shape[-1]
        length = min(m, RUN)
        runs = -(-m // length)
        S, C = np.empty((runs, length, d, d)), np.empty((runs, length, d, d))
        flat_S, flat_C, padding = S.reshape(-1, d, d), C.reshape(-1, d, d), runs * length - m
        flat_S[:padding], flat_C[:padding] = 0, np.eye(d)
        inverse = np.ascontiguousarray(fields.rows(fields.inverse_of_lower(fields.of(L[:, :d]))))
        # A stack of its own: see `Half.add`.
        back = np.ascontiguousarray(inverse.swapaxes(-1, -2))
        np.matmul(back, inverse, out=flat_S[padding:])
        np.matmul(L[:, d:], inverse, out=flat_C[padding:])
        for k in reversed(range(length - 1)):
            S[:, k] += C[:, k].swapaxes(-1, -2) @ S[:, k + 1] @ C[:, k]
            C[:, k] = C[:, k + 1] @ C[:, k]
        return S, C


class Piece(NamedTuple):
    """A run of a term's unknowns that follow each other within one block: which of its columns they
    are, whether they are of the term's block (0) or the next (1), and which unknowns of it."""

    columns: slice
    block: int
    unknowns: slice


@cache
def pieces(at: tuple[int, ...], d: int) -> list[Piece]:
    """How the unknowns `at`, counted from the start of a block of d, lie in it and the next."""
    breaks = [i for i in range(1, len(at)) if at[i] != at[i - 1] + 1 or at[i] == d]
    found = []
    for i, j in pairwise([0, *breaks, len(at)] if at else []):
        block, first = divmod(at[i], d)
        found.append(Piece(slice(i, j), block, slice(first, first + j - i)))
    return found


@cache
def _products(
    at: tuple[int, ...], d: int, backward: bool
) -> list[tuple[Piece, list[tuple[slice, slice]]]]:
    """By which of a term's columns those of each piece are multiplied, and the rows of its panel
    where they belong: by its own, and by those of all pieces further inward."""
    inward = sorted(pieces(at, d), key=lambda piece: piece.block, reverse=backward)
    found = []
    for i, piece in enumerate(inward):
        squares: list[tuple[slice, slice]] = []
        for columns, block, unknowns in inward[i:]:
            shift = 0 if block == piece.block else d
            rows = slice(shift + unknowns.start, shift + unknowns.stop)
            follows = squares and columns.start == squares[-1][0].stop
            if follows and rows.start == squares[-1][1].stop:  # one product for both
                before, above = squares.pop()
                columns, rows = slice(before.start, columns.stop), slice(above.start, rows.stop)
            squares.append((columns, rows))
        found.append((piece, squares))
    return found


def square(blocks: Array, keep: NDArray[np.int64]) -> Array:
    """Rows and columns `keep` (q,), increasing, of matrices (n, d, d)."""
    own = span(keep)
    return blocks[:, own, own] if isinstance(own, slice) else blocks[:, keep[:, None], keep]


def span(index: NDArray[np.int64]) -> Index:
    """An increasing index (n >= 1,), as a slice where it can be one: that is much quicker."""
    first, last = int(index[0]), int(index[-1])
    return slice(first, last + 1) if last - first == len(index) - 1 else index
