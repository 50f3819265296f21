"""How late one clock is against another, from the motion that both tell of."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from fgloc.diagnosis.motion import (
    FEWEST_STEPS,
    SHARED,
    SLOWEST_MPS,
    Motion,
    Signal,
    slopes,
)
from fgloc.measurements import Array

ARM_SIGMA_M = 1.5
"""How far the rig's origin may be from the axle that does not slip: half a wheelbase."""

LARGEST_S = 60.0
"""Offsets are looked for up to this: well beyond the 37 s between TAI and UTC."""
SURE = 12.0
"""A far lag must raise the log-likelihood by this against none: odds of e^12, more than enough for
the hundreds of lags that are tried."""
SURE_SIGMAS, SURE_STEPS = 5.0, 60
"""A lag within a second must be so clear: roads climb and springs swing, which is no white noise
and looks like a lag of tenths over a few bends."""
NEAR_S = 1.0

_COARSE_S, _FINE_S = 0.5, 0.05  # motion is smoothed over seconds
_FINE_REACH_S = 0.75
_MODEL_S = 0.015  # what sideslip and delays within the sensors leave, however long the drive
_SHARED_ERRORS = SHARED / 2  # errors of neighbouring steps cancel in part: they share a velocity


@dataclass(frozen=True)
class Lag:
    """A signal is `lag_s` after the fixes, in the stamps of each.

    lag_s    positive: the same motion bears later stamps in the signal than in the fixes
    sigma_s  formal standard deviation
    gain     log-likelihood above that of no lag
    steps    number of steps of the motion that it rests on
    """

    lag_s: float
    sigma_s: float
    gain: float
    steps: int

    @property
    def is_significant(self) -> bool:
        """Whether the lag is more than chance."""
        if abs(self.lag_s) > NEAR_S:
            return self.gain > SURE
        return abs(self.lag_s) > SURE_SIGMAS * self.sigma_s and self.steps >= SURE_STEPS


@dataclass(frozen=True, eq=False)
class Relation:
    """One quantity that fixes and signal tell of, over the steps of a motion.

    said      (S,) by the fixes
    explains  (S, n) by the signal, with unknown gains
    arm       (S,) what one metre of lever arm adds, or None; `arm_m` is what is known of it
    """

    said: Array
    explains: Array
    arm: Array | None = None
    arm_m: float = 0.0

    def misfit(self, use: NDArray[np.bool_]) -> tuple[float, float]:
        """Sums of squares over some of the steps: what is left unexplained, and all there was."""
        y = self.said[use] - self.said[use].mean()
        A = np.column_stack([self.explains, np.ones(len(self.said))])[use]
        left = y - A @ np.linalg.lstsq(A, y, rcond=None)[0]
        if self.arm is not None:
            weight = np.sqrt(left @ left / len(left)) / ARM_SIGMA_M
            A = np.column_stack([A, self.arm[use]])
            A = np.vstack([A, [*np.zeros(A.shape[1] - 1), weight]])
            extended = np.append(y, weight * self.arm_m)
            left = extended - A @ np.linalg.lstsq(A, extended, rcond=None)[0]
        return float(left @ left), float(y @ y)


Relations = Callable[[Motion, Array], list[Relation]]
"""What relates a motion to a signal that is smoothed at its knots (K, m)."""


def inertial_lag(motion: Motion, imu: Signal, arm_m: float) -> Lag | None:
    """The lag of an IMU, by turns of the course and changes of the speed.

    None where the drive does not tell. An antenna ahead of the rear axle starts to turn before the
    vehicle does, which looks like a lag at one speed; so where it is, about `arm_m`, is fitted too.
    """
    return _search(motion, imu, partial(_turns_and_pushes, arm_m=arm_m))


def speed_lag(motion: Motion, speed: Signal) -> Lag | None:
    """The lag of a speedometer, by changes of the speed; None where the drive does not tell."""
    return _search(motion, speed, _pushes)


def sideslip(motion: Motion, yaw_rad: Array) -> Array:
    """(S,) change over each step of yaw rate over speed: the turn of an antenna 1 m ahead."""
    rate = np.gradient(yaw_rad, motion.knot_s)
    return _step(motion, rate / np.maximum(motion.speed_mps, SLOWEST_MPS))


def _turns_and_pushes(motion: Motion, level: Array, arm_m: float) -> list[Relation]:
    turn = _step(motion, level[:, 0])
    gain = float(turn @ motion.turn_rad) / max(float(turn @ turn), 1e-12)
    arm = gain * sideslip(motion, level[:, 0])  # in the unit and sign of the course
    return [
        Relation(motion.turn_rad, turn[:, None], arm, arm_m),
        Relation(motion.push_mps[:, 0], _step(motion, level[:, 1:])),
    ]


def _pushes(motion: Motion, level: Array) -> list[Relation]:
    return [Relation(motion.push_mps[:, 0], _step(motion, level))]


def _step(motion: Motion, level: Array) -> Array:
    return level[motion.steps + 1] - level[motion.steps]


def _search(motion: Motion, signal: Signal, relations: Relations) -> Lag | None:
    """The lag at which a linear relation with unknown gains explains the motion best."""
    if len(motion.steps) < FEWEST_STEPS:
        return None
    coarse = np.arange(-LARGEST_S, LARGEST_S + _COARSE_S / 2, _COARSE_S)
    levels = _anywhere(motion, signal)
    found = [_likelihood(motion, signal, relations, lag, levels(lag)) for lag in coarse]
    best = float(coarse[int(np.argmax(found))])
    fine = best + np.arange(-_FINE_REACH_S, _FINE_REACH_S + _FINE_S / 2, _FINE_S)
    likely = np.array([
        _likelihood(motion, signal, relations, lag, motion.smoothed(signal, lag)) for lag in fine
    ])  # fmt: skip
    peak = int(np.argmax(likely))
    if not 0 < peak < len(fine) - 1 or not np.isfinite(likely).all():
        return None
    a, b, _ = np.polyfit(fine - best, likely, 2)
    curvature = -2 * a
    none = _likelihood(motion, signal, relations, 0.0, motion.smoothed(signal))
    if curvature <= 0:
        return None
    gain, steps = float(likely[peak] - max(none, 0.0)), int(motion.covered(signal, best).sum())
    return Lag(float(best + b / curvature), float(np.hypot(curvature**-0.5, _MODEL_S)), gain, steps)


def _anywhere(motion: Motion, signal: Signal) -> Callable[[float], Array]:
    """The smoothed integral at all knots for any lag, to the width of the coarse search."""
    first, last = motion.knot_s[0] - LARGEST_S, motion.knot_s[-1] + LARGEST_S
    dense = np.arange(max(signal.t_s[0], first), min(signal.t_s[-1], last), _COARSE_S)
    if not len(dense):  # another time altogether
        return lambda lag_s: np.zeros((len(motion.knot_s), signal.twice.shape[1]))
    level = slopes(dense, signal.at(dense), dense, motion.half_s)[0]

    def at(lag_s: float) -> Array:
        where = motion.knot_s + lag_s
        return np.stack([np.interp(where, dense, column) for column in level.T], -1)

    return at


def _likelihood(
    motion: Motion, signal: Signal, relations: Relations, lag_s: float, level: Array
) -> float:
    """Log-likelihood above that of no relation at all; 0 where the two hardly overlap."""
    use = motion.covered(signal, lag_s)
    if use.sum() < max(FEWEST_STEPS, len(use) / 2):
        return 0.0
    total = 0.0
    for relation in relations(motion, level):
        left, all_ = relation.misfit(use)
        total -= np.log(max(left, 1e-12) / max(all_, 1e-12))
    return total * int(use.sum()) / _SHARED_ERRORS / 2
