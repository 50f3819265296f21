"""A trajectory as columns of a table: what `trajectory.csv` and a drive's `truth.csv` hold."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fgloc import frames
from fgloc.arrays import Array, sealed
from fgloc.datasets.columns import Columns, Group, Layout, place
from fgloc.errors import DriveError
from fgloc.frames import Origin
from fgloc.timing import Instants
from fgloc.trajectory import Trajectory

ENU = ("east_m", "north_m", "up_m")
GEODETIC = ("lat_deg", "lon_deg", "height_m")
QUATERNION = ("qx", "qy", "qz", "qw")
MATRIX = tuple(f"r{i}{j}" for i in range(3) for j in range(3))
"""Entries of R_world_veh by row and column, counted from 0; quaternions lose the last bit."""
VELOCITY = ("v_east_mps", "v_north_mps", "v_up_mps")
SIGMAS = ("sigma_lateral_m", "sigma_longitudinal_m")

_AXES = ("e", "n", "u", "re", "rn", "ru")
_UPPER = np.triu_indices(6)
_QUATERNION_TOLERANCE = 0.01
_ROTATION_TOLERANCE = 1e-6


def _covariance_name(i: int, j: int) -> str:
    unit = {2: "rad2", 1: "mrad", 0: "m2"}[(i >= 3) + (j >= 3)]
    return f"cov_{_AXES[i]}_{_AXES[j]}_{unit}"


COVARIANCE = tuple(_covariance_name(i, j) for i in range(6) for j in range(i, 6))

_OPTIONAL = (
    Group((QUATERNION, MATRIX), required=False),
    Group.of(*VELOCITY, required=False),
    Group.of(*COVARIANCE, required=False),
)
TRAJECTORY = Layout((Group.of("t_ns"), Group.of(*ENU), *_OPTIONAL), ignored=SIGMAS)
TRUTH = Layout((Group.of("t_ns"), Group((ENU, GEODETIC)), *_OPTIONAL), ignored=SIGMAS)


def stack(columns: Columns, names: tuple[str, ...]) -> Array:
    """The named columns side by side, (N, len(names)), read-only."""
    return sealed(np.stack([columns[name] for name in names], axis=-1))


def unstack(names: tuple[str, ...], array: Array) -> Columns:
    """Inverse of `stack`."""
    return dict(zip(names, array.T, strict=True))


def trajectory_to_columns(trajectory: Trajectory, *, exact_attitude: bool = False) -> Columns:
    """Columns of a trajectory; the attitude as quaternion, or as a matrix where it must be exact.

    Lateral and longitudinal sigmas in m follow where there are a covariance and an attitude.
    """
    columns: Columns = {"t_ns": trajectory.t_ns, **unstack(ENU, trajectory.p_world_m)}
    R = trajectory.R_world_veh
    if R is not None and exact_attitude:
        columns |= unstack(MATRIX, R.reshape(-1, 9))
    elif R is not None:
        columns |= unstack(QUATERNION, frames.matrix_to_quat_xyzw(R))
    if trajectory.v_world_mps is not None:
        columns |= unstack(VELOCITY, trajectory.v_world_mps)
    if trajectory.cov is not None:
        columns |= unstack(COVARIANCE, trajectory.cov[:, *_UPPER])
        if R is not None and not exact_attitude:
            along, across = trajectory.sigma_along_across_m()
            columns |= dict(zip(SIGMAS, (across, along), strict=True))
    return columns


def trajectory_from_columns(
    path: Path, columns: Columns, p_veh_point_m: ArrayLike = (0, 0, 0), origin: Origin | None = None
) -> Trajectory:
    """The trajectory of a table read from `path`; `origin` is needed for geodetic positions.

    Raises DriveError where time does not increase, a quaternion is not one, or a matrix is not a
    rotation.
    """
    check_increasing(path, columns["t_ns"])
    cov = stack(columns, COVARIANCE) if COVARIANCE[0] in columns else None
    return Trajectory(
        columns["t_ns"],
        positions(path, columns, origin),
        _attitude(path, columns),
        stack(columns, VELOCITY) if VELOCITY[0] in columns else None,
        None if cov is None else symmetric(cov, 6),
        np.asarray(p_veh_point_m, float),
    )


def positions(
    path: Path, columns: Columns, origin: Origin | None, lines: Sequence[int] | None = None
) -> Array:
    """ENU positions (N, 3) in m from either way of writing them, checked to be on the Earth."""
    if ENU[0] in columns:
        return stack(columns, ENU)
    check_places(path, columns, lines)
    if origin is None:
        raise DriveError(f"{path}: geodetic positions need [origin] in drive.toml")
    return origin.to_world(*(columns[name] for name in GEODETIC))


def check_places(path: Path, columns: Columns, lines: Sequence[int] | None = None) -> None:
    """Raise DriveError at the first latitude, longitude or height that cannot be.

    `lines` gives the line numbers (N,) where they are not those of a plain table.
    """
    limits = (frames.LATITUDE_LIMITS_DEG, frames.LONGITUDE_LIMITS_DEG, frames.HEIGHT_LIMITS_M)
    hints = {"lat_deg": "; is it swapped with the longitude?", "height_m": "; is it in mm?"}
    for name, (low, high) in zip(GEODETIC, limits, strict=True):
        bad = (columns[name] < low) | (columns[name] > high)
        if bad.any():
            row = int(np.argmax(bad))
            where = _place(path, row, lines)
            raise DriveError(
                f"{where}: {name} = {columns[name][row]} is outside [{low}, {high}]"
                + hints.get(name, "")
            )


def check_increasing(
    path: Path,
    t_ns: Instants,
    *,
    duplicates: bool = False,
    lines: Sequence[int] | None = None,
    stamp: Callable[[int], str] = "t_ns = {}".format,
) -> None:
    """Raise DriveError where `t_ns` goes back, or stays and `duplicates` are not allowed.

    `lines` gives the line numbers (N,) where they are not those of a plain table, and `stamp` an
    instant as it stands in the file.
    """
    back = t_ns[1:] < t_ns[:-1]
    same = t_ns[1:] == t_ns[:-1]
    bad = back if duplicates else back | same
    if not bad.any():
        return
    row = int(np.argmax(bad)) + 1
    where = f"{_place(path, row, lines)}: {stamp(int(t_ns[row]))}"
    if same[row - 1]:
        raise DriveError(f"{where} occurs twice; remove one of the two rows")
    by_ns = int(t_ns[row - 1]) - int(t_ns[row])
    raise DriveError(f"{where} goes back by {by_ns} ns; rows must be in time order: sort them")


def symmetric(upper: Array, size: int) -> Array:
    """Upper triangles (N, size (size + 1) / 2), row by row, as full matrices, read-only."""
    i, j = np.triu_indices(size)
    full = np.empty((len(upper), size, size))
    full[:, i, j] = upper
    full[:, j, i] = upper
    return sealed(full)


def _attitude(path: Path, columns: Columns) -> Array | None:
    if QUATERNION[0] in columns:
        return quaternions_to_matrices(path, stack(columns, QUATERNION))
    if MATRIX[0] not in columns:
        return None
    R = stack(columns, MATRIX).reshape(-1, 3, 3)
    fine = frames.is_rotation(R, _ROTATION_TOLERANCE)
    if not fine.all():
        where = place(path, int(np.argmin(fine)))
        raise DriveError(f"{where}: r00 to r22 are not a rotation matrix; are they transposed?")
    return R


def quaternions_to_matrices(path: Path, q_xyzw: Array, lines: Sequence[int] | None = None) -> Array:
    """Matrices (N, 3, 3) of quaternions (N, 4); DriveError at the first that is not one.

    `lines` gives the line numbers (N,) where they are not those of a plain table.
    """
    norm = np.linalg.norm(q_xyzw, axis=-1)
    bad = np.abs(norm - 1) > _QUATERNION_TOLERANCE
    if bad.any():
        row = int(np.argmax(bad))
        raise DriveError(
            f"{_place(path, row, lines)}: the quaternion qx,qy,qz,qw has norm {norm[row]:.6g}, "
            "expected 1; is a row or an order of columns wrong?"
        )
    return frames.quat_to_matrix(q_xyzw)


def _place(path: Path, row: int, lines: Sequence[int] | None) -> str:
    return place(path, row) if lines is None else f"{path}:{lines[row]}"
