"""What carries the vehicle from one state to the next: its IMU, or samples made up for one.

A drive without an IMU gets samples of one that sits at the vehicle's origin, along its axes, where
nothing weighs anything. They say what is known of its motion:
    constant velocity  no force and no turn
    odometry           the yaw rate w that was measured, and the force v w that holds a car in it
    bicycle            the same, with w = v tan(steering wheel / ratio) / wheelbase
                       (Rajamani, Vehicle Dynamics and Control, 2012, eq. 2.12, no slip)
What is not known is white noise of wide density along the ground, narrower upwards and about the
level axes. Without gravity a tilt means nothing but the slope of the road.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fgloc.config import MotionConfig, SmoothConfig, VehicleConfig
from fgloc.drive import AxisNoise, Drive
from fgloc.errors import DriveError
from fgloc.measurements import Array, ImuSamples, Odometry, SteeringAngles, Table, WheelSpeeds
from fgloc.timing import Instants
from fgloc.verdicts import SourceVerdicts, Verdict

Kind = Literal["imu", "constant-velocity", "odometry", "bicycle"]
LEVEL_SIGMA_RAD, PLANAR_SIGMA_RAD = 0.2, 0.05
"""A road vehicle is level to this at the start: with an IMU, that may sit askew, and without."""
HELD_MPS2, HELD_RADPS = 1e-3, 1e-4
"""Biases of made-up samples say nothing; they are held to this, and walk by a tenth of it in each
second: numbers that solvers can bear."""
UNKNOWN_TURN_RADPS = 0.2
"""How fast a car turns of which nobody tells it: its origin slides so fast per metre from the
point that does not."""
STRAIGHT_RAD = 1e-4
"""Made-up samples lie along the car's axes."""
UNSOUND_ODOMETRY = "a speed, yaw rate or sigma is not finite, or a sigma is not above 0"
NEVER_S = 1e9
"""Samples are never so far apart: they leave no gap."""
MOST_STEER_RAD = 1.4
"""Road wheels that are turned further, nearly across, tell of another steering ratio."""


@dataclass(frozen=True, eq=False)
class Motion:
    """The samples that lead from state to state, and what follows from how they were got.

    samples    sound, in order, each instant once
    T_veh_imu  (4, 4) their axes and place in the vehicle frame, m
    vehicle    what the vehicle's constraints are asked for, decided
    noise      of made-up samples; None where it is the IMU's
    gap_s      samples further apart leave a gap
    """

    kind: Kind
    samples: ImuSamples
    T_veh_imu: Array
    vehicle: VehicleConfig
    noise: AxisNoise | None = None
    gap_noise: tuple[Array, Array] | None = None
    gap_s: float = NEVER_S

    @property
    def is_made_up(self) -> bool:
        """Whether the drive has no IMU, or it is not to be used."""
        return self.kind != "imu"

    @property
    def forgets_yaw(self) -> bool:
        """Whether nobody tells how the vehicle turns: a heading of long ago then means nothing."""
        return self.kind == "constant-velocity"

    @property
    def level_sigma_rad(self) -> float:
        """How level the vehicle is at the start."""
        return PLANAR_SIGMA_RAD if self.is_made_up else LEVEL_SIGMA_RAD


def kind_of(drive: Drive, config: SmoothConfig) -> Kind:
    """What is to carry the states: what the configuration names, or the best that the drive has."""
    asked = config.motion.kind
    if asked != "auto":
        return asked
    if "imu" in drive.tables:
        return "imu"
    if _has(drive, "odometry", Odometry):
        return "odometry"
    steered = _has(drive, "steering", SteeringAngles) and _has(drive, "wheel", WheelSpeeds)
    return "bicycle" if steered and config.motion.wheelbase_m else "constant-velocity"


def measured(drive: Drive, samples: ImuSamples, config: SmoothConfig) -> Motion:
    """The motion that the sound samples of the drive's IMU tell."""
    return Motion("imu", samples, drive.rig.T_veh_imu, config.vehicle, gap_s=config.imu.gap_s)


def made_up(
    drive: Drive, kind: Kind, config: SmoothConfig, verdicts: dict[str, SourceVerdicts]
) -> Motion:
    """The motion of a drive whose IMU there is not, or is not to be used.

    Gives the rows that it is made from their verdicts. Raises DriveError where the tables or
    the lengths that `kind` needs are missing.
    """
    c, level = config.motion, np.zeros(3)
    if config.vehicle.zero_velocity:
        raise DriveError(
            f"drive {drive.name!r}: vehicle.zero_velocity tells standstill from the IMU, and there "
            "is none in use; leave it off"
        )
    turn, gap_s, bias = c.turn_radps_per_sqrt_hz, NEVER_S, HELD_RADPS
    t_ns, speed, rate = np.empty(0, np.int64), np.empty(0), np.empty(0)
    if kind == "odometry":
        t_ns, speed, rate, turn = _odometry(drive, verdicts)
    elif kind == "bicycle":
        t_ns, speed, rate = _bicycle(drive, c, verdicts)
        turn = c.steering_radps_per_sqrt_hz
    if kind != "constant-velocity":
        gap_s, bias = c.gap_s, c.yaw_rate_bias_radps
    if "imu" in verdicts:
        verdicts["imu"].set(slice(None), Verdict.UNUSED, f"motion.kind is {kind}")
    samples = _samples(_span(drive), t_ns, speed, rate)
    accel, gyro = _along(c), np.array([c.tilt_radps_per_sqrt_hz] * 2 + [turn])
    held_gyro = level + [HELD_RADPS, HELD_RADPS, bias]
    noise = AxisNoise(accel, gyro, level + HELD_MPS2 / 10, held_gyro / 10, level + HELD_MPS2,
                      held_gyro)  # fmt: skip
    wide = np.array([c.tilt_radps_per_sqrt_hz] * 2 + [c.turn_radps_per_sqrt_hz])
    return Motion(kind, samples, np.eye(4), _vehicle(drive, kind, config), noise, (accel, wide),
                  gap_s)  # fmt: skip


def sound_rows(
    t_ns: Instants, sound: NDArray[np.bool_], why: str, verdicts: SourceVerdicts,
    rows_of: NDArray[np.int64] | None = None,
) -> NDArray[np.int64]:  # fmt: skip
    """Which of some rows, by default all, are sound and the first such of their instant; the others
    get their verdicts."""
    rows_of = np.arange(len(t_ns)) if rows_of is None else rows_of
    rows = np.flatnonzero(sound)
    first = firsts(t_ns[rows])
    again = rows_of[np.delete(rows, first)]
    verdicts.set(again, Verdict.DUPLICATE, "an earlier row has the same t_ns")
    verdicts.set(rows_of[~sound], Verdict.INVALID, why)
    return rows[first]


def firsts(groups: NDArray[np.int64]) -> NDArray[np.int64]:
    """Index of the first of each run of equal numbers."""
    return np.flatnonzero(np.append(True, groups[1:] != groups[:-1])[: len(groups)])


def credit(motion: Motion, verdicts: dict[str, SourceVerdicts]) -> None:
    """Rows whose speed is not taken have still told how the vehicle turned."""
    sources = {"odometry": ["odometry"], "bicycle": ["wheel", "steering"]}.get(motion.kind, [])
    for own in (verdicts[source] for source in sources):
        own.set(own.is_(Verdict.UNUSED), Verdict.USED, "its turn; its speed is not taken")


def _odometry(
    drive: Drive, verdicts: dict[str, SourceVerdicts]
) -> tuple[Instants, Array, Array, float]:
    """Instants, speeds, yaw rates of the sound rows, and the density of the rates' noise."""
    table = drive.tables.get("odometry")
    if not isinstance(table, Odometry) or not len(table):
        raise _missing(drive, "odometry", "odometry")
    sigma = table.sigma_yaw_rate_radps
    own = verdicts["odometry"]
    rows = sound_rows(table.t_ns, sound_odometry(table), UNSOUND_ODOMETRY, own)
    if len(rows) < 2:
        raise DriveError(f"drive {drive.name!r}: {len(rows)} of its odometry rows are sound")
    step_s = float(np.median(np.diff(table.t_ns[rows]))) / 1e9
    density = float(np.median(sigma[rows])) * np.sqrt(step_s)
    return table.t_ns[rows], table.speed_mps[rows], table.yaw_rate_radps[rows], density


def sound_odometry(table: Odometry) -> NDArray[np.bool_]:
    """(N,) bool: rows whose numbers are all finite, with sigmas above 0."""
    sigmas = np.stack([table.sigma_speed_mps, table.sigma_yaw_rate_radps])
    values = np.stack([table.speed_mps, table.yaw_rate_radps])
    return np.asarray(np.isfinite([*values, *sigmas]).all(0) & (sigmas > 0).all(0))


def _bicycle(
    drive: Drive, c: MotionConfig, verdicts: dict[str, SourceVerdicts]
) -> tuple[Instants, Array, Array]:
    """Instants, speeds and yaw rates of the sound steering angles."""
    steering, wheel = drive.tables.get("steering"), drive.tables.get("wheel")
    if not isinstance(steering, SteeringAngles) or not len(steering):
        raise _missing(drive, "bicycle", "steering")
    if not isinstance(wheel, WheelSpeeds) or not np.isfinite(wheel.speed_mps).any():
        raise _missing(drive, "bicycle", "wheel")
    if c.wheelbase_m is None:
        raise DriveError(
            f"drive {drive.name!r}: motion.kind = bicycle needs the distance between the axles; "
            "give it as --set motion.wheelbase_m=2.7"
        )
    angle = steering.angle_rad / c.steering_ratio
    sound = np.isfinite(angle) & (np.abs(angle) < MOST_STEER_RAD)
    why = f"not finite, or by motion.steering_ratio = {c.steering_ratio:g} beyond any wheel"
    rows = sound_rows(steering.t_ns, sound, why, verdicts["steering"])
    if len(rows) < 2:
        raise DriveError(f"drive {drive.name!r}: {len(rows)} of its steering angles are sound")
    known = np.flatnonzero(np.isfinite(wheel.speed_mps))
    t_ns = steering.t_ns[rows]
    speed = np.interp(t_ns - t_ns[0], wheel.t_ns[known] - t_ns[0], wheel.speed_mps[known])
    return t_ns, speed, speed * np.tan(angle[rows]) / c.wheelbase_m


def _samples(
    span_ns: tuple[int, int], t_ns: Instants, speed_mps: Array, yaw_rate_radps: Array
) -> ImuSamples:
    """Samples at some instants, and at both ends of a span that reaches beyond them."""
    begin = [span_ns[0]] if not len(t_ns) or span_ns[0] < t_ns[0] else []
    end = [span_ns[1]] if not len(t_ns) or span_ns[1] > t_ns[-1] else []
    ends = len(begin), len(end)
    at = np.concatenate([begin, t_ns, end], dtype=np.int64, casting="unsafe")
    force, rate = np.zeros((len(at), 3)), np.zeros((len(at), 3))
    force[:, 1] = np.pad(speed_mps * yaw_rate_radps, ends)
    rate[:, 2] = np.pad(yaw_rate_radps, ends)
    return ImuSamples(at, at, force, rate)


def _span(drive: Drive) -> tuple[int, int]:
    """First and last instant of what aids: a state beyond would be a mere guess."""
    aids = [
        t.t_ns for name, t in drive.tables.items() if len(t) and name not in ("imu", "steering")
    ]
    if not aids:
        raise DriveError(f"drive {drive.name!r} has no rows in any table that tells where it is")
    return min(int(t[0]) for t in aids), max(int(t[-1]) for t in aids)


def _along(c: MotionConfig) -> Array:
    return np.array([c.accel_mps2_per_sqrt_hz] * 2 + [c.vertical_mps2_per_sqrt_hz])


def _vehicle(drive: Drive, kind: Kind, config: SmoothConfig) -> VehicleConfig:
    """The vehicle's constraints where there is no IMU: on, unless they are said to be off."""
    v, c = config.vehicle, config.motion
    speeds = _has(drive, "wheel", WheelSpeeds) or _has(drive, "odometry", Odometry)
    interval_s = c.interval_s if speeds or "velocity" in drive.tables else v.interval_s
    often = max(np.sqrt(v.interval_s / interval_s), 1.0)
    sideways = v.lateral_sigma_mps * often
    if kind == "constant-velocity":
        sideways = float(np.hypot(sideways, v.point_sigma_m * UNKNOWN_TURN_RADPS))
    return v.model_copy(update={
        "non_holonomic": v.non_holonomic is not False,
        "wheel_speed": speeds and v.wheel_speed is not False,
        "interval_s": interval_s, "lateral_sigma_mps": sideways,
        "vertical_sigma_mps": v.vertical_sigma_mps * often,
        "mounting_sigma_rad": STRAIGHT_RAD, "pitch_rad_per_mps2": 0.0,
    })  # fmt: skip


def _has(drive: Drive, name: str, kind: type[Table]) -> bool:
    table = drive.tables.get(name)
    return isinstance(table, kind) and len(table.t_ns) > 0


def _missing(drive: Drive, kind: str, table: str) -> DriveError:
    have = ", ".join(drive.tables) or "nothing"
    return DriveError(
        f"drive {drive.name!r}: motion.kind = {kind} needs {table} rows (it has {have})"
    )
