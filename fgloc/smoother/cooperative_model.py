"""The cooperative graph in the plane: a chain of states for each road user, the ego car among them.

| variable | what it is |
|---|---|
| s(track, k) | East and North in m, velocity East and North in m/s, of a road user at instant k |
| h(k) | heading of the ego car, rad |
| n(node) | error of a node's survey: East and North in m, yaw in rad; where the survey has sigmas |
| b(source, k) | slow error, where one is stated, of a node or of a road user's own fixes, m |

| factor | between | residual |
|---|---|---|
| motion | s, s | constant velocity, white noise on the acceleration, exact over the step |
| turning | h, h | the heading walks |
| slow error | b, b | it forgets itself (first-order Gauss-Markov) |
| node's sighting | s, and n, b | where the node sees the road user |
| fix | s, and b | where the car's fix, or what another road user says of itself, puts it |
| own sighting | s of the car, s of another, h | where the car sees the other |

All are linear but the last, which is linearised about a heading that is known to a few degrees; a
batch repeats that. Occlusion is no factor; a track that nobody sees for long ends, and another
begins where it is seen again.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np

from fgloc.correspondence.epochs import Epoch
from fgloc.correspondence.rigid import rotation
from fgloc.drive import GnssBias
from fgloc.infrastructure import Node
from fgloc.measurements import Array
from fgloc.smoother.tree import Stamps

ACCEL_DENSITY = 3.0
"""Root of the spectral density of the acceleration, m/s^2 per sqrt(Hz)."""
TURN_DENSITY = 0.1
"""The same of the yaw rate, rad/s per sqrt(Hz)."""
FIRST_SIGMA_M, FIRST_SIGMA_MPS, FIRST_SIGMA_RAD = 1e3, 30.0, 1.0
"""Of what nobody has measured yet."""
DEATH_S = 3.0
"""A track that nobody sees for longer ends."""
_UNIT = {m: gtsam.noiseModel.Unit.Create(m) for m in (1, 2, 3, 4)}
_POSITION = np.eye(2, 4)


def state_key(track: int, k: int) -> int:
    """Of a road user at an instant; there is room for 10 million instants."""
    return int(gtsam.symbol("s", track * 10_000_000 + k))


def heading_key(k: int) -> int:
    """Of the ego car's heading at an instant."""
    return int(gtsam.symbol("h", k))


def survey_key(node: int) -> int:
    """Of the error of a node's survey."""
    return int(gtsam.symbol("n", node))


def slow_key(source: int, k: int) -> int:
    """Of a slow error at an instant: of a track's own fixes, or, below 0, of a node."""
    return int(gtsam.symbol("b" if source >= 0 else "c", abs(source) * 10_000_000 + k))


def of_node(node: int) -> int:
    """The source of a node's slow error."""
    return -1 - node


@dataclass(eq=False)
class Part:
    """Factors and first values that one instant adds, with the keys whose time it moves on."""

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    keys: list[int]


class Builder:
    """Turns instants into factors, one after the other."""

    def __init__(
        self, ego: int, nodes: tuple[Node, ...], slow: Mapping[int, GnssBias] | None = None
    ) -> None:
        self.ego, self.nodes = ego, nodes
        self.slow = dict(slow or {})
        self.slow |= {
            of_node(i): GnssBias(node.bias_sigma_m, node.bias_tau_s)
            for i, node in enumerate(nodes) if node.bias_sigma_m
        }  # fmt: skip
        self.drifting: dict[int, int] = {}  # instant of the last state of each slow error
        self.zeros = gtsam.Values()  # where the factors are linear from
        self.last: dict[int, int] = {}  # instant of the last state of each live track
        self.seen_ns: dict[int, int] = {}
        self.t_ns: list[int] = []
        self.survey: set[int] = set()
        self.heading: int | None = None
        self.factors = 0

    def begin(self, epoch: Epoch, yaw_rad: float) -> Part:
        """The states of an instant, joined to the instant before; tracks are born and die here.

        The heading's chain begins about `yaw_rad`, once one is known.
        """
        k = len(self.t_ns)
        self.t_ns.append(epoch.t_ns)
        part = Part(gtsam.NonlinearFactorGraph(), gtsam.Values(), [])
        sighted = {int(t) for t in (*epoch.track, *epoch.seen, *epoch.told)}
        if epoch.fix_m is not None:
            sighted.add(self.ego)
        for track in sighted:
            self.seen_ns[track] = epoch.t_ns
        alive = [t for t, when in self.seen_ns.items() if epoch.t_ns - when <= DEATH_S * 1e9]
        for track in alive:
            self._state(part, track, k)
        self.last = dict.fromkeys(alive, k)
        self._drift(part, {of_node(int(node)) for node in epoch.node} | set(alive), k)
        self._turn(part, yaw_rad, k)
        return part

    def sightings(self, part: Part, epoch: Epoch, k: int, yaw_rad: float) -> None:
        """All that was measured at instant k, with own sightings linearised about a heading."""
        for i in range(len(epoch.track)):
            self.node_sighting(part, epoch, i, k)
        self.car_sightings(part, epoch, k, yaw_rad)

    def node_sighting(self, part: Part, epoch: Epoch, i: int, k: int) -> None:
        """One sighting of a node."""
        node, key = int(epoch.node[i]), state_key(int(epoch.track[i]), k)
        W = _whitener(epoch.R_m2[i])
        terms = [(key, W @ _POSITION), *self._slowly(of_node(node), k, W)]
        if not self._has_survey(part, node):
            self._add(part, 2, W @ epoch.z_m[i], *terms)
            return
        ray = epoch.z_m[i] - self.nodes[node].p_world_m[:2]
        # What is told is the place and the survey's errors: z = p + d + yaw across the ray.
        off = np.column_stack([np.eye(2), [-ray[1], ray[0]]])
        self._add(part, 2, W @ epoch.z_m[i], *terms, (survey_key(node), W @ off))

    def car_sightings(self, part: Part, epoch: Epoch, k: int, yaw_rad: float) -> None:
        """The car's fix, what others say of theirs, and where it sees others under a heading."""
        ego = state_key(self.ego, k)
        if epoch.fix_m is not None and epoch.fix_R_m2 is not None:
            self._fix(part, self.ego, k, epoch.fix_m, epoch.fix_R_m2)
        for track, z, cov in zip(epoch.told, epoch.told_m, epoch.told_R_m2, strict=True):
            self._fix(part, int(track), k, z, cov)
        if not math.isfinite(yaw_rad) or self.ego not in self.last:
            return
        R = rotation(yaw_rad)
        for track, z, cov in zip(epoch.seen, epoch.seen_m, epoch.seen_R_m2, strict=True):
            W, ray = _whitener(R @ cov @ R.T), R @ z
            turn = np.array([[-ray[1]], [ray[0]]])
            self._add(
                part, 2, W @ (ray - turn[:, 0] * yaw_rad), (ego, -W @ _POSITION),
                (state_key(int(track), k), W @ _POSITION), (heading_key(k), -W @ turn),
            )  # fmt: skip

    def stamps(self, part: Part) -> Stamps:
        """Time in s of each key that a part moves on."""
        t_s = (self.t_ns[-1] - self.t_ns[0]) / 1e9
        return dict.fromkeys((*part.keys, *map(survey_key, self.survey)), t_s)

    def _state(self, part: Part, track: int, k: int) -> None:
        key = state_key(track, k)
        self._new(part, key, 4)
        if track not in self.last:
            W = np.diag([1 / FIRST_SIGMA_M] * 2 + [1 / FIRST_SIGMA_MPS] * 2)
            self._add(part, 4, np.zeros(4), (key, W))
            return
        dt_s = (self.t_ns[k] - self.t_ns[k - 1]) / 1e9
        F, W = motion(dt_s)
        self._add(part, 4, np.zeros(4), (state_key(track, k - 1), -W @ F), (key, W))

    def _fix(self, part: Part, track: int, k: int, z_m: Array, R_m2: Array) -> None:
        """Where a road user says it is."""
        W = _whitener(R_m2)
        terms = ((state_key(track, k), W @ _POSITION), *self._slowly(track, k, W))
        self._add(part, 2, W @ z_m, *terms)

    def _slowly(self, source: int, k: int, W: Array) -> tuple[tuple[int, Array], ...]:
        """The term of a source's slow error, where it has one."""
        return ((slow_key(source, k), W),) if source in self.slow else ()

    def _drift(self, part: Part, begun: set[int], k: int) -> None:
        """Slow errors go on from instant to instant; those of `begun` begin where they have not."""
        for source in (begun & self.slow.keys()) | self.drifting.keys():
            bias, key = self.slow[source], slow_key(source, k)
            self._new(part, key, 2)
            if source not in self.drifting:
                self._add(part, 2, np.zeros(2), (key, np.eye(2) / bias.sigma_m))
            else:
                dt_s = (self.t_ns[k] - self.t_ns[k - 1]) / 1e9
                kept = math.exp(-dt_s / bias.tau_s)
                W = np.eye(2) / (bias.sigma_m * math.sqrt(1 - kept**2))
                before = slow_key(source, self.drifting[source])
                self._add(part, 2, np.zeros(2), (before, -kept * W), (key, W))
            self.drifting[source] = k

    def _turn(self, part: Part, yaw_rad: float, k: int) -> None:
        """The heading's chain, from where one is known."""
        if self.heading is None and not math.isfinite(yaw_rad):
            return
        key = heading_key(k)
        self._new(part, key, 1)
        if self.heading is None:
            W = np.eye(1) / FIRST_SIGMA_RAD
            self._add(part, 1, W[0] * yaw_rad, (key, W))
        else:
            dt_s = (self.t_ns[k] - self.t_ns[k - 1]) / 1e9
            W = np.eye(1) / (TURN_DENSITY * math.sqrt(dt_s))
            self._add(part, 1, np.zeros(1), (heading_key(k - 1), -W), (key, W))
        self.heading = k

    def _has_survey(self, part: Part, node: int) -> bool:
        """Whether a node's survey is uncertain; its variable begins with its first sighting."""
        sigma_m, sigma_rad = self.nodes[node].sigma_position_m, self.nodes[node].sigma_yaw_rad
        if not sigma_m and not sigma_rad:
            return False
        if node not in self.survey:
            self.survey.add(node)
            self._new(part, survey_key(node), 3)
            W = np.diag(1 / np.maximum([sigma_m, sigma_m, sigma_rad], 1e-6))
            self._add(part, 3, np.zeros(3), (survey_key(node), W))
        return True

    def _new(self, part: Part, key: int, size: int) -> None:
        part.values.insert(key, np.zeros(size))
        self.zeros.insert(key, np.zeros(size))
        part.keys.append(key)

    def _add(self, part: Part, size: int, b: Array, *terms: tuple[int, Array]) -> None:
        """A factor |sum A x - b| of whitened rows."""
        flat: list[Any] = [item for term in terms for item in term]
        factor = gtsam.JacobianFactor(*[*flat, b, _UNIT[size]])
        part.graph.add(gtsam.LinearContainerFactor(factor, self.zeros))
        self.factors += 1


def motion(dt_s: float) -> tuple[Array, Array]:
    """F (4, 4) of constant velocity over a step, and the whitener of its noise."""
    F = np.eye(4)
    F[:2, 2:] = dt_s * np.eye(2)
    Q = np.kron([[dt_s**3 / 3, dt_s**2 / 2], [dt_s**2 / 2, dt_s]], np.eye(2)) * ACCEL_DENSITY**2
    return F, _whitener(np.asarray(Q))


def _whitener(cov: Array) -> Array:
    """W with W' W = cov^-1."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(cov)))
