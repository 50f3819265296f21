"""Matching a node's objects to the car's without a first guess, and without being stuck.

Every heading that two pairs can agree on is a hypothesis with an upper bound of its pairs
(`voting`). They are refined from the best bound down, until no bound is as large as the set that
was found. The set with the best truncated squares is the answer; 'ambiguous' is the answer where
another heading explains as many pairs. Of the pairs, those are claimed that are beyond doubt:
a missing object may by chance stand where another has a ghost, and no geometry tells.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgloc.correspondence.rigid import (
    IDENTITY,
    Correspondence,
    Index,
    Rigid,
    Status,
    check_points,
    mutual_nearest,
    plain,
    squared_distances,
    wrapped,
)
from fgloc.correspondence.voting import BIN_RAD, BINS, bounds
from fgloc.errors import InputError
from fgloc.measurements import Array

APART_RAD = np.deg2rad(5.0)
"""Two answers differ where their headings do by more than this."""
CONSISTENT_SIGMA = 3.0
"""A set of pairs is consistent where every residual is below so many sigma of its pair."""
ACCEPTED_SIGMA = 4.0
"""A pair of the answer may lie so far off: of 20 true ones, each fifth layout has one beyond 3."""
LEAST_PAIRS = 3
"""Two pairs can always be swapped: the heading is then the opposite one."""
DOUBT = 0.002
"""Probability that any of the claimed pairs is wrong."""
_ROUNDS = 4
_FIRST = 8
_FIRST_ANCHORS = 4
_AT_ONCE = 64


@dataclass(frozen=True, eq=False)
class _Poses:
    """Refined poses with their sets: yaw_rad (H,), t_m (H, 2), score (H,), and how many pairs.

    accepted, consistent  (H,) pairs within `ACCEPTED_SIGMA`, and pairs if all are within
                          `CONSISTENT_SIGMA` once those beyond are dropped and the fit repeated
    """

    yaw_rad: Array
    t_m: Array
    score: Array
    accepted: NDArray[np.int64]
    consistent: NDArray[np.int64]


def match(
    p_world_m: Array,
    p_veh_m: Array,
    *,
    sigma_m: float = 0.3,
    doubt: float = DOUBT,
) -> Correspondence:
    """Match the car's points (M, 2), itself first at 0, to a node's (N, 2).

    sigma_m  of each axis of each position; the car's own place in its axes is exact
    doubt    probability that may remain that any of the claimed `pairs` is wrong; the others are
             in `likely`
    Raises InputError where the points are not finite or not of two columns, or sigma is not
    above 0.
    """
    world, veh = check_points("p_world_m", p_world_m), check_points("p_veh_m", p_veh_m)
    if not sigma_m > 0:
        raise InputError(f"sigma_m = {sigma_m}: expected a number above 0, in m")
    if min(len(world), len(veh)) < LEAST_PAIRS:
        status = Status.AMBIGUOUS if len(world) and len(veh) else Status.NONE
        return _unclaimed(status, IDENTITY, 0)
    variance = sigma_m**2 * np.r_[1.0, np.full(len(veh) - 1, 2.0)]
    reach_m = CONSISTENT_SIGMA * sigma_m * 2**0.5
    found = _search(world, veh, variance, reach_m)
    best = int(np.argmax(found.score))
    pose = Rigid(float(found.yaw_rad[best]), found.t_m[best])
    if found.accepted[best] < LEAST_PAIRS or _has_rival(found, best):
        return _unclaimed(Status.AMBIGUOUS, pose, len(found.score))
    return _claimed(pose, world, veh, variance, doubt, len(found.score))


def _search(world: Array, veh: Array, variance: Array, reach_m: float) -> _Poses:
    """Refined poses: of the most promising anchors, then of all whose bound is not below these.

    A set of S of the car's M points holds one of any M - S + 1 of them, so no more anchors are
    needed. Left out is what leads to the best of the first again: its own pairs under its own
    heading.
    """
    few = bounds(world, veh, slice(0, _FIRST_ANCHORS), reach_m)
    top = few.argmax(-1)
    peak = np.take_along_axis(few, top[..., None], -1).ravel()
    best = np.argsort(-peak, kind="stable")[:_FIRST]
    parts = [_refine(best * BINS + top.ravel()[best], few.shape, world, veh, variance, reach_m)]
    largest = max(int(parts[0].consistent.max()), LEAST_PAIRS)
    rest = slice(_FIRST_ANCHORS, max(len(veh) - largest + 1, _FIRST_ANCHORS))
    bound = np.concatenate([few, bounds(world, veh, rest, reach_m)])
    cells = _open_cells(bound, largest, parts[0], world, veh, reach_m)
    for row in range(0, len(cells), _AT_ONCE):
        some = cells[row : row + _AT_ONCE]
        if bound.flat[some[0]] < largest:
            break
        parts.append(_refine(some, bound.shape, world, veh, variance, reach_m))
        largest = max(int(parts[-1].consistent.max()), largest)
    names = ("yaw_rad", "t_m", "score", "accepted", "consistent")
    return _Poses(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def _open_cells(
    bound: Index, largest: int, found: _Poses, world: Array, veh: Array, reach_m: float
) -> Index:
    """Cells (C,) of bounds that may hold as large a set as the largest, from the best down."""
    cells = np.flatnonzero(bound >= largest)
    best = int(np.argmax(found.score))
    cells = cells[~_leads_back(cells, bound.shape, found, best, world, veh, reach_m)]
    return cells[np.argsort(-bound.ravel()[cells], kind="stable")]


def _leads_back(
    cells: Index, shape: tuple[int, ...], found: _Poses, best: int,
    world: Array, veh: Array, reach_m: float,
) -> NDArray[np.bool_]:  # fmt: skip
    """(C,) which cells are a pair of the best pose under about its heading."""
    own, theirs, bin_ = np.unravel_index(cells, shape)
    moved = _moved(found.yaw_rad[best : best + 1], found.t_m[best : best + 1], veh)[0]
    gap = moved[own] - world[theirs]
    off = np.angle(np.exp(1j * ((bin_ + 0.5) * BIN_RAD - found.yaw_rad[best])))
    return (np.hypot(*gap.T) < reach_m) & (np.abs(off) < APART_RAD)


def _refine(
    cells: Index, shape: tuple[int, ...], world: Array, veh: Array, variance: Array, reach_m: float
) -> _Poses:
    """Hypotheses drawn to the nearest set of pairs, by least squares over pairs that are mutual."""
    own, theirs, bin_ = np.unravel_index(cells, shape)
    yaw: Array = np.asarray((bin_ + 0.5) * BIN_RAD, np.float64)
    t = world[theirs] - _turned(veh[own], yaw)
    # The heading may be off by a bin's half, the anchor by the noise of both its points.
    arm_m = np.linalg.norm(veh[None] - veh[own][:, None], axis=-1)
    gate: Array = (2 * reach_m + 0.03 * arm_m) ** 2
    for _ in range(_ROUNDS):
        partner, squares = _mutual(yaw, t, world, veh)
        yaw, t = _fit(partner, squares < gate, world, veh, variance, yaw, t)
        gate = np.broadcast_to(ACCEPTED_SIGMA**2 * variance, squares.shape)
    partner, squares = _mutual(yaw, t, world, veh)
    accepted = squares < gate
    reward = (ACCEPTED_SIGMA**2 - squares / variance) / 2
    score: Array = np.where(accepted, reward, 0.0).sum(-1)
    close = squares < CONSISTENT_SIGMA**2 * variance
    _, again = _residuals(partner, close, world, veh, variance, yaw, t)
    fine = close & (again < CONSISTENT_SIGMA**2 * variance)
    return _Poses(yaw, t, score, accepted.sum(-1), fine.sum(-1))


def _residuals(
    partner: Index, used: Any, world: Array, veh: Array, variance: Array, yaw: Array, t: Array
) -> tuple[Array, Array]:
    """Headings (H,) and squared residuals (H, M) of sets after a fit of their own."""
    yaw, t = _fit(partner, used, world, veh, variance, yaw, t)
    gap = _moved(yaw, t, veh) - world[partner]
    return yaw, np.einsum("hmi,hmi->hm", gap, gap)


def _mutual(yaw: Array, t: Array, world: Array, veh: Array) -> tuple[Index, Array]:
    """(H, M) nearest of the node's points, and its squared distance, infinite if not mutual."""
    moved = _moved(yaw, t, veh)
    dx = moved[..., 0, None] - world[:, 0]
    dy = moved[..., 1, None] - world[:, 1]
    squares = dx * dx + dy * dy
    partner = squares.argmin(-1)
    back = np.take_along_axis(squares.argmin(-2), partner, -1)
    least = np.take_along_axis(squares, partner[..., None], -1)[..., 0]
    return partner, np.where(back == np.arange(len(veh)), least, np.inf)


def _fit(
    partner: Index, used: Any, world: Array, veh: Array, variance: Array, yaw: Array, t: Array
) -> tuple[Array, Array]:
    """Least squares of each of H sets; a set of fewer than two pairs keeps its pose."""
    w = used / variance
    total = np.maximum(w.sum(-1), 1e-12)[:, None]
    b = world[partner]
    mean_a, mean_b = w @ veh / total, np.einsum("hm,hmi->hi", w, b) / total
    a, b = veh - mean_a[:, None], b - mean_b[:, None]
    along = np.einsum("hm,hmi,hmi->h", w, a, b)
    across = (w * (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])).sum(-1)
    enough = used.sum(-1) > 1
    turned = np.where(enough, np.arctan2(across, along), yaw)
    return turned, np.where(enough[:, None], mean_b - _turned(mean_a, turned), t)


def _moved(yaw: Array, t: Array, veh: Array) -> Array:
    """(H, M, 2) the car's points in the world under each pose."""
    c, s = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    x, y = veh[:, 0], veh[:, 1]
    return np.stack([c * x - s * y + t[:, :1], s * x + c * y + t[:, 1:]], -1)


def _turned(p: Array, yaw: Array) -> Array:
    """Points (H, 2) turned by headings (H,)."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack([c * p[:, 0] - s * p[:, 1], s * p[:, 0] + c * p[:, 1]], -1)


def _has_rival(found: _Poses, best: int) -> bool:
    """Whether another heading explains as many pairs, all of them consistent."""
    off = np.abs(np.angle(np.exp(1j * (found.yaw_rad - found.yaw_rad[best]))))
    rivals = (off > APART_RAD) & (found.consistent >= found.accepted[best])
    return bool(rivals.any())


def _claimed(
    pose: Rigid, world: Array, veh: Array, variance: Array, doubt: float, looked_at: int
) -> Correspondence:
    """The pairs at a pose with their probabilities, parted by the doubt that may remain."""
    squares = squared_distances(pose.apply(veh), world)
    pairs = mutual_nearest(squares)
    gap = squares[pairs[:, 0], pairs[:, 1]]
    pairs = pairs[gap < ACCEPTED_SIGMA**2 * variance[pairs[:, 0]]]
    sure = _probability(squares, variance, len(pairs), _area_m2(pose.apply(veh), world))
    probability = sure[pairs[:, 0], pairs[:, 1]]
    order = np.argsort(-probability, kind="stable")
    claimed = int((np.cumsum(1 - probability[order]) <= doubt).sum())
    likely = order[claimed:][probability[order[claimed:]] > 0.5]
    kept = np.r_[order[:claimed], likely]
    return Correspondence(
        Status.MATCHED, Rigid(wrapped(pose.yaw_rad), pose.t_m), pairs[order[:claimed]],
        pairs[likely], probability[kept], looked_at,
    )  # fmt: skip


def _probability(squares: Array, variance: Array, matched: int, area_m2: float) -> Array:
    """(M, N) that two points are one object, against all else that could be true of either.

    Objects that both see lie as densely as the pairs that were found; those of one set alone (the
    other misses them, or they are not there) as densely as the points that were left over.
    """
    both = matched / area_m2
    alone = [(n - matched + 0.5) / area_m2 for n in squares.shape]
    density = np.exp(-squares / (2 * variance[:, None])) / (2 * np.pi * variance[:, None])
    odds = both * density / (alone[0] * alone[1])
    return odds / (1 + odds.sum(0) + odds.sum(1)[:, None] - odds)


def _area_m2(a: Array, b: Array) -> float:
    """Of the box around all points; at least one square metre."""
    return float(max(np.prod(np.ptp(np.concatenate([a, b]), axis=0)), 1.0))


def _unclaimed(status: Status, pose: Rigid, looked_at: int) -> Correspondence:
    none = plain(pose, np.empty((0, 2), np.int64), looked_at)
    return Correspondence(status, pose, none.pairs, none.likely, none.probability, looked_at)
