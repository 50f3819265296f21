"""The cooperative graph solved: the whole drive at once, or as it grows, whole or over a fixed lag.

The car and all road users that nodes and the car see; see `cooperative_model`. What the car tells
of others is linear only about a heading: online about the last estimate, in a batch about its own
answer, again and again. A batch also asks again which track a node's sighting is of.
"""

import math
from collections.abc import Iterator
from dataclasses import replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from fgloc.config import SmoothConfig
from fgloc.correspondence.epochs import Epochs
from fgloc.correspondence.results import TrackStates, cooperative_result
from fgloc.correspondence.rigid import wrapped
from fgloc.correspondence.tracks import track_objects
from fgloc.drive import Drive
from fgloc.errors import InputError, SolverError
from fgloc.measurements import Array
from fgloc.result import Event, Result
from fgloc.smoother.cooperative_graph import (
    Builder,
    Grown,
    heading_key,
    slow_key,
    state_key,
    survey_key,
)
from fgloc.smoother.cooperative_lag import Window
from fgloc.smoother.cooperative_model import Roster, of_node, sighted
from fgloc.smoother.cooperative_odometry import own_motion
from fgloc.smoother.cooperative_start import Start
from fgloc.verdicts import Verdict

ROUNDS, STILL_RAD = 8, 1e-3
"""Of a batch: each is linearised about the headings of the one before, until none turns further."""
FAR_BETTER = 50.0
"""Sightings of one frame go to other tracks where the sum of their squares falls by so much."""
_NAMES = {"batch": "graph-batch", "incremental": "graph-incremental", "fixed-lag": "graph-lag"}
Found = tuple[TrackStates, int, dict[int, Array]]
"""What was found of all tracks, the number of factors, and the errors of surveys by node."""


def run_cooperative(drive: Drive, config: SmoothConfig) -> Result:
    """All road users of a drive by the graph, as `config.mode` says.

    Of the configuration the mode and the lag are in force, and what `motion` and `vehicle` say of a
    drive without an IMU. Raises DriveError where the drive has no detections of nodes or the car is
    never found, SolverError where the graph cannot be solved, InputError where `smoothed` is asked
    for.
    """
    if config.smoothed:
        raise InputError(
            "smoothed is not given for drives of several road users; use the mode batch instead"
        )
    method = _NAMES[config.mode]
    found = track_objects(drive, method)
    own = own_motion(drive, config, found)
    if own is not None:
        found = found.with_instants(own.t_ns)
    roster = Roster(found.ego, drive.infrastructure.nodes, found.slow, own)
    try:
        if config.mode == "batch":
            tracks, factors, survey = _batch(found, roster)
        elif config.mode == "incremental":
            tracks, factors, survey = run_online(found, roster, Grown(roster), math.inf)
        else:
            window = Window(roster, config.lag_s)
            tracks, factors, survey = run_online(found, roster, window, config.lag_s)
    except (RuntimeError, np.linalg.LinAlgError) as err:
        raise SolverError(f"drive {drive.name!r}: the cooperative graph: {err}") from err
    if own is not None:
        own.credit(turned=bool(np.isfinite([epoch.yaw_rad for epoch in found.epochs]).any()))
    result = cooperative_result(
        drive, method, found, tracks, causal=config.mode != "batch",
        mode=config.mode, factors=factors, states=len(tracks.track),
        survey={roster.nodes[i].name: offset.tolist() for i, offset in survey.items()},
    )  # fmt: skip
    return replace(result, events=tuple(_remarks(drive, int(found.t_ns[0]))))


def _remarks(drive: Drive, t_ns: int) -> Iterator[Event]:
    """What the drive states and this graph does not take."""
    for what, arm_m in (("antenna", drive.rig.p_veh_ant_m), ("box", drive.rig.p_veh_box_m)):
        if arm_m[:2].any():
            text = (f"the graph of several road users takes the car's {what} to be at its origin; "
                    f"it is {np.hypot(*arm_m[:2]):.2f} m from there")  # fmt: skip
            yield Event(t_ns, "lever-arm", text)
    stood = [node.name for i, node in enumerate(drive.infrastructure.nodes)
             if drive.infrastructure.post_of(i)]  # fmt: skip
    if stood:
        text = f"the graph of several road users takes posts to stand still: {', '.join(stood)}"
        yield Event(t_ns, "posts", text)


def _batch(found: Epochs, roster: Roster) -> Found:
    """Everything at once, linearised again about the headings that were found."""
    headings = _continuous([epoch.yaw_rad for epoch in found.epochs])
    for _ in range(ROUNDS):
        builder = Builder(roster.afresh())
        graph, alive = gtsam.NonlinearFactorGraph(), []
        for k, epoch in enumerate(found.epochs):
            part = builder.begin(epoch, headings[k])
            builder.sightings(part, epoch, k, headings[k])
            graph.push_back(part.graph)
            alive.append(sorted(builder.last.tracks))
        delta = graph.linearize(builder.zeros).optimize()
        known = {k for k in range(len(alive)) if builder.zeros.exists(heading_key(k))}
        turned = 0.0
        for k in known:
            heading = float(delta.at(heading_key(k))[0])
            turned, headings[k] = max(turned, abs(heading - headings[k])), heading
        revised = _revise(found, alive, delta)
        if not known and roster.own is not None:
            courses = _courses(roster, found, alive, delta)
            headings = roster.own.headings(found.t_ns, courses).tolist()
            turned = 0.0 if np.isnan(headings).all() else math.inf
        if turned < STILL_RAD and not revised:
            break
    marginals = gtsam.Marginals(graph, builder.zeros.retract(delta))
    for k, epoch in enumerate(found.epochs):
        epoch.yaw_rad = epoch.yaw_var = math.nan
        if k in known:
            epoch.yaw_rad = wrapped(headings[k])
            epoch.yaw_var = float(marginals.marginalCovariance(heading_key(k))[0, 0])
    instant = np.repeat(np.arange(len(alive)), [len(tracks) for tracks in alive])
    track = np.concatenate(alive).astype(np.int64)
    keys = [state_key(int(t), int(k)) for k, t in zip(instant, track, strict=True)]
    states = TrackStates(instant, track, np.array([delta.at(key) for key in keys]),
                         np.array([marginals.marginalCovariance(key) for key in keys]))  # fmt: skip
    return states, builder.factors, {i: delta.at(survey_key(i)) for i in builder.survey}


def _courses(
    roster: Roster, found: Epochs, alive: list[list[int]], delta: gtsam.VectorValues
) -> Array:
    """(n,) heading of the car where it drives, rad; NaN elsewhere."""
    courses = np.full(len(alive), np.nan)
    for k, tracks in enumerate(alive):
        if roster.own is not None and roster.ego in tracks:
            state = delta.at(state_key(roster.ego, k))
            courses[k] = roster.own.course(found.epochs[k].t_ns, state)
    return courses


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


def run_online(found: Epochs, roster: Roster, graph: Grown | Window, lag_s: float) -> Found:
    """Instant by instant; sightings of nodes enter when they arrive, at the state they are of.

    Those that are older than `lag_s` get their verdicts, and the instants their headings.
    """
    *arriving, never = _arrivals(found)
    states: list[TrackStates] = []
    told: set[int] = set()
    yaw, start = math.nan, Start(roster.ego, roster.own)
    for k, (epoch, arrived) in enumerate(zip(found.epochs, arriving, strict=True)):
        oldest_ns = epoch.t_ns - lag_s * 1e9
        in_time = {of: rows for of, rows in arrived.items() if found.epochs[of].t_ns >= oldest_ns}
        for of in arrived.keys() - in_time.keys():
            _late(found, of, arrived[of], f"came later than the lag of {lag_s:g} s")
        if not math.isfinite(yaw):
            yaw = (
                epoch.yaw_rad
                if math.isfinite(epoch.yaw_rad)
                else start.heading(
                    epoch, [(found.epochs[of], rows) for of, rows in in_time.items()]
                )
            )
        graph.update(epoch, yaw, in_time)
        told |= sighted(replace(epoch, track=np.empty(0, np.int64)), found.ego)
        for of, rows in in_time.items():
            told |= set(found.epochs[of].track[rows].tolist())
        tracks = sorted(told & set(graph.tracks))
        instant = np.full(len(tracks), k)
        states.append(TrackStates(instant, np.array(tracks, np.int64), *graph.states(tracks)))
        yaw, epoch.yaw_var = graph.heading()
        epoch.yaw_rad = wrapped(yaw) if math.isfinite(yaw) else yaw
    end_ns = found.epochs[-1].t_ns
    for of, rows in never.items():
        for i in rows:
            after_s = (found.epochs[of].received_ns[i] - end_ns) / 1e9
            _late(found, of, np.array([i]), f"came {after_s:.2f} s after the end")
    return TrackStates.joined(states), graph.factors, graph.survey()


def _arrivals(found: Epochs) -> list[dict[int, NDArray[np.int64]]]:
    """For each instant, and for after the last: the instants that are told of, and which rows."""
    arriving: list[dict[int, NDArray[np.int64]]] = [{} for _ in range(len(found.epochs) + 1)]
    for k, epoch in enumerate(found.epochs):
        at = np.searchsorted(found.t_ns, np.maximum(epoch.received_ns, epoch.t_ns))
        for one in np.unique(at):
            arriving[one][k] = np.flatnonzero(at == one)
    return arriving


def _late(found: Epochs, k: int, rows: NDArray[np.int64], reason: str) -> None:
    """Sightings of an instant that are not used."""
    found.verdicts["detections"].set(found.epochs[k].row[rows], Verdict.LATE, reason)


def _continuous(headings: list[float]) -> list[float]:
    """Headings without jumps by a turn; NaN before the first that is known."""
    result, last = [], math.nan
    for heading in headings:
        if math.isfinite(heading):
            near = last if math.isfinite(last) else 0.0
            last = near + wrapped(heading - near)
        result.append(last)
    return result
