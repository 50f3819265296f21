"""Where the error-state filter starts: attitude and speed are unknown until fixes show a course.

Over a window of fixes the IMU tells how the vehicle moved, but for where it was, how fast it went
along its own axis, and which way that pointed; these, and a constant error of the accelerations (a
road that is not level, a bias), are fitted to the fixes. The filter starts at the window's end.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgloc.baselines.eskf_motion import LEVEL_RAD, Inertial, Planar
from fgloc.baselines.eskf_state import BIAS, CORE, POSITION, ROTATION, VELOCITY, Slow, State
from fgloc.frames import yaw_matrix
from fgloc.measurements import Array
from fgloc.positions import Positions
from fgloc.timing import Instants, elapsed_s, seconds_to_ns

SIGMAS, DISTANCE_M, SPAN_S = 8.0, 2.0, 20.0
"""Two fixes show a course when so many sigmas, at least so far and at most so long apart."""
LEAST_FIXES = 4
"""So many are needed for a fit."""
ACCEL_ERROR_MPS2 = 0.3
"""Of the horizontal acceleration while the vehicle is taken to be level."""
UP_SPEED_MPS = 0.5
REVERSE_FITS_BETTER = 0.5
"""A start in reverse is believed where its cost is at most this share of going ahead."""
_ITERATIONS = 20


class Fixes(NamedTuple):
    """Of n fixes in a window: epoch (n,), time (n,) in s, place (n, 3) and sigma (n,) in m."""

    epoch: NDArray[np.int64]
    t_s: Array
    z_m: Array
    sigma_m: Array


def window(positions: Positions, t_ns: Instants, rows: Sequence[int]) -> Fixes | None:
    """The last of some rows, as few as show a course; None where they show none yet."""
    own_ns = positions.t_ns[rows]
    late = own_ns >= own_ns[-1] - seconds_to_ns(SPAN_S)
    chosen = np.asarray(rows)[late]
    z, cov = positions.z_world_m[chosen], positions.cov_world_m2[chosen]
    sigma = np.sqrt(cov[:, :2, :2].trace(axis1=1, axis2=2) / 2)
    far = np.linalg.norm(z[:, :2] - z[-1, :2], axis=1)
    enough = np.flatnonzero(far > np.maximum(DISTANCE_M, SIGMAS * np.hypot(sigma, sigma[-1])))
    if not len(enough) or len(chosen) - enough[-1] < LEAST_FIXES:
        return None
    chosen, z, sigma = (part[enough[-1] :] for part in (chosen, z, sigma))
    at_ns = positions.t_ns[chosen]
    return Fixes(np.searchsorted(t_ns, at_ns), elapsed_s(at_ns, int(at_ns[0])), z, sigma)


def start_inertial(motion: Inertial, fixes: Fixes, lever_m: Array, slow: Slow) -> State:
    """The state at the epoch of the last fix of a window."""
    path = _path(motion, fixes, lever_m, slow)
    x, cov = _fitted(path, fixes)
    J, end = np.zeros((5, len(x))), path.end(x)
    for i, h in enumerate(np.eye(len(x)) * 1e-6):
        J[:, i] = (path.end(x + h) - path.end(x - h)) / 2e-6
    R = yaw_matrix(end[0]) @ path.R[-1]
    up_m = float(np.mean(fixes.z_m[-5:, 2])) - (R @ lever_m)[2]
    flat = np.zeros((CORE, 5))  # rotation, position and velocity by yaw, place and speed
    flat[ROTATION, 0] = R[2]
    flat[POSITION, 1:3] = R[:2].T
    flat[VELOCITY, 3:] = np.eye(3)[:, :2]
    own = flat @ J @ cov @ J.T @ flat.T
    level = LEVEL_RAD**2 * (np.eye(3) - np.outer(R[2], R[2]))
    own[ROTATION, ROTATION] += level
    own[POSITION, POSITION] += fixes.sigma_m[-1] ** 2 * np.outer(R[2], R[2]) * 4
    own[8, 8] = UP_SPEED_MPS**2
    own[BIAS, BIAS] = np.diag(motion.bias_sigmas**2)
    return with_slow(
        R, np.append(end[1:3], up_m), np.append(end[3:], 0.0), own, slow
    )  # fmt: skip


def with_slow(R: Array, p: Array, v: Array, cov: Array, slow: Slow) -> State:
    """A state whose position was taken from fixes: it errs as they do, by their slow error."""
    m = len(slow.sigma)
    full = np.zeros((CORE + m, CORE + m))
    full[:CORE, :CORE] = cov
    full[CORE:, CORE:] = np.diag(slow.sigma**2)
    n = slow.of_fixes
    variance = np.diag(slow.sigma[:n] ** 2)
    if n:
        full[POSITION, POSITION] += R.T @ variance @ R
        full[POSITION, CORE : CORE + n] = -R.T @ variance
        full[CORE : CORE + n, POSITION] = -variance @ R
    return State(R, p, v, np.zeros(6), np.zeros(m), full)


@dataclass(frozen=True, eq=False)
class _Path:
    """Motion by the IMU from the first fix of a window, started level at rest with yaw zero."""

    t_s: Array
    R: Array
    p_m: Array
    v_mps: Array
    lever_m: Array

    def place(self, x: Array) -> tuple[Array, Array]:
        """Antenna (n, 2) and its Jacobian (n, 2, 6) for x = (East, North, speed ahead, yaw, error
        of the acceleration ahead and to the left)."""
        t = self.t_s
        u = self.p_m + self.lever_m + np.outer(t**2 / 2, x[4:])
        u[:, 0] += x[2] * t
        turn = yaw_matrix(x[3])[:2, :2]
        J = np.zeros((len(t), 2, 6))
        J[:, :, :2] = np.eye(2)
        J[:, :, 2] = np.outer(t, turn[:, 0])
        J[:, :, 3] = u @ (turn @ np.array([[0.0, -1], [1, 0]])).T
        J[:, :, 4:] = (t**2 / 2)[:, None, None] * turn
        return x[:2] + u @ turn.T, J

    def end(self, x: Array) -> Array:
        """Yaw turned from the path's own, place (2,) and velocity (2,) at the window's end."""
        t, turn = self.t_s[-1], yaw_matrix(x[3])[:2, :2]
        along = np.array([x[2], 0.0])
        place = x[:2] + turn @ (self.p_m[-1] + along * t + x[4:] * t**2 / 2)
        return np.concatenate([x[3:4], place, turn @ (self.v_mps[-1] + along + x[4:] * t)])


def _path(motion: Inertial, fixes: Fixes, lever_m: Array, slow: Slow) -> _Path:
    epochs = fixes.epoch.tolist()
    m = CORE + len(slow.sigma)
    state = State(np.eye(3), np.zeros(3), np.zeros(3), np.zeros(6), np.zeros(m - CORE),
                  np.zeros((m, m)))  # fmt: skip
    states = {epochs[0]: state}
    for k in range(epochs[0] + 1, epochs[-1] + 1):
        states[k] = motion.step(k, states[k - 1])
    told = [states[k] for k in epochs]
    R = np.array([one.R for one in told])
    return _Path(
        fixes.t_s - fixes.t_s[0], R, np.array([one.p[:2] for one in told]),
        np.array([one.v[:2] for one in told]), (R @ lever_m)[:, :2],
    )  # fmt: skip


def _fitted(path: _Path, fixes: Fixes) -> tuple[Array, Array]:
    """Parameters (6,) and their covariance, ahead or in reverse as fits."""
    chord = fixes.z_m[-1, :2] - fixes.z_m[np.argmax(
        np.linalg.norm(fixes.z_m[:, :2] - fixes.z_m[-1, :2], axis=1)), :2]  # fmt: skip
    course = float(np.arctan2(chord[1], chord[0]))
    speed = float(np.linalg.norm(chord)) / max(path.t_s[-1], 1e-3)
    ahead = _descend(path, fixes, course, speed)
    back = _descend(path, fixes, course + np.pi, -speed)
    x, cov, _ = back if back[2] < REVERSE_FITS_BETTER * ahead[2] else ahead
    return x, cov


def _descend(path: _Path, fixes: Fixes, yaw: float, speed: float) -> tuple[Array, Array, float]:
    """Gauss-Newton: parameters, covariance and cost."""
    x = np.array([*fixes.z_m[0, :2], speed, yaw, 0.0, 0.0])
    prior = np.diag([0, 0, 0, 0, 1, 1]) / ACCEL_ERROR_MPS2**2
    weight = fixes.sigma_m[:, None] ** -2
    for _ in range(_ITERATIONS):
        place, J = path.place(x)
        error = place - fixes.z_m[:, :2]
        H = np.einsum("nia,nib->ab", J * weight[..., None], J) + prior
        g = np.einsum("nia,ni->a", J, error * weight) + prior @ x
        x = x - np.linalg.solve(H + 1e-9 * np.eye(6), g)
    cost = float((error**2 * weight).sum() + x @ prior @ x)
    return x, np.linalg.inv(H + 1e-9 * np.eye(6)), cost


def start_planar(
    motion: Planar, k: int, z_m: Array, cov_m2: Array, lever_m: Array, slow: Slow
) -> State | None:
    """The state at epoch k from a fix there, None while the vehicle is too slow for a course."""
    heading = motion.heading(k)
    if heading is None:
        return None
    R, _ = heading
    own = np.zeros((CORE, CORE))
    own[POSITION, POSITION] = R.T @ cov_m2 @ R
    return with_slow(R, z_m - R @ lever_m, motion.v[k], own, slow)
