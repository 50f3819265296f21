"""The cooperative graph solved: the whole drive at once, or iSAM2 as it grows or over a fixed lag.

The car and all road users that nodes and the car see; see `cooperative_model`. What the car tells
of others is linear only about a heading: online about the last estimate, in a batch about its own
answer, again and again. A batch also asks again which track a node's sighting is of.
"""

import math

import gtsam
import numpy as np
from numpy.typing import NDArray

from fgloc.config import SmoothConfig
from fgloc.correspondence.epochs import Epochs
from fgloc.correspondence.results import cooperative_result
from fgloc.correspondence.rigid import wrapped
from fgloc.correspondence.tracks import track_objects
from fgloc.drive import Drive
from fgloc.errors import InputError, SolverError
from fgloc.infrastructure import Node
from fgloc.measurements import Array
from fgloc.result import Result
from fgloc.smoother.cooperative_model import (
    Builder,
    heading_key,
    of_node,
    slow_key,
    state_key,
    survey_key,
)
from fgloc.verdicts import Verdict

ROUNDS, STILL_RAD = 8, 1e-3
"""Of a batch: each is linearised about the headings of the one before, until none turns further."""
FAR_BETTER = 50.0
"""Sightings of one frame go to other tracks where the sum of their squares falls by so much."""
_NAMES = {"batch": "graph-batch", "incremental": "graph-incremental", "fixed-lag": "graph-lag"}
_FOREVER_S = 1e9


class Beliefs:
    """What is believed of all tracks at each instant: x (4K,), P (4K, 4K), born (K,), heading."""

    def __init__(self, instants: int, tracks: int) -> None:
        self.x = [np.zeros(4 * tracks) for _ in range(instants)]
        self.P = [np.eye(4 * tracks) for _ in range(instants)]
        self.born: list[NDArray[np.bool_]] = [np.zeros(tracks, bool) for _ in range(instants)]
        self.yaw = [(math.nan, math.nan)] * instants

    def set(self, k: int, track: int, mean: Array, cov: Array) -> None:
        """The belief of one track at one instant."""
        at = slice(4 * track, 4 * track + 4)
        self.x[k][at], self.P[k][at, at], self.born[k][track] = mean, (cov + cov.T) / 2, True


def run_cooperative(drive: Drive, config: SmoothConfig) -> Result:
    """All road users of a drive by the graph, as `config.mode` says.

    Of the configuration only the mode and the lag are in force. Raises DriveError where the drive
    has no detections of nodes or the car is never found,
    SolverError where the graph cannot be solved, InputError where `smoothed` is asked for.
    """
    if config.smoothed:
        raise InputError(
            "smoothed is not given for drives of several road users; use the mode batch instead"
        )
    method = _NAMES[config.mode]
    found = track_objects(drive, method)
    nodes = drive.infrastructure.nodes
    beliefs = Beliefs(len(found.epochs), found.tracks)
    try:
        if config.mode == "batch":
            factors, survey = _batch(found, nodes, beliefs)
        else:
            lag_s = config.lag_s if config.mode == "fixed-lag" else _FOREVER_S
            factors, survey = _online(found, nodes, beliefs, lag_s)
    except RuntimeError as err:
        raise SolverError(f"drive {drive.name!r}: the cooperative graph: {err}") from err
    for epoch, (mean, variance) in zip(found.epochs, beliefs.yaw, strict=True):
        epoch.yaw_rad, epoch.yaw_var = mean, variance
    states = int(sum(born.sum() for born in beliefs.born))
    causal = config.mode != "batch"
    return cooperative_result(
        drive, method, found, beliefs.x, beliefs.P, beliefs.born, causal=causal,
        mode=config.mode, factors=factors, states=states,
        survey={nodes[i].name: offset.tolist() for i, offset in survey.items()},
    )  # fmt: skip


def _batch(
    found: Epochs, nodes: tuple[Node, ...], beliefs: Beliefs
) -> tuple[int, dict[int, Array]]:
    """Everything at once, linearised again about the headings that were found."""
    headings = _continuous([epoch.yaw_rad for epoch in found.epochs])
    for _ in range(ROUNDS):
        builder = Builder(found.ego, nodes, found.slow)
        graph, alive = gtsam.NonlinearFactorGraph(), []
        for k, epoch in enumerate(found.epochs):
            part = builder.begin(epoch, headings[k])
            builder.sightings(part, epoch, k, headings[k])
            graph.push_back(part.graph)
            alive.append(sorted(builder.last))
        delta = graph.linearize(builder.zeros).optimize()
        known = [k for k in range(len(alive)) if builder.zeros.exists(heading_key(k))]
        turned = 0.0
        for k in known:
            heading = float(delta.at(heading_key(k))[0])
            turned, headings[k] = max(turned, abs(heading - headings[k])), heading
        revised = _revise(found, alive, delta)
        if turned < STILL_RAD and not revised:
            break
    marginals = gtsam.Marginals(graph, builder.zeros.retract(delta))
    for k, tracks in enumerate(alive):
        for track in tracks:
            key = state_key(track, k)
            beliefs.set(k, track, delta.at(key), marginals.marginalCovariance(key))
    for k in known:
        variance = float(marginals.marginalCovariance(heading_key(k))[0, 0])
        beliefs.yaw[k] = (wrapped(headings[k]), variance)
    return builder.factors, {i: delta.at(survey_key(i)) for i in builder.survey}


def _revise(found: Epochs, alive: list[list[int]], delta: gtsam.VectorValues) -> bool:
    """Give sightings of nodes to the tracks on which they fall, where that is far better.

    Whether any went to another.

    A node that mixes up two numbers for a moment shows only against the whole drive.
    """
    from scipy.optimize import linear_sum_assignment

    revised = False
    for k, epoch in enumerate(found.epochs):
        tracks = np.array(alive[k])
        place = np.array([delta.at(state_key(int(track), k))[:2] for track in tracks])
        for node in np.unique(epoch.node):
            rows = np.flatnonzero(epoch.node == node)
            key = slow_key(of_node(int(node)), k)
            slow_m = delta.at(key) if delta.exists(key) else np.zeros(2)
            gap = epoch.z_m[rows][:, None] - slow_m - place
            W = np.linalg.inv(epoch.R_m2[rows])
            cost = np.einsum("nti,nij,ntj->nt", gap, W, gap)
            own, theirs = linear_sum_assignment(cost)
            now = cost[np.arange(len(rows)), np.searchsorted(tracks, epoch.track[rows])]
            if cost[own, theirs].sum() < now.sum() - FAR_BETTER:
                epoch.track[rows[own]] = tracks[theirs]
                revised = True
    return revised


def _online(
    found: Epochs, nodes: tuple[Node, ...], beliefs: Beliefs, lag_s: float
) -> tuple[int, dict[int, Array]]:
    """Instant by instant; sightings of nodes enter when they arrive, at the state they are of."""
    builder = Builder(found.ego, nodes, found.slow)
    tree = new_tree(lag_s, close=bool(found.users))  # users have clocks of their own
    waiting: list[tuple[int, int, int]] = []  # arrival, instant, row of the instant
    sighted: set[int] = set()
    yaw = math.nan
    for k, epoch in enumerate(found.epochs):
        about = yaw if math.isfinite(yaw) else epoch.yaw_rad
        part = builder.begin(epoch, about)
        waiting += [(int(at), k, i) for i, at in enumerate(epoch.received_ns)]
        due = [one for one in waiting if one[0] <= epoch.t_ns]
        waiting = [one for one in waiting if one[0] > epoch.t_ns]
        for _, of, i in due:
            late = found.epochs[of]
            if (epoch.t_ns - late.t_ns) / 1e9 > lag_s:
                reason = f"came later than the lag of {lag_s:g} s"
                found.verdicts["detections"].set(late.row[i], Verdict.LATE, reason)
                continue
            builder.node_sighting(part, late, i, of)
            sighted.add(int(late.track[i]))
        builder.car_sightings(part, epoch, k, about)
        sighted |= {int(track) for track in (*epoch.seen, *epoch.told)}
        if epoch.fix_m is not None:
            sighted.add(found.ego)
        tree.update(part.graph, part.values, builder.stamps(part))
        for track in sorted(builder.last.keys() & sighted):
            beliefs.set(k, track, *_estimate(tree, state_key(track, k)))
        if builder.heading == k:
            mean, variance = _estimate(tree, heading_key(k))
            yaw = float(mean[0])
            beliefs.yaw[k] = (wrapped(yaw), float(variance[0, 0]))
    for at, of, i in waiting:
        reason = f"came {(at - found.epochs[-1].t_ns) / 1e9:.2f} s after the end"
        found.verdicts["detections"].set(found.epochs[of].row[i], Verdict.LATE, reason)
    return builder.factors, {i: tree.calculateEstimateVector(survey_key(i)) for i in builder.survey}


def new_tree(lag_s: float, *, close: bool = False) -> gtsam.IncrementalFixedLagSmoother:
    """iSAM2 over a lag. All factors are linear where they stand, so nothing is relinearised.

    Where instants may be `close`, a fraction of a millisecond apart, it takes QR, which is slower.
    """
    params = gtsam.ISAM2Params()
    params.setRelinearizeThreshold(1e9)
    params.findUnusedFactorSlots = True
    if close:
        params.setFactorization("QR")
    return gtsam.IncrementalFixedLagSmoother(lag_s, params)


def _estimate(tree: gtsam.IncrementalFixedLagSmoother, key: int) -> tuple[Array, Array]:
    return tree.calculateEstimateVector(key), tree.getISAM2().marginalCovariance(key)


def _continuous(headings: list[float]) -> list[float]:
    """Headings without jumps by a turn; NaN before the first that is known."""
    result, last = [], math.nan
    for heading in headings:
        if math.isfinite(heading):
            near = last if math.isfinite(last) else 0.0
            last = near + wrapped(heading - near)
        result.append(last)
    return result
