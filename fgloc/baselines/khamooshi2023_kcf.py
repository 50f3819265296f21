"""Methods `khamooshi2023-kcf`: the Kalman-Consensus Filter of car and nodes.

Khamooshi, Cooperative perception and localization for autonomous driving (thesis, Waterloo, 2023),
section 4.4, Algorithm 4.3.

| thesis | here |
|---|---|
| m = {u, U, R}, Eq. (4.10) | `Packet`, bytes on a `Network` |
| y, S, Eq. (4.15) | `Information` |
| x_bar, P, M | `Belief`, predicted and updated |
| gamma, Eq. (4.22) | `consensus.gamma` |

Differs from the paper: state [x, y, vx, vy] of each object (three states are in use there); the
sum holds the car's own measurement; M = (P^-1 + S)^-1; what the car sees is turned by the heading
on which its objects and the nodes' agree. A packet that comes late is put where it belongs and the
steps from there on are done again. Whose number is whose is told by the time of measurement.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from fgloc.baselines.consensus import gamma, gamma_star, rank_of, star
from fgloc.baselines.joint import Belief, Information, model, of_car, of_node
from fgloc.baselines.packets import Network, Packet
from fgloc.correspondence.epochs import Epochs
from fgloc.correspondence.results import TrackStates, cooperative_result
from fgloc.correspondence.tracks import track_objects
from fgloc.drive import Drive
from fgloc.measurements import Array
from fgloc.result import Result
from fgloc.verdicts import Verdict

LATEST_S = 1.0
"""A packet that is older when it arrives is not used."""


@dataclass(frozen=True)
class Sources:
    """Who takes part: the car's own sensors, and nodes by their number (None: all)."""

    car: bool = True
    nodes: tuple[int, ...] | None = None


@dataclass(eq=False)
class _Step:
    """One instant: what the car measured, and what has come of nodes."""

    own: Information
    dt_s: float
    packets: list[Packet] = field(default_factory=list)


def run(drive: Drive) -> Result:
    """The car with all nodes."""
    return run_sources(drive, Sources(), "khamooshi2023-kcf")


def run_onboard(drive: Drive) -> Result:
    """The car alone. Its own number for an object is matched by what nodes see, nothing else."""
    return run_sources(drive, Sources(nodes=()), "khamooshi2023-kcf:onboard")


def run_nodes(drive: Drive) -> Result:
    """All nodes, without the car's own sensors."""
    return run_sources(drive, Sources(car=False), "khamooshi2023-kcf:nodes")


def run_sources(drive: Drive, sources: Sources, method: str = "khamooshi2023-kcf") -> Result:
    """The filter of some sources; DriveError where the drive has no detections of nodes."""
    found = track_objects(drive, method)
    every = range(len(drive.infrastructure.nodes))
    nodes = tuple(every) if sources.nodes is None else sources.nodes
    network = Network()
    local = _nodes_send(found, nodes, network)
    beliefs, late, checks = _car_fuses(found, sources, network, local)
    if not sources.car:
        for name in ("gnss", "relative"):
            if name in found.verdicts:
                found.verdicts[name].set(slice(None), Verdict.UNUSED, f"{method} does not take it")
    for epoch in found.epochs:
        left = ~np.isin(epoch.node, nodes)
        judged = found.verdicts["detections"]
        judged.set(epoch.row[left], Verdict.UNUSED, f"{method} does not take this node")
        behind = [packet.node for packet in late if packet.t_ns == epoch.t_ns]
        judged.set(
            epoch.row[np.isin(epoch.node, behind)],
            Verdict.LATE,
            f"came {LATEST_S:g} s late or more",
        )
    columns = [b.x for b in beliefs], [b.P for b in beliefs], [b.born for b in beliefs]
    return cooperative_result(
        drive, method, found, TrackStates.of_all(*columns), packets=network.sent,
        packets_late=len(late), consensus=checks,
    )  # fmt: skip


def _nodes_send(found: Epochs, nodes: tuple[int, ...], network: Network) -> list[list[Belief]]:
    """Every node's own filter; gives its predictions, and puts its packets on the network."""
    beliefs = [Belief.unborn(found.tracks) for _ in nodes]
    predictions: list[list[Belief]] = []
    last_ns = int(found.t_ns[0])
    for epoch in found.epochs:
        dt_s, last_ns = (epoch.t_ns - last_ns) / 1e9, epoch.t_ns
        predictions.append([])
        for i, node in enumerate(nodes):
            prior = beliefs[i].predicted(dt_s)
            information = of_node(epoch, node, found.tracks)
            beliefs[i] = prior.updated(information)
            predictions[-1].append(prior)
            rows = epoch.node == node
            if rows.any():
                packet = _packet(node, epoch.t_ns, information, prior)
                network.send(packet.encode(), int(epoch.received_ns[rows].max()))
    return predictions


def _packet(node: int, t_ns: int, information: Information, prior: Belief) -> Packet:
    """What the node sees, and what it had predicted of it. Of a new object it predicts nothing."""
    names = np.flatnonzero(information.seen)
    rows = 4 * names[:, None] + np.arange(4)
    x_bar = np.where(prior.born[names][:, None], prior.x[rows], np.nan)
    S = information.S[rows[:, :, None], rows[:, None, :]]
    return Packet(node, t_ns, names, information.y[rows], S, x_bar)


def _car_fuses(
    found: Epochs, sources: Sources, network: Network, local: list[list[Belief]]
) -> tuple[list[Belief], list[Packet], dict[str, float]]:
    """The car's belief at each instant, with what had arrived by then; and what came too late."""
    steps: list[_Step] = []
    states: list[Belief] = []
    told: list[Belief] = []
    late: list[Packet] = []
    index = {int(t): k for k, t in enumerate(found.t_ns)}
    gains, bounds, ranks = [], [], []
    for k, epoch in enumerate(found.epochs):
        dt_s = (epoch.t_ns - found.epochs[max(k - 1, 0)].t_ns) / 1e9
        own = of_car(epoch, found.ego, found.tracks) if sources.car else None
        steps.append(_Step(own or Information.nothing(found.tracks), dt_s))
        first = k
        for packet in map(Packet.decode, network.receive(epoch.t_ns)):
            if epoch.t_ns - packet.t_ns > LATEST_S * 1e9:
                late.append(packet)
                continue
            steps[index[packet.t_ns]].packets.append(packet)
            first = min(first, index[packet.t_ns])
        del states[first:]
        for step in steps[first:]:
            before = states[-1] if states else Belief.unborn(found.tracks)
            states.append(_fuse(before.predicted(step.dt_s), step))
        told.append(states[-1])
        if k and local[k]:
            prior = states[k - 1].predicted(dt_s)
            agents = [(prior, steps[k].own)]
            agents += [(b, _of_packets(steps[k].packets, found.tracks, i))
                       for i, b in enumerate(local[k])]  # fmt: skip
            gains.append(gamma(prior.P[np.ix_(prior.index, prior.index)], dt_s))
            bounds.append(gamma_star(agents, dt_s, star(len(agents))))
        total = _evidence(steps[-1], found.tracks)
        rows = np.ix_(told[-1].index, told[-1].index)
        F = model(max(dt_s, 0.1), found.tracks)[0]
        ranks.append(rank_of(total.S[rows], F[rows]) / max(len(told[-1].index), 1))
    return told, late, _checks(gains, bounds, ranks)


def _fuse(prior: Belief, step: _Step) -> Belief:
    """Algorithm 4.3, from "fuse information" on."""
    information = _evidence(step, len(prior.born))
    rows = prior.index
    pull = np.zeros(len(prior.x))
    if len(rows) and step.packets:
        block = np.ix_(rows, rows)
        apart = sum(_apart(packet, prior) for packet in step.packets)
        pull[rows] = gamma(prior.P[block], step.dt_s) * prior.P[block] @ np.asarray(apart)[rows]
    return prior.updated(information, pull)


def _evidence(step: _Step, tracks: int) -> Information:
    """y and S of the car and of all packets. Eq. (4.15)."""
    return step.own + _of_packets(step.packets, tracks)


def _of_packets(packets: list[Packet], tracks: int, node: int | None = None) -> Information:
    found = Information.nothing(tracks)
    for packet in packets:
        if node is not None and packet.node != node:
            continue
        for name, u, U in zip(packet.name, packet.u, packet.U, strict=True):
            at = slice(4 * name, 4 * name + 4)
            found.y[at] += u
            found.S[at, at] += U
            found.seen[name] = True
    return found


def _apart(packet: Packet, prior: Belief) -> Array:
    """(4K,) x_bar_j - x_bar, of the objects that both had predicted."""
    gap = np.zeros((len(prior.born), 4))
    both = prior.born[packet.name] & np.isfinite(packet.x_bar).all(-1)
    names = packet.name[both]
    gap[names] = packet.x_bar[both] - prior.x.reshape(-1, 4)[names]
    return gap.ravel()


def _checks(gains: list[float], bounds: list[float], ranks: list[float]) -> dict[str, float]:
    """The largest gain, the least bound, and the share of steps that are stable and observable."""
    g, b = np.array(gains), np.array(bounds)
    known = np.isfinite(b)
    return {
        "gamma_max": float(g.max()) if len(g) else math.nan,
        "gamma_star_min": float(b[known].min()) if known.any() else math.nan,
        "stable_share": float((g[known] < b[known]).mean()) if known.any() else math.nan,
        "observable_share": float(np.mean(np.array(ranks) >= 1)),
    }
