"""`recording.toml`: what a recording of a node's sensors says about itself and the mounts."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import tomli_w
from pydantic import Field

from fgloc.datasets.drive_toml import (
    AboutPart,
    NodePart,
    OriginPart,
    Part,
    Vector2,
    Vector3,
    read_model,
)
from fgloc.errors import DriveError, InputError
from fgloc.infrastructure import Node
from fgloc.perception.heads import UNDISTORTED, Camera, Head, Lidar, PerceptionNode
from fgloc.perception.recording import Recording

FILE_NAME = "recording.toml"

Matrix3 = Annotated[list[Vector3], Field(min_length=3, max_length=3)]
Vector5 = Annotated[list[float], Field(min_length=5, max_length=5)]
Size = Annotated[list[Annotated[int, Field(gt=0)]], Field(min_length=2, max_length=2)]
SensorName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]


class SensorPart(Part):
    """What cameras and LiDARs share. Frames are in the folder of the sensor's name."""

    name: SensorName
    clock_ahead_s: float = 0.0
    """By how much the sensor's clock is ahead of the recording's; taken off its stamps."""


class CameraPart(SensorPart):
    """[[head.camera]]: the fields of `Camera`."""

    size_px: Size
    focal_px: Vector2
    principal_px: Vector2
    R_node_cam: Matrix3
    p_node_cam_m: Vector3
    distortion: Vector5 = Field(default_factory=lambda: list(UNDISTORTED))


class LidarPart(SensorPart):
    """[head.lidar]: the fields of `Lidar`."""

    R_node_lidar: Matrix3
    p_node_lidar_m: Vector3
    min_range_m: float
    max_range_m: float
    azimuth_rad: Vector2
    elevation_rad: Vector2
    step_rad: Vector2
    sigma_m: float


class HeadPart(Part):
    """[[head]]: cameras that share a view, and a LiDAR."""

    name: str = Field(min_length=1)
    camera: list[CameraPart] = Field(default_factory=list)
    lidar: LidarPart | None = None


class SurveyPart(NodePart):
    """[node]: the fields of `Node`, and the height of its origin above the ground."""

    height_m: float = Field(gt=0)


class RecordingToml(Part):
    """The whole file. Stamps of `clock` "gps" count from 1980-01-06, of "tai" as PTP does."""

    format: Literal[1]
    name: str = Field(min_length=1)
    clock: Literal["utc", "gps", "tai"] = "utc"
    about: AboutPart = AboutPart()
    origin: OriginPart
    node: SurveyPart
    head: Annotated[list[HeadPart], Field(min_length=1)]


def read_toml(path: Path) -> RecordingToml:
    """The validated content of a `recording.toml`; DriveError with every fault at once."""
    return read_model(path, RecordingToml)


def to_perception_node(path: Path, file: RecordingToml) -> PerceptionNode:
    """The node with its heads; DriveError where one is impossible."""
    survey = file.node.model_dump()
    height_m = survey.pop("height_m")
    try:
        return PerceptionNode(Node(**survey), tuple(_head(part) for part in file.head), height_m)
    except InputError as err:
        raise DriveError(f"{path}: {err}") from err


def _head(part: HeadPart) -> Head:
    cameras = tuple(
        Camera(**_fields(camera) | {"size_px": tuple(camera.size_px)}) for camera in part.camera
    )
    return Head(part.name, cameras, Lidar(**_fields(part.lidar)) if part.lidar else None)


def _fields(part: SensorPart) -> dict[str, Any]:
    return part.model_dump(exclude={"clock_ahead_s"})


def format_toml(recording: Recording) -> str:
    """The text of the `recording.toml` that describes a recording."""
    survey, heads = recording.node.node, recording.node.heads
    return tomli_w.dumps({
        "format": 1,
        "name": recording.name,
        "about": asdict(recording.about),
        "origin": asdict(recording.origin),
        "node": _plain(survey) | {"height_m": float(recording.node.height_m)},
        "head": [
            {"name": head.name, "camera": [_plain(camera) for camera in head.cameras]}
            | ({"lidar": _plain(head.lidar)} if head.lidar else {})
            for head in heads
        ],
    })  # fmt: skip


def _plain(one: object) -> dict[str, Any]:
    """The fields of a dataclass as TOML has them."""
    return {name: _toml_value(value) for name, value in vars(one).items()}


def _toml_value(value: Any) -> Any:
    if isinstance(value, str):
        return value
    if isinstance(value, tuple):
        return list(value)
    return value.tolist() if hasattr(value, "tolist") else float(value)
