"""A drive: the rig, the tables it recorded, and the truth if there is any."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Self, TypeVar

import numpy as np

from fgloc.arrays import Array, freeze
from fgloc.errors import DriveError
from fgloc.frames import Origin, is_rotation
from fgloc.infrastructure import Infrastructure
from fgloc.measurements import GnssFixes, ImuSamples, NodeDetections, NodePoses, ObjectTruth, Table
from fgloc.posts import PostStates
from fgloc.trajectory import Trajectory

T = TypeVar("T", bound=Table)

NUMBERED = ("node", "sign", "anchor")
"""Columns that hold the number of something in the infrastructure."""
_ROTATION_TOLERANCE = 1e-5  # a matrix written with six decimals is one


@dataclass(frozen=True)
class ImuNoise:
    """Continuous-time noise of an IMU; the same on all three axes.

    The walks drive the biases; the sigmas say how far a bias may be from zero at the start.
    A first-order Gauss-Markov bias of sigma s and time constant tau has a walk of s sqrt(2 / tau)
    over times short against tau.
    """

    accel_noise_mps2_per_sqrt_hz: float
    gyro_noise_radps_per_sqrt_hz: float
    accel_bias_walk_mps3_per_sqrt_hz: float
    gyro_bias_walk_radps2_per_sqrt_hz: float
    accel_bias_sigma_mps2: float = 0.3
    gyro_bias_sigma_radps: float = 0.01


@dataclass(frozen=True, eq=False)
class AxisNoise:
    """The numbers of `ImuNoise` for axes that are not alike, (3,) each, x forward and z up."""

    accel_noise_mps2_per_sqrt_hz: Array
    gyro_noise_radps_per_sqrt_hz: Array
    accel_bias_walk_mps3_per_sqrt_hz: Array
    gyro_bias_walk_radps2_per_sqrt_hz: Array
    accel_bias_sigma_mps2: Array
    gyro_bias_sigma_radps: Array


Noise = ImuNoise | AxisNoise
"""Of an IMU, or of what stands for one."""


@dataclass(frozen=True)
class GnssBias:
    """A slowly varying error of the fixes: first-order Gauss-Markov, each axis of ENU alike.

    sigma_m  its standard deviation
    tau_s    over which it forgets itself
    """

    sigma_m: float
    tau_s: float


@dataclass(frozen=True)
class VelocityErrors:
    """Errors of the velocities that stay the same over a drive, as standard deviations.

    scale_sigma        of the speed, as a share of it
    heading_sigma_rad  of the direction on the level
    """

    scale_sigma: float
    heading_sigma_rad: float


@dataclass(frozen=True, eq=False)
class Camera:
    """A level pinhole camera on the vehicle.

    Raises DriveError where a shape does not fit or the focal length is not above 0.

    focal_px      focal length in pixels
    principal_px  (2,) where the optical axis meets the image, right and down in px
    p_veh_cam_m   (3,) its place in the vehicle frame, m
    yaw_rad       from the vehicle's x axis to the optical axis, counter-clockwise
    """

    focal_px: float
    principal_px: Array
    p_veh_cam_m: Array
    yaw_rad: float = 0.0

    def __post_init__(self) -> None:
        for name, shape in {"principal_px": (2,), "p_veh_cam_m": (3,)}.items():
            array = freeze(getattr(self, name))
            if array.shape != shape or not np.isfinite(array).all():
                raise DriveError(f"rig.camera.{name}: expected finite numbers of shape {shape}")
            object.__setattr__(self, name, array)
        if not (np.isfinite([self.focal_px, self.yaw_rad]).all() and self.focal_px > 0):
            raise DriveError("rig.camera: expected a focal_px above 0 and a finite yaw_rad")


@dataclass(frozen=True, eq=False)
class Rig:
    """Where the sensors sit on the vehicle, and how noisy they are.

    Raises DriveError where a shape does not fit or the IMU's axes are not a rotation.

    p_veh_ant_m  (3,) GNSS antenna in the vehicle frame, m
    p_veh_box_m  (3,) centre of the box that nodes see around the vehicle, in its frame, m
    T_veh_imu    (4, 4) IMU axes and place in the vehicle frame, m
    imu_noise    or None where the drive has no IMU
    gnss_bias    or None where the fixes' errors are white
    camera       that reads Smart Codes, or None where there is none
    p_veh_tag_m  (3,) what measures ranges, in the vehicle frame, m
    user_bias    or None where the errors of what other road users say of their places are white;
                 each user's is its own
    velocity_errors  or None where the errors of the velocities are white
    """

    p_veh_ant_m: Array = field(default_factory=lambda: np.zeros(3))
    T_veh_imu: Array = field(default_factory=lambda: np.eye(4))
    imu_noise: ImuNoise | None = None
    p_veh_box_m: Array = field(default_factory=lambda: np.zeros(3))
    gnss_bias: GnssBias | None = None
    camera: Camera | None = None
    p_veh_tag_m: Array = field(default_factory=lambda: np.zeros(3))
    user_bias: GnssBias | None = None
    velocity_errors: VelocityErrors | None = None

    def __post_init__(self) -> None:
        shapes = {
            "p_veh_ant_m": (3,), "p_veh_box_m": (3,), "p_veh_tag_m": (3,), "T_veh_imu": (4, 4),
        }  # fmt: skip
        for name, shape in shapes.items():
            array = freeze(getattr(self, name))
            if array.shape != shape or not np.isfinite(array).all():
                raise DriveError(f"rig.{name}: expected finite numbers of shape {shape}")
            object.__setattr__(self, name, array)
        if not is_rotation(self.T_veh_imu[:3, :3], _ROTATION_TOLERANCE):
            raise DriveError("rig.T_veh_imu: the upper left 3x3 block is not a rotation matrix")


@dataclass(frozen=True)
class About:
    """What people should know of a drive: a line of description, licence, origin of the data."""

    title: str = ""
    licence: str = ""
    source: str = ""
    simulated: bool = False


@dataclass(frozen=True, eq=False)
class Drive:
    """One recorded or simulated drive; `tables` maps the source's name to its table.

    `truth` is that of the vehicle, `objects` of other road users, `post_truth` tells how the posts
    beside the road swayed.
    """

    name: str
    origin: Origin
    rig: Rig
    tables: Mapping[str, Table]
    truth: Trajectory | None = None
    about: About = About()
    infrastructure: Infrastructure = field(default_factory=Infrastructure)
    objects: ObjectTruth | None = None
    post_truth: PostStates | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "tables", MappingProxyType(dict(self.tables)))
        for table in (*self.tables.values(), self.post_truth):
            for what in NUMBERED:
                if table is not None and hasattr(table, what):
                    self._check_numbers(table, what)
        self._check_heights()

    def _check_numbers(self, table: Table, what: str) -> None:
        """Every row is of a node, sign or anchor that the infrastructure has."""
        numbers, have = getattr(table, what), len(getattr(self.infrastructure, f"{what}s"))
        unknown = (numbers < 0) | (numbers >= have)
        if unknown.any():
            row = int(np.argmax(unknown))
            raise DriveError(
                f"drive {self.name!r}: {table.KIND} row {row}: {what} = {numbers[row]}, but the "
                f"drive has {have} {what}s, counted from 0; add it as [[{what}]] or remove the row"
            )

    def _check_heights(self) -> None:
        """No camera tells a height."""
        seen = self.tables.get(NodeDetections.KIND)
        if isinstance(seen, NodeDetections):
            table = f"drive {self.name!r}: detections"
            self.infrastructure.refuse_camera_heights(
                seen.node, seen.up_node_m, lambda row: f"{table} row {row}: up_node_m"
            )

    @property
    def gnss(self) -> GnssFixes:
        """The GNSS fixes; raises DriveError where the drive has none."""
        return self._table("gnss", GnssFixes)

    @property
    def imu(self) -> ImuSamples:
        """The IMU samples; raises DriveError where the drive has none."""
        return self._table("imu", ImuSamples)

    @property
    def has_vehicle(self) -> bool:
        """Whether any table tells of a vehicle; poses of nodes alone do not."""
        return set(self.tables) != {NodePoses.KIND}

    @property
    def start_ns(self) -> int:
        """The first instant of any table; raises DriveError where no table has rows."""
        return min(int(t.t_ns[0]) for t in self._filled())

    @property
    def end_ns(self) -> int:
        """The last instant of any table; raises DriveError where no table has rows."""
        return max(int(t.t_ns[-1]) for t in self._filled())

    def with_tables(self, **tables: Table) -> Self:
        """The same drive with some tables replaced or added."""
        return replace(self, tables={**self.tables, **tables})

    def _filled(self) -> list[Table]:
        tables = [table for table in self.tables.values() if len(table)]
        if not tables:
            raise DriveError(f"drive {self.name!r} has no rows in any table")
        return tables

    def _table(self, name: str, kind: type[T]) -> T:
        table = self.tables.get(name)
        if not isinstance(table, kind) or len(table) == 0:
            have = ", ".join(self.tables) or "nothing"
            raise DriveError(f"drive {self.name!r} has no {name} rows (it has {have})")
        return table
