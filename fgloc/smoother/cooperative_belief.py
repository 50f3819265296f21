"""What is believed of all that lives at one instant: a dense core, and tracks free of it.

Who was only ever seen by nodes without slow errors depends on all others by the errors of the
nodes' surveys alone, and these do not move:

    s = m + G n + e,   e ~ N(0, C), independent of everything else

So the time that free tracks take grows with their number. The car, whom it sees, slow errors and
who is seen through them are the core, with the surveys in front: x and one covariance P. Nothing is
approximated.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fgloc.measurements import Array
from fgloc.smoother.cooperative_model import FIRST_SIGMAS, motion
from fgloc.smoother.cooperative_rows import ERRORS, HEADING, SIZES, Index, Name, Places, Rows

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True, eq=False)
class Core:
    """Variables with one covariance: names, x (n,), P (n, n)."""

    names: tuple[Name, ...]
    x: Array
    P: Array

    @cached_property
    def column(self) -> dict[Name, int]:
        """The first column of each variable."""
        sizes = np.array([SIZES[letter] for letter, _ in self.names], np.int64)
        return dict(zip(self.names, (np.cumsum(sizes) - sizes).tolist(), strict=True))

    @cached_property
    def surveys(self) -> int:
        """How many columns belong to surveys."""
        return 3 * sum(letter == "n" for letter, _ in self.names)

    def marginal(self, name: Name) -> tuple[Array, Array]:
        """Mean and covariance of one variable."""
        at = slice(self.column[name], self.column[name] + SIZES[name[0]])
        return self.x[at], self.P[at, at]

    def only(self, names: Iterable[Name]) -> "Core":
        """Without all but the variables named."""
        kept = set(names)
        if kept >= set(self.names):
            return self
        stays = np.repeat([n in kept for n in self.names], [SIZES[c] for c, _ in self.names])
        rows = np.flatnonzero(stays)
        left = tuple(name for name in self.names if name in kept)
        return Core(left, self.x[rows], self.P[np.ix_(rows, rows)])

    def joined(self, names: list[Name], x: Array, cross: Array, P: Array) -> "Core":
        """With more variables at the end; `cross` is their covariance with those that are there."""
        both = np.block([[self.P, cross.T], [cross, P]])
        return Core((*self.names, *names), np.append(self.x, x), both)

    def begun(self, name: Name, mean: float, sigma: Array | float) -> "Core":
        """With one that depends on nothing."""
        d = SIZES[name[0]]
        return self.joined([name], np.full(d, mean), np.zeros((d, len(self.x))),
                           np.diag(np.full(d, sigma) ** 2))  # fmt: skip

    def moved(
        self, dt_s: float, turn_rad: float, steps: dict[Name, tuple[float, Array | float]]
    ) -> "Core":
        """A step later: tracks move on, the car turns; `steps` has the factor and the new variance
        of what is no track."""
        x, P = self.x.copy(), self.P.copy()
        if HEADING in self.column:
            h = self.column[HEADING]
            x[h] += turn_rad
            if ERRORS in self.column:
                rate = self.column[ERRORS]
                x[h] -= dt_s * x[rate]
                P[h] -= dt_s * P[rate]
                P[:, h] -= dt_s * P[:, rate]
        scale, variance = np.ones(len(x)), np.zeros(len(x))
        for name, (kept, new) in steps.items():
            at = slice(self.column[name], self.column[name] + SIZES[name[0]])
            scale[at], variance[at] = kept, new
        x *= scale
        P *= scale[:, None] * scale
        P[np.diag_indices(len(P))] += variance
        first = np.array([c for name, c in self.column.items() if name[0] == "s"], np.int64)
        place = (first[:, None] + [0, 1]).ravel()
        x[place] += dt_s * x[place + 2]
        P[place] += dt_s * P[place + 2]
        P[:, place] += dt_s * P[:, place + 2]
        block = first[:, None] + np.arange(4)
        P[block[:, :, None], block[:, None, :]] += motion(dt_s)[1]
        return Core(self.names, x, _symmetric(P))

    def told(self, groups: list[Rows], evidence: Array) -> "Core":
        """With what was measured; `evidence` (m, surveys + 1) are rows [A b] on the surveys."""
        from scipy.linalg import solve_triangular

        H, b = self._stacked(groups, evidence)
        if not len(b):
            return self
        HP = H @ self.P
        L = np.linalg.cholesky(H @ HP.T + np.eye(len(b)))
        W = solve_triangular(L, HP, lower=True, check_finite=False)
        gap = solve_triangular(L, b - H @ self.x, lower=True, check_finite=False)
        return Core(self.names, self.x + W.T @ gap, self.P - W.T @ W)

    def _stacked(self, groups: list[Rows], evidence: Array) -> "tuple[csr_array, Array]":
        """All rows as one sparse matrix (m, n), and their right-hand sides (m,)."""
        from scipy.sparse import coo_array

        A, row, col = [evidence[:, :-1].ravel()], *_dense(evidence[:, :-1].shape)
        rows, cols, b = [row], [col], [evidence[:, -1]]
        height = len(evidence)
        for group in groups:
            for index, names, block in group.terms:
                first = np.array([self.column[name] for name in names], np.int64)
                down, across = _dense(block.shape[1:])
                rows.append((height + 2 * index[:, None] + down).ravel())
                cols.append((first[:, None] + across).ravel())
                A.append(block.ravel())
            b.append(group.b.ravel())
            height += group.b.size
        place = np.concatenate(rows), np.concatenate(cols)
        H = coo_array((np.concatenate(A), place), shape=(height, len(self.x)))
        return H.tocsr(), np.concatenate(b)


@dataclass(frozen=True, eq=False)
class Free:
    """Tracks (f,) in ascending order with m (f, 4), G (f, 4, surveys), C (f, 4, 4)."""

    tracks: Index
    m: Array
    G: Array
    C: Array

    def __getitem__(self, which: Index | NDArray[np.bool_]) -> "Free":
        return Free(self.tracks[which], self.m[which], self.G[which], self.C[which])

    def born(self, tracks: Index) -> "Free":
        """With tracks of which nothing is known."""
        n = len(tracks)
        all_ = Free(
            np.append(self.tracks, tracks), np.concatenate([self.m, np.zeros((n, 4))]),
            np.concatenate([self.G, np.zeros((n, 4, self.G.shape[2]))]),
            np.concatenate([self.C, np.tile(np.diag(FIRST_SIGMAS**2), (n, 1, 1))]),
        )  # fmt: skip
        return all_[np.argsort(all_.tracks)]

    def moved(self, dt_s: float) -> "Free":
        """A step later."""
        F, Q = motion(dt_s)
        C = _symmetric(F @ self.C @ F.T + Q)
        return Free(self.tracks, self.m @ F.T, F @ self.G, C)

    def told(self, places: Places) -> tuple["Free", Array]:
        """With where they were seen; and what that says of the surveys, rows [A b]."""
        m, G, C = self.m.copy(), self.G.copy(), self.C.copy()
        evidence = [np.zeros((0, G.shape[2] + 1))]
        for turn in _turns(places.track):
            seen = places[turn]
            i, W = np.searchsorted(self.tracks, seen.track), seen.W
            J = W @ G[i, :2]
            at = np.flatnonzero(seen.col >= 0)
            columns = seen.col[at, None] + np.arange(3)
            J[at[:, None, None], np.arange(2)[:, None], columns[:, None]] += seen.off[at]
            gap = seen.b[..., None] - W @ m[i, :2, None]
            HC = W @ C[i, :2]
            S = HC[..., :2] @ W.swapaxes(1, 2) + np.eye(2)
            K = np.linalg.solve(S, HC).swapaxes(1, 2)
            m[i] += (K @ gap)[..., 0]
            G[i] -= K @ J
            C[i] -= K @ HC
            rows = np.linalg.solve(np.linalg.cholesky(S), np.concatenate([J, gap], -1))
            evidence.append(rows.reshape(-1, rows.shape[-1]))
        # Rows that say the same in fewer; what is left over says nothing of the surveys.
        R = np.asarray(np.linalg.qr(np.concatenate(evidence), mode="r"))
        return Free(self.tracks, m, G, C), R[: G.shape[2]]


def pulled(core: Core, free: Free, tracks: Index) -> tuple[Core, Free]:
    """Free tracks become part of the core."""
    which = np.isin(free.tracks, tracks)
    if not which.any():
        return core, free
    these, s = free[which], core.surveys
    m, C = marginals(core, these)
    G = these.G.reshape(4 * len(these.tracks), s)
    cross = G @ core.P[:s]
    P = cross[:, :s] @ G.T
    block = np.arange(len(P)).reshape(-1, 4)
    P[block[:, :, None], block[:, None, :]] = C
    names = [("s", int(track)) for track in these.tracks]
    return core.joined(names, m.ravel(), cross, P), free[~which]


def marginals(core: Core, free: Free) -> tuple[Array, Array]:
    """Means (f, 4) and covariances (f, 4, 4) of free tracks, whatever the surveys are."""
    s = core.surveys
    C = free.C + free.G @ core.P[:s, :s] @ free.G.swapaxes(1, 2)
    return free.m + free.G @ core.x[:s], _symmetric(C)


def _symmetric(P: Array) -> Array:
    """(..., d, d) without the rounding by which it is not."""
    return np.asarray((P + P.swapaxes(-1, -2)) / 2)


def _turns(tracks: Index) -> list[Index]:
    """Indices of the first row of each track, then of the second, and so on."""
    order = np.argsort(tracks, kind="stable")
    sorted_ = tracks[order]
    rank = np.arange(len(tracks)) - np.searchsorted(sorted_, sorted_)
    return [order[rank == r] for r in range(rank.max(initial=-1) + 1)]


def _dense(shape: tuple[int, ...]) -> tuple[Index, Index]:
    """Row and column of each element of a matrix."""
    rows, columns = np.indices(shape[-2:])
    return rows.ravel(), columns.ravel()
