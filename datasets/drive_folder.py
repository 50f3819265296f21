"""A drive as a folder: `drive.toml` and one CSV or Parquet file per table.

Reading gives back every bit that was written. The attitude of the truth is stored as a matrix
for that reason (columns r00 to r22); quaternions qx,qy,qz,qw are read as well.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fgloc.datasets.code_columns import smart_codes_from_columns
from fgloc.datasets.columns import Columns, Layout
from fgloc.datasets.drive_tables import (
    LAYOUTS,
    OBJECTS,
    detections_from_columns,
    gnss_from_columns,
    imu_from_columns,
    objects_from_columns,
    odometry_from_columns,
    origin_from_first_fix,
    ranges_from_columns,
    relative_from_columns,
    steering_from_columns,
    table_to_columns,
    users_from_columns,
    velocity_from_columns,
    wheel_from_columns,
)
from fgloc.datasets.drive_toml import (
    FILE_NAME,
    DriveToml,
    format_toml,
    read_toml,
    to_about,
    to_infrastructure,
    to_origin,
    to_rig,
)
from fgloc.datasets.parquet_table import read_table, write_table
from fgloc.datasets.post_columns import TRUTH as POST_TRUTH
from fgloc.datasets.post_columns import poses_from_columns, truth_columns, truth_from_columns
from fgloc.datasets.trajectory_columns import TRUTH, trajectory_from_columns, trajectory_to_columns
from fgloc.drive import Drive
from fgloc.errors import DriveError, InputError, nearest
from fgloc.frames import Origin
from fgloc.infrastructure import Infrastructure
from fgloc.measurements import ObjectTruth, Table
from fgloc.parallel import each
from fgloc.posts import PostStates
from fgloc.trajectory import Trajectory

_OTHER_LAYOUTS = {"truth": TRUTH, "objects": OBJECTS, "post_truth": POST_TRUTH}
_STEMS = (*LAYOUTS, *_OTHER_LAYOUTS)
_SUFFIXES = (".csv", ".parquet")


def is_drive_folder(folder: str | Path) -> bool:
    """Whether a path is a folder that holds a `drive.toml`."""
    return (Path(folder) / FILE_NAME).is_file()


def read_drive(folder: str | Path) -> Drive:
    """The drive in a folder.

    Raises DriveError, naming file, row, field, value and remedy, where anything is missing,
    unknown or impossible.
    """
    folder = Path(folder)
    _check_folder(folder)
    about = read_toml(folder / FILE_NAME)
    files = _table_files(folder)
    read = each(lambda stem: read_table(files[stem], _layout(stem)), files)
    columns = dict(zip(files, read, strict=True))
    origin = _origin(folder, about, files, columns)
    infrastructure = to_infrastructure(folder / FILE_NAME, about)
    stems = [stem for stem in LAYOUTS if stem in files]

    def made(stem: str) -> Any:
        if stem == "truth":
            return _truth(folder, about, files, columns, origin)
        return _table(stem, files[stem], columns[stem], origin, infrastructure)

    *tables, truth = each(made, [*stems, "truth"])
    return Drive(
        about.name,
        origin,
        to_rig(folder / FILE_NAME, about.rig),
        dict(zip(stems, tables, strict=True)),
        truth,
        to_about(about.about),
        infrastructure,
        _objects(files, columns),
        _post_truth(files, columns, infrastructure),
    )


def salvage_drive(folder: str | Path) -> tuple[Drive | None, dict[str, InputError]]:
    """What can be read of a faulty folder, and each part that cannot, with its error.

    Parts are tables by their name, and 'drive' for all else. The drive is None where too little is
    left. Raises DriveError where the folder is no drive at all.
    """
    folder = Path(folder)
    _check_folder(folder)
    faults: dict[str, InputError] = {}
    with _kept(faults, "drive"):
        about = read_toml(folder / FILE_NAME)
    files: dict[str, Path] = {}
    with _kept(faults, "drive"):
        files = _table_files(folder)
    columns: dict[str, Columns] = {}
    for stem, path in files.items():
        with _kept(faults, stem):
            columns[stem] = read_table(path, _layout(stem))
    origin_is_known = "drive" not in faults and (about.origin is not None or "gnss" in columns)
    if not origin_is_known:
        return None, faults
    with _kept(faults, "drive"):
        origin = _origin(folder, about, files, columns)
        rig = to_rig(folder / FILE_NAME, about.rig)
        infrastructure = to_infrastructure(folder / FILE_NAME, about)
    if "drive" in faults:
        return None, faults
    tables: dict[str, Table] = {}
    for stem in [stem for stem in LAYOUTS if stem in columns]:
        with _kept(faults, stem):
            tables[stem] = _table(stem, files[stem], columns[stem], origin, infrastructure)
    truth = None
    if "truth" not in faults:
        with _kept(faults, "truth"):
            truth = _truth(folder, about, files, columns, origin)
    objects = post_truth = None
    if "objects" not in faults:
        with _kept(faults, "objects"):
            objects = _objects(files, columns)
    if "post_truth" not in faults:
        with _kept(faults, "post_truth"):
            post_truth = _post_truth(files, columns, infrastructure)
    drive = Drive(
        about.name,
        origin,
        rig,
        tables,
        truth,
        to_about(about.about),
        infrastructure,
        objects,
        post_truth,
    )
    return (drive if tables else None), faults


@contextmanager
def _kept(faults: dict[str, InputError], part: str) -> Iterator[None]:
    """Keep the error of a part, the first if there are several, and go on."""
    try:
        yield
    except InputError as err:
        faults.setdefault(part, err)


def write_drive(
    drive: Drive, folder: str | Path, parquet: bool = False, overwrite: bool = False
) -> None:
    """Write a drive as a folder, with CSV tables unless `parquet`.

    An existing drive folder is replaced only where `overwrite` says so; files that are not a
    drive's stay. Raises DriveError rather than write among foreign files, and where a table
    could not be read back.
    """
    folder = Path(folder)
    suffix = ".parquet" if parquet else ".csv"
    contents = _contents(drive)
    check_free(folder, overwrite)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _remove_drive(folder)
        for stem, columns in contents.items():
            write_table(folder / f"{stem}{suffix}", columns)
        # Last, so that a folder with a drive.toml is a whole drive.
        (folder / FILE_NAME).write_text(format_toml(drive), encoding="utf-8", newline="\n")
    except OSError as err:
        raise DriveError(f"{folder}: cannot be written: {err.strerror}") from err


def _contents(drive: Drive) -> dict[str, Columns]:
    """Columns of every table by the stem of its file, checked before anything is written."""
    contents = {}
    for name, table in drive.tables.items():
        if name != table.KIND:
            raise DriveError(
                f"a drive folder has no file for source {name!r}; known: {', '.join(LAYOUTS)}"
            )
        if not len(table):
            raise DriveError(f"drive {drive.name!r}: table {name} has no rows; leave it out")
        contents[name] = table_to_columns(table)
    if drive.objects is not None:
        contents["objects"] = table_to_columns(drive.objects)
    if drive.truth is not None:
        contents["truth"] = trajectory_to_columns(drive.truth, exact_attitude=True)
    if drive.post_truth is not None:
        contents["post_truth"] = truth_columns(drive.post_truth)
    return contents


def check_free(folder: Path, overwrite: bool) -> None:
    """Raise DriveError where no drive can or should be written: a file, foreign files, a drive
    that is not to be replaced."""
    if folder.exists() and not folder.is_dir():
        raise DriveError(f"{folder}: is a file; a drive is a folder")
    if not folder.exists() or not any(folder.iterdir()):
        return
    if not is_drive_folder(folder):
        raise DriveError(f"{folder}: holds other files and no drive; choose a new or empty folder")
    if not overwrite:
        raise DriveError(f"{folder}: holds a drive already; choose another folder or overwrite it")


def _remove_drive(folder: Path) -> None:
    """Take away the files of a drive, so that no table of the old one joins the new one."""
    for name in [FILE_NAME, *(stem + suffix for stem in _STEMS for suffix in _SUFFIXES)]:
        (folder / name).unlink(missing_ok=True)


def _check_folder(folder: Path) -> None:
    if not folder.exists():
        raise DriveError(f"{folder}: no such folder")
    if not folder.is_dir():
        raise DriveError(f"{folder}: is a file; a drive is a folder with a {FILE_NAME}")
    if not is_drive_folder(folder):
        raise DriveError(f"{folder}: is not a drive folder: it has no {FILE_NAME}")


def _table_files(folder: Path) -> dict[str, Path]:
    """The tables' files by stem; DriveError for a file that is no table, or is there twice."""
    files: dict[str, Path] = {}
    for path in sorted(p for p in folder.iterdir() if p.suffix.lower() in _SUFFIXES):
        if path.stem not in _STEMS or path.suffix not in _SUFFIXES:
            raise DriveError(
                f"{path}: is not a table that a drive has; the nearest valid name is "
                f"'{nearest(path.stem, _STEMS)}{path.suffix.lower()}'; "
                "rename it or move it out of the folder"
            )
        if path.stem in files:
            raise DriveError(
                f"{folder}: has both {files[path.stem].name} and {path.name}; keep one"
            )
        files[path.stem] = path
    if not set(files) & set(LAYOUTS):
        raise DriveError(
            f"{folder}: has none of the tables {', '.join(f'{s}.csv' for s in LAYOUTS)}"
        )
    return files


def _layout(stem: str) -> Layout:
    return {**LAYOUTS, **_OTHER_LAYOUTS}[stem]


def _origin(
    folder: Path, about: DriveToml, files: dict[str, Path], columns: dict[str, Columns]
) -> Origin:
    if about.origin is not None:
        return to_origin(about.origin)
    if "gnss" not in columns:
        raise DriveError(f"{folder / FILE_NAME}: [origin] is missing; without gnss it is needed")
    return origin_from_first_fix(files["gnss"], columns["gnss"])


def _table(
    stem: str, path: Path, columns: Columns, origin: Origin, infrastructure: Infrastructure
) -> Table:
    if stem == "gnss":
        return gnss_from_columns(path, columns, origin)
    roadside = {
        "detections": detections_from_columns, "node_poses": poses_from_columns,
        "smart_codes": smart_codes_from_columns, "ranges": ranges_from_columns,
    }  # fmt: skip
    if stem in roadside:
        return roadside[stem](path, columns, infrastructure)
    readers = {
        "imu": imu_from_columns, "wheel": wheel_from_columns, "steering": steering_from_columns,
        "odometry": odometry_from_columns, "velocity": velocity_from_columns,
        "relative": relative_from_columns, "users": users_from_columns,
    }  # fmt: skip
    return readers[stem](path, columns)


def _objects(files: dict[str, Path], columns: dict[str, Columns]) -> ObjectTruth | None:
    if "objects" not in files:
        return None
    return objects_from_columns(files["objects"], columns["objects"])


def _truth(
    folder: Path,
    about: DriveToml,
    files: dict[str, Path],
    columns: dict[str, Columns],
    origin: Origin,
) -> Trajectory | None:
    if "truth" not in files:
        if about.truth is not None:
            raise DriveError(
                f"{folder / FILE_NAME}: has [truth], but there is no truth.csv or truth.parquet"
            )
        return None
    point = about.truth.p_veh_point_m if about.truth else (0, 0, 0)
    return trajectory_from_columns(files["truth"], columns["truth"], point, origin)


def _post_truth(
    files: dict[str, Path], columns: dict[str, Columns], infrastructure: Infrastructure
) -> PostStates | None:
    if "post_truth" not in files:
        return None
    return truth_from_columns(files["post_truth"], columns["post_truth"], infrastructure)
