"""Method `covariance-intersection`: filters of car and nodes, joined without double counting.

Julier and Uhlmann, A non-divergent estimation algorithm in the presence of unknown correlations
(1997). Nodes and car each filter what they measure themselves; their estimates share a prior and a
process noise and so are correlated in a way that nobody knows. For any correlation, the weighted
sum of information w P_1^-1 + (1 - w) P_2^-1 does not claim too much; w makes its determinant least.
The joint estimate is told, and is not given back to the filters.
"""

import numpy as np

from fgloc.baselines.joint import Belief, of_car, of_node
from fgloc.correspondence.results import TrackStates, cooperative_result
from fgloc.correspondence.tracks import track_objects
from fgloc.drive import Drive
from fgloc.measurements import Array
from fgloc.result import Result

_WEIGHTS = np.linspace(0.0, 1.0, 51)


def run(drive: Drive) -> Result:
    """Car and all nodes; DriveError where the drive has no detections of nodes.

    What nodes tell counts at the instant when it was true; latency is not regarded.
    """
    method = "covariance-intersection"
    found = track_objects(drive, method)
    agents = range(-1, len(drive.infrastructure.nodes))
    beliefs = {agent: Belief.unborn(found.tracks) for agent in agents}
    x, P, born = [], [], []
    last_ns = int(found.t_ns[0])
    for epoch in found.epochs:
        dt_s, last_ns = (epoch.t_ns - last_ns) / 1e9, epoch.t_ns
        for agent in agents:
            seen = (
                of_car(epoch, found.ego, found.tracks) if agent < 0
                else of_node(epoch, agent, found.tracks)
            )  # fmt: skip
            beliefs[agent] = beliefs[agent].predicted(dt_s).updated(seen)
        joined = _joined(list(beliefs.values()))
        x.append(joined.x)
        P.append(joined.P)
        born.append(joined.born)
    return cooperative_result(drive, method, found, TrackStates.of_all(x, P, born))


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
