"""What is to be estimated of a drive, and what is known of it: the numbers behind every solver.

Keyframe j has a pose and a velocity, of the IMU's place along the vehicle's axes: GTSAM's own way
with a lever arm to the IMU leaves out the tangential acceleration, which is 0.1 m/s^2 where a bend
begins. A bias of the IMU is shared by the keyframes of `bias_interval_s`. A slow error of a source
of positions, if there is one, belongs to each of its rows.
"""

from bisect import bisect_left
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgloc.config import SmoothConfig
from fgloc.drive import Drive, ImuNoise, Noise
from fgloc.errors import DriveError
from fgloc.factors import detection, gnss, imu
from fgloc.factors.preintegration import preintegrate
from fgloc.frames import skew
from fgloc.measurements import Array
from fgloc.positions import position_sources
from fgloc.smoother import velocities
from fgloc.smoother.car import Car
from fgloc.smoother.swaying import Swaying, occurrence
from fgloc.sync import Plan
from fgloc.timing import elapsed_s

YAW_SIGMA_RAD = 10.0
"""Nothing is known of the yaw: so wide that the guess it is laid around leaves no trace."""
POSITION_SIGMA_M = 100.0
"""Around the first fix."""
SPEED_SIGMA_MPS = 30.0
"""Around standstill."""
OBSERVED_YAW_RAD = 0.1
"""The yaw counts as observable once its sigma is below this."""


class Model:
    """Everything about a drive's graph that does not change while it is solved."""

    def __init__(self, drive: Drive, plan: Plan, config: SmoothConfig) -> None:
        self.drive, self.plan, self.config = drive, plan, config
        self.epochs = plan.epochs
        self.positions = plan.positions
        self.sources = position_sources(drive, config)
        self.p_veh_imu_m = np.array(plan.motion.T_veh_imu[:3, 3])
        self.levers = [source.p_veh_m - self.p_veh_imu_m for source in self.sources]
        self.point_by_pose = [np.hstack([-skew(lever), np.eye(3)]) for lever in self.levers]
        self.slow = [s for s, source in enumerate(self.sources) if source.bias is not None]
        self.epoch_of = self.epochs.keyframes
        self.t_ns = self.epochs.t_ns[self.epoch_of]
        self.t_s = elapsed_s(self.t_ns, int(self.t_ns[0]))
        self.key_of = np.searchsorted(self.t_ns, self.positions.t_ns)
        self.swaying = self._swaying()
        self.references = plan.references
        self.reference_key = np.searchsorted(self.t_ns, self.references.t_ns)
        self.reference_layer = occurrence(
            self.reference_key * len(self.sources) + self.references.source
        )
        self.noise: Noise = plan.motion.noise or _imu_noise(drive, config)
        self.level_sigma_rad = plan.motion.level_sigma_rad
        gravity_mps2 = config.imu.gravity_mps2 or drive.origin.gravity_mps2()
        self.gravity_mps2 = 0.0 if plan.motion.is_made_up else gravity_mps2
        self.bias_of, self.bias_t_s = _bias_grid(self.t_s, config.imu.bias_interval_s)
        # By how much estimated latenesses have moved the stamps already.
        self.shifted_s = np.zeros(len(config.clock.estimate))
        self.car = self._car()

    def __len__(self) -> int:
        return len(self.t_ns)

    def _car(self) -> Car:
        return Car(self.drive, self.plan, self.config, self.bias_of, self.noise)

    def _swaying(self) -> Swaying:
        return Swaying(self.drive, self.plan.posts, self.t_ns)

    @property
    def aids(self) -> list[str]:
        """The clocks of what is in use beside the motion."""
        rows = self.car.rows_of
        used = {
            "gnss": True, "wheel": self.car.wheel_source in rows,
            "velocity": velocities.SOURCE in rows, "nodes": bool(self.positions.candidates.any()),
        }  # fmt: skip
        return [name for name, use in used.items() if use]

    @cached_property
    def guides(self) -> NDArray[np.int64]:
        """Rows of the positions that are surely of the vehicle: the first guess is laid by them."""
        return np.flatnonzero(~self.positions.candidates)

    def fixed(self, first: int, stop: int) -> NDArray[np.int64]:
        """The guides at keyframes first..stop - 1."""
        return self.guides[slice(*np.searchsorted(self.key_of[self.guides], [first, stop]))]

    @cached_property
    def survey_size(self) -> int:
        """Unknowns of a survey that is uncertain: fewer where no node tells heights."""
        high = (self.positions.dof[self.positions.candidates] == 3).any()
        high |= (self.references.dof == 3).any()
        return detection.SURVEY if high else detection.FLAT_SURVEY

    @cached_property
    def first_place_m(self) -> Array:
        """About where the vehicle begins (3,): by the first guide."""
        return self.positions.z_world_m[self.guides[0]]

    @cached_property
    def bias_sigmas(self) -> Array:
        """How far the IMU's biases (6,) may be from zero at the start: m/s^2, then rad/s."""
        n = self.noise
        sigmas = n.accel_bias_sigma_mps2, n.gyro_bias_sigma_radps
        return np.concatenate([np.broadcast_to(sigma, 3) for sigma in sigmas])

    @cached_property
    def gate_nis(self) -> Array:
        """(n,) NIS above which each position is gated."""
        by_dof = [[source.settings.gate_nis(dof) for dof in (2, 3)] for source in self.sources]
        return np.array(by_dof)[self.positions.source, self.positions.dof - 2]

    @cached_property
    def gate_in_plane(self) -> Array:
        """(n,) NIS above which each position is gated by its place seen from above alone."""
        by_source = np.array([source.settings.gate_nis(2) for source in self.sources])
        return by_source[self.positions.source]

    @cached_property
    def cov_world_m2(self) -> Array:
        """(n, 3, 3) covariance of every position as the configuration believes it."""
        scale = np.array([source.settings.sigma_scale for source in self.sources])
        return self.positions.cov_world_m2 * scale[self.positions.source, None, None] ** 2

    @cached_property
    def cov_m2(self) -> Array:
        """(n, 3, 3) covariance with which the positions enter the graph: with the slack of the tie
        between pose and point where there is one."""
        tied = np.array([source.linked for source in self.sources])[self.positions.source]
        slack = np.where(tied, gnss.TIE_SIGMA_M**2, 0.0)
        return self.cov_world_m2 + slack[:, None, None] * np.eye(3)

    def deltas(self) -> tuple[imu.ImuDeltas, imu.ImuDeltas]:
        """The IMU from each keyframe to the next, and to each output epoch before that one.

        Preintegrated at zero bias, in the order of the epochs. Intervals with equally many output
        epochs are taken together.
        """
        at, steps = self.epoch_of, np.diff(self.epoch_of)
        counts = np.unique(steps).tolist()
        if len(counts) == 1:  # they come in order
            told = self._deltas(at[:-1], counts[0])
            between = (c[:-1].swapaxes(0, 1).reshape(-1, *c.shape[2:]) for c in told)
            return told.take(-1), imu.ImuDeltas(*between)
        n = len(self.epochs) - 1
        out = imu.ImuDeltas(*(np.zeros((n, *shape)) for shape in ((9,), (9, 6), (9, 9), (), (6,))))
        for count in counts:
            left = at[:-1][steps == count]
            epochs = left + np.arange(count)[:, None]
            for column, values in zip(out, self._deltas(left, count), strict=True):
                column[epochs] = values
        is_keyframe = self.epochs.is_keyframe[1:]
        return out.take(is_keyframe), out.take(~is_keyframe)

    def _deltas(self, left: NDArray[np.int64], count: int) -> imu.ImuDeltas:
        """The IMU from some keyframes (n,) to each of the `count` epochs after them, the last of
        which is the next keyframe: (count, n, ...)."""
        e = self.epochs
        epochs = left + np.arange(1, count + 1)[:, None]
        return preintegrate(
            e.accel_mps2, e.gyro_radps, e.dt_s, e.first_sample[left + 1],
            e.first_sample[epochs + 1], *self._densities(epochs[-1]),
        )  # fmt: skip

    def _densities(self, epochs: NDArray[np.int64]) -> tuple[Array, Array]:
        """Noise of accelerometer and gyro on the way to some epochs, in a gap or not: (n,), or
        (n, 3) where the axes are not alike."""
        n, gap = self.noise, self.epochs.in_gap[epochs]
        plain = n.accel_noise_mps2_per_sqrt_hz, n.gyro_noise_radps_per_sqrt_hz
        gap = gap if np.ndim(plain[0]) == 0 else gap[:, None]
        accel, gyro = (np.where(gap, *pair) for pair in zip(self.gap_noise, plain, strict=True))
        return accel, gyro

    @property
    def gap_noise(self) -> tuple[ArrayLike, ArrayLike]:
        """Densities in a gap, of accelerometer and gyro: for all axes, or (3,)."""
        c = self.config.imu
        return self.plan.motion.gap_noise or (c.gap_accel_mps2, c.gap_gyro_radps)


def _imu_noise(drive: Drive, config: SmoothConfig) -> ImuNoise:
    """The rig's noise with the configuration's values laid over it."""
    given = {
        name: value
        for name in ImuNoise.__dataclass_fields__
        if (value := getattr(config.imu, name)) is not None
    }
    if drive.rig.imu_noise is not None:
        given = {**vars(drive.rig.imu_noise), **given}
    try:
        return ImuNoise(**given)
    except TypeError as err:
        raise DriveError(
            f"drive {drive.name!r} has no [rig.imu_noise]; give it there or as --set imu.*"
        ) from err


def _bias_grid(t_s: Array, interval_s: float) -> tuple[np.ndarray, Array]:
    """Index (n,) of each keyframe's bias, and the time in s (m,) at which each bias begins."""
    begins, times, last = [0], t_s.tolist(), len(t_s)
    while (j := bisect_left(times, times[begins[-1]] + interval_s - 1e-9, begins[-1] + 1)) < last:
        begins.append(j)
    index = np.zeros(last, int)
    index[begins[1:]] = 1
    return np.cumsum(index), t_s[begins]
