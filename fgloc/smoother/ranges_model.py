"""The planar graph of a vehicle that measures ranges: states, globals, and what ties them.

    states   (N, m), at even epochs; columns 0 and 1 are the tag's East and North in m
    globals  (G,): scale of the ranges, height of the tag in m, yaw-rate bias in rad/s, and a bias
             in m of the ranges to each anchor

A range is true between two epochs and is tied to both, along the straight line between them. Two
motions: a velocity that stays about the same (m = 4, East and North in m/s), or odometry (m = 3,
yaw in rad), which is what the drive tells decides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from fgloc.factors.noise import cost, weight
from fgloc.factors.ranging import residual
from fgloc.frames import wrap_pi
from fgloc.measurements import Array, Odometry, Ranges
from fgloc.timing import Instants

SCALE, HEIGHT, TURN, BIASES = 0, 1, 2, 3
"""Where the globals stand."""


@dataclass(frozen=True)
class RangeSettings:
    """What the graph takes for granted; sigmas of the globals are of their priors.

    interval_s          between epochs
    accel_mps2_per_sqrt_hz  white acceleration where there is no odometry
    slip_m_per_sqrt_s   of odometry, across
    loss_width          of the Cauchy loss on a range, in sigmas
    """

    interval_s: float = 0.2
    accel_mps2_per_sqrt_hz: float = 0.5
    slip_m_per_sqrt_s: float = 0.02
    loss_width: float = 2.0
    scale_sigma: float = 0.1
    bias_sigma_m: float = 0.3
    height_m: float = 1.0
    height_sigma_m: float = 0.5
    turn_sigma_radps: float = 0.01
    start_sigma: float = 1e3


class Between(NamedTuple):
    """Whitened errors (R, k) that tie a state, the next and the globals, and their Jacobians by
    these (R, k, m), (R, k, m), (R, k, G)."""

    error: Array
    by_first: Array
    by_second: Array
    by_globals: Array


class Motion(Protocol):
    """What carries the states of a window of epochs from one to the next."""

    @property
    def size(self) -> int:
        """How many numbers a state has."""
        ...

    def between(self, states: Array, globals_: Array, first: int) -> Between:
        """Steps (N - 1) of states (N, m) at the epochs from `first` on."""
        ...

    def predict(self, state: Array, globals_: Array, epoch: int) -> Array:
        """The state (m,) at the epoch after `epoch`."""
        ...


class WindowModel(Protocol):
    """A planar graph that is solved window by window."""

    @property
    def epochs_ns(self) -> Instants:
        """(N,) even instants of the states."""
        ...

    @property
    def motion(self) -> Motion:
        """What ties each state to the next."""
        ...

    @property
    def interval_s(self) -> float:
        """Between epochs."""
        ...

    @property
    def start_sigma(self) -> float:
        """Of a prior on the first state that says next to nothing."""
        ...

    @property
    def prior(self) -> tuple[Array, Array]:
        """Means and standard deviations (G,) of the globals."""
        ...

    def linearize(self, states: Array, globals_: Array, first: int) -> Blocks:
        """All that ties the states (N, m) from the epoch `first` on, without priors."""
        ...


@dataclass(frozen=True, eq=False)
class ConstantVelocity:
    """White noise on the acceleration, of a density in m/s^2 per sqrt(Hz), over even steps."""

    dt_s: float
    accel: float
    size: int = 4

    def _step(self) -> Array:
        return np.block([[np.eye(2), self.dt_s * np.eye(2)], [np.zeros((2, 2)), np.eye(2)]])

    def between(self, states: Array, globals_: Array, first: int) -> Between:
        """See `Motion`."""
        dt, n = self.dt_s, len(states) - 1
        cov = np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], np.eye(2)) * self.accel**2
        root = np.linalg.inv(np.linalg.cholesky(cov))
        F = self._step()
        error = (states[1:] - states[:-1] @ F.T) @ root.T
        by_first, by_second = (np.broadcast_to(J, (n, 4, 4)) for J in (-root @ F, root))
        return Between(error, by_first, by_second, np.zeros((n, 4, len(globals_))))

    def predict(self, state: Array, globals_: Array, epoch: int) -> Array:
        """See `Motion`."""
        return self._step() @ state


@dataclass(frozen=True, eq=False)
class OdometrySteps:
    """Ways (N - 1,) in m and turns (N - 1,) in rad between epochs, their sigmas (N - 1, 3) ahead,
    aside and in yaw, and how long each step takes."""

    way_m: Array
    turn_rad: Array
    sigmas: Array
    dt_s: float
    size: int = 3

    @classmethod
    def of(cls, table: Odometry, epochs_ns: Instants, slip: float) -> OdometrySteps:
        """The odometry summed up between epochs; rates hold half way to their neighbours."""
        t_s, at_s = ((t - epochs_ns[0]) / 1e9 for t in (table.t_ns, epochs_ns))
        edges = np.r_[t_s[0] - 1e3, (t_s[1:] + t_s[:-1]) / 2, t_s[-1] + 1e3]
        told = np.stack([table.speed_mps, table.yaw_rate_radps], -1)
        sums = np.r_[np.zeros((1, 2)), np.cumsum(told * np.diff(edges)[:, None], axis=0)]
        way, turn = (np.diff(np.interp(at_s, edges, sums[:, i])) for i in range(2))
        dt_s, every_s = float(at_s[1] - at_s[0]), float(np.median(np.diff(t_s)))
        root = np.sqrt(dt_s * every_s)
        sigma_way, sigma_turn = (
            float(np.median(s)) * root for s in (table.sigma_speed_mps, table.sigma_yaw_rate_radps)
        )
        sigmas = np.tile([sigma_way, slip * np.sqrt(dt_s), sigma_turn], (len(way), 1))
        return cls(way, turn, sigmas, dt_s)

    def between(self, states: Array, globals_: Array, first: int) -> Between:
        """See `Motion`. The step is a chord: half the turn, the way, half the turn."""
        n = len(states) - 1
        steps = slice(first, first + n)
        turn = self.turn_rad[steps] - globals_[TURN] * self.dt_s
        way = self.way_m[steps]
        c, s = np.cos(states[:-1, 2]), np.sin(states[:-1, 2])
        back = np.stack([np.stack([c, s], -1), np.stack([-s, c], -1)], 1)
        apart = states[1:, :2] - states[:-1, :2]
        local = np.einsum("nij,nj->ni", back, apart)
        half = np.stack([np.cos(turn / 2), np.sin(turn / 2)], -1) * way[:, None]
        error = np.c_[local - half, wrap_pi(states[1:, 2] - states[:-1, 2] - turn)]
        by_first, by_second = np.zeros((2, n, 3, 3))
        by_first[:, :2, :2], by_second[:, :2, :2] = -back, back
        by_first[:, 0, 2], by_first[:, 1, 2] = local[:, 1], -local[:, 0]
        by_first[:, 2, 2], by_second[:, 2, 2] = -1, 1
        by_globals = np.zeros((n, 3, len(globals_)))
        by_globals[:, 0, TURN] = -half[:, 1] * self.dt_s / 2
        by_globals[:, 1, TURN] = half[:, 0] * self.dt_s / 2
        by_globals[:, 2, TURN] = self.dt_s
        root = 1 / self.sigmas[steps]
        by_first, by_second, by_globals = (
            J * root[:, :, None] for J in (by_first, by_second, by_globals)
        )
        return Between(error * root, by_first, by_second, by_globals)

    def predict(self, state: Array, globals_: Array, epoch: int) -> Array:
        """See `Motion`."""
        turn = self.turn_rad[epoch] - globals_[TURN] * self.dt_s
        course = state[2] + turn / 2
        way = self.way_m[epoch] * np.array([np.cos(course), np.sin(course)])
        return np.r_[state[:2] + way, state[2] + turn]


@dataclass(frozen=True, eq=False)
class RangeModel:
    """A drive as the graph takes it.

    epochs_ns  (N,) even
    ranges     (M,) rows in the order of time, all within the epochs
    epoch      (M,) the epoch before each range; share (M,) how far it is to the one after
    place_m    (M, 3) the anchor of each
    first_row  (N,) the first range after each epoch
    """

    epochs_ns: Instants
    ranges: Ranges
    epoch: NDArray[np.int64]
    share: Array
    place_m: Array
    first_row: NDArray[np.int64]
    motion: Motion
    settings: RangeSettings
    anchors: int

    @property
    def prior(self) -> tuple[Array, Array]:
        """Means and standard deviations (G,) of the globals."""
        s = self.settings
        mean = np.r_[1.0, s.height_m, 0.0, np.zeros(self.anchors)]
        sigma = np.r_[s.scale_sigma, s.height_sigma_m, s.turn_sigma_radps,
                      np.full(self.anchors, s.bias_sigma_m)]  # fmt: skip
        return mean, sigma

    @property
    def interval_s(self) -> float:
        """Between epochs."""
        return self.settings.interval_s

    @property
    def start_sigma(self) -> float:
        """Of the prior on the first state."""
        return self.settings.start_sigma

    def linearize(self, states: Array, globals_: Array, first: int) -> Blocks:
        """Motion and ranges of a window of states (N, m) from the epoch `first` on."""
        blocks = motion_blocks(self.motion, states, globals_, first)
        if len(states) > 1:
            rows = slice(self.first_row[first], self.first_row[first + len(states) - 1])
            told = range_errors(self, states, globals_, first, rows)
            add_robust(blocks, self.epoch[rows] - first, told, self.settings.loss_width)
        return blocks


@dataclass(eq=False)
class Blocks:
    """Normal equations of a window: H of the states is block-tridiagonal, the globals tie to all.

    diagonal (N, m, m), beside (N - 1, m, m) of a state with the next, tied (N, m, G), globals_
    (G, G); gradients (N, m) and (G,); what the errors cost, half their square under the loss
    """

    diagonal: Array
    beside: Array
    tied: Array
    globals_: Array
    gradient: Array
    gradient_globals: Array
    cost: float


def motion_blocks(motion: Motion, states: Array, globals_: Array, first: int) -> Blocks:
    """The motion of a window of states (N, m) from the epoch `first` on."""
    n, m = states.shape
    blocks = Blocks(
        np.zeros((n, m, m)), np.zeros((n - 1, m, m)), np.zeros((n, m, len(globals_))),
        np.zeros((len(globals_),) * 2), np.zeros((n, m)), np.zeros(len(globals_)), 0.0,
    )  # fmt: skip
    if n > 1:
        step = motion.between(states, globals_, first)
        _add(blocks, np.arange(n - 1), step)
        blocks.cost += float((step.error**2).sum() / 2)
    return blocks


def range_errors(
    model: RangeModel, states: Array, globals_: Array, first: int, rows: slice
) -> Between:
    """Whitened errors (R, 1) of some ranges."""
    i, w = model.epoch[rows] - first, model.share[rows][:, None]
    place, z = model.place_m[rows], model.ranges.range_m[rows]
    anchor, root = model.ranges.anchor[rows], 1 / model.ranges.sigma_m[rows]
    tag = np.c_[(1 - w) * states[i, :2] + w * states[i + 1, :2], np.full(len(i), globals_[HEIGHT])]
    level = np.broadcast_to(np.eye(3), (len(i), 3, 3))
    bias = globals_[BIASES + anchor]
    told = residual(tag, level, place, z, scale=globals_[SCALE], bias_m=bias)
    by_first, by_second = np.zeros((2, len(i), 1, states.shape[1]))
    by_first[:, 0, :2] = (1 - w) * told.by_tag[:, 0, :2]
    by_second[:, 0, :2] = w * told.by_tag[:, 0, :2]
    by_globals = np.zeros((len(i), 1, len(globals_)))
    by_globals[:, 0, SCALE] = told.by_scale[:, 0, 0]
    by_globals[:, 0, HEIGHT] = told.by_tag[:, 0, 2]
    by_globals[np.arange(len(i)), 0, BIASES + anchor] = 1.0
    return _weighed(Between(told.error, by_first, by_second, by_globals), root)


def add_robust(blocks: Blocks, i: NDArray[np.int64], told: Between, width: float) -> None:
    """Add whitened rows that tie states i (R,), i + 1 and the globals, under a Cauchy loss on the
    norm of each."""
    norm = np.linalg.norm(told.error, axis=1)
    blocks.cost += float(cost(norm, "cauchy", width).sum())
    _add(blocks, i, _weighed(told, np.sqrt(weight(norm, "cauchy", width))))


def _weighed(told: Between, root: Array) -> Between:
    """Errors and Jacobians times a factor (R,) for each row."""
    by = (J * root[:, None, None] for J in (told.by_first, told.by_second, told.by_globals))
    by_first, by_second, by_globals = by
    return Between(told.error * root[:, None], by_first, by_second, by_globals)


def _add(blocks: Blocks, i: NDArray[np.int64], told: Between) -> None:
    """Add rows that tie states i (R,), i + 1 and the globals."""
    error = told.error[..., None]
    a, b, g = (J.swapaxes(-1, -2) for J in (told.by_first, told.by_second, told.by_globals))
    np.add.at(blocks.diagonal, i, a @ told.by_first)
    np.add.at(blocks.diagonal, i + 1, b @ told.by_second)
    np.add.at(blocks.beside, i, a @ told.by_second)
    np.add.at(blocks.tied, i, a @ told.by_globals)
    np.add.at(blocks.tied, i + 1, b @ told.by_globals)
    blocks.globals_ += (g @ told.by_globals).sum(0)
    np.add.at(blocks.gradient, i, (a @ error)[..., 0])
    np.add.at(blocks.gradient, i + 1, (b @ error)[..., 0])
    blocks.gradient_globals += (g @ error).sum(0)[:, 0]
