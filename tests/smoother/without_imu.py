"""Drives that have no IMU, made of the motion behind `city`."""

import numpy as np

from fgloc.datasets.city import GNSS_SIGMA_ENU_M, ORIGIN, city_motion, city_rig
from fgloc.datasets.simulator import simulate_gnss, simulate_wheel, stream, truth_of
from fgloc.drive import Drive, Rig
from fgloc.measurements import EnuVelocities, GnssFixes, Odometry, SteeringAngles
from fgloc.trajectory import Trajectory

WHEELBASE_M, STEERING_RATIO = 2.7, 15.0
SPEED_SIGMA_MPS, YAW_RATE_SIGMA_RADPS, VELOCITY_SIGMA_MPS = 0.05, 0.01, 0.1


def drive_of(*kinds: str, seed: int = 1, duration_s: float = 30.0, fix_s: float = 1.0) -> Drive:
    """Fixes every `fix_s`, and at 10 Hz what is named: wheel, steering, odometry, velocity."""
    motion = city_motion(seed, duration_s)
    tenth, rng = motion.every(10), stream(seed, "without imu")
    t, n = tenth.t_ns, len(tenth)
    ahead = np.einsum("ni,ni->n", tenth.R_world_veh[:, :, 0], tenth.v_world_mps)
    turn = tenth.w_veh_radps[:, 2]
    bend = np.divide(turn, ahead, out=np.zeros(n), where=ahead > 0.1)
    tables = {
        "gnss": simulate_gnss(
            motion.every(round(100 * fix_s)), city_rig(), GNSS_SIGMA_ENU_M, stream(seed, "gnss")
        ),
        "wheel": simulate_wheel(tenth, SPEED_SIGMA_MPS, stream(seed, "wheel")),
        "steering": SteeringAngles(t, t, STEERING_RATIO * np.arctan(WHEELBASE_M * bend)),
        "odometry": Odometry(
            t, t, ahead + SPEED_SIGMA_MPS * rng.standard_normal(n),
            turn + YAW_RATE_SIGMA_RADPS * rng.standard_normal(n),
            np.full(n, SPEED_SIGMA_MPS), np.full(n, YAW_RATE_SIGMA_RADPS),
        ),
        "velocity": EnuVelocities(
            t, t, tenth.v_world_mps + VELOCITY_SIGMA_MPS * rng.standard_normal((n, 3)),
            np.full(n, VELOCITY_SIGMA_MPS),
        ),
    }  # fmt: skip
    kept = {name: table for name, table in tables.items() if name in ("gnss", *kinds)}
    rig = Rig(p_veh_ant_m=city_rig().p_veh_ant_m)
    return Drive("without imu", ORIGIN, rig, kept, truth_of(motion.every(5)))


def wandering(seed: int, densities: np.ndarray, duration_s: float = 60.0) -> Drive:
    """Something whose acceleration is white noise of densities (3,) ENU, and that never turns;
    fixes of 1 m once a second."""
    rng, dt_s, n = np.random.default_rng(seed), 0.01, round(100 * duration_s) + 1
    steps = densities * np.sqrt(dt_s) * rng.standard_normal((n, 3))
    v = np.array([10.0, 0.0, 0.0]) + np.cumsum(steps, axis=0) - steps / 2
    p = np.cumsum(v, axis=0) * dt_s
    t = 1_760_000_000_000_000_000 + np.arange(n) * 10_000_000
    at = np.arange(0, n, 100)
    z = p[at] + rng.standard_normal((len(at), 3))
    fixes = GnssFixes(t[at], t[at], z, np.tile(np.eye(3), (len(at), 1, 1)), np.full_like(z, np.nan))
    ahead = np.tile(np.eye(3), (n, 1, 1))
    truth = Trajectory(t, p, ahead, v).take(np.arange(0, n, 25))
    return Drive("wandering", ORIGIN, Rig(), {"gnss": fixes}, truth)
