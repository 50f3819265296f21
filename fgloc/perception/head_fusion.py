"""The tracks of a node's heads as one list of objects.

Lee et al. (2021), section III-B: the tracks of the heads, in common axes, are matched by 3-D IoU.
What two heads say of one object is joined by covariance intersection (Julier and Uhlmann, 1997):
their errors have the assumed size and motion in common, so that their information does not add up,
and how much they have in common is not known.

# Differs from the paper: two tracks are also one object where they agree within their covariances,
# or one is inside of the other; of pedestrians, 0.5 m wide, IoU is 0 where heads differ by as much.
# The common axes are the node's level ones instead of UTM: both heads are on one node, and a turn
# and a shift of all axes change neither IoU nor the result.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgloc.chi_square import chi2_quantile
from fgloc.measurements import UNKNOWN, Array
from fgloc.perception.iou import best_pairs, cuboid_iou
from fgloc.perception.settings import HeadsConfig
from fgloc.perception.track_filter import Belief
from fgloc.perception.tracks import Tracks, is_inside

WEIGHTS = np.linspace(0.0, 1.0, 51)


@dataclass(frozen=True, eq=False)
class Objects:
    """Objects of one frame.

    object_id  (N,) the node's own number; kind (N,); votes (N,) how many boxes said so
    heads      (N,) how many heads saw it
    p_node_m   (N, 2) what is told of the place, along the node's level axes; cov_m2 (N, 2, 2)
    x, P       (N, 9), (N, 9, 9) states, for the cuboids
    """

    object_id: NDArray[np.int64]
    kind: NDArray[np.int64]
    votes: NDArray[np.int64]
    heads: NDArray[np.int64]
    p_node_m: Array
    cov_m2: Array
    x: Array
    P: Array

    def __len__(self) -> int:
        return len(self.object_id)

    @property
    def belief(self) -> Belief:
        """The states."""
        return Belief(self.x, self.P)

    def take(self, rows: Any) -> "Objects":
        """Some of the rows."""
        return Objects(*(getattr(self, f.name)[rows] for f in fields(self)))

    def and_(self, more: "Objects") -> "Objects":
        """These and some more."""
        pairs = ((getattr(self, f.name), getattr(more, f.name)) for f in fields(self))
        return Objects(*(np.concatenate(pair) for pair in pairs))


class HeadFusion:
    """Joins what heads tell of each frame, and numbers the objects.

    An object keeps its number while a head's track that had it lives.
    """

    def __init__(self, config: HeadsConfig) -> None:
        self.config = config
        self._gate = chi2_quantile(config.gate_probability, 2)
        self._number: dict[tuple[int, int], int] = {}
        self._given = 0

    def join(self, heads: Sequence[tuple[Tracks, Belief]]) -> Objects:
        """One list of the heads' tracks, each with the belief whose place is told of."""
        joined, *others = [
            self._of_head(number, tracks, told) for number, (tracks, told) in enumerate(heads)
        ]
        for other in others:
            joined = self._joined(joined, other)
        return self._renumbered(joined)

    def _of_head(self, head: int, tracks: Tracks, told: Belief) -> "_Rows":
        """A head's tracks; those without a number have a negative one for now."""
        keys = [(head, int(track)) for track in tracks.id]
        known = [self._number.get(key, -1) for key in keys]
        objects = Objects(
            np.array(known, np.int64), tracks.kind, tracks.votes.sum(1),
            np.ones(len(keys), np.int64), told.x[:, :2], told.P[:, :2, :2], tracks.x, tracks.P,
        )  # fmt: skip
        return _Rows(objects, [[key] for key in keys])

    def _joined(self, one: "_Rows", other: "_Rows") -> "_Rows":
        a, b = one.objects, other.objects
        iou = cuboid_iou(a.belief.cuboids, b.belief.cuboids)
        off = a.p_node_m[:, None] - b.p_node_m
        cov = a.cov_m2[:, None] + b.cov_m2 + self.config.slack_m**2 * np.eye(2)
        near = (off * np.linalg.solve(cov, off[..., None])[..., 0]).sum(-1) / self._gate
        inside = is_inside(a.p_node_m, b.belief, 0.0) | is_inside(b.p_node_m, a.belief, 0.0).T
        same = (iou > self.config.least_iou) | (near < 1) | inside
        pairs = best_pairs(iou - near, same)
        i, j = pairs.T
        keys = [one.keys[m] + other.keys[n] for m, n in pairs.tolist()]
        free_a, free_b = np.setdiff1d(np.arange(len(a)), i), np.setdiff1d(np.arange(len(b)), j)
        keys += [one.keys[k] for k in free_a.tolist()] + [other.keys[k] for k in free_b.tolist()]
        return _Rows(_both(a.take(i), b.take(j)).and_(a.take(free_a)).and_(b.take(free_b)), keys)

    def _renumbered(self, rows: "_Rows") -> Objects:
        """New numbers for what has none, or one that another row of the frame has already."""
        numbers = rows.objects.object_id.copy()
        taken: set[int] = set()
        for k, number in enumerate(numbers.tolist()):
            if number < 0 or number in taken:
                numbers[k], self._given = self._given, self._given + 1
            taken.add(int(numbers[k]))
            for key in rows.keys[k]:
                self._number[key] = int(numbers[k])
        return replace(rows.objects, object_id=numbers)


class _Rows(NamedTuple):
    """Objects, and of each the tracks (head, number) that it is made of."""

    objects: Objects
    keys: list[list[tuple[int, int]]]


def intersection(p1: Array, P1: Array, p2: Array, P2: Array) -> tuple[Array, Array]:
    """Estimates (N, d) and covariances (N, d, d) that are safe for any correlation of two: weights
    of their information by the least determinant."""
    I1, I2 = np.linalg.inv(P1), np.linalg.inv(P2)
    w = WEIGHTS[:, None, None, None]
    best = np.linalg.slogdet(w * I1 + (1 - w) * I2)[1].argmax(0)
    w = WEIGHTS[best][:, None, None]
    P = np.linalg.inv(w * I1 + (1 - w) * I2)
    told = (w * I1) @ p1[..., None] + ((1 - w) * I2) @ p2[..., None]
    return np.asarray((P @ told)[..., 0]), np.asarray(P)


def _both(a: Objects, b: Objects) -> Objects:
    """Pairs of rows (N,) as one row each; the state is that of the head that places it better."""
    p, P = intersection(a.p_node_m, a.cov_m2, b.p_node_m, b.cov_m2)
    first = np.linalg.det(a.cov_m2) <= np.linalg.det(b.cov_m2)
    x = np.where(first[:, None], a.x, b.x)
    P_x = np.where(first[:, None, None], a.P, b.P)
    older = np.minimum(a.object_id, b.object_id)
    number = np.where(older < 0, np.maximum(a.object_id, b.object_id), older)
    said = (b.kind == UNKNOWN) | ((a.kind != UNKNOWN) & (a.votes >= b.votes))
    kind = np.where(said, a.kind, b.kind)
    return Objects(number, kind, a.votes + b.votes, a.heads + b.heads, p, P, x, P_x)
