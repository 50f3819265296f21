"""Configuration of a run: TOML in, a validated model out, all faults named at once."""

import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from fgloc.chi_square import chi2_quantile
from fgloc.errors import ConfigError, nearest

M = TypeVar("M", bound=BaseModel)
Mode = Literal["batch", "incremental", "fixed-lag"]
Clock = Literal["gnss", "imu", "wheel", "velocity", "nodes"]


class Section(BaseModel):
    """A group of settings; unknown keys, NaN and infinity are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Gated(Section):
    """Settings of a source with a gate."""

    gate_probability: float
    gate_slack: float

    def gate_nis(self, dof: int) -> float:
        """The NIS above which what has so many degrees of freedom is gated."""
        return chi2_quantile(self.gate_probability, dof) * self.gate_slack**2


class GnssConfig(Gated):
    """How GNSS fixes enter the graph."""

    loss: Literal["none", "huber", "cauchy"] = "huber"
    """Robust loss on the whitened position error."""
    loss_width: float = Field(default=3.4, gt=0)
    """Whitened norm at which the loss leaves the parabola; 3.4 holds 99 % of three-dimensional
    Gaussian errors."""
    gate_probability: float = Field(default=0.9999, gt=0, le=1)
    """A fix is gated where its NIS exceeds this quantile of chi-square, times the slack squared;
    1 switches the gate off."""
    gate_slack: float = Field(default=3.0, ge=1, le=1e6)
    """How many times too small the innovation's sigma may be before the gate may act: real noise is
    never quite the model's, and what lies between is left to the loss."""
    gate_reset_s: float = Field(default=5.0, gt=0)
    """After this long without an accepted fix the gate opens, or it would never recover."""
    sigma_scale: float = Field(default=1.0, ge=1e-6, le=1e6)
    """Factor on every fix's standard deviation."""
    bias_sigma_m: float | None = Field(default=None, ge=0)
    """Stationary standard deviation per axis of a slowly varying position bias; 0 leaves it out.
    Default: what the drive's rig states, or 0."""
    bias_tau_s: float | None = Field(default=None, gt=0)
    """Time constant of that bias. Default: what the rig states, or 60 s."""


class DetectionConfig(Gated):
    """How what roadside nodes see enters the graph."""

    use: bool = True
    covariance: Literal["stated", "lee2021", "khamooshi2023"] = "stated"
    """Of a detection: what the node states (where it states none, Lee's law), or a law of the
    distance; see `factors/detection.py`."""
    sigma_scale: float = Field(default=1.0, ge=1e-6, le=1e6)
    """Factor on every detection's standard deviation."""
    floor_m: float = Field(default=0.3, gt=0)
    """Least sigma along the line of sight under Lee's law, which is 0 at 13.76 m."""
    loss: Literal["none", "huber", "cauchy"] = "huber"
    loss_width: float = Field(default=3.0, gt=0)
    """Whitened norm at which the loss leaves the parabola; 3.0 holds 99 % of two-dimensional
    Gaussian errors, and 97 % of those with a height."""
    gate_probability: float = Field(default=0.999, gt=0, le=1)
    """A candidate is not the car where its NIS exceeds this quantile of chi-square, times the slack
    squared."""
    gate_slack: float = Field(default=1.5, ge=1, le=1e6)
    """Less than a fix's: what a fix has to fit is noise, here it is the car next to it as well."""
    bias_sigma_m: float | None = Field(default=None, ge=0)
    """Standard deviation per axis of each node's slowly varying error; 0 leaves it out. Default:
    what the node states."""
    bias_tau_s: float | None = Field(default=None, gt=0)
    """Time constant of that error. Default: what the node states."""
    offset_sigma_m: float = Field(default=0.0, ge=0)
    """How far, each axis, the box's centre may be from where the rig says; above 0 it is
    estimated."""


class ImuConfig(Section):
    """IMU settings; noise left out is taken from the drive's rig."""

    accel_noise_mps2_per_sqrt_hz: float | None = Field(default=None, gt=0)
    gyro_noise_radps_per_sqrt_hz: float | None = Field(default=None, gt=0)
    accel_bias_walk_mps3_per_sqrt_hz: float | None = Field(default=None, gt=0)
    gyro_bias_walk_radps2_per_sqrt_hz: float | None = Field(default=None, gt=0)
    accel_bias_sigma_mps2: float | None = Field(default=None, gt=0)
    gyro_bias_sigma_radps: float | None = Field(default=None, gt=0)
    gravity_mps2: float | None = Field(default=None, gt=9.7, lt=9.9)
    """Default: normal gravity at the drive's origin."""
    bias_interval_s: float = Field(default=1.0, gt=0, le=1e6)
    """A new bias variable at the first keyframe this long after the last one."""
    gap_s: float = Field(default=0.2, gt=0)
    """Samples further apart than this are a gap, which is bridged and reported."""
    gap_accel_mps2: float = Field(default=3.0, gt=0)
    """Unknown acceleration in a gap: density of its white noise, m/s^2 per sqrt(Hz)."""
    gap_gyro_radps: float = Field(default=0.3, gt=0)
    """Unknown turn rate in a gap: density of its white noise, rad/s per sqrt(Hz)."""


class MotionConfig(Section):
    """What carries the vehicle from one state to the next, above all where there is no IMU."""

    kind: Literal["auto", "imu", "constant-velocity", "odometry", "bicycle"] = "auto"
    """auto: the IMU if the drive has one, or its odometry, or steering with wheel speeds where the
    wheelbase is given, or a velocity that stays about the same."""
    accel_mps2_per_sqrt_hz: float = Field(default=1.5, gt=0)
    """Without an IMU, of the acceleration along the ground: density of its white noise, which lets
    the speed change by so much in a second."""
    vertical_mps2_per_sqrt_hz: float = Field(default=0.3, gt=0)
    """Upwards: slopes come and go over some seconds."""
    turn_radps_per_sqrt_hz: float = Field(default=0.3, gt=0)
    """About the vertical, where nobody tells the yaw rate."""
    tilt_radps_per_sqrt_hz: float = Field(default=0.01, gt=0)
    """About the level axes: 0.03 rad of slope in ten seconds."""
    steering_radps_per_sqrt_hz: float = Field(default=0.02, gt=0)
    """Of the yaw rate that steering and wheels tell: tyres that yield."""
    yaw_rate_bias_radps: float = Field(default=0.005, gt=0)
    """Of a constant error of a yaw rate, which is estimated: 0.03 rad of the steering wheel at
    20 m/s do as much."""
    wheelbase_m: float | None = Field(default=None, gt=0)
    """Between the axles, for steering."""
    steering_ratio: float = Field(default=15.0, gt=0)
    """Turn of the steering wheel for a turn of the road wheels: cars have 14 to 17."""
    interval_s: float = Field(default=0.1, ge=1e-3, le=1e6)
    """Without an IMU, one speed or velocity is taken in so much time."""
    gap_s: float = Field(default=1.0, gt=0)
    """Yaw rates further apart tell nothing of the turn between them."""
    velocities: bool | None = None
    """Use the drive's `velocity` rows. Default: where nothing else tells how the vehicle moves, as
    such rows come from an IMU or from odometry, and would tell the same twice."""
    velocity_scale_sigma: float | None = Field(default=None, ge=0)
    """Of an error of their speed that lasts, as a share of it; it is estimated, unless 0. Default:
    what the drive's rig states, or 0."""
    velocity_heading_sigma_rad: float | None = Field(default=None, ge=0)
    """Of an error of their direction on the level that lasts, likewise."""


class VehicleConfig(Section):
    """What may be taken for granted of a vehicle; off where the drive does not say it is a car."""

    non_holonomic: bool | None = None
    """The wheels do not slide sideways and the road holds the car: no speed but along its axis.
    Default: only where there is no IMU to tell how the vehicle points."""
    zero_velocity: bool = False
    """While the IMU shakes no more than a car at rest does, it neither moves nor turns."""
    wheel_speed: bool | None = None
    """Use the drive's wheel speeds, or those of its odometry; their scale is estimated. Default:
    only where there is no IMU."""
    interval_s: float = Field(default=1.0, ge=1e-3, le=1e6)
    """One constraint, and one wheel speed, in so much time: their errors last for seconds, so more
    of them say little more."""
    p_veh_point_m: list[float] = Field(default=[0.0, 0.0, 0.0], min_length=3, max_length=3)
    """The point that does not slide, vehicle frame: its origin, which is the rear axle."""
    point_sigma_m: float = Field(default=0.5, ge=0)
    """How well its place along x is known: in a bend, tyres that yield seem to move it."""
    lateral_sigma_mps: float = Field(default=0.02, gt=0)
    """Of the speed sideways where the car goes straight: camber and wind; a camber of 2 % slips by
    as much at 15 m/s."""
    vertical_sigma_mps: float = Field(default=0.06, gt=0)
    """Of the speed upwards, along the body's axes: it heaves by 0.04 m/s in town, alike for about a
    second, so once a second that is worth a little more in white noise."""
    pitch_rad_per_mps2: float = Field(default=0.005, ge=0)
    """How far the body pitches on its springs for each m/s^2 of force along x, nose up: common cars
    do by 2 to 4 degrees per g. 0 for a body that has no springs, as in simulation."""
    mounting_sigma_rad: float = Field(default=0.03, gt=0)
    """How straight the IMU's axes lie to the car's; the turn between them is estimated."""
    wheel_sigma_scale: float = Field(default=1.0, ge=1e-6, le=1e6)
    """Factor on every wheel speed's standard deviation."""
    scale_sigma: float = Field(default=0.02, gt=0)
    """Of the wheels' scale, which is estimated: tyres differ in wear, load and pressure."""
    still_window_s: float = Field(default=1.0, gt=0, le=1e6)
    """Standstill is told from the samples of so much time before."""
    still_accel_mps2: float = Field(default=0.1, gt=0)
    """Standard deviation of the specific force within the window, all axes, below which a car
    stands: an idling engine shakes it by 0.01 to 0.05, a road at walking pace by 0.2 and more."""
    still_gyro_radps: float = Field(default=0.01, gt=0)
    """The same of the angular rate."""
    still_speed_mps: float = Field(default=0.05, gt=0)
    """Standard deviation of the velocity of a car at rest; wheels that show more on average are
    believed and not the IMU."""
    still_rate_radps: float = Field(default=5e-4, gt=0)
    """Of its angular rate over the window, beside the gyro's noise: it rocks when people move."""


class ClockConfig(Section):
    """Stamps that are late, or early where negative: a measurement was true so much before."""

    gnss_s: float = Field(default=0.0, ge=-60, le=60)
    imu_s: float = Field(default=0.0, ge=-60, le=60)
    wheel_s: float = Field(default=0.0, ge=-60, le=60)
    """Of wheel speeds and of odometry."""
    steering_s: float = Field(default=0.0, ge=-60, le=60)
    velocity_s: float = Field(default=0.0, ge=-60, le=60)
    nodes_s: float = Field(default=0.0, ge=-60, le=60)
    estimate: tuple[Clock, ...] = ()
    """Estimate, in a batch, how late the stamps of these are against all others, each as one
    constant of the drive: `gnss`, `imu`, `wheel`, `velocity`, `nodes`, or several, `gnss,wheel`.
    The clock of the others is that of the trajectory."""
    sigma_s: float = Field(default=0.3, gt=0)
    """How late each may be beforehand."""

    @field_validator("estimate", mode="before")
    @classmethod
    def _listed(cls, names: Any) -> Any:
        """A list as one word, with commas; `none` is none."""
        if not isinstance(names, str):
            return names
        return [name.strip() for name in names.split(",") if name.strip() not in ("", "none")]


class SolverConfig(Section):
    """Settings of the solvers; a word alone, `--set solver=gtsam`, is that of the batch."""

    batch: Literal["banded", "gtsam"] = "banded"
    """Who solves a batch: our chain with a banded Cholesky, or GTSAM, to the same optimum."""
    factorization: Literal["cholesky", "qr"] = "qr"
    """Of iSAM2. Cholesky is a third faster, but GTSAM gives up where pivots differ by more than
    2^12, as a good gyro beside a GPS of metres makes them; the window is then solved anew by QR."""
    relinearize_rad: float = Field(default=0.01, gt=0)
    """iSAM2 relinearises a pose that has turned by more: a coarser value makes a causal run sure of
    a tilt that it linearised around another heading."""
    relinearize_m: float | None = Field(default=None, gt=0)
    """... or moved by more. Default: 0.1, or the median sigma of the fixes if that is less, since
    robust weights are renewed only with it."""
    max_iterations: int = Field(default=50, gt=0)
    cost_tolerance: float = Field(default=1e-3, gt=0)
    """The batch has converged where an iteration changes the cost, half a chi-square, by less."""


class PostsConfig(Section):
    """Swaying posts: of a drive that has poses of nodes, or nodes on posts that see vehicles."""

    compensate: bool = True
    """Follow the post of every node that sees vehicles: what the node reports depends on both.
    Without, what it tells is taken as if it stood still, heights that a tilt has moved too."""

    estimate_mode: bool = False
    """Seek frequency, damping and load of each post where all that tells of it is likeliest,
    instead of taking what the drive states; a search over the whole drive, for a batch alone."""


class SmoothConfig(Section):
    """Everything that `fgloc smooth` can be told."""

    mode: Mode = "batch"
    lag_s: float = Field(default=5.0, gt=0)
    smoothed: bool = False
    """Causal modes: also give the last estimate of every state."""
    keyframe_interval_s: float = Field(default=1.0, ge=1e-3, le=1e6)
    """Longest time between two states of the graph; every aiding measurement gets its own."""
    output_interval_s: float = Field(default=0.25, ge=1e-3, le=1e6)
    """Longest time between two states of the written trajectory."""
    seed: int | None = None
    """Kept with the results of simulated drives; the smoother itself draws nothing."""
    gnss: GnssConfig = GnssConfig()
    detections: DetectionConfig = DetectionConfig()
    imu: ImuConfig = ImuConfig()
    motion: MotionConfig = MotionConfig()
    vehicle: VehicleConfig = VehicleConfig()
    clock: ClockConfig = ClockConfig()
    solver: SolverConfig = SolverConfig()
    posts: PostsConfig = PostsConfig()


def load_config(
    path: Path | None = None,
    settings: Iterable[str] = (),
    base: SmoothConfig | None = None,
    **overrides: Any,
) -> SmoothConfig:
    """The configuration of a TOML file, changed by `key=value` settings and by overrides.

    Dotted keys reach into sections: `gnss.loss=none`. Overrides that are None are passed over.
    Raises ConfigError that names every unknown key (with the nearest valid one) and every value
    that does not fit, each with the place it came from.
    """
    return load_model(SmoothConfig, path, settings, base, overrides)


def load_model(
    model: type[M], path: Path | None, settings: Iterable[str], base: M | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> M:  # fmt: skip
    """As `load_config`, of any model."""
    values: dict[str, Any] = base.model_dump() if base else {}
    where = "configuration"
    if path is not None:
        where = str(path)
        values = merge(values, _read(path))
    places: dict[str, str] = {}
    for setting in settings:
        key, equals, text = setting.partition("=")
        if not equals:
            raise ConfigError(f"--set {setting}: expected key=value, e.g. gnss.loss=none")
        keys = key.strip().split(".")
        if keys == ["solver"]:
            keys.append("batch")
        values = merge(values, _nested(keys, parse_value(text.strip())))
        places[".".join(keys)] = "--set"
    given = {key: value for key, value in (overrides or {}).items() if value is not None}
    values = merge(values, given)
    places |= dict.fromkeys(given, "configuration")
    return validate(model, values, where, places)


def validate(
    model: type[M], values: Mapping[str, Any], where: str, places: Mapping[str, str] | None = None
) -> M:
    """`model` made from plain values, or ConfigError with every fault and the place it is in.

    That is `where`, but for the dotted keys for which `places` names another.
    """
    try:
        return model.model_validate(values)
    except ValidationError as err:
        faults: dict[str, list[str]] = {}
        for fault in err.errors():
            place = _place(".".join(map(str, fault["loc"])), places or {}, where)
            faults.setdefault(place, []).append(_describe(model, fault))
        lines = [f"{place}: " + "; ".join(texts) for place, texts in faults.items()]
        raise ConfigError("; ".join(lines)) from err


def merge(base: Mapping[str, Any], update: Mapping[str, Any]) -> dict[str, Any]:
    """`base` with `update` laid over it, section by section."""
    result = dict(base)
    for key, value in update.items():
        old = result.get(key)
        both = isinstance(old, Mapping) and isinstance(value, Mapping)
        result[key] = merge(old, value) if both else value  # type: ignore[arg-type]
    return result


def parse_value(text: str) -> Any:
    """TOML's reading of a value, or the text itself: `--set mode=batch` needs no quotes."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _read(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as err:
        raise ConfigError(f"{path}: {err.strerror}; give the path of a TOML file") from err
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as err:
        raise ConfigError(f"{path}: not valid TOML: {err}") from err


def _nested(keys: list[str], value: Any) -> dict[str, Any]:
    return {keys[0]: _nested(keys[1:], value) if len(keys) > 1 else value}


def _place(dotted: str, places: Mapping[str, str], where: str) -> str:
    """Where a faulty key was given: itself, the section that holds it or a part of it."""
    for key, place in places.items():
        if f"{dotted}.".startswith(f"{key}.") or f"{key}.".startswith(f"{dotted}."):
            return place
    return where


def _describe(model: type[BaseModel], fault: Any) -> str:
    keys = [str(part) for part in fault["loc"]]
    dotted = ".".join(keys)
    if fault["type"] == "missing":
        return f"{dotted} is missing"
    if fault["type"] != "extra_forbidden":
        return f"{dotted} = {fault.get('input')!r}: {fault['msg']}"
    best = ".".join([*keys[:-1], nearest(keys[-1], _fields_at(model, keys[:-1]))])
    return f"unknown key {dotted!r}; the nearest valid key is {best!r}"


def _fields_at(model: type[BaseModel], keys: list[str]) -> list[str]:
    for key in keys:
        annotation = model.model_fields[key].annotation
        for choice in (annotation, *get_args(annotation)):  # a section may be `Section | None`
            if isinstance(choice, type) and issubclass(choice, BaseModel):
                model = choice
    return list(model.model_fields)
