"""Output epochs between two smoothed keyframes, from the IMU samples between them.

With s the state at an inner epoch m and i, j the keyframes around it, the IMU says
s_m = f(s_i) + w_1 and s_j = F s_m + w_2. Given s_i and s_j, s_m is
    f(s_i) + K (s_j - f(s_i -> j)),  K = Q_1 F' Q^-1,
with Q_1 the noise from i to m, Q that from i to j and F the transition from m to j: the IMU's own
path, bent so that it ends where the graph says. Its covariance is C = Q_1 - K F Q_1 plus what the
keyframes' own uncertainty adds, for which the two are mixed linearly; as a convex mix this never
claims more than the keyframes do.
"""

import numpy as np
from numpy.typing import NDArray

from fgloc.factors import imu
from fgloc.frames import exp_so3, log_so3
from fgloc.measurements import Array
from fgloc.smoother.model import Model
from fgloc.smoother.states import StateLog


def fill(
    log: StateLog, model: Model, bias: Array, whole: imu.ImuDeltas, part: imu.ImuDeltas
) -> None:
    """Write all inner epochs of a log whose keyframes are written.

    bias (n, 6) is each keyframe's; `whole` and `part` are `model.deltas()`.
    """
    inner = np.flatnonzero(~model.epochs.is_keyframe)
    if not len(inner):
        return
    at = model.epoch_of
    j = np.searchsorted(at, inner) - 1
    _fill_between(log, inner, at[j], at[j + 1], part, whole.take(j), bias[j], model.gravity_mps2)


def _fill_between(
    log: StateLog, epochs: NDArray[np.int64], left: NDArray[np.int64], right: NDArray[np.int64],
    part: imu.ImuDeltas, whole: imu.ImuDeltas, bias: Array, gravity_mps2: float,
) -> None:  # fmt: skip
    """Write M inner epochs: `part` leads from the left keyframe to each, `whole` to the right."""
    R_i, p_i, v_i = log.R[left], log.p[left], log.v[left]
    R_m, p_m, v_m = imu.predict(part, R_i, p_i, v_i, bias, gravity_mps2)
    R_j, p_j, v_j = imu.predict(whole, R_i, p_i, v_i, bias, gravity_mps2)
    miss = np.concatenate(
        [
            log_so3(R_j.swapaxes(-1, -2) @ log.R[right]),
            np.einsum("nji,nj->ni", R_j, log.p[right] - p_j),
            log.v[right] - v_j,
        ],
        axis=-1,
    )
    to_m, _ = imu.transition(part, R_i, bias)
    to_j, _ = imu.transition(whole, R_i, bias)
    F = to_j @ np.linalg.inv(to_m)
    Q_1 = imu.noise_world_velocity(part, R_m)
    Q = imu.noise_world_velocity(whole, R_j)
    K = np.linalg.solve(Q, F @ Q_1).swapaxes(-1, -2)
    bend = np.einsum("nij,nj->ni", K, miss)
    conditional = Q_1 - K @ F @ Q_1
    log.R[epochs] = R_m @ exp_so3(bend[:, :3])
    log.p[epochs] = p_m + np.einsum("nij,nj->ni", R_m, bend[:, 3:6])
    log.v[epochs] = v_m + bend[:, 6:]
    log.gyro_bias[epochs] = bias[:, 3:]
    share = (part.dt_s / whole.dt_s)[:, None, None]
    mixed = (1 - share) * _world(log.R[left], log.cov[left]) + share * _world(
        log.R[right], log.cov[right]
    )
    log.cov[epochs] = _world(log.R[epochs].swapaxes(-1, -2), mixed) + conditional[:, :6, :6]


def _world(R: Array, cov: Array) -> Array:
    """Both blocks of pose covariances (M, 6, 6) turned by R (M, 3, 3)."""
    turn = np.zeros((len(R), 6, 6))
    turn[:, :3, :3] = R
    turn[:, 3:, 3:] = R
    return turn @ cov @ turn.swapaxes(-1, -2)
