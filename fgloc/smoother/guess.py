"""Where to start: positions and speeds from the fixes, yaw from the gyro held to the course.

The guess is only a point of linearisation; it adds no information. Course over ground is taken
for heading where the vehicle moves, so that a drive that starts in reverse, or an IMU mounted
askew, is told apart afterwards by `choose_yaw`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc import frames
from fgloc.measurements import Array
from fgloc.smoother.lines import Lines
from fgloc.smoother.model import Model

HALF_WINDOW_S = 1.0
"""Speeds are slopes of straight lines through the fixes of this many seconds to either side."""
MIN_SPEED_MPS = 1.5
SPEED_SIGMAS = 8.0
"""A course counts where the speed is this many of its own sigmas (0.125 rad)."""
BIN_S = 5.0
KERNEL_S = 15.0
"""The gyro's yaw is held to the course over about this time."""
TURNS_RAD = (np.pi, np.pi / 2, -np.pi / 2)
"""Headings tried where the course itself does not fit: reverse, and an IMU mounted across."""
FITS = 5.0
"""The course fits where twice the cost is at most this for each dimension of the fixes."""
BETTER = 0.5
"""Another heading must come down to this share of the cost: ties are broken by rounding otherwise,
and a wrong heading that biases make up for in a short while costs far more in a longer one."""
STRETCH = 400
"""Keyframes of the moving stretch that headings are tried on."""


@dataclass(frozen=True)
class Guess:
    """First values of keyframes first..last: R (n, 3, 3), p and v (n, 3); is the yaw known?"""

    first: int
    R_world_veh: Array
    p_world_m: Array
    v_world_mps: Array
    yaw_known: bool

    def turned(self, yaw_rad: float) -> "Guess":
        """The same with all attitudes turned about the vertical."""
        R = frames.yaw_matrix(yaw_rad) @ self.R_world_veh
        return Guess(self.first, R, self.p_world_m, self.v_world_mps, self.yaw_known)


def guess(model: Model, first: int, last: int, turn_rad: Array) -> Guess:
    """Values of keyframes first..last from the fixes and the gyro among them.

    `turn_rad` (n,) is the yaw but for a constant, as from `yaw_by_turns`. Velocities that the drive
    has are taken instead of those of the fixes.
    """
    keys = np.arange(first, last + 1)
    rows = model.fixed(first, last + 1)
    t, z, at = model.t_s[model.key_of[rows]], model.positions.z_world_m[rows], model.t_s[keys]
    told, v, sigma_v = _velocities(model, first, last, rows)
    good = is_course(v, sigma_v)
    yaw = turn_rad[keys].copy()
    if good.any():
        course = np.arctan2(v[good, 1], v[good, 0])
        weight = (v[good, :2] ** 2).sum(1) / sigma_v[good] ** 2
        offset = course - turn_rad[told[good]]
        yaw += _smooth_angle(model.t_s[told[good]], offset, weight, at)
    R = frames.yaw_matrix(yaw)
    p = _interpolate(at, t, z) - R @ model.levers[model.positions.source[rows[0]]]
    return Guess(first, R, p, _interpolate(at, model.t_s[told], v), bool(good.any()))


def is_course(v_world_mps: Array, sigma_mps: Array) -> NDArray[np.bool_]:
    """Whether velocities (n, 3) with sigmas (n,) on an axis are fast enough to tell a course."""
    speed = np.linalg.norm(v_world_mps[:, :2], axis=1)
    return np.asarray(speed > np.maximum(MIN_SPEED_MPS, SPEED_SIGMAS * sigma_mps))


def _velocities(
    model: Model, first: int, last: int, rows: NDArray[np.int64]
) -> tuple[NDArray[np.int64], Array, Array]:
    """Keyframes with a velocity, the velocities (n, 3), and their sigmas (n,) on an axis: those of
    the drive among keyframes first..last, or the slopes of the fixes of some rows."""
    velocities = model.car.velocities
    own = velocities.keys[(first <= velocities.keys) & (velocities.keys <= last)]
    if len(own):
        return own, velocities.v_world_mps[own], velocities.sigma_mps[own]
    with_fix = model.key_of[rows]
    sigma = np.sqrt(model.cov_m2[rows][:, :2, :2].trace(axis1=1, axis2=2) / 2)
    return with_fix, *_slopes(model.t_s[with_fix], model.positions.z_world_m[rows], sigma)


def misfit(fixes: int) -> float:
    """The cost above which a solution of so many fixes does not fit; see `FITS`."""
    return FITS * 3 * fixes / 2


def stretch(guess: Guess) -> int:
    """How many keyframes of a guess it takes to try headings: up to the first moving ones."""
    speed = np.linalg.norm(guess.v_world_mps[:, :2], axis=1)
    return min(len(speed), int(np.argmax(speed > 0.5 * speed.max())) + STRETCH)


def choose_yaw(guess: Guess, fixes: int, cost: Callable[[Guess], float]) -> Guess:
    """The guess turned to the heading that the first moving stretch fits best.

    `cost` gives the least cost of that stretch from a guess, and `fixes` how many are in it.
    Without a course the guess is returned as it is.
    """
    if not guess.yaw_known:
        return guess
    best, least = guess, cost(guess)
    if least <= misfit(fixes):
        return guess
    for turn in TURNS_RAD:
        turned = guess.turned(turn)
        if (other := cost(turned)) < BETTER * least:
            best, least = turned, other
    return best


def yaw_by_turns(model: Model) -> Array:
    """Yaw (n,) in rad at every keyframe, but for a constant, from the gyro about the vehicle's
    vertical alone; by the course of its velocities where nobody tells how it turns."""
    velocities = model.car.velocities
    v = velocities.v_world_mps[velocities.keys]
    good = is_course(v, velocities.sigma_mps[velocities.keys])
    if model.plan.motion.forgets_yaw and good.any():
        course = np.unwrap(np.arctan2(v[good, 1], v[good, 0]))
        return np.interp(model.t_s, model.t_s[velocities.keys[good]], course)
    epochs = model.epochs
    total = np.concatenate([[0.0], np.cumsum(epochs.gyro_radps[:, 2] * epochs.dt_s)])
    return total[epochs.first_sample[model.epoch_of + 1]]


def _slopes(t: Array, z: Array, sigma: Array) -> tuple[Array, Array]:
    """Velocity (n, 3) and its horizontal sigma (n,) from lines through neighbouring fixes."""
    half = max(HALF_WINDOW_S, 1.01 * float(np.median(np.diff(t)))) if len(t) > 1 else HALF_WINDOW_S
    lines = Lines(t, half)
    return lines.slope(z), np.sqrt(lines.mean(sigma**2) / lines.spread)


def _smooth_angle(t: Array, angle: Array, weight: Array, at: Array) -> Array:
    """Weighted circular mean of angles around the times `at`, over bins under a Gaussian kernel.

    The far tail of the kernel is exponential, so that times without any course take the nearest.
    """
    bins = np.arange(min(t[0], at[0]), max(t[-1], at[-1]) + 2 * BIN_S, BIN_S)
    place = np.clip(((t - bins[0]) / BIN_S).astype(int), 0, len(bins) - 1)
    phasor = np.bincount(place, weight * np.cos(angle), len(bins)) + 1j * np.bincount(
        place, weight * np.sin(angle), len(bins)
    )
    filled = np.flatnonzero(np.bincount(place, minlength=len(bins)))
    distance = np.abs(bins[:, None] - bins[None, filled]) / KERNEL_S
    kernel = np.exp(-np.minimum(0.5 * distance**2, 10 + distance))
    return np.angle(_unit(kernel @ phasor[filled])[np.clip(
        ((at - bins[0]) / BIN_S).astype(int), 0, len(bins) - 1)])  # fmt: skip


def _unit(z: np.ndarray) -> np.ndarray:
    return z / np.maximum(np.abs(z), 1e-300)


def _interpolate(at: Array, t: Array, values: Array) -> Array:
    return np.stack([np.interp(at, t, column) for column in values.T], -1)
