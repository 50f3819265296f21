"""The two witnesses of a drive's motion, fixes and IMU, and how late one is against the other."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from fgloc.diagnosis.lag import Lag, inertial_lag
from fgloc.diagnosis.motion import LONGEST_M, Motion, Signal, inertial
from fgloc.drive import Drive
from fgloc.measurements import Array


@dataclass(frozen=True, eq=False)
class Witness:
    """What fixes and IMU say of the same steps, with the lag between them taken out.

    motion   the fixes' side
    imu      the IMU's: yaw rate, forward and leftward specific force
    lag      of the IMU, or None where the drive does not tell
    use      (S,) bool: the steps that the IMU covers
    turn_rad    (S,) turn over each step by the IMU
    push_mps    (S, 2) change of forward and leftward velocity over each step by the IMU
    """

    motion: Motion
    imu: Signal
    lag: Lag | None
    use: NDArray[np.bool_]
    turn_rad: Array
    push_mps: Array

    @classmethod
    def of(cls, drive: Drive) -> Self | None:
        """The witnesses of a drive, or None where there are no two."""
        motion = Motion.of(drive)
        if motion is None:
            return None
        imu = inertial(drive, motion.start_ns)
        if imu is None:
            return None
        lag = inertial_lag(motion, imu, _ahead_m(drive))
        lag_s = lag.lag_s if lag is not None and lag.is_significant else 0.0
        change = motion.change(imu, lag_s)
        return cls(motion, imu, lag, motion.covered(imu, lag_s), change[:, 0], change[:, 1:])


def _ahead_m(drive: Drive) -> float:
    """The antenna ahead of the vehicle's origin, unless it is said to be off the vehicle."""
    ahead_m = float(drive.rig.p_veh_ant_m[0])
    return ahead_m if abs(ahead_m) < LONGEST_M else 0.0
