"""The cooperative graph in the plane: a chain of states for each road user, the ego car among them.

| variable | what it is |
|---|---|
| s(track, k) | East and North in m, velocity East and North in m/s, of a road user at instant k |
| h(k) | heading of the ego car, rad |
| n(node) | error of a node's survey: East and North in m, yaw in rad; where the survey has sigmas |
| b(source, k) | slow error, where one is stated, of a node or of a road user's own fixes, m |
| o(k) | errors of the car's yaw rate, rad/s, and of its wheels' scale; where it tells these |

| factor | between | residual |
|---|---|---|
| motion | s, s | constant velocity, white noise on the acceleration, exact over the step |
| turning | h, h, and o | the heading walks, or turns as the car says |
| rolling | s, h, o | the wheels' speed along the heading, none sideways |
| slow error | b, b | it forgets itself (first-order Gauss-Markov) |
| node's sighting | s, and n, b | where the node sees the road user |
| fix | s, and b | where the car's fix, or what another road user says of itself, puts it |
| own sighting | s of the car, s of another, h | where the car sees the other |

All are linear but the last and rolling, which are linearised about a heading that is known to a few
degrees; a batch repeats that. Occlusion is no factor; a track that nobody sees for long ends, and
another begins where it is seen again. The car's goes on while it tells of its own motion.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from fgloc.correspondence.epochs import Epoch
from fgloc.correspondence.rigid import rotation
from fgloc.drive import GnssBias
from fgloc.factors.gnss import bias_transition
from fgloc.infrastructure import Node
from fgloc.measurements import Array
from fgloc.smoother.cooperative_odometry import OwnMotion

ACCEL_DENSITY = 3.0
"""Root of the spectral density of the acceleration, m/s^2 per sqrt(Hz)."""
TURN_DENSITY = 0.1
"""The same of the yaw rate, rad/s per sqrt(Hz)."""
FIRST_SIGMA_M, FIRST_SIGMA_MPS, FIRST_SIGMA_RAD = 1e3, 30.0, 1.0
"""Of what nobody has measured yet."""
FIRST_SIGMAS = np.array([FIRST_SIGMA_M] * 2 + [FIRST_SIGMA_MPS] * 2)
DEATH_S = 3.0
"""A track that nobody sees for longer ends."""
LEAST_SIGMA = 1e-6
"""Of a survey that is uncertain in one respect alone: m or rad."""


Number = TypeVar("Number", int, NDArray[np.int64])


def of_node(node: Number) -> Number:
    """The source of a node's slow error; that of a track's own fixes is the track."""
    return -1 - node


@dataclass(frozen=True, eq=False)
class Call:
    """Who lives at an instant: tracks, the sources of slow errors, and whether a heading is known.

    dt_s   since the instant before, 0 at the first
    turn   how far the car turned since, rad, and its variance
    rolls  whether the errors of its yaw rate and of its wheels live
    """

    t_ns: int
    dt_s: float
    tracks: list[int]
    sources: list[int]
    heading: bool
    turn: tuple[float, float] = (0.0, 0.0)
    rolls: bool = False


class Roster:
    """Births and deaths; and the constants of nodes and of slow errors."""

    def __init__(
        self, ego: int, nodes: tuple[Node, ...], slow: Mapping[int, GnssBias] | None = None,
        own: OwnMotion | None = None,
    ) -> None:  # fmt: skip
        self.ego, self.nodes, self.own = ego, nodes, own
        self.slow = dict(slow or {})
        self.slow |= {
            of_node(i): GnssBias(node.bias_sigma_m, node.bias_tau_s)
            for i, node in enumerate(nodes) if node.bias_sigma_m
        }  # fmt: skip
        self._seen_ns: dict[int, int] = {}
        self._sources: set[int] = set()
        self._heading = False
        self._last_ns: int | None = None

    def afresh(self) -> "Roster":
        """The same constants, before the first instant."""
        return Roster(self.ego, self.nodes, self.slow, self.own)

    def call(self, epoch: Epoch, yaw_rad: float) -> Call:
        """Who lives at the next instant; a heading does once a finite yaw was given."""
        t_ns, last_ns = epoch.t_ns, epoch.t_ns if self._last_ns is None else self._last_ns
        self._heading = self._heading or math.isfinite(yaw_rad)
        self._seen_ns |= dict.fromkeys(sighted(epoch, self.ego), t_ns)
        if self._goes_on(t_ns, last_ns):
            self._seen_ns[self.ego] = t_ns
        tracks = [t for t, when in self._seen_ns.items() if t_ns - when <= DEATH_S * 1e9]
        begun = {of_node(int(node)) for node in epoch.node} | set(tracks)
        self._sources |= begun & self.slow.keys()
        self._last_ns, dt_s = t_ns, (t_ns - last_ns) / 1e9
        turn = 0.0, TURN_DENSITY**2 * dt_s
        if self.own is not None:
            turn = self.own.turn(last_ns, t_ns)
        rolls = self._heading and self.own is not None
        return Call(t_ns, dt_s, tracks, sorted(self._sources), self._heading, turn, rolls)

    def _goes_on(self, t_ns: int, last_ns: int) -> bool:
        """Whether the car, alive just before, tells how it moves itself."""
        seen_ns = self._seen_ns.get(self.ego)
        alive = seen_ns is not None and last_ns - seen_ns <= DEATH_S * 1e9
        return alive and self._heading and self.own is not None and self.own.tells(t_ns)

    def survey_sigma(self, node: int) -> Array | None:
        """(3,) m, m, rad of a node's survey; None where it is certain."""
        one = self.nodes[node]
        sigma = np.array([one.sigma_position_m] * 2 + [one.sigma_yaw_rad])
        return np.maximum(sigma, LEAST_SIGMA) if sigma.any() else None


def sighted(epoch: Epoch, ego: int) -> set[int]:
    """Tracks of which anybody tells at an instant."""
    tracks = {int(track) for track in (*epoch.track, *epoch.seen, *epoch.told)}
    return tracks | {ego} if epoch.fix_m is not None else tracks


def motion(dt_s: float) -> tuple[Array, Array]:
    """F and Q (4, 4) of constant velocity over a step."""
    F, Q = np.eye(4), np.zeros((4, 4))
    F[[0, 1], [2, 3]] = dt_s
    Q[[0, 1], [0, 1]] = dt_s**3 / 3
    Q[[0, 1, 2, 3], [2, 3, 0, 1]] = dt_s**2 / 2
    Q[[2, 3], [2, 3]] = dt_s
    return F, Q * ACCEL_DENSITY**2


def forgetting(bias: GnssBias, dt_s: float) -> tuple[float, float]:
    """What is kept of a slow error over a step, and the variance in m^2 of what is new."""
    kept, sigma_m = bias_transition(dt_s, bias.sigma_m, bias.tau_s)
    return float(kept), float(sigma_m) ** 2


def off_survey(z_m: Array, p_world_m: Array) -> Array:
    """(n, 2, 3) by which places (n, 2) that nodes at (n, 2) tell are off, per survey error.

    z = p + d + yaw across the ray.
    """
    ray = z_m - p_world_m
    off = np.zeros((len(z_m), 2, 3))
    off[:, [0, 1], [0, 1]] = 1
    off[:, 0, 2], off[:, 1, 2] = -ray[:, 1], ray[:, 0]
    return off


def own_sightings(epoch: Epoch, yaw_rad: float) -> tuple[Array, Array, Array]:
    """Of what the car sees: z = R ray - turn yaw (m, 2), turn (m, 2, 1), whiteners (m, 2, 2).

    z is the other's place less the car's less turn times the heading.
    """
    R = rotation(yaw_rad)
    ray = epoch.seen_m @ R.T
    turn = np.stack([-ray[:, 1], ray[:, 0]], -1)
    return ray - turn * yaw_rad, turn[..., None], whitener(R @ epoch.seen_R_m2 @ R.T)


def whitener(cov: Array) -> Array:
    """W (..., d, d) with W' W = cov^-1."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(cov)))
