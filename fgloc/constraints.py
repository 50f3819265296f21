"""Where the vehicle's own constraints act: at which epochs, with what speed, standing or not.

Everything here looks back only: what holds at an instant follows from what was true before it.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fgloc.config import MotionConfig, SmoothConfig, VehicleConfig
from fgloc.drive import Drive, VelocityErrors
from fgloc.factors.velocity import sigma_with_errors
from fgloc.measurements import (
    Array,
    EnuVelocities,
    GnssFixes,
    ImuSamples,
    Odometry,
    Table,
    WheelSpeeds,
)
from fgloc.motion import UNSOUND_ODOMETRY, Motion, firsts, sound_odometry, sound_rows
from fgloc.timing import Instants, elapsed_s, seconds_to_ns
from fgloc.verdicts import SourceVerdicts, Verdict

NON_HOLONOMIC, STANDSTILL = "non-holonomic", "standstill"
"""The names under which constraints are counted: nobody measured them, but they have verdicts."""
NOT_REACHED = "not reached"
"""Of rows that an estimator may take, and has not yet."""
LEAST_ERROR = 1e-6
"""A sigma of a lasting error that is as good as none."""
MIN_SAMPLES = 10
"""Fewer IMU samples in a window tell nothing of how it shakes."""
PITCH_WINDOW_S = 0.5
"""A body follows the force along x about as fast as this, and the road's shaking averages out."""
TYRES_MPS2 = 10.0
"""No tyre holds more, so no body pitches further."""
FIX_SPAN_S, CRUISE_MPS, CRUISE_SIGMAS = 2.0, 1.0, 3.0
"""On a road like glass nothing shakes: a car that the fixes of this span see moving at more than
this, and so many of its sigmas, does not stand."""


@dataclass(frozen=True, eq=False)
class Constraints:
    """The constraints at K epochs.

    in_force      (K,) bool: the car follows its axis here, if that is asked for
    wheel_row     (K,) row of the wheel speed true at the epoch, -1 where there is none
    velocity_row  (K,) the same of a velocity in the world
    stands        (K,) bool: the car does not move
    rate_radps    (K, 3) mean angular rate of the window before, vehicle axes
    ahead_mps2    (K,) mean specific force along x of the last `PITCH_WINDOW_S`, 0 where nothing is
                  in force
    """

    in_force: NDArray[np.bool_]
    wheel_row: NDArray[np.int64]
    velocity_row: NDArray[np.int64]
    stands: NDArray[np.bool_]
    rate_radps: Array
    ahead_mps2: Array


def chosen_rows(
    drive: Drive, others_ns: Instants, config: SmoothConfig, motion: Motion,
    verdicts: dict[str, SourceVerdicts],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:  # fmt: skip
    """Rows of wheel speeds and of velocities that are taken, where these are asked for.

    One sound row in each interval from the first of `others_ns` to the last, best at one of these
    instants, as it then needs no keyframe of its own; the others get their verdicts.
    """
    wheels = velocities = np.empty(0, np.int64)
    wheel, velocity = wheel_of(drive), velocity_of(drive)
    if wheel is not None and motion.vehicle.wheel_speed:
        sound = np.isfinite(wheel.speed_mps) & _positive(wheel.sigma_mps)
        source, interval_s = wheel_source(drive), motion.vehicle.interval_s
        own = verdicts[source]
        why = "speed or sigma is not finite, or sigma is not above 0"
        why = UNSOUND_ODOMETRY if source == "odometry" else why
        wheels = _chosen(wheel.t_ns, sound, why, others_ns, interval_s, own)
    asked = config.motion.velocities
    if velocity is not None and (motion.forgets_yaw if asked is None else asked):
        sound = np.isfinite(velocity.v_world_mps).all(-1) & _positive(velocity.sigma_mps)
        why = "velocity or sigma is not finite, or sigma is not above 0"
        own, interval_s = verdicts["velocity"], config.motion.interval_s
        velocities = _chosen(velocity.t_ns, sound, why, others_ns, interval_s, own)
    return wheels, velocities


def _positive(sigma: Array) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(sigma) & (sigma > 0))


def _chosen(
    t_ns: Instants, sound: NDArray[np.bool_], why: str, others_ns: Instants, interval_s: float,
    own: SourceVerdicts,
) -> NDArray[np.int64]:  # fmt: skip
    """Rows that are taken of a table with these instants."""
    outside = (t_ns < others_ns[0]) | (t_ns > others_ns[-1])
    own.set(slice(None), Verdict.UNUSED, f"one in {interval_s:g} s is taken")
    inside = np.flatnonzero(~outside)
    rows = inside[sound_rows(t_ns[inside], sound[inside], why, own, inside)]
    own.set(outside, Verdict.OUTSIDE, "before the first keyframe or after the last")
    own.set(~sound, Verdict.INVALID, why)
    at_ns = t_ns[rows]
    taken = rows[_one_each(at_ns, ~np.isin(at_ns, others_ns), int(others_ns[0]), interval_s)]
    own.set(taken, Verdict.UNUSED, NOT_REACHED)
    return taken


def constraints(
    drive: Drive, motion: Motion, t_ns: Instants, is_keyframe: NDArray[np.bool_],
    rows: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> Constraints:  # fmt: skip
    """Constraints of the epochs `t_ns`; the rows of `chosen_rows` are true at keyframes."""
    config, imu, wheel = motion.vehicle, motion.samples, wheel_of(drive)
    row, velocity_row = (
        _rows_at(t_ns, table, taken)
        for table, taken in zip((wheel, velocity_of(drive)), rows, strict=True)
    )
    keys = np.flatnonzero(is_keyframe)
    chosen = keys[_one_each(t_ns[keys], row[keys] < 0, int(t_ns[0]), config.interval_s)]
    in_force = row >= 0
    in_force[chosen] |= bool(config.non_holonomic)
    stands, rate = np.zeros(len(t_ns), bool), np.zeros((len(t_ns), 3))
    if config.zero_velocity:
        quiet, mean = _quiet(imu, t_ns[chosen], config)
        rate[chosen] = mean @ motion.T_veh_imu[:3, :3].T
        stands[chosen] = [
            still and not _moves(int(t), wheel, drive.gnss, config)
            for still, t in zip(quiet, t_ns[chosen], strict=True)
        ]
    ahead = np.zeros(len(t_ns))
    if in_force.any():
        mean, _ = _moments(imu, t_ns, PITCH_WINDOW_S)
        ahead = mean @ np.append(motion.T_veh_imu[0, :3], np.zeros(3))
    return Constraints(
        in_force, row, velocity_row, stands, rate, np.clip(ahead, -TYRES_MPS2, TYRES_MPS2)
    )


def _rows_at(t_ns: Instants, table: Table | None, taken: NDArray[np.int64]) -> NDArray[np.int64]:
    """(K,) row of a table that is true at an epoch, of those taken; -1 where there is none."""
    row = np.full(len(t_ns), -1)
    if table is not None:
        row[np.searchsorted(t_ns, table.t_ns[taken])] = taken
    return row


def wheel_of(drive: Drive) -> WheelSpeeds | None:
    """The drive's wheel speeds, or without them those of its odometry, if it has any."""
    table = drive.tables.get("wheel")
    if isinstance(table, WheelSpeeds) and len(table):
        return table
    table = drive.tables.get("odometry")
    if isinstance(table, Odometry) and len(table):
        speed_mps = np.where(sound_odometry(table), table.speed_mps, np.nan)
        return WheelSpeeds(table.t_ns, table.received_ns, speed_mps, table.sigma_speed_mps)
    return None


def wheel_source(drive: Drive) -> str:
    """The name of the table that `wheel_of` takes."""
    wheel = drive.tables.get("wheel")
    return "wheel" if isinstance(wheel, WheelSpeeds) and len(wheel) else "odometry"


def velocity_with_errors(drive: Drive, config: MotionConfig) -> EnuVelocities | None:
    """The same with lasting errors counted as noise, for who has no state for them."""
    velocity, lasting = velocity_of(drive), velocity_error_sigmas(drive, config)
    if velocity is None:
        return None
    stated = velocity.sigma_mps
    sigma_mps = sigma_with_errors(stated, velocity.v_world_mps, lasting)
    # What is no sigma stays none, for who looks for that.
    return replace(velocity, sigma_mps=np.where(stated > 0, sigma_mps, stated))


def velocity_of(drive: Drive) -> EnuVelocities | None:
    """The drive's velocities in the world, if it has any."""
    table = drive.tables.get("velocity")
    return table if isinstance(table, EnuVelocities) and len(table) else None


def _one_each(
    t_ns: Instants, worse: NDArray[np.bool_], first_ns: int, interval_s: float
) -> NDArray[np.int64]:
    """Index of one of the instants (n,) in each interval: the first, of those that are not worse
    where there are any."""
    bucket = (t_ns - first_ns) // seconds_to_ns(interval_s)
    order = np.lexsort((t_ns, worse, bucket))
    return order[firsts(bucket[order])]


def _quiet(
    imu: ImuSamples, t_ns: Instants, config: VehicleConfig
) -> tuple[NDArray[np.bool_], Array]:
    """Whether the IMU is quiet in the window before each instant, and its mean rate (n, 3)."""
    mean, variance = _moments(imu, t_ns, config.still_window_s)
    accel, gyro = (np.sqrt(part.sum(-1)) for part in (variance[:, :3], variance[:, 3:]))
    still = (accel < config.still_accel_mps2) & (gyro < config.still_gyro_radps)
    return still, mean[:, 3:]


def _moments(imu: ImuSamples, t_ns: Instants, window_s: float) -> tuple[Array, Array]:
    """Mean and variance (n, 6) of force and rate, IMU axes, in the window before each instant.

    A window with few samples takes the ones before it as well; its variance is then infinite.
    """
    values = np.hstack([imu.accel_mps2, imu.gyro_radps])
    middle = values[0]  # squares of what is small keep their digits, and nothing looks ahead
    moments = np.hstack([values - middle, (values - middle) ** 2])
    sums = np.cumsum(np.vstack([np.zeros(12), moments]), axis=0)
    high = np.searchsorted(imu.t_ns, t_ns, side="right")
    low = np.searchsorted(imu.t_ns, t_ns - seconds_to_ns(window_s), side="right")
    few = (high - low < MIN_SAMPLES) | (imu.t_ns[0] > t_ns - seconds_to_ns(window_s))
    low = np.where(few, np.maximum(high - MIN_SAMPLES, 0), low)
    mean = (sums[high] - sums[low]) / np.maximum(high - low, 1)[:, None]
    variance = np.maximum(mean[:, 6:] - mean[:, :6] ** 2, 0)
    variance[few] = np.inf
    return mean[:, :6] + middle, variance


def _moves(t_ns: int, wheel: WheelSpeeds | None, gnss: GnssFixes, config: VehicleConfig) -> bool:
    """Whether the wheels, or without them the last fixes, say that the car is moving."""
    if wheel is not None:
        rows = _known(wheel.t_ns, wheel.received_ns, t_ns, config.still_window_s)
        if len(rows):
            return bool(abs(wheel.speed_mps[rows].mean()) > config.still_speed_mps)
    rows = _known(gnss.t_ns, gnss.received_ns, t_ns, FIX_SPAN_S)
    rows = rows[np.isfinite(gnss.p_world_ant_m[rows]).all(-1)]
    if len(rows) < 2:
        return False
    t = elapsed_s(gnss.t_ns[rows], int(gnss.t_ns[rows[0]]))
    t, spread = t - t.mean(), float(((t - t.mean()) ** 2).sum())
    if spread == 0:
        return False
    speed = np.hypot(*(t @ gnss.p_world_ant_m[rows][:, :2] / spread))
    variance = gnss.cov_world_m2[rows][:, :2, :2].trace(axis1=1, axis2=2).mean() / 2
    return bool(speed > CRUISE_MPS + CRUISE_SIGMAS * np.sqrt(variance / spread))


def _known(true_ns: Instants, received_ns: Instants, t_ns: int, span_s: float) -> NDArray[np.int64]:
    """Rows true in the span before an instant and received by then."""
    low = np.searchsorted(true_ns, t_ns - seconds_to_ns(span_s), side="right")
    high = np.searchsorted(true_ns, t_ns, side="right")
    return low + np.flatnonzero(received_ns[low:high] <= t_ns)


def velocity_error_sigmas(drive: Drive, config: MotionConfig) -> Array:
    """Sigmas (2,) of what speed and direction of the velocities are off for good, a share and rad:
    those of the configuration, or else the rig's, next to none where only one has any."""
    stated = drive.rig.velocity_errors or VelocityErrors(0.0, 0.0)
    scale, heading = config.velocity_scale_sigma, config.velocity_heading_sigma_rad
    sigmas = np.array([stated.scale_sigma if scale is None else scale,
                       stated.heading_sigma_rad if heading is None else heading])  # fmt: skip
    return np.maximum(sigmas, LEAST_ERROR) if sigmas.any() else sigmas
