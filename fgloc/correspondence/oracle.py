"""Whether a layout leaves a choice: an exhaustive search for a second assignment.

Ambiguous is a layout where an assignment of as many pairs as the true one, or more, has all its
residuals below three sigma after its own least-squares fit, with a heading more than 5 deg from
the true one. Of such a set, the two points of the car that lie furthest apart fix a motion that
carries every other of its points to within (1 + sqrt(3) + 1) times the largest residual of its
partner, and no point of the set lies further from either of the two than they from each other.
So all pairs of pairs are tried, and what stays within these bounds is searched to the end. Left
out are pairs whose votes for all other headings are fewer than the true set has pairs.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fgloc.correspondence.matching import APART_RAD, CONSISTENT_SIGMA
from fgloc.correspondence.rigid import Index, Rigid, fit, squared_distances, wrapped
from fgloc.correspondence.voting import BIN_RAD, BINS, alike, bounds
from fgloc.measurements import Array

_SPREAD = 3.8  # 2 + sqrt(3), and what the sine adds to it
_AT_ONCE = 4000


def is_ambiguous(
    p_world_m: Array, p_veh_m: Array, yaw_rad: float, true_pairs: Index, *, sigma_m: float = 0.3
) -> bool:
    """Whether points of a node (N, 2) and of a car (M, 2) allow another heading than the true one.

    true_pairs  (K, 2) index among the car's points and among the node's
    sigma_m     of each axis of each position; the car's own place, its first point, is exact
    """
    size = len(true_pairs)
    if size < 2:
        return True  # one pair fits any heading
    variance = sigma_m**2 * np.r_[1.0, np.full(len(p_veh_m) - 1, 2.0)]
    reach_m = CONSISTENT_SIGMA * sigma_m * 2**0.5
    open_ = _open_pairs(p_world_m, p_veh_m, yaw_rad, size, reach_m)
    return search(p_world_m, p_veh_m, yaw_rad, size, variance, reach_m, open_)


def search(
    p_world_m: Array, p_veh_m: Array, yaw_rad: float, size: int, variance: Array, reach_m: float,
    open_: NDArray[np.bool_] | None = None,
) -> bool:  # fmt: skip
    """Whether any set of `size` pairs is consistent under a heading that is not about `yaw_rad`.

    open_  (M, N) pairs that such a set may hold; without it, all
    """
    if open_ is None:
        open_ = np.ones((len(p_veh_m), len(p_world_m)), bool)
    for ends in _pairs_of_pairs(p_world_m, p_veh_m, reach_m, open_):
        near = _within_reach(ends, p_world_m, p_veh_m, reach_m)
        enough = np.flatnonzero(np.minimum(near.any(2).sum(1), near.any(1).sum(1)) >= size)
        for row in enough:
            candidates = np.argwhere(near[row])
            if _has_set(candidates, size, p_world_m, p_veh_m, yaw_rad, variance, reach_m):
                return True
    return False


def _open_pairs(
    world: Array, veh: Array, yaw: float, size: int, reach_m: float
) -> NDArray[np.bool_]:
    """(M, N) pairs that could be of a set as large under another heading, by the bound of votes."""
    middle = (np.arange(BINS) + 0.5) * BIN_RAD
    other = np.abs(np.angle(np.exp(1j * (middle - yaw)))) > APART_RAD - BIN_RAD / 2
    enough = bounds(world, veh, slice(None), reach_m)[:, :, other] >= size
    return np.asarray(enough.any(-1))


def _pairs_of_pairs(
    world: Array, veh: Array, reach_m: float, open_: NDArray[np.bool_]
) -> Iterator[tuple[NDArray[np.int64], ...]]:
    """Chunks of i, k of the car's points and j, l of the node's, about as far apart."""
    i, k = np.triu_indices(len(veh), 1)
    j, l = np.nonzero(~np.eye(len(world), dtype=bool))  # noqa: E741
    d_own = np.linalg.norm(veh[k] - veh[i], axis=-1)
    d_theirs = np.linalg.norm(world[l] - world[j], axis=-1)
    a, b = alike(d_own, d_theirs, 2 * reach_m)
    kept = open_[i[a], j[b]] & open_[k[a], l[b]]
    a, b = a[kept], b[kept]
    for start in range(0, len(a), _AT_ONCE):
        rows = slice(start, start + _AT_ONCE)
        yield i[a[rows]], k[a[rows]], j[b[rows]], l[b[rows]]


def _within_reach(
    ends: tuple[Index, ...], world: Array, veh: Array, reach_m: float
) -> NDArray[np.bool_]:
    """(H, M, N) which pairs a set with i, k to j, l as its ends can hold."""
    i, k, j, l = ends  # noqa: E741
    own, theirs = veh[k] - veh[i], world[l] - world[j]
    yaw = np.arctan2(theirs[:, 1], theirs[:, 0]) - np.arctan2(own[:, 1], own[:, 0])
    c, s = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    from_middle = veh[None] - ((veh[i] + veh[k]) / 2)[:, None]
    x, y = from_middle[..., 0], from_middle[..., 1]
    middle = (world[j] + world[l]) / 2
    moved_x, moved_y = c * x - s * y + middle[:, :1], s * x + c * y + middle[:, 1:]
    near = (moved_x[..., None] - world[:, 0]) ** 2 + (moved_y[..., None] - world[:, 1]) ** 2
    apart = squared_distances(veh, veh)
    length = apart[i, k][:, None]
    inside = (apart[i] <= length) & (apart[k] <= length)
    return (near < (_SPREAD * reach_m) ** 2) & inside[..., None]


def _has_set(
    candidates: Index, size: int, world: Array, veh: Array, yaw: float, variance: Array,
    reach: float,
) -> bool:  # fmt: skip
    """Whether the candidate pairs (C, 2) hold a consistent set with another heading."""
    own, theirs = candidates.T
    d_own = np.linalg.norm(veh[own][:, None] - veh[own], axis=-1)
    d_theirs = np.linalg.norm(world[theirs][:, None] - world[theirs], axis=-1)
    agree = np.abs(d_own - d_theirs) <= 2 * reach
    agree &= (own[:, None] != own) & (theirs[:, None] != theirs)
    return any(
        _is_other(candidates[members], size, world, veh, yaw, variance)
        for members in _cliques(agree, size)
    )


def _is_other(
    pairs: Index, size: int, world: Array, veh: Array, yaw: float, variance: Array
) -> bool:
    """Whether the pairs, without those that fit worst, are consistent under another heading."""
    while len(pairs) >= size:
        a, b = veh[pairs[:, 0]], world[pairs[:, 1]]
        pose: Rigid = fit(a, b, 1 / variance[pairs[:, 0]])
        gap = np.linalg.norm(pose.apply(a) - b, axis=-1) / np.sqrt(variance[pairs[:, 0]])
        if gap.max() < CONSISTENT_SIGMA:
            return abs(wrapped(pose.yaw_rad - yaw)) > APART_RAD
        pairs = np.delete(pairs, gap.argmax(), axis=0)
    return False


def _cliques(agree: NDArray[np.bool_], size: int) -> Iterator[list[int]]:
    """All largest sets of at least `size` that agree in pairs (Bron and Kerbosch, with a pivot)."""
    neighbours = [set(np.flatnonzero(row).tolist()) for row in agree]

    def grow(chosen: list[int], open_: set[int], done: set[int]) -> Iterator[list[int]]:
        if not open_ and not done:
            yield chosen
            return
        if len(chosen) + len(open_) < size:
            return
        pivot = max(open_ | done, key=lambda v: len(neighbours[v] & open_))
        for v in list(open_ - neighbours[pivot]):
            yield from grow([*chosen, v], open_ & neighbours[v], done & neighbours[v])
            open_ = open_ - {v}
            done = done | {v}

    for found in grow([], set(range(len(agree))), set()):
        if len(found) >= size:
            yield found
