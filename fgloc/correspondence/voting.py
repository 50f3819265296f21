"""Every rotation that two pairs of objects can agree on, counted.

If a set of pairs lies within `reach_m` of one rigid motion, then around any of its pairs as the
anchor each other pair allows an interval of headings, and the heading of the motion lies in all of
them. So the number of intervals over a heading is an upper bound of the pairs that a motion with
this anchor can have: where it is below the size of a set that is known, nothing is left to find.
"""

import numpy as np
from numpy.typing import NDArray

from fgloc.measurements import Array

BINS = 120
"""Headings are counted in bins of 3 deg."""
BIN_RAD = 2 * np.pi / BINS


def bounds(world: Array, veh: Array, anchors: slice, reach_m: float) -> NDArray[np.int64]:
    """(A, N, BINS) most pairs of any motion that carries an anchor to a point of the node's (N, 2).

    The anchors are some of the car's points (M, 2); bin b holds the headings from b to b + 1 times
    `BIN_RAD`.
    """
    A, N = len(veh[anchors]), len(world)
    own = veh[None] - veh[anchors][:, None]
    i, k = np.nonzero(np.arange(len(veh)) != np.arange(len(veh))[anchors][:, None])
    j, l = np.nonzero(~np.eye(N, dtype=bool))  # noqa: E741
    d_own, yaw_own = _polar(own[i, k])
    d_theirs, yaw_theirs = _polar(world[l] - world[j])
    a, b = alike(d_own, d_theirs, 2 * reach_m)
    # The ends of the two differ by up to twice the reach: seen over d, an angle to either side.
    half = np.arcsin(2 * reach_m / np.maximum(d_own, 2 * reach_m))
    half[d_own <= 2 * reach_m] = np.pi
    span = np.minimum(np.ceil(2 * half / BIN_RAD).astype(np.int64) + 1, BINS)[a]
    start = np.floor((yaw_theirs[b] - (yaw_own + half)[a]) / BIN_RAD).astype(np.int64) % BINS
    row = 2 * BINS + 1
    first = (i[a] * N + j[b]) * row + start
    size = A * N * row
    change = np.bincount(first, minlength=size) - np.bincount(first + span, minlength=size)
    over = np.cumsum(change.reshape(A * N, row), axis=1)
    return (1 + over[:, :BINS] + over[:, BINS : 2 * BINS]).reshape(A, N, BINS)


def _polar(p: Array) -> tuple[Array, Array]:
    """Length and angle (N,) of vectors (N, 2)."""
    return np.hypot(p[:, 0], p[:, 1]), np.arctan2(p[:, 1], p[:, 0])


def alike(a: Array, b: Array, tolerance: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices of all pairs of a (A,) and b (B,) that differ by no more than the tolerance."""
    order = np.argsort(b)
    ranked = b[order]
    first = np.searchsorted(ranked, a - tolerance, side="left")
    count = np.searchsorted(ranked, a + tolerance, side="right") - first
    total = int(count.sum())
    index_a = np.repeat(np.arange(len(a)), count)
    begin = np.repeat(first - (np.cumsum(count) - count), count)
    return index_a, order[np.arange(total) + begin]
