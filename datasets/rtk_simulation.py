"""A consumer GPS and odometry made from the RTK positions of a real drive, with stated noise.

For recordings that have a truth but not the sensors of an ordinary car. What is made here is
simulated on a real motion, and a drive that uses it has to say so.

Of an RTK antenna alone the heading is not known. The vehicle frame is the antenna's: its origin is
the antenna, its x axis the course, held where the antenna moves slower than `COURSE_FROM_MPS`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc.datasets.simulator import gauss_markov, stream
from fgloc.drive import GnssBias
from fgloc.errors import DriveError
from fgloc.frames import yaw_matrix
from fgloc.measurements import Array, EnuVelocities, GnssFixes, Odometry
from fgloc.timing import Instants, elapsed_s
from fgloc.trajectory import Trajectory

COURSE_FROM_MPS = 0.5
"""Below this the course is that of RTK noise: 1 cm over the base of 0.28 s is 0.04 m/s."""
BASE_ROWS = 7
"""Velocity is a difference over so many rows before and after: at 50 Hz over 0.28 s."""

ODOMETRY_HZ = 10.0
SPEED_SHARE, LEAST_SPEED_SIGMA_MPS = 0.02, 0.02
YAW_RATE_SIGMA_RADPS = float(np.deg2rad(0.5))


@dataclass(frozen=True, eq=False)
class Ride:
    """What the antenna did: instants (N,), ENU m (N, 3), speed m/s, course and its rate (N,)."""

    t_ns: Instants
    p_world_m: Array
    speed_mps: Array
    course_rad: Array
    course_rate_radps: Array

    def truth(self, rows: NDArray[np.bool_]) -> Trajectory:
        """The vehicle frame at the rows (N,) that a mask selects."""
        course_rad = self.course_rad[rows]
        v_world_mps = self.speed_mps[rows, None] * _direction(course_rad)
        return Trajectory(
            self.t_ns[rows], self.p_world_m[rows], yaw_matrix(course_rad), v_world_mps
        )


def ride(where: str, t_ns: Instants, p_world_m: Array) -> Ride:
    """The ride of positions (N, 3) at increasing instants; DriveError where it never moves."""
    east_mps, north_mps = change_rate(t_ns, p_world_m[:, :2]).T
    speed_mps = np.hypot(east_mps, north_mps)
    moving = speed_mps >= COURSE_FROM_MPS
    if not moving.any():
        raise DriveError(f"{where}: never moves at {COURSE_FROM_MPS} m/s; its heading is unknown")
    course_rad = np.unwrap(np.arctan2(north_mps, east_mps)[moving])
    t_s = elapsed_s(t_ns, int(t_ns[0]))
    course_rad = np.interp(t_s, t_s[moving], course_rad)
    rate_radps = change_rate(t_ns, course_rad[:, None])[:, 0]
    return Ride(t_ns, p_world_m, speed_mps, course_rad, rate_radps)


def change_rate(t_ns: Instants, values: Array) -> Array:
    """(N, m) per second, of values (N, m) at increasing instants, over `BASE_ROWS` to each side."""
    n = len(t_ns)
    before = np.maximum(np.arange(n) - BASE_ROWS, 0)
    after = np.minimum(np.arange(n) + BASE_ROWS, n - 1)
    t_s = elapsed_s(t_ns, int(t_ns[0]))
    base_s = np.maximum(t_s[after] - t_s[before], 1e-9)
    return np.asarray((values[after] - values[before]) / base_s[:, None])


def every(t_ns: Instants, rate_hz: float) -> NDArray[np.bool_]:
    """(N,) bool: of instants the first in each period of a rate, counted from the first instant.

    Half of the usual step is granted, so that jitter does not make a period miss its turn.
    """
    step_s = float(np.median(np.diff(t_ns))) / 1e9
    period = np.floor((elapsed_s(t_ns, int(t_ns[0])) + step_s / 2) * rate_hz)
    return np.diff(period, prepend=-1.0) > 0


def simulated_gps(
    t_ns: Instants,
    p_world_m: Array,
    sigma_m: float,
    bias: GnssBias | None,
    seed: int,
    name: str = "rtk",
) -> GnssFixes:
    """Fixes of an antenna at places (N, 3), white noise of `sigma_m` and a slow bias on each axis.

    Of receivers with different names the errors have nothing in common.
    """
    rng = stream(seed, f"{name}/gps")
    n = len(t_ns)
    error_m = sigma_m * rng.standard_normal((n, 3))
    if bias is not None:
        slow = gauss_markov(
            bias.tau_s, elapsed_s(t_ns, int(t_ns[0])), 3, stream(seed, f"{name}/bias")
        )
        error_m += bias.sigma_m * slow
    cov_m2 = np.tile(sigma_m**2 * np.eye(3), (n, 1, 1))
    return GnssFixes(t_ns, t_ns, p_world_m + error_m, cov_m2, np.full((n, 3), np.nan))


def simulated_odometry(ride: Ride, seed: int) -> Odometry:
    """Speed and yaw rate at `ODOMETRY_HZ`, white noise of 2 % and 0.5 deg/s."""
    rows, rng = every(ride.t_ns, ODOMETRY_HZ), stream(seed, "rtk/odometry")
    t_ns, speed_mps = ride.t_ns[rows], ride.speed_mps[rows]
    sigma_mps = np.maximum(SPEED_SHARE * speed_mps, LEAST_SPEED_SIGMA_MPS)
    sigma_radps = np.full(len(t_ns), YAW_RATE_SIGMA_RADPS)
    speed_mps = speed_mps + sigma_mps * rng.standard_normal(len(t_ns))
    rate_radps = ride.course_rate_radps[rows] + sigma_radps * rng.standard_normal(len(t_ns))
    return Odometry(t_ns, t_ns, speed_mps, rate_radps, sigma_mps, sigma_radps)


def dead_reckoned(odometry: Odometry, heading_rad: float) -> EnuVelocities:
    """The velocity that odometry gives from a known heading at its first row on.

    Its heading walks, so errors of neighbouring rows are alike; the sigma of each row is that of
    speed and heading together.
    """
    t_s = elapsed_s(odometry.t_ns, int(odometry.t_ns[0]))
    dt_s, rate_radps = np.diff(t_s), odometry.yaw_rate_radps
    turned_rad = np.cumsum(dt_s * (rate_radps[1:] + rate_radps[:-1]) / 2)
    yaw_rad = heading_rad + np.concatenate([[0.0], turned_rad])
    variance = np.cumsum((dt_s * odometry.sigma_yaw_rate_radps[1:]) ** 2)
    sigma_rad = np.sqrt(np.concatenate([[0.0], variance]))
    sigma_mps = np.hypot(odometry.sigma_speed_mps, odometry.speed_mps * sigma_rad)
    v_world_mps = odometry.speed_mps[:, None] * _direction(yaw_rad)
    return EnuVelocities(odometry.t_ns, odometry.received_ns, v_world_mps, sigma_mps)


def _direction(yaw_rad: Array) -> Array:
    return np.stack([np.cos(yaw_rad), np.sin(yaw_rad), np.zeros(len(yaw_rad))], -1)
