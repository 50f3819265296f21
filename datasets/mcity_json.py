"""The two JSON files of a trial of the Mcity roadside data: the node's detections and the RTK.

Both are a list of frames `{"timestamp": s, "objs": [{...}]}`. Numbers may stand in quotes. Frames
need not be in order: those of one trial are not.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgloc.datasets.recording import number
from fgloc.errors import DriveError, InputError
from fgloc.files import read_filled
from fgloc.frames import check_geodetic
from fgloc.measurements import PEDESTRIAN, UNKNOWN, VEHICLE, Array
from fgloc.timing import Instants

_KINDS = {"2": VEHICLE, "10": PEDESTRIAN}
_CUT = "-cut"
_MOST_DIGITS = 18  # as many fit into an int64
_LONGEST_S = 1e10  # later than the year 2200 a stamp is not in seconds


@dataclass(frozen=True, eq=False)
class Sightings:
    """Objects (N,) of all frames, in order of time.

    stamp_ns   (N,) stamp of the frame
    place_deg  (N, 2) latitude and longitude
    object_id  (N,) as text
    kind       (N,) as `NodeDetections` has it
    turned     how many frames stood before an earlier one
    """

    stamp_ns: Instants
    place_deg: Array
    object_id: NDArray[np.str_]
    kind: NDArray[np.int64]
    turned: int


def read_sightings(path: Path, *, whole_ids: bool = False) -> Sightings:
    """All objects of a file, whose ids must be whole numbers where this is asked for.

    Raises DriveError that names the file, frame, object and field at fault.
    """
    stamps_s, rows = [], []
    for at, (where, entry) in enumerate(_entries(str(path), "frame", _read(path))):
        stamps_s.append(_stamp(where, entry))
        objects = _entries(where, "object", _field(where, entry, "objs"))
        rows += [(at, *_object(there, one, whole_ids)) for there, one in objects]
    if not rows:
        raise DriveError(f"{path}: no frame holds an object; is it the right file?")
    frames_ns = np.rint(np.array(stamps_s) * 1e9).astype(np.int64)
    frame, lat_deg, lon_deg, object_id, kind = map(np.array, zip(*rows, strict=True))
    stamp_ns, place_deg = frames_ns[frame], np.stack([lat_deg, lon_deg], -1)
    order = np.argsort(stamp_ns, kind="stable")
    turned = int((np.diff(frames_ns) < 0).sum())
    return Sightings(stamp_ns[order], place_deg[order], object_id[order], kind[order], turned)


def vehicle_of(object_id: str) -> str:
    """The vehicle that an id of the RTK means: '0-cut' is vehicle 0 after a lap was cut."""
    return object_id.removesuffix(_CUT)


def _read(path: Path) -> Any:
    try:
        return json.loads(read_filled(path))
    except ValueError as err:  # both of JSON and of UTF-8
        raise DriveError(f"{path}: not valid JSON: {err}; copy the file again") from err


def _entries(where: str, what: str, values: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    """The objects of a list, each with the place for messages."""
    if not isinstance(values, list):
        raise DriveError(f"{where}: expected a list of {what}s, not {type(values).__name__}")
    for index, value in enumerate(values):
        there = f"{where}, {what} {index}" if what == "object" else f"{where}: {what} {index}"
        if not isinstance(value, dict):
            raise DriveError(f"{there} (from 0): expected fields by name, not {value!r}")
        yield f"{there} (from 0)", value


def _field(where: str, entry: dict[str, Any], name: str) -> Any:
    if name not in entry:
        raise DriveError(f"{where}: {name!r} is missing; copy the file again")
    return entry[name]


def _stamp(where: str, frame: dict[str, Any]) -> float:
    stamp_s = number(where, "timestamp", str(_field(where, frame, "timestamp")))
    if not 0 < stamp_s < _LONGEST_S:
        raise DriveError(f"{where}: timestamp = {stamp_s:g}: expected seconds since 1970")
    return stamp_s


def _object(where: str, entry: dict[str, Any], whole_ids: bool) -> tuple[float, float, str, int]:
    lat_deg, lon_deg = (
        number(where, name, str(_field(where, entry, name))) for name in ("lat", "lon")
    )
    try:
        check_geodetic(lat_deg, lon_deg, 0.0)
    except InputError as err:
        raise DriveError(f"{where}: {err}") from err
    object_id = str(_field(where, entry, "id"))
    if whole_ids and not (object_id.isdecimal() and len(object_id) <= _MOST_DIGITS):
        raise DriveError(
            f"{where}: id = {object_id!r} is not a whole number of {_MOST_DIGITS} digits or fewer"
        )
    kind = _KINDS.get(str(_field(where, entry, "classType")), UNKNOWN)
    return lat_deg, lon_deg, object_id, kind
