"""What is known of a car's motion: wheels do not slide sideways, they count metres, it may stand.

With r the arm from the IMU's place to the point of the vehicle that does not slide (the rear
axle), the point's velocity along the vehicle's axes is
    u = R' v + (w - b_gyro) x r,
and a car that follows its own x axis has u = C [k s, 0, 0]: s is what the wheels say, k their
scale, and C = Exp([0, pitch, yaw]) the mounting, a small turn from the vehicle's axes to those that
the car really follows; the IMU is never mounted quite straight. The residuals are
    non-holonomic  rows y and z of C' u
    wheel          row x of C [k s, 0, 0] - u
    standstill     v, and b_gyro - w with w the mean rate over a window.

GTSAM for Python has no factor on R' v. But an `ImuFactor` between two states holds
R_j' (v_i + R_i dv - v_j) in the frame of state j, and Exp(theta) between their attitudes, where dv
and theta depend on a bias variable as the samples say. Made-up samples without gravity therefore
say all of the above exactly, each in one native factor whose other rows have no weight:
    Y(j)  the car's own axes: the attitude of X(j) turned by C
    W(j)  velocity of the point in the world; where there is no arm, V(j) itself
    K(0)  scale and mounting, carried by a bias variable
    Z(0)  the number zero: a velocity slot that must not say anything.
Points instead (a body velocity w with X w - X 0 = V, by `ReferenceFrameFactorPoint3Pose3`) need
five such variables a constraint, and a `BetweenFactorPose3` on the displacement since the last
keyframe cannot say along what: the direction turns with the car's speed, which nobody measured.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fgloc.frames import exp_so3, right_jacobian_so3, skew
from fgloc.measurements import Array

if TYPE_CHECKING:
    import gtsam

MOUNTING_S = 1e-3
"""The mounting is a bias of rad per this: what the same variable holds beside it, the scale, then
moves a velocity of the mounting's factor by micrometres a second, and all pivots are alike."""
INSTANT_S = 1e-6
"""Length of made-up samples that must not let an accelerometer bias act."""
TIE_RAD, TIE_M, TIE_MPS = 1e-5, 1e-2, 1e-4
"""Slack of the auxiliary variables: far below what constrains them."""
STRAIGHT = np.array([0.0, 0.0, 1.0])
"""The calibration of an IMU that is mounted straight, and of wheels that count right."""
_ZERO, _AHEAD = np.zeros(3), np.array([1.0, 0.0, 0.0])


class BodyVelocity(NamedTuple):
    """u (N, 3) in m/s along vehicle axes, and by pose (N, 3, 6), velocity (3), bias (6)."""

    value: Array
    by_pose: Array
    by_velocity: Array
    by_bias: Array


class VehicleResidual(NamedTuple):
    """error (N, m) in m/s; Jacobians (N, m, d), d = 6 of the pose, 3 of the velocity, 6 of the
    bias, 2 of the mounting, 1 of the scale."""

    error: Array
    by_pose: Array
    by_velocity: Array
    by_bias: Array
    by_mounting: Array
    by_scale: Array


class StandstillResidual(NamedTuple):
    """error (N, 6) in m/s and rad/s; Jacobians by velocity (6, 3) and by bias (6, 6)."""

    error: Array
    by_velocity: Array
    by_bias: Array


def body_velocity(
    R_world_veh: Array, v_world_mps: Array, rate_radps: Array, bias: Array, arm_m: ArrayLike
) -> BodyVelocity:
    """Velocity of a point `arm_m` (3,) from the IMU's place, of states and rates (N, ...)."""
    r, n = np.asarray(arm_m, float), len(v_world_mps)
    back = R_world_veh.swapaxes(-1, -2)
    along = np.einsum("nij,nj->ni", back, v_world_mps)
    by_pose, by_bias = np.zeros((n, 3, 6)), np.zeros((n, 3, 6))
    by_pose[:, :, :3] = skew(along)
    by_bias[:, :, 3:] = skew(r)
    return BodyVelocity(along + np.cross(rate_radps - bias[:, 3:], r), by_pose, back, by_bias)


def non_holonomic(u: BodyVelocity, turn_rad: ArrayLike) -> VehicleResidual:
    """Velocity (N, 2) to the car's left and up; the turn (N, 2), pitch and yaw in rad, is the
    mounting, by which the Jacobians are, and what else is known of it."""
    turn = _rotvec(turn_rad, len(u.value))
    back = exp_so3(turn).swapaxes(-1, -2)
    along = np.einsum("nij,nj->ni", back, u.value)
    by_mounting = (skew(along) @ right_jacobian_so3(turn))[:, 1:, 1:]
    rows = (back @ part for part in (u.by_pose, u.by_velocity, u.by_bias))
    by_pose, by_velocity, by_bias = (part[:, 1:] for part in rows)
    by_scale = np.zeros((len(along), 2, 1))
    return VehicleResidual(along[:, 1:], by_pose, by_velocity, by_bias, by_mounting, by_scale)


def wheel(u: BodyVelocity, turn_rad: ArrayLike, scale: float, speed_mps: Array) -> VehicleResidual:
    """Predicted speed from the wheels' (N,), times the scale, minus that of the state: (N, 1).

    The turn (N, 2) is that of `non_holonomic`.
    """
    turn = _rotvec(turn_rad, len(u.value))
    C = exp_so3(turn)
    ahead = C[:, 0, 0] * speed_mps
    by_turn = (-C @ skew(_AHEAD) @ right_jacobian_so3(turn))[:, :1, 1:]
    error = scale * ahead - u.value[:, 0]
    by_pose, by_velocity, by_bias = (-part[:, :1] for part in (u.by_pose, u.by_velocity, u.by_bias))
    by_mounting = (scale * speed_mps)[:, None, None] * by_turn
    return VehicleResidual(
        error[:, None], by_pose, by_velocity, by_bias, by_mounting, ahead[:, None, None]
    )


def late_wheel(
    u: BodyVelocity, turn_rad: ArrayLike, scale: float, speed_mps: Array, slope_mps2: Array,
    late_s: float,
) -> tuple[VehicleResidual, Array]:  # fmt: skip
    """`wheel` of speeds that are stamped too late, and its Jacobian by that (N, 1, 1).

    What was true at the stamp is told only `late_s` later, by when the wheels' speed has changed
    by its own slope (N,); what bends it within `late_s` is left out.
    """
    told = wheel(u, turn_rad, scale, speed_mps + late_s * slope_mps2)
    ahead = exp_so3(_rotvec(turn_rad, len(u.value)))[:, 0, 0]
    return told, (scale * ahead * slope_mps2)[:, None, None]


def standstill(v_world_mps: Array, bias: Array, rate_radps: Array) -> StandstillResidual:
    """Velocity, and gyro bias minus the mean rate (N, 3) of a car that stands."""
    error = np.concatenate([v_world_mps, bias[:, 3:] - rate_radps], axis=-1)
    by_velocity, by_bias = np.zeros((6, 3)), np.zeros((6, 6))
    by_velocity[:3], by_bias[3:, 3:] = np.eye(3), np.eye(3)
    return StandstillResidual(error, by_velocity, by_bias)


def calibration(known: ArrayLike) -> gtsam.imuBias.ConstantBias:
    """The value of K(0) that stands for pitch and yaw of the mounting in rad and the scale (3,)."""
    import gtsam

    pitch, yaw, scale = np.asarray(known, float) / [MOUNTING_S, MOUNTING_S, 1.0]
    return gtsam.imuBias.ConstantBias(np.array([1 - scale, 0, 0]), -np.array([0, pitch, yaw]))


def read_calibration(value: gtsam.imuBias.ConstantBias) -> Array:
    """Pitch and yaw of the mounting, in rad, and the scale (3,) that a value of K(0) stands for."""
    pitch, yaw = -MOUNTING_S * value.gyroscope()[1:]
    return np.array([pitch, yaw, 1 - value.accelerometer()[0]])


def calibration_covariance(cov: Array) -> Array:
    """(3, 3) of the pitch and yaw of the mounting, in rad, and of the scale, from the covariance
    (6, 6) of K(0)."""
    by = np.zeros((3, 6))
    by[[0, 1, 2], [4, 5, 0]] = -MOUNTING_S, -MOUNTING_S, -1.0
    return by @ cov @ by.T


def car_pose(pose: gtsam.Pose3, point_mps: Array, turn_rad: ArrayLike) -> gtsam.Pose3:
    """Where the ties of Y(j) want it, from X(j), W(j) and the turn (2,)."""
    import gtsam

    turn = gtsam.Rot3(exp_so3(_rotvec(turn_rad, 1)[0]))
    return gtsam.Pose3(pose.rotation() * turn, pose.translation() + MOUNTING_S * point_mps)


def calibration_prior(
    key: int, mounting_sigma_rad: float, scale_sigma: float
) -> gtsam.PriorFactorConstantBias:
    """What is known beforehand: straight and true, to these standard deviations."""
    import gtsam

    unused, angle = 1e-3, mounting_sigma_rad / MOUNTING_S
    sigmas = np.array([scale_sigma, unused, unused, unused, angle, angle])
    model = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    return gtsam.PriorFactorConstantBias(key, calibration(STRAIGHT), model)


def zero_prior(key: int) -> gtsam.PriorFactorVector:
    """Holds Z(0) at zero."""
    import gtsam

    return gtsam.PriorFactorVector(key, _ZERO, gtsam.noiseModel.Isotropic.Sigma(3, TIE_MPS / 10))


def point_velocity_factor(
    pose: int, velocity: int, car: int, point: int, bias: int, rate_radps: Array, arm_m: Array
) -> gtsam.NonlinearFactor:
    """Ties W(j) to v + R (w - b) x r: two samples of an instant, of which the second's force is
    turned by the bias of the first and so brings in -b x r."""
    second = np.asarray(arm_m, float) / INSTANT_S**2
    first = np.cross(rate_radps, arm_m) / INSTANT_S - second
    samples = _samples((first, _ZERO, INSTANT_S), (second, _ZERO, INSTANT_S))
    return _factor((pose, velocity, car, point, bias), samples, _no_rows(velocity=TIE_MPS))


def non_holonomic_factor(
    pose: int, point: int, car: int, zero: int, calibration: int, pitch_rad: float,
    model: gtsam.noiseModel.Base,
) -> gtsam.NonlinearFactor:  # fmt: skip
    """Ties Y(j) to the pose, and is the native factor of `non_holonomic`: the turn is the
    mounting and the body's pitch. `model` is that of `car_model`, a robust loss may lie on it."""
    rate = np.array([0.0, pitch_rad / MOUNTING_S, 0.0])
    return _factor(
        (pose, point, car, zero, calibration), _samples((_ZERO, rate, MOUNTING_S)), model
    )


def wheel_factor(
    car: int, zero: int, pose: int, point: int, calibration: int, speed_mps: float,
    model: gtsam.noiseModel.Base,
) -> gtsam.NonlinearFactor:  # fmt: skip
    """The native factor of `wheel`: a force of 1 along the car's axis for as long as it has metres
    a second. `model` is that of `wheel_model`. In reverse a sample before turns it half about."""
    half_turn = (_ZERO, np.array([0.0, 0.0, np.pi]) / INSTANT_S**2, INSTANT_S**2)
    ahead = (_AHEAD, _ZERO, max(abs(speed_mps), INSTANT_S**2))
    samples = _samples(half_turn, ahead) if speed_mps < 0 else _samples(ahead)
    return _factor((car, zero, pose, point, calibration), samples, model)


def car_model(sigmas_mps: ArrayLike) -> gtsam.noiseModel.Base:
    """The noise of `non_holonomic_factor`, to the left and up (2,); infinite sigmas leave the ties
    of Y(j) alone."""
    import gtsam

    ties = np.repeat([TIE_RAD**-2, TIE_M**-2], 3)
    slip = np.asarray(sigmas_mps, float) ** -2
    return gtsam.noiseModel.Diagonal.Precisions(np.concatenate([ties, [0.0], slip]))


def wheel_model(sigma_mps: float) -> gtsam.noiseModel.Base:
    """The noise of a wheel speed as `wheel_factor` takes it."""
    import gtsam

    return gtsam.noiseModel.Diagonal.Precisions(np.r_[np.zeros(6), 1 / sigma_mps**2, 0, 0])


def standstill_factors(
    velocity: int, bias: int, rate_radps: Array, model: gtsam.noiseModel.Base,
    rate_sigma_radps: float,
) -> list[gtsam.NonlinearFactor]:  # fmt: skip
    """The native factors of `standstill`; `model` is the noise of the velocity."""
    import gtsam

    weight = np.repeat([0.0, rate_sigma_radps**-2], 3)
    rate = gtsam.imuBias.ConstantBias(_ZERO, np.asarray(rate_radps, float))
    return [
        gtsam.PriorFactorVector(velocity, _ZERO, model),
        gtsam.PriorFactorConstantBias(bias, rate, gtsam.noiseModel.Diagonal.Precisions(weight)),
    ]


@cache
def _params() -> gtsam.PreintegrationParams:
    import gtsam

    params = gtsam.PreintegrationParams.MakeSharedU(0.0)
    params.setImuFactorErrorMode(gtsam.ImuFactorErrorMode.ComponentWise)
    return params


def _samples(*samples: tuple[Array, Array, float]) -> gtsam.PreintegratedImuMeasurements:
    """Made-up samples of force, rate and duration."""
    import gtsam

    pim = gtsam.PreintegratedImuMeasurements(_params())
    for force, rate, dt_s in samples:
        pim.integrateMeasurement(force, rate, dt_s)
    return pim


def _rotvec(turn_rad: ArrayLike, n: int) -> Array:
    """Pitch and yaw, (2,) or (n, 2), as rotation vectors (n, 3)."""
    rotvec = np.zeros((n, 3))
    rotvec[:, 1:] = turn_rad
    return rotvec


def _factor(
    keys: tuple[int, int, int, int, int],
    samples: gtsam.PreintegratedImuMeasurements,
    model: gtsam.noiseModel.Base,
) -> gtsam.NonlinearFactor:
    import gtsam

    return gtsam.ImuFactor(*keys, samples).cloneWithNewNoiseModel(model)


@cache
def _no_rows(velocity: float) -> gtsam.noiseModel.Base:
    """Weight on the three rows of the velocity alone."""
    import gtsam

    return gtsam.noiseModel.Diagonal.Precisions(np.repeat([0.0, 0.0, velocity**-2], 3))
