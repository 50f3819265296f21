"""The planar graph of a camera that reads Smart Codes: states, globals, and what ties them.

    states   (N, 2), the camera's East and North in m, at even epochs
    globals  (G,): scale error of the speed, error of the heading in rad, and for each size of sign
             a bias in m of the ranges to it, or where its corners are told a share of its side

The velocity that the vehicle tells carries a state to the next. A sighting is true between two
epochs and ties the camera, on the straight line between them, to the sign: `codes_sightings`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgloc.measurements import Array, EnuVelocities
from fgloc.smoother.codes_sightings import HEADING, SPEED, ByCorners, BySize
from fgloc.smoother.ranges_model import Between, Blocks, add_robust, motion_blocks
from fgloc.timing import Instants


@dataclass(frozen=True)
class CodeSettings:
    """What the graph takes for granted; sigmas of the globals are of their priors.

    speed_sigma, heading_sigma_rad  of their lasting errors, where the drive does not state them
    corner_sigma_px    of each corner: the reader's err by 0.14 px near and 0.34 px at the end of
                       its reach (rendered images)
    side_sigma         share of a code's side by which its record, the focal length or the reader
                       may be wrong
    corner_loss_width  for eight errors what `loss_width` is for three
    """

    interval_s: float = 0.2
    speed_sigma: float = 0.02
    heading_sigma_rad: float = 0.0125
    bias_sigma_m: float = 0.3
    corner_sigma_px: float = 0.2
    side_sigma: float = 0.005
    size_sigma_px: float = 0.4
    loss_width: float = 3.0
    corner_loss_width: float = 5.0
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
class CodeModel:
    """A drive as the graph takes it.

    height_m       of the camera
    sightings      by size, by corners, or both
    biases, sides  how many sizes of sign are seen by size, and by corners
    start_m        (2,) where the camera was at the first epoch, as the first sightings have it
    start_epoch    the last epoch before the end of these
    """

    epochs_ns: Instants
    motion: VelocitySteps
    sightings: tuple[BySize | ByCorners, ...]
    height_m: float
    biases: int
    sides: int
    start_m: Array
    start_epoch: int
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
        own = np.r_[np.full(self.biases, s.bias_sigma_m), np.full(self.sides, s.side_sigma)]
        sigma = np.r_[s.speed_sigma, s.heading_sigma_rad, own]
        return np.zeros(len(sigma)), sigma

    def first_path(self) -> Array:
        """States (n, 2) over the first sightings, from where these put the camera."""
        path = [self.start_m]
        for k in range(self.start_epoch + 1):
            path.append(self.motion.predict(path[-1], self.prior[0], k))
        return np.array(path)

    def linearize(self, states: Array, globals_: Array, first: int) -> Blocks:
        """Motion and sightings of a window of states (N, 2) from the epoch `first` on."""
        blocks = motion_blocks(self.motion, states, globals_, first)
        if len(states) > 1:
            for seen in self.sightings:
                rows = slice(seen.at.first[first], seen.at.first[first + len(states) - 1])
                told = self.errors(seen, states, globals_, first, rows)
                add_robust(blocks, seen.at.epoch[rows] - first, told, seen.loss_width)
        return blocks

    def errors(
        self, seen: BySize | ByCorners, states: Array, globals_: Array, first: int, rows: slice
    ) -> Between:
        """Whitened errors (R, k) of some sightings."""
        i, w = seen.at.epoch[rows] - first, seen.at.share[rows][:, None]
        camera = np.c_[(1 - w) * states[i] + w * states[i + 1], np.full(len(i), self.height_m)]
        told = seen.errors(camera, globals_, rows)
        by_first, by_second = ((1 - w[..., None]) * told.by_camera, w[..., None] * told.by_camera)
        return Between(told.error, by_first, by_second, told.by_globals)
