"""Where the vehicle's own constraints act: at which epochs, with what speed, standing or not.

Everything here looks back only: what holds at an instant follows from what was true before it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc.config import VehicleConfig
from fgloc.drive import Drive
from fgloc.measurements import Array, GnssFixes, ImuSamples, WheelSpeeds
from fgloc.timing import Instants, elapsed_s, seconds_to_ns
from fgloc.verdicts import SourceVerdicts, Verdict

NON_HOLONOMIC, STANDSTILL = "non-holonomic", "standstill"
"""The names under which constraints are counted: nobody measured them, but they have verdicts."""
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

    in_force    (K,) bool: the car follows its axis here, if that is asked for
    wheel_row   (K,) row of the wheel speed true at the epoch, -1 where there is none
    stands      (K,) bool: the car does not move
    rate_radps  (K, 3) mean angular rate of the window before, vehicle axes
    ahead_mps2  (K,) mean specific force along x of the last `PITCH_WINDOW_S`
    """

    in_force: NDArray[np.bool_]
    wheel_row: NDArray[np.int64]
    stands: NDArray[np.bool_]
    rate_radps: Array
    ahead_mps2: Array


def chosen_wheel_rows(
    drive: Drive, others_ns: Instants, config: VehicleConfig, verdicts: dict[str, SourceVerdicts]
) -> NDArray[np.int64]:
    """One sound row in each interval from the first of `others_ns` to the last, best at one of
    these instants, as it then needs no keyframe of its own; the others get their verdicts."""
    wheel = wheel_of(drive)
    if wheel is None or not config.wheel_speed:
        return np.empty(0, np.int64)
    sound = np.isfinite(wheel.speed_mps) & np.isfinite(wheel.sigma_mps) & (wheel.sigma_mps > 0)
    outside = (wheel.t_ns < others_ns[0]) | (wheel.t_ns > others_ns[-1])
    rows = np.flatnonzero(sound & ~outside)
    first = _firsts(wheel.t_ns[rows])
    own = verdicts["wheel"]
    own.set(slice(None), Verdict.UNUSED, f"one in {config.interval_s:g} s is taken")
    own.set(np.delete(rows, first), Verdict.DUPLICATE, "an earlier row has the same t_ns")
    own.set(outside, Verdict.OUTSIDE, "before the first keyframe or after the last")
    own.set(~sound, Verdict.INVALID, "speed or sigma is not finite, or sigma is not above 0")
    rows = rows[first]
    at_ns = wheel.t_ns[rows]
    taken = rows[_one_each(at_ns, ~np.isin(at_ns, others_ns), int(others_ns[0]), config)]
    own.set(taken, Verdict.UNUSED, "not reached")
    return taken


def constraints(
    drive: Drive, imu: ImuSamples, t_ns: Instants, is_keyframe: NDArray[np.bool_],
    wheel_rows: NDArray[np.int64], config: VehicleConfig,
) -> Constraints:  # fmt: skip
    """Constraints of the epochs `t_ns`; `imu` are the drive's sound samples, and `wheel_rows` are
    true at keyframes."""
    row = np.full(len(t_ns), -1)
    wheel = wheel_of(drive)
    if wheel is not None:
        row[np.searchsorted(t_ns, wheel.t_ns[wheel_rows])] = wheel_rows
    keys = np.flatnonzero(is_keyframe)
    chosen = keys[_one_each(t_ns[keys], row[keys] < 0, int(t_ns[0]), config)]
    in_force = row >= 0
    in_force[chosen] |= config.non_holonomic
    stands, rate = np.zeros(len(t_ns), bool), np.zeros((len(t_ns), 3))
    if config.zero_velocity:
        quiet, mean = _quiet(imu, t_ns[chosen], config)
        rate[chosen] = mean @ drive.rig.T_veh_imu[:3, :3].T
        stands[chosen] = [
            still and not _moves(int(t), wheel, drive.gnss, config)
            for still, t in zip(quiet, t_ns[chosen], strict=True)
        ]
    mean, _ = _moments(imu, t_ns, PITCH_WINDOW_S)
    ahead = mean @ np.append(drive.rig.T_veh_imu[0, :3], np.zeros(3))
    return Constraints(in_force, row, stands, rate, np.clip(ahead, -TYRES_MPS2, TYRES_MPS2))


def wheel_of(drive: Drive) -> WheelSpeeds | None:
    """The drive's wheel speeds, if it has any."""
    table = drive.tables.get("wheel")
    return table if isinstance(table, WheelSpeeds) and len(table) else None


def _one_each(
    t_ns: Instants, worse: NDArray[np.bool_], first_ns: int, config: VehicleConfig
) -> NDArray[np.int64]:
    """Index of one of the instants (n,) in each interval: the first, of those that are not worse
    where there are any."""
    bucket = (t_ns - first_ns) // seconds_to_ns(config.interval_s)
    order = np.lexsort((t_ns, worse, bucket))
    return order[_firsts(bucket[order])]


def _firsts(groups: NDArray[np.int64]) -> NDArray[np.int64]:
    """Index of the first of each run of equal numbers."""
    return np.flatnonzero(np.append(True, groups[1:] != groups[:-1])[: len(groups)])


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
