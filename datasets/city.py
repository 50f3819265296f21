"""Scenario `city`: a plain simulated car drive with GNSS, IMU and wheel speed.

The car waits, sets off, follows gently bent streets over low hills, stops at lights and turns
corners. The motion is a closed formula of time but for the horizontal position, which is
integrated to far below a millimetre, so what the sensors say fits the truth exactly.

Speed is a chain of phases, each going from one speed to another along a smooth step; a phase may
also turn the heading along another smooth step of the distance it covers. A smooth step has two
continuous derivatives, so acceleration, turn rate and their first derivatives are continuous.
"""

from dataclasses import dataclass

import numpy as np

from fgloc import frames
from fgloc.datasets.simulator import (
    Motion,
    instants,
    simulate_gnss,
    simulate_imu,
    simulate_wheel,
    stream,
    truth_of,
)
from fgloc.drive import About, Drive, ImuNoise, Rig
from fgloc.errors import InputError
from fgloc.frames import Origin
from fgloc.measurements import Array
from fgloc.timing import elapsed_s

START_NS = 1_760_000_000 * 1_000_000_000
ORIGIN = Origin(52.3759, 9.7320, 98.0)
IMU_HZ, WHEEL_HZ, TRUTH_HZ, GNSS_HZ = 100, 50, 20, 10
GNSS_SIGMA_ENU_M = (1.0, 1.0, 2.0)
WHEEL_SIGMA_MPS = 0.05

P_VEH_ANT_M = (1.2, 0.0, 1.5)
P_VEH_IMU_M = (0.5, -0.2, 0.4)
IMU_TURN_RAD = (0.01, -0.02, 0.03)  # nobody mounts a box exactly straight
IMU_NOISE = ImuNoise(
    accel_noise_mps2_per_sqrt_hz=2e-3,
    gyro_noise_radps_per_sqrt_hz=2e-4,
    accel_bias_walk_mps3_per_sqrt_hz=2e-4,
    gyro_bias_walk_radps2_per_sqrt_hz=4e-6,
    accel_bias_sigma_mps2=0.1,
    gyro_bias_sigma_radps=0.005,
)

SHORTEST_S, LONGEST_S = 1.0, 86_400.0
_STEEPEST = 1.875  # largest slope of the smooth step
_ACCEL_MPS2 = (1.2, 2.3)  # peak of setting off and braking
_TURN_ACCEL_MPS2 = (1.2, 2.4)  # peak sideways in a corner
_BEND_ACCEL_MPS2 = 0.8  # peak sideways on a bent street
_HILLS = ((0.012, 900.0), (0.010, 370.0), (0.006, 140.0))  # slope, wavelength in m


@dataclass(frozen=True)
class _Phase:
    """From one speed to another over a time, turning the heading by an angle meanwhile."""

    duration_s: float
    from_mps: float
    to_mps: float
    turn_rad: float = 0.0

    @property
    def length_m(self) -> float:
        return self.duration_s * (self.from_mps + self.to_mps) / 2


def make_city(seed: int = 0, duration_s: float = 120.0) -> Drive:
    """The drive of a seed; truth of the rear axle at 20 Hz with attitude and velocity.

    Raises InputError for a seed below 0 or a duration outside [1 s, 1 day].
    """
    if not SHORTEST_S <= duration_s <= LONGEST_S:
        raise InputError(
            f"duration_s = {duration_s}: expected {SHORTEST_S:g} to {LONGEST_S:g} seconds"
        )
    motion = city_motion(seed, duration_s)
    rig = city_rig()
    tables = {
        "gnss": simulate_gnss(
            motion.every(IMU_HZ // GNSS_HZ), rig, GNSS_SIGMA_ENU_M, stream(seed, "gnss")
        ),
        "imu": simulate_imu(motion, rig, ORIGIN.gravity_mps2(), stream(seed, "imu")),
        "wheel": simulate_wheel(
            motion.every(IMU_HZ // WHEEL_HZ), WHEEL_SIGMA_MPS, stream(seed, "wheel")
        ),
    }
    truth = truth_of(motion.every(IMU_HZ // TRUTH_HZ))
    return Drive("city", ORIGIN, rig, tables, truth, _about(seed, duration_s))


def city_rig() -> Rig:
    """The antenna on the roof, the IMU between the seats and slightly askew."""
    T_veh_imu = np.eye(4)
    T_veh_imu[:3, :3] = frames.exp_so3(IMU_TURN_RAD)
    T_veh_imu[:3, 3] = P_VEH_IMU_M
    return Rig(np.array(P_VEH_ANT_M), T_veh_imu, IMU_NOISE)


def city_motion(seed: int, duration_s: float) -> Motion:
    """The motion of the vehicle frame at 100 Hz."""
    rng = stream(seed, "motion")
    phases = _plan(rng, duration_s)
    heading_rad = rng.uniform(-np.pi, np.pi)
    hill_phase_rad = rng.uniform(0, 2 * np.pi, len(_HILLS))
    t_ns = instants(START_NS, duration_s, IMU_HZ)
    s, v, a, yaw, yaw_rate, yaw_acc = _along_road(phases, heading_rad, elapsed_s(t_ns, START_NS))
    z, slope, bend, bend_rate = _hills(s, hill_phase_rad)

    direction = np.stack([np.cos(yaw), np.sin(yaw), slope], -1)
    d_direction = np.stack([-np.sin(yaw) * yaw_rate, np.cos(yaw) * yaw_rate, bend * v], -1)
    velocity = v[:, None] * direction
    acceleration = a[:, None] * direction + v[:, None] * d_direction
    position = _integrate(velocity, acceleration, 1 / IMU_HZ)
    position[:, 2] = z - z[0]  # known in closed form

    # Nose up by the slope of the street, and its rates; the attitude is Rz(yaw) Ry(-pitch).
    pitch, flat = np.arctan(slope), 1 + slope**2
    pitch_rate = bend * v / flat
    pitch_acc = (bend_rate * v**2 + bend * a) / flat - 2 * slope * pitch_rate**2
    R_world_veh = frames.yaw_matrix(yaw) @ frames.exp_so3(np.outer(pitch, [0.0, -1.0, 0.0]))
    sin, cos = np.sin(pitch), np.cos(pitch)
    w = np.stack([yaw_rate * sin, -pitch_rate, yaw_rate * cos], -1)
    wdot = np.stack(
        [
            yaw_acc * sin + yaw_rate * pitch_rate * cos,
            -pitch_acc,
            yaw_acc * cos - yaw_rate * pitch_rate * sin,
        ],
        axis=-1,
    )
    return Motion(t_ns, position, velocity, acceleration, R_world_veh, w, wdot)


def _plan(rng: np.random.Generator, duration_s: float) -> list[_Phase]:
    """Phases that fill the duration: a wait, then block after block with a corner at the end."""
    phases = [_Phase(rng.uniform(3.0, 6.0), 0.0, 0.0)]
    while sum(phase.duration_s for phase in phases) < duration_s:
        phases += _block(rng, phases[-1].to_mps)
    return phases


def _block(rng: np.random.Generator, speed_mps: float) -> list[_Phase]:
    """Speed up, cruise along a gently bent street, perhaps stop at a light, turn a corner."""
    cruise_mps = rng.uniform(9.0, 15.0)
    corner_m = rng.uniform(22.0, 40.0)
    # Peak curvature of a corner times the speed squared is the peak acceleration sideways.
    corner_mps = np.sqrt(rng.uniform(*_TURN_ACCEL_MPS2) * corner_m / (np.pi / 2 * _STEEPEST))
    cruise_s = rng.uniform(6.0, 20.0)
    bend_rad = rng.uniform(-1, 1) * min(_BEND_ACCEL_MPS2 * cruise_s / (_STEEPEST * cruise_mps), 0.6)
    phases = [
        _ramp(rng, speed_mps, cruise_mps),
        _Phase(cruise_s, cruise_mps, cruise_mps, bend_rad),
    ]
    if rng.random() < 0.5:
        wait = _Phase(rng.uniform(3.0, 10.0), 0.0, 0.0)
        phases += [_ramp(rng, cruise_mps, 0.0), wait, _ramp(rng, 0.0, corner_mps)]
    else:
        phases += [_ramp(rng, cruise_mps, corner_mps)]
    side = rng.choice([-1.0, 1.0])
    return [*phases, _Phase(corner_m / corner_mps, corner_mps, corner_mps, side * np.pi / 2)]


def _ramp(rng: np.random.Generator, from_mps: float, to_mps: float) -> _Phase:
    return _Phase(_STEEPEST * abs(to_mps - from_mps) / rng.uniform(*_ACCEL_MPS2), from_mps, to_mps)


def _along_road(phases: list[_Phase], heading_rad: float, t_s: Array) -> tuple[Array, ...]:
    """At times (N,): distance on the map in m, its two derivatives, yaw in rad, its two."""
    T = np.array([phase.duration_s for phase in phases])
    v0 = np.array([phase.from_mps for phase in phases])
    dv = np.array([phase.to_mps for phase in phases]) - v0
    L = np.array([phase.length_m for phase in phases])
    turn = np.array([phase.turn_rad for phase in phases])
    begin_s, begin_m, begin_rad = (np.cumsum(x) - x for x in (T, L, turn))
    i = np.clip(np.searchsorted(begin_s, t_s, side="right") - 1, 0, len(phases) - 1)

    x = (t_s - begin_s[i]) / T[i]
    area, step, d_step, _ = _smooth_step(x)
    along = T[i] * (v0[i] * x + dv[i] * area)
    v, a = v0[i] + dv[i] * step, dv[i] * d_step / T[i]

    length = np.where(L > 0, L, 1.0)[i]  # a wait covers no distance and turns nothing
    _, turned, curve, d_curve = _smooth_step(along / length)
    yaw_per_m, yaw_per_m2 = turn[i] * curve / length, turn[i] * d_curve / length**2
    yaw = heading_rad + begin_rad[i] + turn[i] * turned
    return begin_m[i] + along, v, a, yaw, yaw_per_m * v, yaw_per_m2 * v**2 + yaw_per_m * a


def _smooth_step(x: Array) -> tuple[Array, Array, Array, Array]:
    """10x^3 - 15x^4 + 6x^5 on [0, 1]: its integral, itself and its first two derivatives."""
    x2 = x * x
    return (
        x2 * x2 * (2.5 - 3 * x + x2),
        x2 * x * (10 - 15 * x + 6 * x2),
        30 * x2 * (1 - x) ** 2,
        60 * x * (1 - x) * (1 - 2 * x),
    )


def _hills(s: Array, phase_rad: Array) -> tuple[Array, Array, Array, Array]:
    """Height in m over the distance on the map, and its first three derivatives by it."""
    slope, wavelength_m = np.array(_HILLS).T
    k = 2 * np.pi / wavelength_m
    angle = s[:, None] * k + phase_rad
    sin, cos = np.sin(angle), np.cos(angle)
    return sin @ (slope / k), cos @ slope, -sin @ (slope * k), -cos @ (slope * k**2)


def _integrate(velocity: Array, acceleration: Array, dt_s: float) -> Array:
    """Positions (N, 3) from 0: the trapezoid with its end correction, exact to fourth order."""
    mean = (velocity[1:] + velocity[:-1]) / 2
    correction = (acceleration[:-1] - acceleration[1:]) * dt_s / 12
    position = np.zeros_like(velocity)
    np.cumsum((mean + correction) * dt_s, axis=0, out=position[1:])
    return position


def _about(seed: int, duration_s: float) -> About:
    return About(
        title=f"Simulated city drive of {duration_s:g} s, seed {seed}",
        licence="MIT",
        source=f"fgloc scenario city, seed {seed}, duration_s {duration_s:g}",
        simulated=True,
    )
