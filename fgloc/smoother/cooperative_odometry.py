"""What the car tells of its own motion, in the cooperative graph.

Rows and noises are those of one car alone (`fgloc.motion`, `fgloc.constraints`): how fast it goes,
along its heading and not sideways; how fast it turns; or, where nothing tells how it turns, its
velocity in the world. Own sensors are taken to arrive at once.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc.config import SmoothConfig
from fgloc.constraints import chosen_rows, velocity_with_errors, wheel_of, wheel_source
from fgloc.correspondence.epochs import Epochs
from fgloc.correspondence.rigid import rotation
from fgloc.drive import AxisNoise, Drive
from fgloc.errors import DriveError
from fgloc.measurements import Array, Table, WheelSpeeds
from fgloc.motion import Motion, credit, kind_of, made_up
from fgloc.smoother.guess import MIN_SPEED_MPS
from fgloc.timing import Instants
from fgloc.verdicts import SourceVerdicts, Verdict

SCALE_WALK = 1e-4
"""Of the wheels' scale, per sqrt(s): tyres warm up."""
_TABLES = ("odometry", "wheel", "steering", "velocity")


@dataclass(frozen=True, eq=False)
class OwnRows:
    """Whitened rows sum A x = b (2,) on the car's velocity v (2, 2), its heading h (2, 1), and the
    errors o (2, 2) of its yaw rate and of its wheels' scale."""

    b: Array
    v: Array
    h: Array
    o: Array


class OwnMotion:
    """The car's speeds, or velocities, at some instants, and its turn between any two.

    error_sigma  (2,) of the yaw rate in rad/s and of the scale of the wheels
    error_walk   (2,) how these change, per sqrt(s)
    """

    def __init__(
        self, drive: Drive, config: SmoothConfig, others_ns: Instants,
        verdicts: dict[str, SourceVerdicts],
    ) -> None:  # fmt: skip
        """Raises DriveError where `config.motion.kind` asks for what the drive has not."""
        self.motion = _motion(drive, config, verdicts)
        self._verdicts, self._source = verdicts, wheel_source(drive)
        self._wheel, self._velocity = wheel_of(drive), velocity_with_errors(drive, config.motion)
        wheels, velocities = chosen_rows(drive, others_ns, config, self.motion, verdicts)
        self._speed_at = _by_instant(self._wheel, wheels)
        self._velocity_at = _by_instant(self._velocity, velocities)
        self._turned = _Turned(self.motion)
        self._reckoned = _Reckoned(self._wheel, wheels, self._turned)
        noise = _noise(self.motion)
        bias, walk = noise.gyro_bias_sigma_radps[2], noise.gyro_bias_walk_radps2_per_sqrt_hz[2]
        self.error_sigma = np.array([bias, self.motion.vehicle.scale_sigma])
        self.error_walk = np.array([walk, SCALE_WALK])

    @property
    def t_ns(self) -> Instants:
        """When what is taken of speeds and velocities is true."""
        return np.array(sorted(self._speed_at.keys() | self._velocity_at.keys()), np.int64)

    def tells(self, t_ns: int) -> bool:
        """Whether it tells anything of an instant."""
        return t_ns in self._speed_at or t_ns in self._velocity_at

    def turn(self, before_ns: int, t_ns: int) -> tuple[float, float]:
        """How far the car turned, rad, and the variance of that."""
        return self._turned.between(before_ns, t_ns)

    def course(self, t_ns: int, state: Array) -> float:
        """The heading of a state (4,), rad, by its velocity; NaN where the wheels turn too slowly
        for that, or do not tell."""
        row = self._speed_at.get(t_ns)
        speed = 0.0 if row is None or self._wheel is None else float(self._wheel.speed_mps[row])
        if abs(speed) < MIN_SPEED_MPS:
            return np.nan
        ahead = np.sign(speed) * state[2:]
        return float(np.arctan2(ahead[1], ahead[0]))

    def reckoned(self, t_ns: int) -> tuple[Array, float]:
        """Place (2,) in m and heading in rad by wheels and yaw rates alone, from 0 at the start."""
        return self._reckoned.at(t_ns), self._turned.until(t_ns)

    def headings(self, t_ns: Instants, courses: Array) -> Array:
        """Headings (n,) without jumps: courses (n,) where there are any, or else the turn since, or
        up to, the nearest of them; NaN where there is no course at all."""
        known = np.flatnonzero(np.isfinite(courses))
        if not len(known):
            return courses
        turned = np.array([self._turned.until(int(t)) for t in t_ns])
        level = courses - turned
        level[known] = np.unwrap(level[known])
        after = np.searchsorted(known, np.arange(len(t_ns)), side="right")
        return level[known[np.maximum(after - 1, 0)]] + turned

    def rows(self, t_ns: int, yaw_rad: float) -> list[OwnRows]:
        """What is told of an instant; of speeds about a heading, where one is known."""
        found = []
        row = self._velocity_at.get(t_ns)
        if row is not None and self._velocity is not None:
            W = np.eye(2) / self._velocity.sigma_mps[row]
            b = W @ self._velocity.v_world_mps[row, :2]
            found.append(OwnRows(b, W, np.zeros((2, 1)), np.zeros((2, 2))))
            self._verdicts["velocity"].set(row, Verdict.USED)
        row = self._speed_at.get(t_ns)
        if row is not None and self._wheel is not None and np.isfinite(yaw_rad):
            sigmas = self._sigmas(t_ns, float(self._wheel.sigma_mps[row]))
            found.append(rolling(float(self._wheel.speed_mps[row]), yaw_rad, sigmas))
            self._verdicts[self._source].set(row, Verdict.USED)
        return found

    def credit(self, *, turned: bool) -> None:
        """Rows whose speed is not taken have told how the car turned, if it has a heading."""
        if turned:
            credit(self.motion, self._verdicts)
            return
        for name in {self._source, "odometry", "steering"} & self._verdicts.keys():
            unused = self._verdicts[name].is_(Verdict.UNUSED)
            self._verdicts[name].set(unused, Verdict.UNUSED, "the car has no heading")

    def _sigmas(self, t_ns: int, sigma_mps: float) -> Array:
        """(2,) of the speed ahead, and of that sideways, m/s."""
        c = self.motion.vehicle
        sideways = np.hypot(c.lateral_sigma_mps, c.point_sigma_m * self._turned.rate(t_ns))
        return np.array([c.wheel_sigma_scale * sigma_mps, sideways if c.non_holonomic else np.inf])


class _Turned:
    """The integral of the yaw rate: by trapezoids up to a sample, the last rate from there on, so
    that nothing looks ahead."""

    def __init__(self, motion: Motion) -> None:
        self._t_ns, self._rate = motion.samples.t_ns, motion.samples.gyro_radps[:, 2]
        density = _noise(motion).gyro_noise_radps_per_sqrt_hz[2]
        in_gap = density if motion.gap_noise is None else motion.gap_noise[1][2]
        dt_s = np.diff(self._t_ns) / 1e9
        self._until = np.append(0, np.cumsum(dt_s * (self._rate[1:] + self._rate[:-1]) / 2))
        variance = dt_s * np.where(dt_s > motion.gap_s, in_gap, density) ** 2
        self._variance = np.append(0, np.cumsum(variance))

    def until(self, t_ns: int) -> float:
        """From the start, rad."""
        i = self._before(t_ns)
        return float(self._until[i] + self._rate[i] * (t_ns - self._t_ns[i]) / 1e9)

    def between(self, before_ns: int, t_ns: int) -> tuple[float, float]:
        """From one instant to another, rad, with its variance."""
        at_s = (np.array([before_ns, t_ns]) - self._t_ns[0]) / 1e9
        variance = np.interp(at_s, (self._t_ns - self._t_ns[0]) / 1e9, self._variance)
        return self.until(t_ns) - self.until(before_ns), float(variance[1] - variance[0])

    def rate(self, t_ns: int) -> float:
        """The last that was told, rad/s."""
        return float(self._rate[self._before(t_ns)])

    def _before(self, t_ns: int) -> int:
        return max(int(np.searchsorted(self._t_ns, t_ns, side="right")) - 1, 0)


class _Reckoned:
    """The integral of the speed along the heading; from the last row on at its speed."""

    def __init__(self, wheel: WheelSpeeds | None, rows: NDArray[np.int64], turned: _Turned) -> None:
        self._t_ns = np.zeros(1, np.int64)
        self._p, self._v = np.zeros((1, 2)), np.zeros((1, 2))
        if wheel is None or not len(rows):
            return
        self._t_ns = wheel.t_ns[rows]
        yaw = np.array([turned.until(int(t)) for t in self._t_ns])
        self._v = wheel.speed_mps[rows, None] * np.stack([np.cos(yaw), np.sin(yaw)], -1)
        step = np.diff(self._t_ns)[:, None] / 1e9 * (self._v[1:] + self._v[:-1]) / 2
        self._p = np.concatenate([np.zeros((1, 2)), np.cumsum(step, 0)])

    def at(self, t_ns: int) -> Array:
        """(2,) in m from where the first row is true."""
        i = max(int(np.searchsorted(self._t_ns, t_ns, side="right")) - 1, 0)
        return np.asarray(self._p[i] + (t_ns - self._t_ns[i]) / 1e9 * self._v[i])


def own_motion(drive: Drive, config: SmoothConfig, found: Epochs) -> OwnMotion | None:
    """What the drive says of the car's own motion, if it does; its rows get their verdicts.

    Raises DriveError where `config.motion.kind` asks for what the drive has not.
    """
    asked = config.motion.kind != "auto"
    if not asked and not any(len(drive.tables.get(name, ())) for name in _TABLES):
        return None
    own = OwnMotion(drive, config, found.t_ns, dict(found.verdicts))
    return own if len(own.t_ns) else None


def rolling(speed_mps: float, yaw_rad: float, sigmas_mps: Array) -> OwnRows:
    """Of wheels that roll ahead and do not slide sideways, about a heading.

    With v ahead and to the left of it, k the error of the scale, h the heading:
        v_ahead - speed k = speed
        v_left - speed h = -speed yaw_rad
    """
    W = np.diag(1 / sigmas_mps)
    b = W @ [speed_mps, -speed_mps * yaw_rad]
    h, o = np.array([[0.0], [-speed_mps]]), np.array([[0.0, -speed_mps], [0.0, 0.0]])
    return OwnRows(b, W @ rotation(yaw_rad).T, W @ h, W @ o)


def _motion(drive: Drive, config: SmoothConfig, verdicts: dict[str, SourceVerdicts]) -> Motion:
    kind = kind_of(drive, config)
    if kind == "imu":
        raise DriveError(
            f"drive {drive.name!r}: motion.kind = imu, but the graph of several road users takes "
            "no IMU; leave it auto"
        )
    return made_up(drive, kind, config, verdicts)


def _noise(motion: Motion) -> AxisNoise:
    """That of made-up samples."""
    if motion.noise is None:
        raise DriveError("the motion of an IMU has no noise of its own")
    return motion.noise


def _by_instant(table: Table | None, rows: NDArray[np.int64]) -> dict[int, int]:
    """Rows of a table by their instants."""
    return {} if table is None else {int(table.t_ns[row]): int(row) for row in rows}
