"""Scenario `city`: a plain simulated car drive with GNSS, IMU and wheel speed.

The car waits, sets off, follows gently bent streets over low hills, stops at lights and turns
corners: a chain of phases, see `datasets/road.py`.
"""

import numpy as np

from fgloc import frames
from fgloc.datasets.road import STEEPEST, Phase, road_motion
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
_ACCEL_MPS2 = (1.2, 2.3)  # peak of setting off and braking
_TURN_ACCEL_MPS2 = (1.2, 2.4)  # peak sideways in a corner
_BEND_ACCEL_MPS2 = 0.8  # peak sideways on a bent street
_HILLS = ((0.012, 900.0), (0.010, 370.0), (0.006, 140.0))  # slope, wavelength in m


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
    hills = np.column_stack([_HILLS, hill_phase_rad])
    return road_motion(t_ns, phases, heading_rad, hills)


def _plan(rng: np.random.Generator, duration_s: float) -> list[Phase]:
    """Phases that fill the duration: a wait, then block after block with a corner at the end."""
    phases = [Phase(rng.uniform(3.0, 6.0), 0.0, 0.0)]
    while sum(phase.duration_s for phase in phases) < duration_s:
        phases += _block(rng, phases[-1].to_mps)
    return phases


def _block(rng: np.random.Generator, speed_mps: float) -> list[Phase]:
    """Speed up, cruise along a gently bent street, perhaps stop at a light, turn a corner."""
    cruise_mps = rng.uniform(9.0, 15.0)
    corner_m = rng.uniform(22.0, 40.0)
    # Peak curvature of a corner times the speed squared is the peak acceleration sideways.
    corner_mps = np.sqrt(rng.uniform(*_TURN_ACCEL_MPS2) * corner_m / (np.pi / 2 * STEEPEST))
    cruise_s = rng.uniform(6.0, 20.0)
    bend_rad = rng.uniform(-1, 1) * min(_BEND_ACCEL_MPS2 * cruise_s / (STEEPEST * cruise_mps), 0.6)
    phases = [
        _ramp(rng, speed_mps, cruise_mps),
        Phase(cruise_s, cruise_mps, cruise_mps, bend_rad),
    ]
    if rng.random() < 0.5:
        wait = Phase(rng.uniform(3.0, 10.0), 0.0, 0.0)
        phases += [_ramp(rng, cruise_mps, 0.0), wait, _ramp(rng, 0.0, corner_mps)]
    else:
        phases += [_ramp(rng, cruise_mps, corner_mps)]
    side = rng.choice([-1.0, 1.0])
    return [*phases, Phase(corner_m / corner_mps, corner_mps, corner_mps, side * np.pi / 2)]


def _ramp(rng: np.random.Generator, from_mps: float, to_mps: float) -> Phase:
    return Phase(STEEPEST * abs(to_mps - from_mps) / rng.uniform(*_ACCEL_MPS2), from_mps, to_mps)


def _about(seed: int, duration_s: float) -> About:
    return About(
        title=f"Simulated city drive of {duration_s:g} s, seed {seed}",
        licence="MIT",
        source=f"fgloc scenario city, seed {seed}, duration_s {duration_s:g}",
        simulated=True,
    )
