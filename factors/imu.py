"""IMU: preintegration between two states, its residual in numpy and its native factor.

Forster et al., 'On-Manifold Preintegration', T-RO 2017, in GTSAM's tangent form: the samples
between states i and j give delta = (theta, dp, dv), corrected to first order for a change of bias,
    R_j = R_i Exp(theta),  p_j = p_i + v_i T + g T^2 / 2 + R_i dp,  v_j = v_i + g T + R_i dv,
and the residual is the difference of prediction and state j in the frame of state j. The biases
are a random walk. The Earth's rotation (15 deg/h) is left out: a consumer gyro's bias hides it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fgloc.drive import Noise
from fgloc.factors.fields import apply, exp, inverse_jacobian, of, product, rows
from fgloc.factors.fields import skew as skews
from fgloc.frames import exp_so3, log_so3, right_jacobian_inverse_so3, right_jacobian_so3, skew
from fgloc.measurements import Array

if TYPE_CHECKING:
    import gtsam

INTEGRATION_NOISE_M_PER_SQRT_S = 1e-3
"""Position noise of the integration itself. A tenth of it makes the normal equations of 10 Hz
keyframes too ill-conditioned for a Cholesky in double precision; estimates do not change."""
_UNKNOWNS = (6, 9, 15, 21)
"""Where the parts of `ImuResidual` begin."""


class ImuDeltas(NamedTuple):
    """Preintegrated motion over N intervals; rows are (theta, dp, dv) in the frame of state i.

    delta     (N, 9) rad, m, m/s at `bias_hat`
    by_bias   (N, 9, 6) change of delta with the bias, accelerometer first
    cov       (N, 9, 9) in the frame at the end of the interval: rad^2, m^2, (m/s)^2
    dt_s      (N,)
    bias_hat  (N, 6) m/s^2 and rad/s
    """

    delta: Array
    by_bias: Array
    cov: Array
    dt_s: Array
    bias_hat: Array

    def take(self, rows: Any) -> ImuDeltas:
        """The intervals that a slice, mask or index array selects."""
        return ImuDeltas(*(column[rows] for column in self))


class ImuResidual(NamedTuple):
    """error (N, 9) and its Jacobian (N, 9, 24), which has a part for each unknown."""

    error: Array
    jacobian: Array

    @property
    def by_pose_i(self) -> Array:
        """(N, 9, 6)."""
        return self.jacobian[..., :6]

    @property
    def by_velocity_i(self) -> Array:
        """(N, 9, 3)."""
        return self.jacobian[..., 6:9]

    @property
    def by_bias(self) -> Array:
        """(N, 9, 6)."""
        return self.jacobian[..., 9:15]

    @property
    def by_pose_j(self) -> Array:
        """(N, 9, 6)."""
        return self.jacobian[..., 15:21]

    @property
    def by_velocity_j(self) -> Array:
        """(N, 9, 3)."""
        return self.jacobian[..., 21:]


def parameters(
    accel_noise: ArrayLike, gyro_noise: ArrayLike, gravity_mps2: float
) -> gtsam.PreintegrationParams:
    """GTSAM's parameters for densities in m/s^2 and rad/s per sqrt(Hz), one for all axes or (3,),
    gravity along -z."""
    import gtsam

    params = gtsam.PreintegrationParams.MakeSharedU(gravity_mps2)
    params.setAccelerometerCovariance(np.eye(3) * np.square(accel_noise))
    params.setGyroscopeCovariance(np.eye(3) * np.square(gyro_noise))
    params.setIntegrationCovariance(np.eye(3) * INTEGRATION_NOISE_M_PER_SQRT_S**2)
    params.setImuFactorErrorMode(gtsam.ImuFactorErrorMode.ComponentWise)
    return params


def integrate(
    pim: gtsam.PreintegratedImuMeasurements, accel: Iterable[Array], gyro: Iterable[Array],
    dt_s: Iterable[float],
) -> None:  # fmt: skip
    """Add samples to a preintegration, each held over its dt."""
    add = pim.integrateMeasurement
    for a, w, dt in zip(accel, gyro, np.asarray(dt_s).tolist(), strict=True):
        add(a, w, dt)


class Snapshot(NamedTuple):
    """What a native preintegration holds at one instant, copied out; `table` makes rows of it."""

    delta: Array
    end_by_bias: Array
    cov: Array
    dt_s: float
    bias_hat: Array


def snapshot(pim: gtsam.PreintegratedImuMeasurements) -> Snapshot:
    """Copy the sums so far; integration may go on."""
    import gtsam

    end_by_bias = np.zeros((9, 6), order="F")
    unused = np.zeros((9, 9), order="F")
    pim.predict(gtsam.NavState(), pim.biasHat(), unused, end_by_bias)
    return Snapshot(pim.preintegrated(), end_by_bias, pim.residualCovariance(), pim.deltaTij(),
                    pim.biasHatVector())  # fmt: skip


def table(snapshots: Sequence[Snapshot]) -> ImuDeltas:
    """Snapshots as the rows of a table."""
    delta, end, cov, dt_s, hat = (np.array(column) for column in zip(*snapshots, strict=True))
    # GTSAM gives the Jacobian by bias in the frame of the end; bring it to delta itself.
    R = exp_so3(delta[:, :3])
    J = right_jacobian_inverse_so3(delta[:, :3])
    by_bias = np.concatenate([J @ end[:, :3], R @ end[:, 3:6], R @ end[:, 6:]], axis=1)
    return ImuDeltas(delta, by_bias, cov, dt_s, hat)


def factor(
    keys: tuple[int, int, int, int, int], pim: gtsam.PreintegratedImuMeasurements
) -> gtsam.ImuFactor:
    """The native factor of `residual`; keys are pose_i, velocity_i, pose_j, velocity_j, bias."""
    import gtsam

    return gtsam.ImuFactor(*keys, pim)


def bias_walk_sigmas(noise: Noise, dt_s: float) -> Array:
    """Standard deviations (6,) of the biases' change over dt seconds: 3 in m/s^2, 3 in rad/s."""
    walks = noise.accel_bias_walk_mps3_per_sqrt_hz, noise.gyro_bias_walk_radps2_per_sqrt_hz
    return np.concatenate([np.broadcast_to(walk, 3) for walk in walks]) * np.sqrt(dt_s)


def predict(
    deltas: ImuDeltas, R: Array, p: Array, v: Array, bias: Array, gravity_mps2: float
) -> tuple[Array, Array, Array]:
    """States (N, ...) carried over the intervals: attitude, position in m, velocity in m/s."""
    return carried(corrected(deltas, bias), deltas.dt_s, R, p, v, gravity_mps2)


def carried(
    d: Array, dt_s: Array, R: Array, p: Array, v: Array, gravity_mps2: float
) -> tuple[Array, Array, Array]:
    """The same by deltas (N, 9) that are `corrected` for the bias, over times (N,)."""
    T = dt_s[:, None]
    g = np.array([0.0, 0.0, -gravity_mps2])
    return (
        R @ exp_so3(d[:, :3]),
        p + v * T + 0.5 * g * T**2 + _rotate(R, d[:, 3:6]),
        v + g * T + _rotate(R, d[:, 6:]),
    )


def transition(deltas: ImuDeltas, R: Array, bias: Array) -> tuple[Array, Array]:
    """How small errors travel: by state (N, 9, 9) and by bias (N, 9, 6).

    Errors are (rotation, position) in the vehicle frame, as GTSAM's Pose3, then velocity in the
    world; noise of the interval is `deltas.cov` turned by `velocity_to_world`.
    """
    d = corrected(deltas, bias)
    dR = exp_so3(d[:, :3])
    R_j = R @ dR
    back = dR.swapaxes(-1, -2)
    F = np.zeros((len(d), 9, 9))
    F[:, :3, :3] = back
    F[:, 3:6, :3] = -back @ skew(d[:, 3:6])
    F[:, 3:6, 3:6] = back
    F[:, 3:6, 6:] = R_j.swapaxes(-1, -2) * deltas.dt_s[:, None, None]
    F[:, 6:, :3] = -R @ skew(d[:, 6:])
    F[:, 6:, 6:] = np.eye(3)
    turn = right_jacobian_so3(d[:, :3]) @ deltas.by_bias[:, :3]
    G = np.concatenate([turn, back @ deltas.by_bias[:, 3:6], R @ deltas.by_bias[:, 6:]], axis=1)
    return F, G


def noise_world_velocity(deltas: ImuDeltas, R_j: Array) -> Array:
    """`deltas.cov` (N, 9, 9) with the velocity turned from the frame of state j to the world."""
    turn = np.zeros((len(R_j), 9, 9))
    turn[:, :6, :6] = np.eye(6)
    turn[:, 6:, 6:] = R_j
    return turn @ deltas.cov @ turn.swapaxes(-1, -2)


def residual(
    deltas: ImuDeltas, state_i: tuple[Array, Array, Array], state_j: tuple[Array, Array, Array],
    bias: Array, gravity_mps2: float,
) -> ImuResidual:  # fmt: skip
    """Prediction from states i minus states j, in the frame of j, (N, 9): rad, m, m/s.

    States are (R_world_veh (N, 3, 3), p_world_m (N, 3), v_world_mps (N, 3)); bias is (N, 6).
    """
    (R_i, p_i, v_i), (R_j, p_j, v_j) = (tuple(map(of, state)) for state in (state_i, state_j))
    theta, dp, dv = of(corrected(deltas, bias)).reshape(3, 3, -1)
    T, g = deltas.dt_s, np.array([[0.0], [0.0], [-gravity_mps2]])
    theta_by_bias, dp_by_bias, dv_by_bias = of(deltas.by_bias).reshape(3, 3, 6, -1)
    dR, Jr = exp(theta)
    back = R_j.swapaxes(0, 1)
    relative = product(back, R_i)
    turn = log_so3(rows(product(relative, dR))).T
    inverse, *_ = inverse_jacobian(turn)
    moved = apply(relative, dp) + apply(back, p_i - p_j + v_i * T + 0.5 * g * T**2)
    sped_up = apply(relative, dv) + apply(back, v_i - v_j + g * T)
    J = np.zeros((9, 24, len(T)))
    by_pose_i, by_velocity_i, by_bias, by_pose_j, by_velocity_j = np.split(J, _UNKNOWNS, axis=1)
    by_pose_i[:3, :3] = product(inverse, dR.swapaxes(0, 1))
    by_pose_i[3:6, :3] = -product(relative, skews(dp))
    by_pose_i[3:6, 3:] = relative
    by_pose_i[6:, :3] = -product(relative, skews(dv))
    by_velocity_i[3:6] = back * T
    by_velocity_i[6:] = back
    by_bias[:3] = product(inverse, product(Jr, theta_by_bias))
    by_bias[3:6] = product(relative, dp_by_bias)
    by_bias[6:] = product(relative, dv_by_bias)
    by_pose_j[:3, :3] = -inverse.swapaxes(0, 1)  # Jr^-1(e) Exp(-e) = Jr^-1(-e)
    by_pose_j[3:6, :3] = skews(moved)
    by_pose_j[3:6, 3:] = -np.eye(3)[..., None]
    by_pose_j[6:, :3] = skews(sped_up)
    by_velocity_j[6:] = -back
    return ImuResidual(rows(np.concatenate([turn, moved, sped_up])), np.ascontiguousarray(rows(J)))


def corrected(deltas: ImuDeltas, bias: ArrayLike) -> Array:
    """Deltas (N, 9) to first order at another bias (N, 6)."""
    return deltas.delta + _rotate(deltas.by_bias, np.asarray(bias) - deltas.bias_hat)


def _rotate(matrix: Array, vector: Array) -> Array:
    return np.einsum("nij,nj->ni", matrix, vector)
