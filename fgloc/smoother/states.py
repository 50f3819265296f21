"""States of the keyframes, estimates of all epochs, and their turn to the world's tangent."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgloc.factors import detection, vehicle
from fgloc.frames import pose_cov_to_world
from fgloc.measurements import Array
from fgloc.smoother.guess import Guess
from fgloc.smoother.model import Model
from fgloc.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class States:
    """Values of n keyframes: attitude (n, 3, 3), position in m and velocity in m/s (n, 3) of the
    IMU's place, its bias (n, 6) in m/s^2 and rad/s, the slow errors of the sources of positions
    that have one (n, 3 for each) in m. Of the whole drive, how late the stamps of each source are
    whose clock is estimated (k,), in s, the car's calibration (3,), see `Car`, how far the box's
    centre is from where the rig says (3,) in m, and of each source what its survey is off (6,):
    see `detection.by_survey`, and what speed and direction of the velocities are off (2,), a share
    and rad. `posts` (n, 6 for each slot) are those of swaying posts, see
    `Swaying`."""

    R: Array
    p: Array
    v: Array
    bias: Array
    slow: Array
    late_s: Array = field(default_factory=lambda: np.zeros(0))
    calibration: Array = field(default_factory=lambda: vehicle.STRAIGHT)
    offset: Array = field(default_factory=lambda: np.zeros(3))
    survey: Array = field(default_factory=lambda: np.zeros((1, detection.SURVEY)))
    posts: Array = field(default_factory=lambda: np.zeros((0, 0)))
    velocity_errors: Array = field(default_factory=lambda: np.zeros(2))

    def first(self, n: int) -> "States":
        """Those of the first n keyframes."""
        return self.take(slice(n))

    def take(self, rows: Any) -> "States":
        """Those of the keyframes that a slice, mask or index array selects."""
        own = ("R", "p", "v", "bias", "slow", "posts")
        return replace(self, **{name: getattr(self, name)[rows] for name in own})

    @classmethod
    def of(cls, guess: Guess, model: Model) -> "States":
        """A guess, with errors of zero."""
        n = len(guess.p_world_m)
        return cls(guess.R_world_veh, guess.p_world_m, guess.v_world_mps, np.zeros((n, 6)),
                   np.zeros((n, 3 * len(model.slow))), np.zeros(len(model.shifted_s)),
                   survey=np.zeros((len(model.sources), detection.SURVEY)),
                   posts=np.zeros((n, model.swaying.width)))  # fmt: skip


@dataclass(frozen=True, eq=False)
class Robustness:
    """What is done about what does not fit: `gated` (positions,) are left out, and the fixes' loss
    begins at a whitened error of `loss_width`, infinity being no loss. `plain` is least squares
    for everything, detections and vehicle constraints as well. `unheld` are the keyframes, of each
    source of the vehicle's own, at which it is left out."""

    gated: NDArray[np.bool_]
    loss_width: float
    plain: bool = False
    unheld: Mapping[str, frozenset[int]] = field(default_factory=dict)

    def holds(self, source: str, keys: NDArray[np.int64]) -> NDArray[np.int64]:
        """Those of some keyframes at which a source of the vehicle's own is not left out."""
        out = self.unheld.get(source)
        return keys[~np.isin(keys, list(out))] if out else keys


@dataclass(frozen=True, eq=False)
class Spread:
    """Covariances at a solution: of the poses (n, 6, 6), of what the positions measure as predicted
    (rows, 3, 3) in m^2, the same of each of the vehicle's own sources, whitened, and of the states
    of the posts in all slots (n, q, q)."""

    poses: Array
    positions: Array
    held: Mapping[str, Array]
    posts: Array


@dataclass(frozen=True, eq=False)
class SharedSigmas:
    """Standard deviations of what a drive shares, where it is estimated: latenesses (k,) in s, the
    box's centre (3,) in m, of some sources, by number, the survey (6,), or (3,) without
    heights, and speed and direction of the velocities (2,), a share and rad."""

    late_s: Array = field(default_factory=lambda: np.zeros(0))
    offset: Array | None = None
    survey: Mapping[int, Array] = field(default_factory=dict)
    velocity_errors: Array | None = None


class StateLog:
    """Room for the estimates of n epochs; covariances are (6, 6) in GTSAM's pose tangent."""

    def __init__(self, n: int) -> None:
        self.R = np.full((n, 3, 3), np.nan)
        self.p = np.full((n, 3), np.nan)
        self.v = np.full((n, 3), np.nan)
        self.cov = np.full((n, 6, 6), np.nan)
        self.gyro_bias = np.zeros((n, 3))

    def put(self, k: int, R: Array, p: Array, v: Array, cov: Array, gyro_bias: Array) -> None:
        """Write one epoch."""
        self.R[k], self.p[k], self.v[k], self.cov[k] = R, p, v, cov
        self.gyro_bias[k] = gyro_bias

    def trajectory(self, model: Model) -> Trajectory:
        """The epochs as the vehicle origin's trajectory, with covariance in the world frame."""
        of_imu = Trajectory(
            model.epochs.t_ns, self.p, self.R, None, pose_cov_to_world(self.R, self.cov),
            model.p_veh_imu_m,
        )  # fmt: skip
        arm = np.cross(model.epochs.rate_radps - self.gyro_bias, -model.p_veh_imu_m)
        v = self.v + np.einsum("nij,nj->ni", self.R, arm)
        return replace(of_imu.at_point(np.zeros(3)), v_world_mps=v)


def yaw_sigma_rad(R_world_veh: Array, cov_rotation: Array) -> float:
    """Sigma of the yaw from a rotation covariance (3, 3) in the vehicle frame."""
    up = R_world_veh[2]
    return float(np.sqrt(up @ cov_rotation @ up))
