"""How late one clock is against another, from the motion that both tell of."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fgloc.diagnosis.motion import (
    FEWEST_STEPS,
    SHARED,
    SLOWEST_MPS,
    Motion,
    Signal,
    slopes,
)
from fgloc.measurements import Array

Columns = Callable[[Motion, Array], list[tuple[Array, Array]]]
"""From a signal smoothed at the knots (K, m): what the fixes say of each step (S,), and what may
explain it (S, n), for each quantity that both tell of."""

LARGEST_S = 60.0
"""Offsets are looked for up to this: well beyond the 37 s between TAI and UTC."""
SURE = 12.0
"""A lag must raise the log-likelihood by this against none: odds of e^12, more than enough for the
hundreds of lags that are tried."""

_COARSE_S, _FINE_S = 0.25, 0.02
_FINE_REACH_S = 0.6
_SHARED_ERRORS = SHARED / 2  # errors of neighbouring steps cancel in part: they share a velocity


@dataclass(frozen=True)
class Lag:
    """A signal is `lag_s` after the fixes, in the stamps of each.

    lag_s    positive: the same motion bears later stamps in the signal than in the fixes
    sigma_s  formal standard deviation
    gain     log-likelihood above that of no lag
    """

    lag_s: float
    sigma_s: float
    gain: float


def inertial_lag(motion: Motion, imu: Signal) -> Lag | None:
    """The lag of an IMU, by turns of the course and changes of the speed.

    None where the drive does not tell. An antenna ahead of the rear axle starts to turn before the
    vehicle does, which looks like a lag at one speed; so where it is, is fitted as well.
    """
    return _search(motion, imu, _turns_and_pushes)


def speed_lag(motion: Motion, speed: Signal) -> Lag | None:
    """The lag of a speedometer, by changes of the speed; None where the drive does not tell."""
    return _search(motion, speed, _pushes)


def sideslip(motion: Motion, yaw_rad: Array) -> Array:
    """(S,) change over each step of yaw rate over speed: the turn of an antenna 1 m ahead."""
    rate = np.gradient(yaw_rad, motion.knot_s)
    return _step(motion, rate / np.maximum(motion.speed_mps, SLOWEST_MPS))


def _turns_and_pushes(motion: Motion, level: Array) -> list[tuple[Array, Array]]:
    turn = np.column_stack([_step(motion, level[:, 0]), sideslip(motion, level[:, 0])])
    return [(motion.turn_rad, turn), (motion.push_mps[:, 0], _step(motion, level[:, 1:]))]


def _pushes(motion: Motion, level: Array) -> list[tuple[Array, Array]]:
    return [(motion.push_mps[:, 0], _step(motion, level))]


def _step(motion: Motion, level: Array) -> Array:
    return level[motion.steps + 1] - level[motion.steps]


def _search(motion: Motion, signal: Signal, columns: Columns) -> Lag | None:
    """The lag at which a linear relation with unknown gains explains the motion best."""
    if len(motion.steps) < FEWEST_STEPS:
        return None
    coarse = np.arange(-LARGEST_S, LARGEST_S + _COARSE_S / 2, _COARSE_S)
    levels = _anywhere(motion, signal)
    found = [_likelihood(motion, signal, columns, lag, levels(lag)) for lag in coarse]
    best = float(coarse[int(np.argmax(found))])
    fine = best + np.arange(-_FINE_REACH_S, _FINE_REACH_S + _FINE_S / 2, _FINE_S)
    likely = np.array([
        _likelihood(motion, signal, columns, lag, motion.smoothed(signal, lag)) for lag in fine
    ])  # fmt: skip
    peak = int(np.argmax(likely))
    if not 0 < peak < len(fine) - 1 or not np.isfinite(likely).all():
        return None
    a, b, _ = np.polyfit(fine - best, likely, 2)
    curvature = -2 * a
    none = _likelihood(motion, signal, columns, 0.0, motion.smoothed(signal))
    if curvature <= 0:
        return None
    return Lag(best + b / curvature, curvature**-0.5, float(likely[peak] - max(none, 0.0)))


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
    motion: Motion, signal: Signal, columns: Columns, lag_s: float, level: Array
) -> float:
    """Log-likelihood above that of no relation at all; 0 where the two hardly overlap."""
    use = motion.covered(signal, lag_s)
    if use.sum() < max(FEWEST_STEPS, len(use) / 2):
        return 0.0
    total = 0.0
    for said, explains in columns(motion, level):
        A = np.column_stack([explains, np.ones(len(said))])[use]
        y = said[use] - said[use].mean()
        left = y - A @ np.linalg.lstsq(A, y, rcond=None)[0]
        total -= np.log(max(float(left @ left), 1e-12) / max(float(y @ y), 1e-12))
    return total * int(use.sum()) / _SHARED_ERRORS / 2
