"""The generic simulator: what sensors on a vehicle say of a known motion, plus seeded noise.

A motion is exact and dense; each sensor is `z = predict(motion) + noise`. Every sensor draws from
a stream of its own, so changing one leaves the numbers of the others as they were.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from fgloc.drive import ImuNoise, Rig
from fgloc.errors import InputError
from fgloc.measurements import Array, EnuVelocities, GnssFixes, ImuSamples, WheelSpeeds
from fgloc.timing import NS_PER_S, Instants
from fgloc.trajectory import Trajectory

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Motion:
    """What the vehicle frame really does, at N instants.

    t_ns           (N,) instants
    p_world_m      (N, 3) position of the vehicle origin, ENU m
    v_world_mps    (N, 3) its velocity
    a_world_mps2   (N, 3) its acceleration
    R_world_veh    (N, 3, 3) attitude
    w_veh_radps    (N, 3) angular rate in vehicle axes
    wdot_veh_radps2  (N, 3) angular acceleration in vehicle axes
    """

    t_ns: Instants
    p_world_m: Array
    v_world_mps: Array
    a_world_mps2: Array
    R_world_veh: Array
    w_veh_radps: Array
    wdot_veh_radps2: Array

    def __len__(self) -> int:
        return len(self.t_ns)

    def every(self, step: int) -> Self:
        """Each `step`-th instant, from the first."""
        return type(self)(**{name: array[::step] for name, array in vars(self).items()})


def stream(seed: int, name: str) -> np.random.Generator:
    """The random numbers of one part of a scenario: of the same seed, but apart by name.

    Raises InputError for a seed that is not a whole number from 0.
    """
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed = {seed!r}: expected a whole number from 0")
    return np.random.default_rng([int(seed), *name.encode()])


def instants(start_ns: int, duration_s: float, rate_hz: int) -> Instants:
    """Instants at an even rate from `start_ns` to `duration_s` later, both ends included."""
    n = int(np.floor(duration_s * rate_hz + 1e-9)) + 1
    return start_ns + np.arange(n, dtype=np.int64) * (NS_PER_S // rate_hz)


def truth_of(motion: Motion) -> Trajectory:
    """The motion of the vehicle origin as truth, with attitude and velocity."""
    return Trajectory(motion.t_ns, motion.p_world_m, motion.R_world_veh, motion.v_world_mps)


def simulate_gnss(
    motion: Motion, rig: Rig, sigma_enu_m: ArrayLike, rng: np.random.Generator
) -> GnssFixes:
    """Fixes of the antenna at every instant, white noise of `sigma_enu_m` (3,), no velocity."""
    n = len(motion)
    sigma_m = np.asarray(sigma_enu_m, float)
    p_world_ant_m = motion.p_world_m + motion.R_world_veh @ rig.p_veh_ant_m
    noise_m = rng.standard_normal((n, 3)) * sigma_m
    cov_m2 = np.tile(np.diag(sigma_m**2), (n, 1, 1))
    return GnssFixes(
        motion.t_ns, motion.t_ns, p_world_ant_m + noise_m, cov_m2, np.full((n, 3), np.nan)
    )


def simulate_wheel(motion: Motion, sigma_mps: float, rng: np.random.Generator) -> WheelSpeeds:
    """Speed of the vehicle origin along x at every instant, with white noise."""
    forward = np.einsum("ni,ni->n", motion.R_world_veh[:, :, 0], motion.v_world_mps)
    speed_mps = forward + sigma_mps * rng.standard_normal(len(motion))
    return WheelSpeeds(motion.t_ns, motion.t_ns, speed_mps, np.full(len(motion), sigma_mps))


def simulate_velocity(motion: Motion, sigma_mps: float, rng: np.random.Generator) -> EnuVelocities:
    """Velocity of the vehicle origin at every instant, white noise on each axis of ENU."""
    n = len(motion)
    noise_mps = sigma_mps * rng.standard_normal((n, 3))
    return EnuVelocities(
        motion.t_ns, motion.t_ns, motion.v_world_mps + noise_mps, np.full(n, sigma_mps)
    )


def gauss_markov(tau_s: float, t_s: Array, columns: int, rng: np.random.Generator) -> Array:
    """Stationary first-order Gauss-Markov noise (N, columns) of unit sigma at times (N,) in s.

    The columns are independent; each forgets itself over `tau_s`.
    """
    keep = np.exp(-np.diff(t_s) / tau_s)
    noise = rng.standard_normal((len(t_s), columns))
    noise[1:] *= np.sqrt(1 - keep**2)[:, None]
    for k in range(1, len(noise)):
        noise[k] += keep[k - 1] * noise[k - 1]
    return noise


def predict_imu(motion: Motion, rig: Rig, gravity_mps2: float) -> tuple[Array, Array]:
    """Specific force and angular rate (N, 3) each that an ideal IMU reads, in its own axes.

    The lever arm to the IMU adds the tangential and the centripetal acceleration. The Earth's
    rotation is left out, as it is in the estimators.
    """
    R_veh_imu, p_veh_imu_m = rig.T_veh_imu[:3, :3], rig.T_veh_imu[:3, 3]
    w, wdot = motion.w_veh_radps, motion.wdot_veh_radps2
    f_world = motion.a_world_mps2 + gravity_mps2 * UP
    f_veh = np.einsum("nji,nj->ni", motion.R_world_veh, f_world)
    f_veh += np.cross(wdot, p_veh_imu_m) + np.cross(w, np.cross(w, p_veh_imu_m))
    return f_veh @ R_veh_imu, w @ R_veh_imu


def simulate_imu(
    motion: Motion, rig: Rig, gravity_mps2: float, rng: np.random.Generator
) -> ImuSamples:
    """Samples at every instant: white noise and biases that walk, as `rig.imu_noise` says.

    The biases start at a draw from their sigmas. Raises InputError where the rig has no noise.
    """
    if rig.imu_noise is None:
        raise InputError("a rig needs imu_noise before an IMU can be simulated")
    dt_s = float(motion.t_ns[1] - motion.t_ns[0]) / NS_PER_S if len(motion) > 1 else 1.0
    accel, gyro = predict_imu(motion, rig, gravity_mps2)
    accel_error, gyro_error = imu_errors(rig.imu_noise, len(motion), dt_s, rng)
    return ImuSamples(motion.t_ns, motion.t_ns, accel + accel_error, gyro + gyro_error)


def imu_errors(
    noise: ImuNoise, n: int, dt_s: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Errors (n, 3) of accelerometer (m/s^2) and gyro (rad/s) sampled every `dt_s`."""
    accel = _sensor_error(
        noise.accel_noise_mps2_per_sqrt_hz, noise.accel_bias_walk_mps3_per_sqrt_hz,
        noise.accel_bias_sigma_mps2, n, dt_s, rng,
    )  # fmt: skip
    gyro = _sensor_error(
        noise.gyro_noise_radps_per_sqrt_hz, noise.gyro_bias_walk_radps2_per_sqrt_hz,
        noise.gyro_bias_sigma_radps, n, dt_s, rng,
    )  # fmt: skip
    return accel, gyro


def _sensor_error(
    density: float, walk: float, bias_sigma: float, n: int, dt_s: float, rng: np.random.Generator
) -> Array:
    """White noise of a density, plus a bias that starts at a draw and walks."""
    steps = walk * np.sqrt(dt_s) * rng.standard_normal((n, 3))
    steps[:1] = bias_sigma * rng.standard_normal((min(n, 1), 3))
    return density / np.sqrt(dt_s) * rng.standard_normal((n, 3)) + np.cumsum(steps, axis=0)
