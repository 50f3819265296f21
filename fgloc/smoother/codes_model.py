"""The planar graph of a camera that reads Smart Codes: states, globals, and what ties them.

    states   (N, 2), the camera's East and North in m, at even epochs
    globals  (G,): scale error of the speed, error of the heading in rad, and a bias in m of the
             ranges to each size of sign

The velocity that the vehicle tells carries a state to the next. A sighting ties the camera to the
sign three times: by the range that the code's height tells, by the direction of its middle, which
the heading and the camera's yaw turn into the world's, and by its width, which tells from how far
aside it is seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc.factors.ranging import residual
from fgloc.frames import wrap_pi
from fgloc.measurements import Array, EnuVelocities
from fgloc.smoother.ranges_model import Between, Blocks, add_robust, motion_blocks
from fgloc.timing import Instants

SPEED, HEADING, BIASES = 0, 1, 2
"""Where the globals stand."""


@dataclass(frozen=True)
class CodeSettings:
    """What the graph takes for granted; sigmas of the globals are of their priors."""

    interval_s: float = 0.2
    speed_sigma: float = 0.02
    heading_sigma_rad: float = 0.0125
    bias_sigma_m: float = 0.3
    heading_noise_rad: float = 0.005
    corner_sigma_px: float = 0.3
    size_sigma_px: float = 0.4
    loss_width: float = 3.0
    start_sigma: float = 1e3


@dataclass(frozen=True, eq=False)
class VelocitySteps:
    """Displacements (N - 1, 2) in m between epochs by the velocities told, and their sigmas."""

    step_m: Array
    sigma_m: float
    size: int = 2

    @classmethod
    def of(cls, table: EnuVelocities, epochs_ns: Instants) -> VelocitySteps:
        """Velocities summed up between epochs; each holds half way to its neighbours."""
        t_s, at_s = ((t - epochs_ns[0]) / 1e9 for t in (table.t_ns, epochs_ns))
        edges = np.r_[t_s[0] - 1e3, (t_s[1:] + t_s[:-1]) / 2, t_s[-1] + 1e3]
        parts = table.v_world_mps[:, :2] * np.diff(edges)[:, None]
        way = np.r_[np.zeros((1, 2)), np.cumsum(parts, axis=0)]
        at = np.stack([np.interp(at_s, edges, way[:, i]) for i in range(2)], -1)
        every_s = float(np.median(np.diff(t_s)))
        sigma = float(np.median(table.sigma_mps)) * np.sqrt(every_s * float(at_s[1] - at_s[0]))
        return cls(np.diff(at, axis=0), sigma)

    def _turned(self, globals_: Array, steps: slice) -> tuple[Array, Array]:
        """Steps (K, 2) with their heading set right, and what a rad more would add to them."""
        c, s = np.cos(globals_[HEADING]), np.sin(globals_[HEADING])
        turned = self.step_m[steps] @ np.array([[c, s], [-s, c]])
        return turned, np.stack([-turned[:, 1], turned[:, 0]], -1)

    def between(self, states: Array, globals_: Array, first: int) -> Between:
        """See `Motion`."""
        n = len(states) - 1
        turned, aside = self._turned(globals_, slice(first, first + n))
        scale = 1 + globals_[SPEED]
        error = (states[1:] - states[:-1] - scale * turned) / self.sigma_m
        by = np.broadcast_to(np.eye(2) / self.sigma_m, (n, 2, 2))
        by_globals = np.zeros((n, 2, len(globals_)))
        by_globals[:, :, SPEED] = -turned / self.sigma_m
        by_globals[:, :, HEADING] = -scale * aside / self.sigma_m
        return Between(error, -by, by, by_globals)

    def predict(self, state: Array, globals_: Array, epoch: int) -> Array:
        """See `Motion`."""
        turned, _ = self._turned(globals_, slice(epoch, epoch + 1))
        return state + (1 + globals_[SPEED]) * turned[0]


@dataclass(frozen=True, eq=False)
class Sightings:
    """Sightings (M,) in the order of time: the epoch before each and how far it is to the one
    after; the sign's place (M, 3), the way (M, 2) in m from there to the code's left side, as seen,
    and which size it has; range in m, direction from East of the ray to it and width, both in rad
    on the level, with their sigmas; and the row of the table."""

    epoch: NDArray[np.int64]
    share: Array
    place_m: Array
    to_left_m: Array
    kind: NDArray[np.int64]
    range_m: Array
    range_sigma_m: Array
    direction_rad: Array
    direction_sigma_rad: float
    width_rad: Array
    width_sigma_rad: float
    row: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class CodeModel:
    """A drive as the graph takes it; `height_m` is the camera's, `kinds` how many sizes there are,
    `first_row` (N,) the first sighting after each epoch."""

    epochs_ns: Instants
    motion: VelocitySteps
    seen: Sightings
    first_row: NDArray[np.int64]
    height_m: float
    kinds: int
    settings: CodeSettings

    @property
    def interval_s(self) -> float:
        """Between epochs."""
        return self.settings.interval_s

    @property
    def start_sigma(self) -> float:
        """Of the prior on the first state."""
        return self.settings.start_sigma

    @property
    def prior(self) -> tuple[Array, Array]:
        """Means and standard deviations (G,) of the globals."""
        s = self.settings
        sigma = np.r_[s.speed_sigma, s.heading_sigma_rad, np.full(self.kinds, s.bias_sigma_m)]
        return np.zeros(len(sigma)), sigma

    def linearize(self, states: Array, globals_: Array, first: int) -> Blocks:
        """Motion and sightings of a window of states (N, 2) from the epoch `first` on."""
        blocks = motion_blocks(self.motion, states, globals_, first)
        if len(states) > 1:
            rows = slice(self.first_row[first], self.first_row[first + len(states) - 1])
            told = self.errors(states, globals_, first, rows)
            add_robust(blocks, self.seen.epoch[rows] - first, told, self.settings.loss_width)
        return blocks

    def errors(self, states: Array, globals_: Array, first: int, rows: slice) -> Between:
        """Whitened errors (R, 3) of range, direction and width of some sightings."""
        seen = self.seen
        i, w = seen.epoch[rows] - first, seen.share[rows][:, None]
        camera = np.c_[(1 - w) * states[i] + w * states[i + 1], np.full(len(i), self.height_m)]
        level = np.broadcast_to(np.eye(3), (len(i), 3, 3))
        bias = BIASES + seen.kind[rows]
        told = residual(camera, level, seen.place_m[rows], seen.range_m[rows],
                        bias_m=globals_[bias])  # fmt: skip
        off, by_direction = self._direction(camera, globals_, rows)
        wide, by_width = self._width(camera, rows)
        by_camera = np.stack([told.by_tag[:, 0, :2], by_direction, by_width], 1)
        by_globals = np.zeros((len(i), 3, len(globals_)))
        by_globals[np.arange(len(i)), 0, bias] = 1.0
        by_globals[:, 1, HEADING] = -1.0
        angles = np.full((len(i), 2), [seen.direction_sigma_rad, seen.width_sigma_rad])
        root = 1 / np.c_[seen.range_sigma_m[rows], angles]
        by_camera, by_globals = by_camera * root[:, :, None], by_globals * root[:, :, None]
        error = np.stack([told.error[:, 0], off, wide], -1) * root
        return Between(error, (1 - w[..., None]) * by_camera, w[..., None] * by_camera, by_globals)

    def _direction(self, camera: Array, globals_: Array, rows: slice) -> tuple[Array, Array]:
        """Predicted minus measured directions (R,) in rad of cameras (R, 3), by their East and
        North (R, 2)."""
        direction, by = _towards(camera, self.seen.place_m[rows, :2])
        return wrap_pi(direction - self.seen.direction_rad[rows] - globals_[HEADING]), by

    def _width(self, camera: Array, rows: slice) -> tuple[Array, Array]:
        """Predicted minus measured widths (R,) in rad, the angle between the directions of the
        code's sides, by East and North (R, 2)."""
        place, to_left = self.seen.place_m[rows, :2], self.seen.to_left_m[rows]
        left, by_left = _towards(camera, place + to_left)
        right, by_right = _towards(camera, place - to_left)
        return wrap_pi(left - right - self.seen.width_rad[rows]), by_left - by_right


def _towards(camera: Array, place_m: Array) -> tuple[Array, Array]:
    """Directions (R,) from East in rad from cameras (R, 3) to places (R, 2), by the cameras' East
    and North (R, 2)."""
    ray = place_m - camera[:, :2]
    by = np.stack([ray[:, 1], -ray[:, 0]], -1) / (ray**2).sum(1)[:, None]
    return np.arctan2(ray[:, 1], ray[:, 0]), by
