"""Normal equations of a chain, kept and factorised as LAPACK keeps banded matrices.

A chain of n blocks of d unknowns, each tied to the next one only, has a symmetric matrix whose
lower half lies within a band of 2 d. A banded Cholesky solves for all unknowns of an hour's drive
in a fraction of a second, and the blocks of the inverse follow from the factor. Both go from the
two ends to the middle block or from there outward, one half beside the other. The k unknowns that
all blocks share stand in a border, [[H, B], [B', C]], and are solved for by its Schur complement.
"""

from collections.abc import Callable, Iterable
from copy import copy
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from fgloc.measurements import Array
from fgloc.parallel import each, portions
from fgloc.smoother.half import Half, NotPositiveError, pieces, span

LONG = 1000
"""From so many blocks on a band's two halves are worth a thread each."""
Made = TypeVar("Made")


class Vector(NamedTuple):
    """Of all unknowns: those of the blocks (n, d) and those of the border (k,)."""

    blocks: Array
    border: Array

    def dot(self, other: "Vector") -> float:
        """The inner product."""
        return float((self.blocks * other.blocks).sum() + self.border @ other.border)


class Band:
    """Normal equations of n blocks of d unknowns and a border of k, to which terms are added."""

    def __init__(self, n: int, d: int, k: int = 0) -> None:
        self._middle = n // 2
        self.halves = Half(range(self._middle + 1), d), Half(range(n - 1, self._middle - 1, -1), d)
        self.border, self.corner = np.zeros((n, d, k)), np.zeros((k, k))
        self.gradient = Vector(np.zeros((n, d)), np.zeros(k))

    def clear(self) -> None:
        """Take out all terms. A factor in this band's place is lost, and its memory is used again:
        the system takes longer to provide as much anew than the terms to be added."""
        _both(Half.clear, self.halves)
        for values in (self.border, self.corner, *self.gradient):
            values.fill(0)

    def add(
        self, blocks: NDArray[np.int64], at: NDArray[np.int64], J: Array, gradient: Array
    ) -> None:
        """Add M terms: one for each of some blocks (increasing, none twice).

        J (M, m, q) is what the curvature is the square of, and gradient is (M, q), of the unknowns
        `at` (up to q,), increasing; they are counted from the start of the block, and on into the
        next block from d on. If q is more, the rest are the border's k.
        """
        for half, rows in self._split(blocks):
            half.add(blocks[rows], at, J[rows])
        spans, own = (span(blocks), span(blocks + 1)), len(at)
        J_border = J[:, :, own:]
        for piece in pieces(tuple(at.tolist()), self.gradient.blocks.shape[1]):
            place = spans[piece.block], piece.unknowns
            self.gradient.blocks[place] += gradient[:, piece.columns]
            if own < J.shape[2]:
                self.border[place] += J[:, :, piece.columns].swapaxes(-1, -2) @ J_border
        if own < J.shape[2]:
            self.corner += (J_border.swapaxes(-1, -2) @ J_border).sum(0)
            self.gradient.border[:] += gradient[:, own:].sum(0)

    def add_steps(
        self, blocks: NDArray[np.int64], at: NDArray[np.int64], phi: Array, error: Array,
        sigma: Array,
    ) -> None:  # fmt: skip
        """Add M steps x_j+1 - phi x_j = error of the unknowns `at` (q,) from some blocks j to the
        next, each with a phi (M,) and sigmas (M, q): what `add` would, from diagonals alone."""
        weight, phi = sigma**-2, phi[:, None]
        for half, rows in self._split(blocks):
            half.add_steps(blocks[rows], at, phi[rows], weight[rows])
        self.gradient.blocks[span(blocks), span(at)] -= phi * weight * error
        self.gradient.blocks[span(blocks + 1), span(at)] += weight * error

    def _split(self, blocks: NDArray[np.int64]) -> list[tuple[Half, slice]]:
        """Which terms each half takes: the first those of blocks before the middle one."""
        cut = int(np.searchsorted(blocks, self._middle))
        parts = zip(self.halves, (slice(0, cut), slice(cut, len(blocks))), strict=True)
        return [(half, rows) for half, rows in parts if rows.start < rows.stop]

    def outward(self, blocks: range, size: int) -> list[range]:
        """Some blocks in portions of so many, in the order in which adding to them costs least."""
        parts = [blocks[part] for part in portions(len(blocks), size)]
        before = [part for part in parts if part.start < self._middle]
        return [*reversed(before), *parts[len(before) :]]

    def section(self) -> "Band":
        """The same memory for somebody who adds to blocks that nobody else adds to meanwhile;
        `join` ends it."""
        part = copy(self)
        part.halves = copy(self.halves[0]), copy(self.halves[1])
        part.corner = np.zeros_like(self.corner)
        part.gradient = Vector(self.gradient.blocks, np.zeros_like(self.gradient.border))
        return part

    def join(self, part: "Band") -> None:
        """Take over what a section has of the border."""
        self.corner += part.corner
        self.gradient.border[:] += part.gradient.border
        for half, own in zip(self.halves, part.halves, strict=True):
            half.join(own)

    def factor(self, damping: Vector | None = None) -> "BorderedFactor":
        """The Cholesky factor, with a damping (d,) and (k,) on the diagonal, in the place of H.

        Raises NotPositiveError.
        """
        corner = self.corner
        if damping is not None:
            corner = corner + np.diag(damping.border)
            self.halves[0].diagonal[:] += damping.blocks
            self.halves[1].diagonal[:-1] += damping.blocks  # the middle block has it
        return BorderedFactor(Factor(self.halves), self.border, corner)


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
    """The Cholesky factor of a band: of each half, in the place of H, and of the middle block."""

    def __init__(self, halves: tuple[Half, Half]) -> None:
        self._halves, self._at = halves, halves[0].blocks[-1]
        left = np.sum(_both(Half.eliminate, halves), 0)
        try:
            self._middle = np.linalg.cholesky(left)
        except np.linalg.LinAlgError as err:
            raise NotPositiveError(self._at * len(left) + _first_not_held(left)) from err

    @property
    def log_determinant(self) -> float:
        """Natural logarithm of the determinant of H."""
        halves = sum(half.log_determinant for half in self._halves)
        return 2 * (halves + float(np.log(np.diagonal(self._middle)).sum()))

    def solve(self, right: Array) -> Array:
        """X (n, d, k) of H X = right (n, d, k)."""
        told = _both(lambda half: half.forward(right[half.outer]), self._halves)
        y = np.linalg.solve(self._middle, right[self._at] - sum(taken for _, taken in told))
        middle = np.linalg.solve(self._middle.T, y)
        x = np.empty_like(right)
        x[self._at] = middle

        def fill(half: Half, y: Array) -> None:
            x[half.outer] = half.backward(y, middle)

        _both(fill, self._halves, [y for y, _ in told])
        return x

    def inverse_blocks(self, keep: NDArray[np.int64]) -> Array:
        """Rows and columns `keep` (q,) of the n diagonal blocks of H^-1, (n, q, q)."""
        inverse = np.linalg.inv(self._middle)
        middle = inverse.T @ inverse
        n = sum(len(half.blocks) for half in self._halves) - 1
        out = np.empty((n, len(keep), len(keep)))
        out[self._at] = middle[np.ix_(keep, keep)]
        _both(lambda half: half.inverse_blocks(out[half.outer], keep, middle), self._halves)
        return out


def _both(make: Callable[..., Made], halves: tuple[Half, Half], *told: Iterable[Any]) -> list[Made]:
    """What is made of each half and of what is told of it, side by side where that is worth it."""
    parts = list(zip(halves, *told, strict=True))
    if len(halves[1].blocks) <= LONG:
        return [make(*part) for part in parts]
    return each(lambda part: make(*part), parts)


def _first_not_held(matrix: Array) -> int:
    """The first unknown at which a matrix is not positive definite."""
    for q in range(1, len(matrix)):
        try:
            np.linalg.cholesky(matrix[:q, :q])
        except np.linalg.LinAlgError:
            return q - 1
    return len(matrix) - 1
