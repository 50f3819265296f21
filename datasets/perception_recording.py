"""A recording of a node's sensors as a folder, from which `fgloc perceive` makes a drive.

    recording.toml          survey of the node, mounts and intrinsics of its sensors, clock
    NAME/frames.csv         one folder for each sensor: t_ns, file and maybe received_ns
    NAME/000000.png ...     PNG or JPEG of a camera, PCD, PLY or NPZ of a LiDAR, in its own axes
    boxes.csv               boxes that some detector found in the images, if there are any
    objects.csv             where the road users really were, if that is known

Frames are loaded one by one, as they are asked for: a file that is missing or damaged is told then.
"""

import csv
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgloc.datasets.columns import Columns, Group, Layout
from fgloc.datasets.csv_table import read_csv, write_csv
from fgloc.datasets.drive_tables import OBJECTS, objects_from_columns, table_to_columns
from fgloc.datasets.drive_toml import to_about, to_origin
from fgloc.datasets.perception_toml import (
    FILE_NAME,
    RecordingToml,
    SensorPart,
    format_toml,
    read_toml,
    to_perception_node,
)
from fgloc.errors import DriveError, InputError, nearest
from fgloc.files import read_filled
from fgloc.perception.boxes import ImageBoxes
from fgloc.perception.image_files import IMAGE_SUFFIXES, read_image, write_image
from fgloc.perception.point_clouds import CLOUD_SUFFIXES, read_cloud, write_cloud
from fgloc.perception.recording import Frames, Recording
from fgloc.timing import Instants, gps_to_utc_ns, seconds_to_ns, tai_to_utc_ns

FRAMES, BOXES, OBJECTS_FILE = "frames.csv", "boxes.csv", "objects.csv"
IMAGE_SUFFIX = ".jpg"
EDGES = ("x0_px", "y0_px", "x1_px", "y1_px")
BOX_COLUMNS = Layout((Group.of("frame"), Group.of("camera"), Group.of(*EDGES), Group.of("kind"),
                      Group.of("score", required=False)))  # fmt: skip
_FRAME_COLUMNS = ("t_ns", "received_ns", "file")
_CLOCKS: Mapping[str, Callable[[Instants], Instants]] = {
    "utc": lambda t_ns: t_ns, "gps": gps_to_utc_ns, "tai": tai_to_utc_ns,
}  # fmt: skip


def is_recording_folder(folder: str | Path) -> bool:
    """Whether a path is a folder that holds a `recording.toml`."""
    return (Path(folder) / FILE_NAME).is_file()


def read_recording(folder: str | Path) -> Recording:
    """The recording in a folder; its frames stay on disk until they are asked for.

    Raises DriveError, naming file, row, field, value and remedy, where anything is missing,
    unknown or impossible.
    """
    folder = Path(folder)
    if not is_recording_folder(folder):
        raise DriveError(f"{folder}: is not a recording: it has no {FILE_NAME}")
    about = read_toml(folder / FILE_NAME)
    node = to_perception_node(folder / FILE_NAME, about)
    images = tuple(
        _frames(folder, camera, about, IMAGE_SUFFIXES, read_image)
        for head in about.head
        for camera in head.camera
    )
    clouds = tuple(
        _frames(folder, head.lidar, about, CLOUD_SUFFIXES, read_cloud) if head.lidar else None
        for head in about.head
    )
    recording = Recording(
        about.name, to_origin(about.origin), node, images, clouds, about=to_about(about.about)
    )
    return _with_tables(folder, recording)


def _with_tables(folder: Path, recording: Recording) -> Recording:
    """The recording with boxes and truth where the folder has them."""
    path = folder / OBJECTS_FILE
    if path.exists():
        objects = objects_from_columns(path, read_csv(path, OBJECTS))
        recording = replace(recording, objects=objects)
    path = folder / BOXES
    if path.exists():
        try:
            recording = replace(recording, boxes=_boxes(read_csv(path, BOX_COLUMNS)))
        except InputError as err:
            raise err if str(err).startswith(str(path)) else DriveError(f"{path}: {err}") from err
    return recording


def _boxes(columns: Columns) -> ImageBoxes:
    """Boxes in any order of rows; those without a score are sure."""
    edges_px = np.column_stack([columns[name] for name in EDGES])
    score = columns.get("score", np.ones(len(edges_px)))
    return ImageBoxes(columns["frame"], columns["camera"], edges_px, columns["kind"], score)


def _frames(
    folder: Path, sensor: SensorPart, about: RecordingToml, suffixes: tuple[str, ...],
    read: Callable[[Path], NDArray[Any]],
) -> Frames:  # fmt: skip
    """The frames of a sensor on the axis of POSIX time."""
    path = folder / sensor.name / FRAMES
    t_ns, received_ns, files = _frame_rows(path, suffixes)
    ahead_ns = seconds_to_ns(sensor.clock_ahead_s)
    to_utc = _CLOCKS[about.clock]
    try:
        return Frames(
            sensor.name, to_utc(t_ns - ahead_ns), to_utc(received_ns),
            lambda frame: read(path.parent / files[frame]),
        )  # fmt: skip
    except InputError as err:
        raise DriveError(f"{path}: {err}") from err


def _frame_rows(path: Path, suffixes: tuple[str, ...]) -> tuple[Instants, Instants, list[str]]:
    """Stamps and names of the files of a `frames.csv`."""
    text = read_filled(path, "; a line with column names is needed").decode("utf-8-sig", "replace")
    try:
        header, *rows = list(csv.reader(text.splitlines())) or [[]]
    except csv.Error as err:
        raise DriveError(f"{path}: is no CSV file: {err}") from err
    _check_header(path, header)
    if not rows:
        raise DriveError(f"{path}: lists no frames (a header, no rows)")
    stamps: dict[str, list[int]] = {name: [] for name in header if name != "file"}
    files: list[str] = []
    for line, row in enumerate(rows, start=2):
        if len(row) != len(header):
            raise DriveError(f"{path}:{line}: {len(row)} cells where the header names "
                             f"{len(header)} columns")  # fmt: skip
        cells = dict(zip(header, row, strict=True))
        files.append(_file(f"{path}:{line}", cells["file"].strip(), suffixes))
        for name, column in stamps.items():
            column.append(_stamp(f"{path}:{line}", name, cells[name]))
    t_ns = np.array(stamps["t_ns"], np.int64)
    return t_ns, np.array(stamps.get("received_ns", t_ns), np.int64), files


def _check_header(path: Path, header: list[str]) -> None:
    for name in header:
        if name not in _FRAME_COLUMNS:
            raise DriveError(f"{path}:1: unknown column {name!r}; the nearest valid name is "
                             f"{nearest(name, _FRAME_COLUMNS)!r}")  # fmt: skip
    for name in ("t_ns", "file"):
        if header.count(name) != 1:
            raise DriveError(f"{path}:1: column {name!r} is needed once")


def _file(where: str, name: str, suffixes: tuple[str, ...]) -> str:
    """The name of a file beside the list; one that leads elsewhere is refused."""
    within = name.isprintable() and not PurePath(name).is_absolute()
    if not name or not within or ".." in PurePath(name).parts:
        raise DriveError(f"{where}: file = {name!r}: expected the name of a file in this folder")
    if PurePath(name).suffix.lower() not in suffixes:
        raise DriveError(f"{where}: file = {name!r}: expected one of {', '.join(suffixes)}")
    return name


def _stamp(where: str, name: str, cell: str) -> int:
    if not re.fullmatch(r"\s*[+-]?[0-9]{1,19}\s*", cell, re.ASCII) or abs(int(cell)) >= 2**63:
        raise DriveError(f"{where}: {name} = {cell!r} is not a whole number of nanoseconds")
    return int(cell)


def write_recording(
    recording: Recording, folder: str | Path, image_suffix: str = IMAGE_SUFFIX,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> None:  # fmt: skip
    """Write a recording as a new folder: every frame is loaded and written once, clouds as NPZ.

    progress  is told, after each frame, how many of how many are written

    Raises DriveError where the folder holds files already or cannot be written, and what loading a
    frame raises.
    """
    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise DriveError(f"{folder}: is not an empty folder; choose another")
    clouds = [frames for frames in recording.clouds if frames is not None]
    total = sum(map(len, [*recording.images, *clouds]))
    done = 0
    try:
        for frames in (*recording.images, *clouds):
            suffix = ".npz" if frames in clouds else image_suffix
            write = write_cloud if frames in clouds else write_image
            for name, frame in _listed(folder / frames.sensor, frames, suffix):
                write(folder / frames.sensor / name, frames.load(frame))
                progress(done := done + 1, total)
        _write_tables(folder, recording)
        # Last, so that a folder with a recording.toml is a whole recording.
        (folder / FILE_NAME).write_text(format_toml(recording), encoding="utf-8", newline="\n")
    except OSError as err:
        raise DriveError(f"{folder}: cannot be written: {err.strerror}") from err


def _listed(folder: Path, frames: Frames, suffix: str) -> list[tuple[str, int]]:
    """Write the list of a sensor's frames; names of files and numbers of frames."""
    folder.mkdir(parents=True)
    names = [f"{frame:06d}{suffix}" for frame in range(len(frames))]
    rows = zip(frames.t_ns.tolist(), frames.received_ns.tolist(), names, strict=True)
    lines = [",".join(_FRAME_COLUMNS), *(",".join(map(str, row)) for row in rows)]
    (folder / FRAMES).write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
    return list(zip(names, range(len(frames)), strict=True))


def _write_tables(folder: Path, recording: Recording) -> None:
    if recording.objects is not None:
        write_csv(folder / OBJECTS_FILE, table_to_columns(recording.objects))
    if recording.boxes is not None:
        boxes = recording.boxes
        columns = {"frame": boxes.frame, "camera": boxes.camera,
                   **dict(zip(EDGES, boxes.box_px.T, strict=True)),
                   "kind": boxes.kind, "score": boxes.score}  # fmt: skip
        write_csv(folder / BOXES, columns)
