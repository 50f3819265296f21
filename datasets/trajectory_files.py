"""Trajectories as files: TUM for other tools, CSV with everything, GeoJSON for maps."""

from pathlib import Path
from typing import Any

import numpy as np
import orjson

from fgloc.datasets.columns import Columns
from fgloc.datasets.csv_table import format_rows, read_csv, write_csv
from fgloc.datasets.recording import number
from fgloc.datasets.trajectory_columns import (
    TRAJECTORY,
    check_increasing,
    quaternions_to_matrices,
    trajectory_from_columns,
    trajectory_to_columns,
)
from fgloc.errors import DriveError, InputError
from fgloc.files import read_text
from fgloc.frames import Origin, matrix_to_quat_xyzw
from fgloc.timing import decimal_to_ns, iso_utc, ns_to_decimal
from fgloc.trajectory import Trajectory

_TUM_COLUMNS = ("seconds", "x", "y", "z", "qx", "qy", "qz", "qw")
_DEGREE_DIGITS = 9  # 0.1 mm
_HEIGHT_DIGITS = 4


def read_trajectory(path: str | Path) -> Trajectory:
    """The trajectory in a `.tum`, `.txt` (TUM) or `.csv` file.

    Raises DriveError, naming file, line, field, value and remedy, where it is missing or wrong.
    """
    path = Path(path)
    if path.suffix in (".tum", ".txt"):
        return read_tum(path)
    if path.suffix == ".csv":
        return read_trajectory_csv(path)
    raise DriveError(
        f"{path}: a trajectory file ends in .tum, .txt or .csv, not {path.suffix or 'nothing'!r}"
    )


def write_trajectory_csv(path: str | Path, trajectory: Trajectory) -> None:
    """Write `t_ns`, position, and of quaternion, velocity, covariance and sigmas what there is."""
    write_csv(Path(path), trajectory_to_columns(trajectory))


def read_trajectory_csv(path: str | Path) -> Trajectory:
    """Inverse of `write_trajectory_csv`; raises DriveError where the table is wrong."""
    path = Path(path)
    columns: Columns = read_csv(path, TRAJECTORY)
    return trajectory_from_columns(path, columns)


def write_tum(path: str | Path, trajectory: Trajectory) -> None:
    """Write `seconds x y z qx qy qz qw`, seconds of POSIX time with all nine decimals.

    Where there is no attitude the quaternion is 0 0 0 1, as is usual for this format.
    """
    q = np.tile([0.0, 0.0, 0.0, 1.0], (len(trajectory), 1))
    if trajectory.R_world_veh is not None:
        q = matrix_to_quat_xyzw(trajectory.R_world_veh)
    stamps = [ns_to_decimal(t).encode() for t in trajectory.t_ns.tolist()]
    rows = format_rows(np.concatenate([trajectory.p_world_m, q], -1))
    lines = map(b",".join, zip(stamps, rows, strict=True))
    Path(path).write_bytes(b"\n".join(lines).replace(b",", b" ") + b"\n")


def read_tum(path: str | Path) -> Trajectory:
    """The trajectory of a TUM file; blank lines and those that begin with # are comments.

    Stamps are read to the nanosecond. Raises DriveError where a line is wrong or time does not
    increase.
    """
    path = Path(path)
    lines = _tum_lines(path)
    numbers = [number for number, _ in lines]
    rows = [_tum_row(f"{path}:{number}", text) for number, text in lines]
    t_ns = np.array([t for t, _ in rows], np.int64)
    values = np.array([row for _, row in rows])
    check_increasing(path, t_ns, lines=numbers, stamp=lambda ns: f"seconds = {ns_to_decimal(ns)}")
    R_world_veh = quaternions_to_matrices(path, values[:, 3:], numbers)
    return Trajectory(t_ns, values[:, :3], R_world_veh)


def write_geojson(
    path: str | Path,
    trajectory: Trajectory,
    origin: Origin,
    *,
    name: str = "estimate",
    truth: Trajectory | None = None,
) -> None:
    """Write a FeatureCollection (RFC 7946) with the path as a line, and that of the truth.

    Coordinates are longitude, latitude (deg) and height (m, above the origin's datum). Raises
    InputError for a trajectory without states.
    """
    features = [_feature(name, trajectory, origin)]
    if truth is not None:
        features.append(_feature("truth", truth, origin))
    text = orjson.dumps(
        {"type": "FeatureCollection", "features": features}, option=orjson.OPT_SERIALIZE_NUMPY
    )
    Path(path).write_bytes(text + b"\n")


def _feature(name: str, trajectory: Trajectory, origin: Origin) -> dict[str, Any]:
    if not len(trajectory):
        raise InputError(f"trajectory {name!r} has no states, so there is no line to draw")
    lat, lon, height = origin.to_geodetic(trajectory.p_world_m).T
    lon = (lon + 180) % 360 - 180
    columns = (lon.round(_DEGREE_DIGITS), lat.round(_DEGREE_DIGITS), height.round(_HEIGHT_DIGITS))
    coordinates = np.stack(columns, axis=-1)
    one = len(coordinates) == 1  # a line needs two positions
    return {
        "type": "Feature",
        "properties": {
            "name": name,
            "start": iso_utc(int(trajectory.t_ns[0])),
            "end": iso_utc(int(trajectory.t_ns[-1])),
            "height_datum": origin.datum,
        },
        "geometry": {
            "type": "Point" if one else "LineString",
            "coordinates": coordinates[0] if one else coordinates,
        },
    }


def _tum_lines(path: Path) -> list[tuple[int, str]]:
    """The lines that hold data, with their numbers counted from 1."""
    text = read_text(path)
    stripped = ((number, line.strip()) for number, line in enumerate(text.split("\n"), start=1))
    lines = [(number, line) for number, line in stripped if line and not line.startswith("#")]
    if not lines:
        raise DriveError(f"{path}: the file holds no states; lines of {' '.join(_TUM_COLUMNS)}")
    return lines


def _tum_row(where: str, text: str) -> tuple[int, list[float]]:
    cells = text.split()
    if len(cells) != len(_TUM_COLUMNS):
        hint = "; is it separated by commas? save it as .csv" if "," in text else ""
        raise DriveError(
            f"{where}: {len(cells)} values, expected 8: {' '.join(_TUM_COLUMNS)}{hint}"
        )
    try:
        t_ns = decimal_to_ns(cells[0])
    except ValueError as err:
        raise DriveError(
            f"{where}: seconds = {cells[0]!r} is not a decimal number with at most nine decimals"
        ) from err
    if abs(t_ns) > np.iinfo(np.int64).max:
        raise DriveError(f"{where}: seconds = {cells[0]} is out of range; is it in nanoseconds?")
    return t_ns, [
        number(where, name, cell) for name, cell in zip(_TUM_COLUMNS[1:], cells[1:], strict=True)
    ]
