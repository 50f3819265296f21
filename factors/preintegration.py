"""Preintegration of a whole drive's IMU samples at once, in numpy.

The sums are those of GTSAM's `PreintegratedImuMeasurements` (Forster et al., T-RO 2017, in the
tangent form of GTSAM's ImuFactor notes): theta' = theta + Jr^-1(theta) w dt, and so on. Intervals
are laid side by side and stepped through together. Only the rotation needs stepping: given it, a
sample's share in delta, its bias Jacobians and its covariance is a product of what precedes it and
of P, the 9 x 3 effect that a change of theta just after the sample has at the interval's end.

Inside are fields, see `fields.py`: of vectors (3, L, n) and matrices (3, 3, L, n) for sample l of
interval n.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgloc.factors.fields import apply, cross, curvature, exp, inverse_jacobian, product, rows
from fgloc.factors.fields import skew as skews
from fgloc.factors.imu import INTEGRATION_NOISE_M_PER_SQRT_S, ImuDeltas
from fgloc.frames import (
    exp_so3,
    log_so3,
    right_jacobian_inverse_so3,
    right_jacobian_so3,
    skew,
)
from fgloc.measurements import Array
from fgloc.parallel import each

SAMPLES_AT_ONCE = 24_000
"""Intervals are taken in portions of about so many samples, which fit the processor's cache."""


def preintegrate(
    accel_mps2: Array, gyro_radps: Array, dt_s: Array, first: NDArray[np.int64],
    stops: NDArray[np.int64], accel_noise: ArrayLike, gyro_noise: ArrayLike,
) -> ImuDeltas:  # fmt: skip
    """Samples first[n]:stops[s, n] of (M, 3) m/s^2, (M, 3) rad/s and (M,) s, at zero bias.

    Columns have leading axes (S, N): N intervals, each up to S stops that do not go back. Noise is
    a density in m/s^2 and rad/s per sqrt(Hz), one for all intervals, (N,), or (N, 3) where the
    axes are not alike.
    """
    shape = stops.shape
    out = ImuDeltas(np.zeros((*shape, 9)), np.zeros((*shape, 9, 6)), np.zeros((*shape, 9, 9)),
                    np.zeros(shape), np.zeros((*shape, 6)))  # fmt: skip
    variances = [_variances(noise, shape[1]) for noise in (accel_noise, gyro_noise)]
    count = stops - first

    def fill(rows: slice) -> None:
        sample = first[rows] + np.arange(count[-1, rows].max(initial=0))[:, None]
        sample = np.minimum(sample, max(len(dt_s) - 1, 0))
        path = _Path(
            accel_mps2.T[:, sample], gyro_radps.T[:, sample], dt_s[sample], count[-1, rows]
        )
        for s in range(shape[0]):
            upto = count[s, rows]
            delta, by_bias, cov = path.sums(upto, *(v[:, rows] for v in variances))
            out.delta[s, rows], out.by_bias[s, rows], out.cov[s, rows] = delta, by_bias, cov
            out.dt_s[s, rows] = path.dt_until(upto).sum(0)

    each(fill, _portions(count[-1]))
    return out


def _variances(noise: ArrayLike, n: int) -> Array:
    """Squares of densities: (1, n) where all axes are alike, (3, n) where they are not."""
    square = np.square(np.asarray(noise, float))
    return square.T if square.ndim == 2 else np.broadcast_to(square, (1, n))


def joined(deltas: ImuDeltas, first: NDArray[np.int64]) -> ImuDeltas:
    """Runs of intervals as one each, from their sums alone: run k is first[k]:first[k + 1].

    All must be linearised at the same bias. The sums of the whole differ to second order in what
    turns within a sample.
    """
    run = deltas.take(first[:-1])
    R, cov, dt_s = exp_so3(run.delta[:, :3]), run.cov, run.dt_s
    p, v, by_bias = run.delta[:, 3:6], run.delta[:, 6:], _end(run, R)
    for s in range(1, int(np.diff(first).max(initial=0))):
        own = np.flatnonzero(first[:-1] + s < first[1:])
        step = deltas.take(first[own] + s)
        p_2, v_2, T = step.delta[:, 3:6], step.delta[:, 6:], step.dt_s[:, None]
        R_1, R_2 = R[own], exp_so3(step.delta[:, :3])
        F = _travel(R_2, p_2, v_2, T)
        cov[own] = F @ cov[own] @ F.swapaxes(-1, -2) + step.cov
        by_bias[own] = F @ by_bias[own] + _end(step, R_2)
        p[own] += v[own] * T + np.einsum("nij,nj->ni", R_1, p_2)
        v[own] += np.einsum("nij,nj->ni", R_1, v_2)
        R[own], dt_s[own] = R_1 @ R_2, dt_s[own] + step.dt_s
    theta = log_so3(R)
    by_bias[:, :3] = right_jacobian_inverse_so3(theta) @ by_bias[:, :3]
    by_bias[:, 3:6], by_bias[:, 6:] = R @ by_bias[:, 3:6], R @ by_bias[:, 6:]
    return ImuDeltas(np.concatenate([theta, p, v], axis=1), by_bias, cov, dt_s, run.bias_hat)


def _travel(R: Array, p: Array, v: Array, T: Array) -> Array:
    """How errors (N, 9) at the start of intervals travel, in the frames of their two ends."""
    back, F = R.swapaxes(-1, -2), np.zeros((len(R), 9, 9))
    F[:, :3, :3] = F[:, 3:6, 3:6] = F[:, 6:, 6:] = back
    F[:, 3:6, :3], F[:, 6:, :3] = -back @ skew(p), -back @ skew(v)
    F[:, 3:6, 6:] = back * T[..., None]
    return F


def _end(deltas: ImuDeltas, R: Array) -> Array:
    """The Jacobians by the bias (N, 9, 6) as errors in the frame R of the interval's end."""
    back, by_bias = R.swapaxes(-1, -2), deltas.by_bias
    turn = right_jacobian_so3(deltas.delta[:, :3]) @ by_bias[:, :3]
    return np.concatenate([turn, back @ by_bias[:, 3:6], back @ by_bias[:, 6:]], axis=1)


def _portions(count: NDArray[np.int64]) -> Iterator[slice]:
    """Consecutive intervals of together about `SAMPLES_AT_ONCE` samples, padding included."""
    first = 0
    while first < len(count):
        widest = np.maximum.accumulate(count[first:])
        size = widest * np.arange(1, len(widest) + 1)
        stop = first + max(int(np.searchsorted(size, SAMPLES_AT_ONCE)), 1)
        yield slice(first, stop)
        first = stop


class _Path:
    """Padded samples (L, n) of n intervals, and what each sample does whatever comes after it."""

    def __init__(self, accel: Array, gyro: Array, dt: Array, count: NDArray[np.int64]) -> None:
        self._dt = dt
        self._theta = _rotations(gyro * self.dt_until(count))
        self._R, Jr = exp(self._theta[:, :-1])
        self._inverse, c, slope = inverse_jacobian(self._theta[:, :-1])
        self._force = apply(self._R, accel)
        self._force_by_theta = product(product(self._R, -skews(accel)), Jr)
        self._turn_by_theta = _theta_by_theta(self._theta[:, :-1], gyro, c, slope)

    def dt_until(self, count: NDArray[np.int64]) -> Array:
        """Lengths (l, n) in s of the first `count` samples of each interval, 0 after them."""
        most = count.max(initial=0)
        return np.where(np.arange(most)[:, None] < count, self._dt[:most], 0.0)

    def sums(
        self, count: NDArray[np.int64], accel_var: Array, gyro_var: Array
    ) -> tuple[Array, Array, Array]:
        """Delta (n, 9), its Jacobian by bias (n, 9, 6) and covariance (n, 9, 9)."""
        dt = self.dt_until(count)
        R, force, inverse, force_by_theta, turn_by_theta = (
            field[..., : len(dt), :] for field in (self._R, self._force, self._inverse,
                                                   self._force_by_theta, self._turn_by_theta)
        )  # fmt: skip
        remaining = dt.sum(0) - np.cumsum(dt, 0)
        reach = dt / 2 + remaining  # a speed gained in a step has moved so far by the end, per dt
        theta = self._theta[:, count, np.arange(len(count))]
        delta = np.concatenate([theta, _over(force, dt * reach), _over(force, dt)]).T
        step = np.eye(3)[:, :, None, None] + dt * turn_by_theta
        M = _effects(step, force_by_theta * (dt * reach), force_by_theta * dt, inverse)
        by_bias = np.zeros((len(count), 9, 6))
        by_bias[:, 3:6, :3] = -rows(_over(R, dt * reach))
        by_bias[:, 6:, :3] = -rows(_over(R, dt))
        by_bias[:, :, 3:] = -rows(_over(M, dt))
        cov = _covariance(M, R, dt, reach, accel_var, gyro_var)
        return delta, by_bias, _at_the_end(exp(theta), cov)


def _over(field: Array, weight: Array) -> Array:
    """The sum over the samples of a field (..., L, n) under weights (L, n)."""
    return np.asarray(np.einsum("...ln,ln->...n", field, weight))


def _rotations(turn: Array) -> Array:
    """Rotation vectors (3, L + 1, n) before each sample and at the end, from w dt (3, L, n)."""
    theta = np.zeros((3, turn.shape[1] + 1, turn.shape[2]))
    for k in range(turn.shape[1]):
        t, w = theta[:, k], turn[:, k]
        square, along = (t * t).sum(0), (t * w).sum(0)
        c, _ = curvature(square)
        theta[:, k + 1] = (1 - c * square) * w + c * along * t + t + cross(t, w) / 2
    return theta


def _effects(step: Array, move: Array, speed_up: Array, inverse: Array) -> Array:
    """M (9, 3, L, n): what a rotation rate during each sample does, per second, at the end."""
    M = np.empty((9, *inverse.shape[1:]))
    P = np.zeros((9, 3, step.shape[-1]))
    P[:3] = np.eye(3)[..., None]
    for k in reversed(range(step.shape[2])):
        M[:, :, k] = product(P, inverse[:, :, k])
        P = product(P, step[:, :, k])
        P[3:6] += move[:, :, k]
        P[6:] += speed_up[:, :, k]
    return M


def _theta_by_theta(theta: Array, gyro: Array, c: Array, slope: Array) -> Array:
    """Derivative (3, 3, L, n) by theta of Jr^-1(theta) w = w + theta x w / 2 + c theta x ..."""
    along = (theta * gyro).sum(0)
    once = cross(theta, gyro)
    twice = theta * along - gyro * (theta * theta).sum(0)
    result = -skews(gyro / 2 + c * once) + (slope * twice - c * gyro)[:, None] * theta
    result[range(3), range(3)] += c * along
    return result


def _covariance(
    M: Array, R: Array, dt: Array, reach: Array, accel_var: Array, gyro_var: Array
) -> Array:
    """(n, 9, 9): the gyro's noise through M; the accelerometer's as sums where its axes are alike,
    and through R where they are not."""
    cov = _spread(M * np.sqrt(dt * gyro_var[:, None]))
    along = np.arange(3)
    place = INTEGRATION_NOISE_M_PER_SQRT_S**2 * dt.sum(0)
    if len(accel_var) == 1:
        speed = accel_var[0] * dt.sum(0)
        both = accel_var[0] * (dt * reach).sum(0)
        place = accel_var[0] * (dt * reach**2).sum(0) + place
        for i, j, value in ((3, 6, both), (6, 3, both), (6, 6, speed)):
            cov[:, i + along, j + along] += value[:, None]
    else:
        shaken = R * np.sqrt(dt * accel_var[:, None])
        cov[:, 3:, 3:] += _spread(np.concatenate([shaken * reach, shaken]))
    cov[:, 3 + along, 3 + along] += place[:, None]
    return cov


def _spread(effects: Array) -> Array:
    """(n, m, m): the sum over samples of E E' for effects (m, 3, L, n) of unit noise."""
    m, n = len(effects), effects.shape[-1]
    cov = np.empty((n, m, m))
    for i in range(m):
        row = np.einsum("abln,bln->an", effects[: i + 1], effects[i]).T
        cov[:, i, : i + 1] = cov[:, : i + 1, i] = row
    return cov


def _at_the_end(end: tuple[Array, Array], cov: Array) -> Array:
    """A covariance of (theta, dp, dv) turned into the frame at the interval's end."""
    R, Jr = end
    turn = np.zeros_like(cov)
    turn[:, :3, :3] = Jr.transpose(2, 0, 1)
    turn[:, 3:6, 3:6] = turn[:, 6:, 6:] = R.transpose(2, 1, 0)
    return turn @ cov @ turn.swapaxes(-1, -2)
