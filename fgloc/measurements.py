"""The tables in which measurements travel: read-only columnar arrays with a time axis.

Every table has `t_ns` (N,), when a measurement was true, and `received_ns` (N,), when it arrived.
Rows are in the order of `t_ns` and named by their index, counted from 0.
"""

from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from fgloc.arrays import Array, freeze, freeze_ns, sealed
from fgloc.errors import DriveError
from fgloc.timing import Instants

SYMMETRIC = 1e-6
"""Triangles of a covariance may differ by this share of its largest variance, as rounding does."""


@dataclass(frozen=True, eq=False)
class Table:
    """What all tables share. Subclasses add arrays whose first axis is time.

    `SHAPES` gives the trailing shape of each column. Raises DriveError where lengths or shapes
    do not fit, stamps are not integers or `t_ns` goes back.
    """

    t_ns: Instants
    received_ns: Instants

    KIND: ClassVar[str]
    SHAPES: ClassVar[dict[str, tuple[int, ...]]]
    WHOLE: ClassVar[frozenset[str]] = frozenset()  # columns of whole numbers
    OPTIONAL: ClassVar[frozenset[str]] = frozenset()  # columns with NaN where nothing was told

    def __post_init__(self) -> None:
        for one in fields(self):
            column = getattr(self, one.name)
            expected = (len(self.t_ns), *self.SHAPES.get(one.name, ()))
            if one.name in ("t_ns", "received_ns"):
                column = freeze_ns(f"{self.KIND}.{one.name}", column, DriveError)
            elif column is LEFT_OUT:
                column = freeze(np.full(expected, np.nan))
            else:
                column = freeze(column, np.int64 if one.name in self.WHOLE else np.float64)
            if column.shape != expected:
                raise DriveError(
                    f"{self.KIND}.{one.name} has shape {column.shape}, expected {expected}"
                )
            object.__setattr__(self, one.name, column)
        back = np.flatnonzero(self.t_ns[1:] < self.t_ns[:-1])  # a difference could overflow
        if len(back):
            row = int(back[0]) + 1
            by_ns = int(self.t_ns[row - 1]) - int(self.t_ns[row])
            raise DriveError(
                f"{self.KIND} row {row}: t_ns goes back by {by_ns} ns; rows must be in time order"
            )

    def __len__(self) -> int:
        return len(self.t_ns)

    def take(self, index: Any) -> Self:
        """The rows that a slice, mask or index array selects, as a table of the same kind."""
        return replace(self, **{f.name: sealed(getattr(self, f.name)[index]) for f in fields(self)})

    def same_as(self, other: object) -> bool:
        """Whether both are of one kind and equal in every bit (NaN equals NaN)."""
        return type(self) is type(other) and all(
            np.array_equal(a := getattr(self, f.name), getattr(other, f.name),
                           equal_nan=a.dtype.kind == "f")
            for f in fields(self)
        )  # fmt: skip


LEFT_OUT: Array = freeze(np.zeros(0))
"""What stands for an optional column that nobody gave: it reads as NaN in every row."""


def check_symmetric(kind: str, cov_m2: Array) -> None:
    """Raise DriveError at the first of finite covariances (N, m, m) that is not symmetric: solvers
    read one triangle alone."""
    told = np.asarray(np.isfinite(cov_m2).all((1, 2)))
    cov = np.where(told[:, None, None], cov_m2, 0.0)
    size = np.diagonal(cov, axis1=1, axis2=2).max(-1, initial=0.0)
    apart = np.abs(cov - cov.swapaxes(1, 2)).max((1, 2), initial=0.0)
    skew = np.flatnonzero(apart > SYMMETRIC * size)
    if len(skew):
        row = int(skew[0])
        raise DriveError(
            f"{kind} row {row}: the covariance {cov[row].tolist()} m^2 is not symmetric; write "
            "each covariance of two axes twice, at both places"
        )


def check_heights(kind: str, up_m: Array, sigma_up_m: Array) -> None:
    """Raise DriveError at the first of heights (N,) that is not told as it should be: finite with a
    sigma above 0, or NaN for both."""
    told = np.isfinite(up_m) & np.isfinite(sigma_up_m) & (sigma_up_m > 0)
    faulty = np.flatnonzero(~told & ~(np.isnan(up_m) & np.isnan(sigma_up_m)))
    if len(faulty):
        row = int(faulty[0])
        raise DriveError(
            f"{kind} row {row}: height {up_m[row]} m with a sigma of {sigma_up_m[row]} m; give a "
            "finite height with a sigma above 0, or NaN for both"
        )


@dataclass(frozen=True, eq=False)
class GnssFixes(Table):
    """Antenna positions: ENU m (N, 3), covariance ENU m^2 (N, 3, 3), velocity ENU m/s (N, 3).

    The velocity is NaN where the receiver gave none.
    """

    p_world_ant_m: Array
    cov_world_m2: Array
    v_world_mps: Array

    KIND = "gnss"
    SHAPES: ClassVar = {"p_world_ant_m": (3,), "cov_world_m2": (3, 3), "v_world_mps": (3,)}

    def __post_init__(self) -> None:
        super().__post_init__()
        check_symmetric(self.KIND, self.cov_world_m2)


@dataclass(frozen=True, eq=False)
class ImuSamples(Table):
    """Specific force m/s^2 (N, 3) and angular rate rad/s (N, 3) in the IMU's own axes.

    An IMU at rest and level, z up, reads about +9.81 m/s^2 on z.
    """

    accel_mps2: Array
    gyro_radps: Array

    KIND = "imu"
    SHAPES: ClassVar = {"accel_mps2": (3,), "gyro_radps": (3,)}


@dataclass(frozen=True, eq=False)
class WheelSpeeds(Table):
    """Speed over ground of the vehicle origin along x, m/s (N,), with its sigma in m/s (N,)."""

    speed_mps: Array
    sigma_mps: Array

    KIND = "wheel"
    SHAPES: ClassVar = {"speed_mps": (), "sigma_mps": ()}


@dataclass(frozen=True, eq=False)
class SteeringAngles(Table):
    """Angle of the steering wheel, rad (N,), positive to the left; the ratio to the road wheels
    is the vehicle's.
    """

    angle_rad: Array

    KIND = "steering"
    SHAPES: ClassVar = {"angle_rad": ()}


@dataclass(frozen=True, eq=False)
class Odometry(Table):
    """Speed over ground along x, m/s (N,), and yaw rate about z, rad/s (N,), of the vehicle origin,
    with their sigmas in m/s and rad/s (N,).
    """

    speed_mps: Array
    yaw_rate_radps: Array
    sigma_speed_mps: Array
    sigma_yaw_rate_radps: Array

    KIND = "odometry"
    SHAPES: ClassVar = dict.fromkeys(
        ("speed_mps", "yaw_rate_radps", "sigma_speed_mps", "sigma_yaw_rate_radps"), ()
    )


@dataclass(frozen=True, eq=False)
class EnuVelocities(Table):
    """Velocity of the vehicle origin, ENU m/s (N, 3), with the sigma of each component (N,).

    What an inertial unit with filters of its own gives out: Lee et al. (2021) predict with it.
    """

    v_world_mps: Array
    sigma_mps: Array

    KIND = "velocity"
    SHAPES: ClassVar = {"v_world_mps": (3,), "sigma_mps": ()}


UNKNOWN, VEHICLE, PEDESTRIAN = 0, 1, 2
"""What a detection can be of."""


@dataclass(frozen=True, eq=False)
class NodeDetections(Table):
    """Objects as roadside nodes see them: the centre of the box around each, seen from above.

    node          (N,) number of the node among the drive's nodes, from 0
    object_id     (N,) the number that the node gave the object, -1 where it gave none
    kind          (N,) `UNKNOWN`, `VEHICLE` or `PEDESTRIAN`
    p_node_m      (N, 2) position along the node's level axes, m from the node
    cov_node_m2   (N, 2, 2) its covariance in these axes, NaN where the node states none
    up_node_m     (N,) height of the box's centre over the node, negative below it, m; NaN where
                  the node tells none
    sigma_up_m    (N,) its standard deviation; it errs apart from the position

    The graph of a car takes heights where they are told; all other methods, association before
    anything is solved and the graph of several road users take the position seen from above alone.
    Raises DriveError where a height comes without a sigma above 0, or a sigma without a height.
    """

    node: NDArray[np.int64]
    object_id: NDArray[np.int64]
    kind: NDArray[np.int64]
    p_node_m: Array
    cov_node_m2: Array
    up_node_m: Array = field(default_factory=lambda: LEFT_OUT)
    sigma_up_m: Array = field(default_factory=lambda: LEFT_OUT)

    KIND = "detections"
    WHOLE = frozenset({"node", "object_id", "kind"})
    OPTIONAL = frozenset({"cov_node_m2", "up_node_m", "sigma_up_m"})
    SHAPES: ClassVar = {
        "node": (), "object_id": (), "kind": (), "p_node_m": (2,), "cov_node_m2": (2, 2),
        "up_node_m": (), "sigma_up_m": (),
    }  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        check_heights(self.KIND, self.up_node_m, self.sigma_up_m)

    @property
    def has_height(self) -> NDArray[np.bool_]:
        """(N,) of which detections the node tells the height."""
        return np.isfinite(self.up_node_m)

    @property
    def place_node_m(self) -> Array:
        """(N, 3) position and height along the node's axes; NaN for a height that is not told."""
        return np.column_stack([self.p_node_m, self.up_node_m])


@dataclass(frozen=True, eq=False)
class RelativeSightings(Table):
    """Objects as the vehicle itself sees them, along its own axes.

    object_id    (N,) the number that the vehicle gave the object; nodes have numbers of their own
    kind         (N,) `UNKNOWN`, `VEHICLE` or `PEDESTRIAN`
    p_veh_m      (N, 2) forward and left of the vehicle origin, m
    cov_veh_m2   (N, 2, 2) its covariance in these axes
    """

    object_id: NDArray[np.int64]
    kind: NDArray[np.int64]
    p_veh_m: Array
    cov_veh_m2: Array

    KIND = "relative"
    WHOLE = frozenset({"object_id", "kind"})
    SHAPES: ClassVar = {"object_id": (), "kind": (), "p_veh_m": (2,), "cov_veh_m2": (2, 2)}


@dataclass(frozen=True, eq=False)
class ObjectTruth(Table):
    """Where other road users really were; no measurement, and no estimator sees it.

    object_id    (N,) number of the road user
    p_world_m    (N, 2) its place, East and North, m
    v_world_mps  (N, 2) its velocity
    """

    object_id: NDArray[np.int64]
    p_world_m: Array
    v_world_mps: Array

    KIND = "objects"
    WHOLE = frozenset({"object_id"})
    SHAPES: ClassVar = {"object_id": (), "p_world_m": (2,), "v_world_mps": (2,)}


@dataclass(frozen=True, eq=False)
class ObjectTracks(Table):
    """What a method says of other road users.

    track_id    (N,) number of the track, from 0 in the order of birth
    user_id     (N,) of the road user that says so itself, in `UserFixes`; -1 where nobody says
    state       (N, 4) East and North in m, velocity East and North in m/s
    cov         (N, 4, 4) its covariance
    """

    track_id: NDArray[np.int64]
    user_id: NDArray[np.int64]
    state: Array
    cov: Array

    KIND = "tracks"
    WHOLE = frozenset({"track_id", "user_id"})
    SHAPES: ClassVar = {"track_id": (), "user_id": (), "state": (4,), "cov": (4, 4)}


@dataclass(frozen=True, eq=False)
class NodePoses(Table):
    """How far a node on a swaying post is from where it was surveyed, as a pose estimator sees it.

    node            (N,) number of the node among the drive's nodes, from 0
    p_node_m        (N, 2) displacement along the node's level axes, m
    tilt_rad        (N, 2) roll and pitch: turns about the same axes; NaN where they are not told
    sigma_p_m       (N, 2) standard deviations of the displacement
    sigma_tilt_rad  (N, 2) and of roll and pitch
    """

    node: NDArray[np.int64]
    p_node_m: Array
    tilt_rad: Array
    sigma_p_m: Array
    sigma_tilt_rad: Array

    KIND = "node_poses"
    WHOLE = frozenset({"node"})
    OPTIONAL = frozenset({"tilt_rad", "sigma_tilt_rad"})
    SHAPES: ClassVar = {
        "node": (), "p_node_m": (2,), "tilt_rad": (2,), "sigma_p_m": (2,), "sigma_tilt_rad": (2,),
    }  # fmt: skip


@dataclass(frozen=True, eq=False)
class UserFixes(Table):
    """Where other road users say that they are, as they broadcast it: the point that nodes see.

    user_id     (N,) number of the road user; nodes have numbers of their own
    p_world_m   (N, 2) its place, East and North, m
    cov_m2      (N, 2, 2) its covariance
    up_m        (N,) height of that point, m; NaN where the user tells none
    sigma_up_m  (N,) its standard deviation; it errs apart from the place

    Raises DriveError where a height comes without a sigma above 0, or a sigma without a height.
    """

    user_id: NDArray[np.int64]
    p_world_m: Array
    cov_m2: Array
    up_m: Array = field(default_factory=lambda: LEFT_OUT)
    sigma_up_m: Array = field(default_factory=lambda: LEFT_OUT)

    KIND = "users"
    WHOLE = frozenset({"user_id"})
    OPTIONAL = frozenset({"up_m", "sigma_up_m"})
    SHAPES: ClassVar = {
        "user_id": (), "p_world_m": (2,), "cov_m2": (2, 2), "up_m": (), "sigma_up_m": (),
    }  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        check_symmetric(self.KIND, self.cov_m2)
        check_heights(self.KIND, self.up_m, self.sigma_up_m)


@dataclass(frozen=True, eq=False)
class SmartCodeSightings(Table):
    """Smart Codes as the vehicle's camera reads them.

    sign        (N,) number of the sign among the drive's signs, from 0
    height_px   (N,) of the code in the image, as its reader states it
    width_px    (N,) likewise
    centre_px   (N, 2) its middle, right and down in px
    corners_px  (N, 4, 2) likewise, clockwise from the upper left corner as the code is printed;
                NaN in all eight where the reader gave none

    Raises DriveError where a row has some numbers of its corners and not all.
    """

    sign: NDArray[np.int64]
    height_px: Array
    width_px: Array
    centre_px: Array
    corners_px: Array

    KIND = "smart_codes"
    WHOLE = frozenset({"sign"})
    OPTIONAL = frozenset({"corners_px"})
    SHAPES: ClassVar = {
        "sign": (), "height_px": (), "width_px": (), "centre_px": (2,), "corners_px": (4, 2),
    }  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        partly = ~self.has_corners & ~np.isnan(self.corners_px).all((1, 2))
        if partly.any():
            row = int(np.argmax(partly))
            raise DriveError(
                f"{self.KIND} row {row}: corners_px = {self.corners_px[row].tolist()}; give all "
                "four corners as finite numbers, or NaN for all"
            )

    @property
    def has_corners(self) -> NDArray[np.bool_]:
        """(N,) of which sightings the reader gave the corners."""
        return np.asarray(np.isfinite(self.corners_px).all((1, 2)))


@dataclass(frozen=True, eq=False)
class Ranges(Table):
    """Distances from the vehicle's tag to surveyed anchors, m (N,), with their sigma in m (N,).

    anchor  (N,) number of the anchor among the drive's anchors, from 0
    """

    anchor: NDArray[np.int64]
    range_m: Array
    sigma_m: Array

    KIND = "ranges"
    WHOLE = frozenset({"anchor"})
    SHAPES: ClassVar = {"anchor": (), "range_m": (), "sigma_m": ()}


TABLES: dict[str, type[Table]] = {
    cls.KIND: cls
    for cls in (
        GnssFixes, ImuSamples, WheelSpeeds, SteeringAngles, Odometry, EnuVelocities, NodeDetections,
        RelativeSightings,
        NodePoses, UserFixes,
        SmartCodeSightings, Ranges,
    )
}  # fmt: skip
"""Every kind of table by its name, which is also the name of its source in a drive."""
