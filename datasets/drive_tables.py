"""The tables of a drive as columns: layouts, conversions, and the checks made on reading."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgloc.datasets.code_columns import CODES, code_columns
from fgloc.datasets.columns import Columns, Group, Layout, check_known, check_positive, place
from fgloc.datasets.height_columns import (
    HEIGHT,
    SEEN_HEIGHT,
    height_columns,
    heights,
    seen_heights,
)
from fgloc.datasets.post_columns import POSES, pose_columns
from fgloc.datasets.trajectory_columns import (
    ENU,
    GEODETIC,
    VELOCITY,
    check_increasing,
    check_places,
    positions,
    stack,
    symmetric,
    unstack,
)
from fgloc.errors import DriveError
from fgloc.frames import Origin
from fgloc.infrastructure import Infrastructure
from fgloc.measurements import (
    Array,
    EnuVelocities,
    GnssFixes,
    ImuSamples,
    NodeDetections,
    NodePoses,
    ObjectTruth,
    Odometry,
    Ranges,
    RelativeSightings,
    SmartCodeSightings,
    SteeringAngles,
    Table,
    UserFixes,
    WheelSpeeds,
)
from fgloc.timing import Instants

COVARIANCE = ("cov_ee_m2", "cov_en_m2", "cov_eu_m2", "cov_nn_m2", "cov_nu_m2", "cov_uu_m2")
SIGMA = ("sigma_east_m", "sigma_north_m", "sigma_up_m")
ACCEL = ("accel_x_mps2", "accel_y_mps2", "accel_z_mps2")
GYRO = ("gyro_x_radps", "gyro_y_radps", "gyro_z_radps")
RATES = ("speed_mps", "yaw_rate_radps", "sigma_speed_mps", "sigma_yaw_rate_radps")
NAMES = ("node", "object_id", "kind")
SEEN, SEEN_WORLD = ("x_m", "y_m"), ("east_m", "north_m")
RANGE = ("range_m", "sigma_m")
SEEN_COVARIANCE = ("cov_xx_m2", "cov_xy_m2", "cov_yy_m2")
PLANE_VELOCITY = ("v_east_mps", "v_north_mps")
PLANE_COVARIANCE, PLANE_SIGMA = ("cov_ee_m2", "cov_en_m2", "cov_nn_m2"), SIGMA[:2]

_TIME = (Group.of("t_ns"), Group.of("received_ns", required=False))
LAYOUTS = {
    "gnss": Layout(
        (
            *_TIME,
            Group((ENU, GEODETIC)),
            Group((COVARIANCE, SIGMA)),
            Group.of(*VELOCITY, required=False, may_be_empty=True),
        )
    ),
    "imu": Layout((*_TIME, Group.of(*ACCEL), Group.of(*GYRO))),
    "wheel": Layout((*_TIME, Group.of("speed_mps"), Group.of("sigma_mps"))),
    "steering": Layout((*_TIME, Group.of("angle_rad"))),
    "odometry": Layout((*_TIME, Group.of(*RATES))),
    "velocity": Layout((*_TIME, Group.of(*VELOCITY), Group.of("sigma_mps"))),
    "detections": Layout(
        (
            *_TIME,
            Group.of(*NAMES),
            Group((SEEN, SEEN_WORLD)),
            Group.of(*SEEN_COVARIANCE, required=False, may_be_empty=True),
            Group((SEEN_HEIGHT, HEIGHT), required=False, may_be_empty=True),
        )
    ),
    "relative": Layout((*_TIME, Group.of(*NAMES[1:]), Group.of(*SEEN), Group.of(*SEEN_COVARIANCE))),
    "node_poses": POSES,
    "users": Layout(
        (
            *_TIME,
            Group.of("user_id"),
            Group.of(*SEEN_WORLD),
            Group((PLANE_COVARIANCE, PLANE_SIGMA)),
            Group.of(*HEIGHT, required=False, may_be_empty=True),
        )
    ),
    "smart_codes": CODES,
    "ranges": Layout((*_TIME, Group.of("anchor"), Group.of(*RANGE))),
}
"""Columns of each kind of table. `received_ns` left out means: received when it was true."""

OBJECTS = Layout(
    (Group.of("t_ns"), Group.of("object_id"), Group.of(*SEEN_WORLD), Group.of(*PLANE_VELOCITY))
)
"""Columns of `objects`, the truth of other road users."""

_SYMMETRY_TOLERANCE = 1e-9


def table_to_columns(table: Table) -> Columns:
    """The columns of a table, without those that say nothing."""
    columns: Columns = {"t_ns": table.t_ns}
    if not np.array_equal(table.t_ns, table.received_ns):
        columns["received_ns"] = table.received_ns
    if isinstance(table, GnssFixes):
        return columns | _gnss_columns(table)
    if isinstance(table, ImuSamples):
        return columns | unstack(ACCEL, table.accel_mps2) | unstack(GYRO, table.gyro_radps)
    if isinstance(table, WheelSpeeds):
        return columns | {"speed_mps": table.speed_mps, "sigma_mps": table.sigma_mps}
    if isinstance(table, SteeringAngles):
        return columns | {"angle_rad": table.angle_rad}
    if isinstance(table, Odometry):
        return columns | {name: getattr(table, name) for name in RATES}
    if isinstance(table, EnuVelocities):
        return columns | unstack(VELOCITY, table.v_world_mps) | {"sigma_mps": table.sigma_mps}
    if isinstance(table, NodeDetections):
        return columns | _detection_columns(table)
    if isinstance(table, RelativeSightings):
        columns |= {name: getattr(table, name) for name in NAMES[1:]}
        columns |= unstack(SEEN, table.p_veh_m)
        return columns | unstack(SEEN_COVARIANCE, table.cov_veh_m2[:, *np.triu_indices(2)])
    if isinstance(table, ObjectTruth):
        columns |= {"object_id": table.object_id} | unstack(SEEN_WORLD, table.p_world_m)
        return columns | unstack(PLANE_VELOCITY, table.v_world_mps)
    if isinstance(table, NodePoses):
        return columns | pose_columns(table)
    if isinstance(table, UserFixes):
        columns |= {"user_id": table.user_id} | unstack(SEEN_WORLD, table.p_world_m)
        columns |= unstack(PLANE_COVARIANCE, table.cov_m2[:, *np.triu_indices(2)])
        return columns | height_columns(HEIGHT, table.up_m, table.sigma_up_m)
    if isinstance(table, SmartCodeSightings):
        return columns | code_columns(table)
    if isinstance(table, Ranges):
        return columns | {name: getattr(table, name) for name in ("anchor", *RANGE)}
    raise DriveError(f"a drive folder has no file for a table of kind {table.KIND!r}")


def _detection_columns(seen: NodeDetections) -> Columns:
    columns: Columns = {name: getattr(seen, name) for name in NAMES}
    columns |= unstack(SEEN, seen.p_node_m)
    if not np.isnan(seen.cov_node_m2).all():
        columns |= unstack(SEEN_COVARIANCE, seen.cov_node_m2[:, *np.triu_indices(2)])
    return columns | height_columns(SEEN_HEIGHT, seen.up_node_m, seen.sigma_up_m)


def _gnss_columns(fixes: GnssFixes) -> Columns:
    check_covariances(fixes.cov_world_m2, lambda row: f"gnss row {row}")
    columns = unstack(ENU, fixes.p_world_ant_m)
    columns |= unstack(COVARIANCE, fixes.cov_world_m2[:, *np.triu_indices(3)])
    if not np.isnan(fixes.v_world_mps).all():
        columns |= unstack(VELOCITY, fixes.v_world_mps)
    return columns


def gnss_from_columns(path: Path, columns: Columns, origin: Origin) -> GnssFixes:
    """GNSS fixes of a table read from `path`. Raises DriveError naming the first bad row.

    Stamps may repeat: what to do with a duplicate is the estimator's to say.
    """
    check_increasing(path, columns["t_ns"], duplicates=True)
    p_world_ant_m = positions(path, columns, origin)
    cov_world_m2 = _covariance(path, columns)
    check_covariances(cov_world_m2, lambda row: place(path, row))
    return GnssFixes(
        *_times(columns), p_world_ant_m, cov_world_m2, _velocity(path, columns, len(p_world_ant_m))
    )


def origin_from_first_fix(path: Path, columns: Columns) -> Origin:
    """The first fix as the origin of the world frame, for a drive that names none."""
    if GEODETIC[0] not in columns:
        raise DriveError(
            f"{path.parent / 'drive.toml'}: [origin] is missing; positions in {path.name} are "
            "east, north, up of it, so lat_deg, lon_deg and height_m of that point are needed"
        )
    check_places(path, columns)
    lat_deg, lon_deg, height_m = (float(columns[name][0]) for name in GEODETIC)
    return Origin(lat_deg, lon_deg, height_m)


def imu_from_columns(path: Path, columns: Columns) -> ImuSamples:
    """IMU samples of a table read from `path`; DriveError where time does not increase."""
    check_increasing(path, columns["t_ns"])
    return ImuSamples(*_times(columns), stack(columns, ACCEL), stack(columns, GYRO))


def wheel_from_columns(path: Path, columns: Columns) -> WheelSpeeds:
    """Wheel speeds of a table read from `path`; DriveError where time goes back or sigma <= 0."""
    check_increasing(path, columns["t_ns"], duplicates=True)
    check_positive(path, columns, ("sigma_mps",))
    return WheelSpeeds(*_times(columns), columns["speed_mps"], columns["sigma_mps"])


def steering_from_columns(path: Path, columns: Columns) -> SteeringAngles:
    """Steering wheel angles of a table read from `path`; DriveError where time goes back."""
    check_increasing(path, columns["t_ns"], duplicates=True)
    return SteeringAngles(*_times(columns), columns["angle_rad"])


def odometry_from_columns(path: Path, columns: Columns) -> Odometry:
    """Odometry of a table read from `path`; DriveError where time goes back or a sigma <= 0."""
    check_increasing(path, columns["t_ns"], duplicates=True)
    check_positive(path, columns, RATES[2:])
    return Odometry(*_times(columns), *(columns[name] for name in RATES))


def velocity_from_columns(path: Path, columns: Columns) -> EnuVelocities:
    """Velocities of a table read from `path`; DriveError where time goes back or sigma <= 0."""
    check_increasing(path, columns["t_ns"], duplicates=True)
    check_positive(path, columns, ("sigma_mps",))
    return EnuVelocities(*_times(columns), stack(columns, VELOCITY), columns["sigma_mps"])


def detections_from_columns(
    path: Path, columns: Columns, infrastructure: Infrastructure
) -> NodeDetections:
    """Detections of a table read from `path`, in their node's axes.

    Raises DriveError naming the first row of a node that the drive does not have, with a covariance
    that cannot be one, or with a height that has no sigma or is told by a camera.
    """
    check_increasing(path, columns["t_ns"], duplicates=True)
    check_known(path, columns, "node", len(infrastructure.nodes))
    node, object_id, kind = (columns[name] for name in NAMES)
    seen, cov = _seen(columns, infrastructure), _seen_covariance(path, columns)
    up = seen_heights(path, columns, infrastructure)
    return NodeDetections(*_times(columns), node, object_id, kind, seen, cov, *up)


def relative_from_columns(path: Path, columns: Columns) -> RelativeSightings:
    """The vehicle's own sightings of a table read from `path`.

    Raises DriveError naming the first row whose covariance cannot be one.
    """
    check_increasing(path, columns["t_ns"], duplicates=True)
    object_id, kind = (columns[name] for name in NAMES[1:])
    cov = _seen_covariance(path, columns)
    return RelativeSightings(*_times(columns), object_id, kind, stack(columns, SEEN), cov)


def users_from_columns(path: Path, columns: Columns) -> UserFixes:
    """What other road users say of their places, of a table read from `path`.

    Raises DriveError naming the first row whose covariance cannot be one, or whose height has no
    sigma.
    """
    check_increasing(path, columns["t_ns"], duplicates=True)
    if PLANE_COVARIANCE[0] in columns:
        cov = symmetric(stack(columns, PLANE_COVARIANCE), 2)
        remedy = "give what the user states, or remove the row"
        _check_definite(path, cov, np.ones(len(cov), bool), remedy)
    else:
        check_positive(path, columns, PLANE_SIGMA)
        cov = stack(columns, PLANE_SIGMA)[:, :, None] ** 2 * np.eye(2)
    places = stack(columns, SEEN_WORLD), cov
    return UserFixes(*_times(columns), columns["user_id"], *places, *heights(path, columns, HEIGHT))


def objects_from_columns(path: Path, columns: Columns) -> ObjectTruth:
    """Truth of other road users of a table read from `path`; DriveError where time goes back."""
    check_increasing(path, columns["t_ns"], duplicates=True)
    p, v = stack(columns, SEEN_WORLD), stack(columns, PLANE_VELOCITY)
    return ObjectTruth(*_times(columns), columns["object_id"], p, v)


def ranges_from_columns(path: Path, columns: Columns, infrastructure: Infrastructure) -> Ranges:
    """Ranges of a table read from `path`.

    Raises DriveError naming the first row of an anchor that the drive does not have, of a range
    below 0 or of a sigma that is not above 0.
    """
    check_increasing(path, columns["t_ns"], duplicates=True)
    check_known(path, columns, "anchor", len(infrastructure.anchors))
    check_positive(path, columns, RANGE[:1], "a distance")
    check_positive(path, columns, RANGE[1:])
    return Ranges(*_times(columns), columns["anchor"], *(columns[name] for name in RANGE))


def _seen(columns: Columns, infrastructure: Infrastructure) -> Array:
    """(N, 2) in the node's axes, from these or from East and North."""
    if SEEN[0] in columns:
        return stack(columns, SEEN)
    p_m = stack(columns, SEEN_WORLD).copy()
    for i, node in enumerate(infrastructure.nodes):
        rows = columns["node"] == i
        p_m[rows] = node.from_world(p_m[rows])
    return p_m


def _seen_covariance(path: Path, columns: Columns) -> Array:
    """(N, 2, 2), NaN where the node states none."""
    n = len(columns["t_ns"])
    if SEEN_COVARIANCE[0] not in columns:
        return np.full((n, 2, 2), np.nan)
    told = stack(columns, SEEN_COVARIANCE)
    cov = symmetric(told, 2)
    stated = np.asarray(~np.isnan(told).all(-1))
    _check_definite(path, cov, stated, "give what the node states, or leave all of it empty")
    return cov


def _check_definite(path: Path, cov: Array, of: NDArray[np.bool_], remedy: str) -> None:
    """DriveError at the first of some covariances (N, 2, 2) that is not positive definite."""
    fine = (cov[:, 0, 0] > 0) & (cov[:, 0, 0] * cov[:, 1, 1] > cov[:, 0, 1] ** 2)
    bad = of & ~fine
    if bad.any():
        row = int(np.argmax(bad))
        raise DriveError(
            f"{place(path, row)}: the covariance {_as_text(cov[row])} m^2 is not positive definite;"
            f" {remedy}"
        )


def check_covariances(cov_m2: Array, where: Callable[[int], str]) -> None:
    """Raise DriveError at the first of the covariances (N, 3, 3) that cannot be one.

    A covariance is finite, symmetric (to 1e-9 of its diagonal) and positive definite; `where`
    names a row, counted from 0, in the message.
    """
    for fine, fault in _covariance_checks(cov_m2):
        if not fine.all():
            row = int(np.argmin(fine))
            raise DriveError(
                f"{where(row)}: the position covariance {fault}: {_as_text(cov_m2[row])} m^2; "
                "give what the receiver states, or remove the row"
            )


def is_covariance(cov_m2: Array) -> NDArray[np.bool_]:
    """(N,) bool: which of (N, 3, 3) are finite, symmetric and positive definite."""
    return np.logical_and.reduce([fine for fine, _ in _covariance_checks(cov_m2)])


def _covariance_checks(cov_m2: Array) -> list[tuple[NDArray[np.bool_], str]]:
    """For each demand on covariances (N, 3, 3), which rows meet it and what the others are."""
    variance = np.diagonal(cov_m2, axis1=-2, axis2=-1)
    finite = np.asarray(np.isfinite(cov_m2).all((-1, -2)))
    positive = np.asarray((variance > 0).all(-1))
    sigma = np.sqrt(np.where(positive[:, None] & finite[:, None], variance, 1.0))
    correlation = np.where(finite[:, None, None], cov_m2, 0.0) / (
        sigma[:, :, None] * sigma[:, None, :]
    )
    skewness = np.abs(correlation - correlation.swapaxes(-1, -2)).max((-1, -2), initial=0)
    # Leading minors of the correlation matrix: the verdict does not hang on the units.
    definite = (1 - correlation[:, 0, 1] ** 2 > 0) & (np.linalg.det(correlation) > 0)
    return [
        (finite, "is not finite"),
        (positive, "has a zero or negative variance"),
        (np.asarray(skewness <= _SYMMETRY_TOLERANCE), "is not symmetric"),
        (definite, "is not positive definite"),
    ]


def _as_text(matrix: Array) -> str:
    return "[" + ", ".join("[" + ", ".join(f"{x:.6g}" for x in row) + "]" for row in matrix) + "]"


def _covariance(path: Path, columns: Columns) -> Array:
    if COVARIANCE[0] in columns:
        return symmetric(stack(columns, COVARIANCE), 3)
    check_positive(path, columns, SIGMA)
    return stack(columns, SIGMA)[:, :, None] ** 2 * np.eye(3)


def _velocity(path: Path, columns: Columns, n: int) -> Array:
    if VELOCITY[0] not in columns:
        return np.full((n, 3), np.nan)
    velocity = stack(columns, VELOCITY)
    absent = np.isnan(velocity)
    partly = absent.any(-1) & ~absent.all(-1)
    if partly.any():
        row = int(np.argmax(partly))
        name = VELOCITY[int(np.argmax(absent[row]))]
        raise DriveError(
            f"{place(path, row)}: {name} is empty but other parts of the velocity are not; "
            "give all three or none"
        )
    return velocity


def _times(columns: Columns) -> tuple[Instants, Instants]:
    return columns["t_ns"], columns.get("received_ns", columns["t_ns"])
