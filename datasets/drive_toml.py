"""`drive.toml`: what a drive folder says about itself, the rig and the world frame."""

import dataclasses
import tomllib
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import numpy as np
import tomli_w
from pydantic import BaseModel, ConfigDict, Field

from fgloc.config import validate
from fgloc.drive import About, Camera, Drive, GnssBias, ImuNoise, Rig, VelocityErrors
from fgloc.errors import ConfigError, DriveError, InputError
from fgloc.files import read_text
from fgloc.frames import HEIGHT_LIMITS_M, LATITUDE_LIMITS_DEG, LONGITUDE_LIMITS_DEG, Origin
from fgloc.infrastructure import Anchor, Infrastructure, Node, Post, Sign

FILE_NAME = "drive.toml"

Vector2 = Annotated[list[float], Field(min_length=2, max_length=2)]
Vector3 = Annotated[list[float], Field(min_length=3, max_length=3)]
Row4 = Annotated[list[float], Field(min_length=4, max_length=4)]
Matrix4 = Annotated[list[Row4], Field(min_length=4, max_length=4)]


M = TypeVar("M", bound=BaseModel)


class Part(BaseModel):
    """A table of the file; unknown keys, text for numbers, NaN and infinity are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class AboutPart(Part):
    """[about]: for people."""

    title: str = ""
    licence: str = ""
    source: str = ""
    simulated: bool = False


class OriginPart(Part):
    """[origin]: where the world frame touches the Earth."""

    lat_deg: float = Field(ge=LATITUDE_LIMITS_DEG[0], le=LATITUDE_LIMITS_DEG[1])
    lon_deg: float = Field(ge=LONGITUDE_LIMITS_DEG[0], le=LONGITUDE_LIMITS_DEG[1])
    height_m: float = Field(ge=HEIGHT_LIMITS_M[0], le=HEIGHT_LIMITS_M[1])
    datum: Literal["ellipsoid", "msl"] = "ellipsoid"


class ImuNoisePart(Part):
    """[rig.imu_noise]: the fields of `ImuNoise`."""

    accel_noise_mps2_per_sqrt_hz: float = Field(gt=0)
    gyro_noise_radps_per_sqrt_hz: float = Field(gt=0)
    accel_bias_walk_mps3_per_sqrt_hz: float = Field(gt=0)
    gyro_bias_walk_radps2_per_sqrt_hz: float = Field(gt=0)
    accel_bias_sigma_mps2: float = Field(default=ImuNoise.accel_bias_sigma_mps2, gt=0)
    gyro_bias_sigma_radps: float = Field(default=ImuNoise.gyro_bias_sigma_radps, gt=0)


class GnssBiasPart(Part):
    """[rig.gnss_bias] and [rig.user_bias]: the fields of `GnssBias`."""

    sigma_m: float = Field(gt=0)
    tau_s: float = Field(gt=0)


class VelocityErrorsPart(Part):
    """[rig.velocity_errors]: the fields of `VelocityErrors`."""

    scale_sigma: float = Field(ge=0)
    heading_sigma_rad: float = Field(ge=0)


class CameraPart(Part):
    """[rig.camera]: the fields of `Camera`."""

    focal_px: float = Field(gt=0)
    principal_px: Vector2
    p_veh_cam_m: Vector3
    yaw_rad: float = Camera.yaw_rad


class RigPart(Part):
    """[rig]: where the sensors sit."""

    p_veh_ant_m: Vector3 = [0.0, 0.0, 0.0]
    p_veh_box_m: Vector3 = [0.0, 0.0, 0.0]
    T_veh_imu: Matrix4 = np.eye(4).tolist()
    imu_noise: ImuNoisePart | None = None
    gnss_bias: GnssBiasPart | None = None
    camera: CameraPart | None = None
    p_veh_tag_m: Vector3 = [0.0, 0.0, 0.0]
    user_bias: GnssBiasPart | None = None
    velocity_errors: VelocityErrorsPart | None = None


class NodePart(Part):
    """[[node]]: the fields of `Node`."""

    name: str = Field(min_length=1)
    p_world_m: Vector3
    yaw_rad: float = Node.yaw_rad
    sigma_position_m: float = Field(default=Node.sigma_position_m, ge=0)
    sigma_yaw_rad: float = Field(default=Node.sigma_yaw_rad, ge=0)
    sigma_level_rad: float = Field(default=Node.sigma_level_rad, ge=0)
    range_m: float = Field(default=Node.range_m, ge=0)
    bias_sigma_m: float = Field(default=Node.bias_sigma_m, ge=0)
    bias_tau_s: float = Field(default=Node.bias_tau_s, gt=0)
    sensor: Literal["camera", "lidar"] = Node.sensor


class PostPart(Part):
    """[[post]]: the fields of `Post`."""

    node: str = Field(min_length=1)
    height_m: float = Field(gt=0)
    frequency_hz: float = Field(gt=0)
    damping: float = Field(gt=0, lt=1)
    modal_mass_kg: float = Field(gt=0)
    tip_slope_per_m: float = Field(gt=0)
    load_sigma_n: float = Field(gt=0)
    load_tau_s: float = Field(gt=0)


class SignPart(Part):
    """[[sign]]: the fields of `Sign`."""

    name: str = Field(min_length=1)
    code: str = Field(pattern="^[0-9a-f]+$")
    p_world_m: Vector3
    normal_yaw_rad: float
    size_m: float = Field(gt=0)
    side: Literal["left", "right"] = Sign.side


class AnchorPart(Part):
    """[[anchor]]: the fields of `Anchor`."""

    name: str = Field(min_length=1)
    p_world_m: Vector3


class TruthPart(Part):
    """[truth]: of which point of the vehicle it tells."""

    p_veh_point_m: Vector3 = [0.0, 0.0, 0.0]


class DriveToml(Part):
    """The whole file."""

    format: Literal[1]
    name: str = Field(min_length=1)
    about: AboutPart = AboutPart()
    origin: OriginPart | None = None
    rig: RigPart = RigPart()
    node: list[NodePart] = []
    post: list[PostPart] = []
    sign: list[SignPart] = []
    anchor: list[AnchorPart] = []
    truth: TruthPart | None = None


def read_toml(path: Path) -> DriveToml:
    """The validated content of a `drive.toml`; DriveError with every fault at once."""
    return read_model(path, DriveToml)


def read_model(path: Path, kind: type[M]) -> M:
    """The content of a TOML file as a model; DriveError with every fault at once."""
    try:
        values = tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as err:
        raise DriveError(f"{path}: not valid TOML: {err}") from err
    try:
        return validate(kind, values, str(path))
    except ConfigError as err:
        raise DriveError(str(err)) from err


def to_rig(path: Path, part: RigPart) -> Rig:
    """The rig of `[rig]`; DriveError where its mounting matrix is not a rigid transform."""
    T_veh_imu = np.array(part.T_veh_imu)
    if not np.array_equal(T_veh_imu[3], [0, 0, 0, 1]):
        raise DriveError(f"{path}: the last row of rig.T_veh_imu must be [0, 0, 0, 1]")
    noise = ImuNoise(**part.imu_noise.model_dump()) if part.imu_noise else None
    bias, user_bias = (GnssBias(**one.model_dump()) if one else None
                       for one in (part.gnss_bias, part.user_bias))  # fmt: skip
    camera = Camera(**part.camera.model_dump()) if part.camera else None
    lasting = part.velocity_errors
    errors = VelocityErrors(**lasting.model_dump()) if lasting else None
    try:
        return Rig(
            np.array(part.p_veh_ant_m), T_veh_imu, noise, np.array(part.p_veh_box_m), bias, camera,
            np.array(part.p_veh_tag_m), user_bias, errors,
        )  # fmt: skip
    except InputError as err:
        raise DriveError(f"{path}: {err}") from err


def to_origin(part: OriginPart) -> Origin:
    """The origin of `[origin]`."""
    return Origin(**part.model_dump())


def to_infrastructure(path: Path, file: DriveToml) -> Infrastructure:
    """What stands beside the road; DriveError where two have one name or a post has no node."""
    try:
        return Infrastructure(
            tuple(Node(**part.model_dump()) for part in file.node),
            tuple(Post(**part.model_dump()) for part in file.post),
            tuple(Sign(**part.model_dump()) for part in file.sign),
            tuple(Anchor(**part.model_dump()) for part in file.anchor),
        )
    except InputError as err:
        raise DriveError(f"{path}: {err}") from err


def to_about(part: AboutPart) -> About:
    """The description of `[about]`."""
    return About(**part.model_dump())


def format_toml(drive: Drive) -> str:
    """The text of the `drive.toml` that describes a drive."""
    rig = {"p_veh_ant_m": drive.rig.p_veh_ant_m.tolist(), "T_veh_imu": drive.rig.T_veh_imu.tolist()}
    if drive.rig.p_veh_box_m.any():
        rig["p_veh_box_m"] = drive.rig.p_veh_box_m.tolist()
    if drive.rig.imu_noise is not None:
        rig["imu_noise"] = _floats(dataclasses.asdict(drive.rig.imu_noise))
    for name in ("gnss_bias", "user_bias", "velocity_errors"):
        if (part := getattr(drive.rig, name)) is not None:
            rig[name] = _floats(dataclasses.asdict(part))
    if drive.rig.camera is not None:
        rig["camera"] = _plain(drive.rig.camera)
    if drive.rig.p_veh_tag_m.any():
        rig["p_veh_tag_m"] = drive.rig.p_veh_tag_m.tolist()
    content = {
        "format": 1,
        "name": drive.name,
        "about": dataclasses.asdict(drive.about),
        "origin": _floats(dataclasses.asdict(drive.origin)),
        "rig": rig,
    }
    for kind, all_of_them in vars(drive.infrastructure).items():
        if all_of_them:
            content[kind.removesuffix("s")] = [_plain(one) for one in all_of_them]
    if drive.truth is not None:
        content["truth"] = {"p_veh_point_m": drive.truth.p_veh_point_m.tolist()}
    return tomli_w.dumps(content)


def _plain(one: object) -> dict[str, object]:
    """The fields of a dataclass as TOML has them."""
    return _floats(vars(one))


def _floats(values: dict[str, object]) -> dict[str, object]:
    """Plain floats where numpy scalars or ints may have crept in: TOML knows only those."""
    return {k: _toml_value(v) for k, v in values.items()}


def _toml_value(value: object) -> object:
    if isinstance(value, np.ndarray):
        return value.tolist()
    return value if isinstance(value, str) else float(value)  # type: ignore[arg-type]
