"""Method `covariance-intersection`: filters of car and nodes, joined without double counting.

Julier and Uhlmann, A non-divergent estimation algorithm in the presence of unknown correlations
(1997). Nodes and car each filter what they measure themselves; their estimates share a prior and a
process noise and so are correlated in a way that nobody knows. For any correlation, the weighted
sum of information w P_1^-1 + (1 - w) P_2^-1 does not claim too much; w makes its determinant least.
The joint estimate is told, and is not given back to the filters. A node's estimate counts once what
it last saw has arrived, moved on to the instant by the motion model.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from fgloc.baselines.joint import Belief, Information, of_car, of_node
from fgloc.correspondence.epochs import Epoch, Epochs
from fgloc.correspondence.results import TrackStates, cooperative_result
from fgloc.correspondence.tracks import track_objects
from fgloc.drive import Drive
from fgloc.measurements import Array
from fgloc.result import Result
from fgloc.verdicts import Verdict

_WEIGHTS = np.linspace(0.0, 1.0, 51)


def run(drive: Drive) -> Result:
    """Car and all nodes; DriveError where the drive has no detections of nodes."""
    method = "covariance-intersection"
    found = track_objects(drive, method)
    own = _filtered(found, lambda epoch: of_car(epoch, found.ego, found.tracks))
    nodes = [
        _Told(found, node, _filtered(found, partial(of_node, node=node, tracks=found.tracks)))
        for node in range(len(drive.infrastructure.nodes))
    ]
    joined = [
        _joined([belief, *(node.at(epoch.t_ns) for node in nodes)])
        for epoch, belief in zip(found.epochs, own, strict=True)
    ]
    columns = [b.x for b in joined], [b.P for b in joined], [b.born for b in joined]
    return cooperative_result(drive, method, found, TrackStates.of_all(*columns))


def _filtered(found: Epochs, told: Callable[[Epoch], Information]) -> list[Belief]:
    """What one agent believes at each instant by what it measures itself."""
    belief, last_ns, beliefs = Belief.unborn(found.tracks), int(found.t_ns[0]), []
    for epoch in found.epochs:
        belief = belief.predicted((epoch.t_ns - last_ns) / 1e9).updated(told(epoch))
        last_ns = epoch.t_ns
        beliefs.append(belief)
    return beliefs


class _Told:
    """What the car knows of a node's estimates: each from when all of its frame has arrived."""

    def __init__(self, found: Epochs, node: int, beliefs: list[Belief]) -> None:
        self._unborn, self._beliefs, self._t_ns = Belief.unborn(found.tracks), beliefs, found.t_ns
        frames = [epoch.node == node for epoch in found.epochs]
        self._sent = np.flatnonzero([frame.any() for frame in frames])
        self._arrival_ns = np.array(
            [found.epochs[k].received_ns[frames[k]].max() for k in self._sent], np.int64
        )
        never = self._arrival_ns > found.t_ns[-1]
        for k in self._sent[never]:
            rows = found.epochs[k].row[frames[k]]
            found.verdicts["detections"].set(rows, Verdict.LATE, "came after the end")

    def at(self, t_ns: int) -> Belief:
        """The newest estimate that has come, moved on to an instant."""
        come = self._sent[(self._arrival_ns <= t_ns) & (self._t_ns[self._sent] <= t_ns)]
        if not len(come):
            return self._unborn
        k = int(come[-1])
        return self._beliefs[k].predicted((t_ns - int(self._t_ns[k])) / 1e9)


def _joined(beliefs: list[Belief]) -> Belief:
    """Each object by itself: the intersection of all who have seen it."""
    result = Belief.unborn(len(beliefs[0].born))
    for track in range(len(result.born)):
        at = slice(4 * track, 4 * track + 4)
        known = [(b.x[at], b.P[at, at]) for b in beliefs if b.born[track]]
        if not known:
            continue
        x, P = known[0]
        for other in known[1:]:
            x, P = intersection(x, P, *other)
        result.x[at], result.P[at, at], result.born[track] = x, P, True
    return result


def intersection(x1: Array, P1: Array, x2: Array, P2: Array) -> tuple[Array, Array]:
    """The estimate that is safe for any correlation of two: weights by the least determinant."""
    I1, I2 = np.linalg.inv(P1), np.linalg.inv(P2)
    all_ = _WEIGHTS[:, None, None] * I1 + (1 - _WEIGHTS)[:, None, None] * I2
    best = int(np.argmax(np.linalg.slogdet(all_)[1]))
    w, P = _WEIGHTS[best], np.linalg.inv(all_[best])
    return P @ (w * I1 @ x1 + (1 - w) * I2 @ x2), P
