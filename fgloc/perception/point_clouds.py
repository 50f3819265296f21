"""Point clouds: Open3D, brought in where it is used and nowhere else, and files of points."""

import ctypes
import re
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fgloc.errors import DriveError, InputError
from fgloc.measurements import Array

CLOUD_SUFFIXES = (".npz", ".pcd", ".ply")
POINTS = "points"
"""Name of the array in an NPZ file."""
_DAMAGED = (
    OSError, ValueError, EOFError, NotImplementedError, RuntimeError, zipfile.BadZipFile, zlib.error
)  # fmt: skip
"""What numpy and zipfile raise where bytes of an NPZ file are not what they were."""
_HEADER_BYTES = 4096
_NO_POINTS = re.compile(rb"^(POINTS|element vertex) 0\s*$", re.MULTILINE)


def import_open3d() -> Any:
    """The module `open3d`. Raises InputError with what to install where it does not load.

    It is linked to libusb-1.0, which servers often lack; the copy that `libusb-package` ships is
    loaded before it.
    """
    try:
        import libusb_package

        ctypes.CDLL(str(libusb_package.get_library_path()))
        import open3d
    except ModuleNotFoundError as err:
        raise InputError(
            f"point clouds need {err.name}; install it with: pip install 'fgloc[lidar]'"
        ) from err
    except OSError as err:
        raise InputError(
            f"open3d does not load: {err}; what it is linked to comes with: apt-get install "
            "libusb-1.0-0 libgl1 libgomp1"
        ) from err
    return open3d


def read_cloud(path: Path) -> Array:
    """The points (N, 3) of a file, x, y, z in m as they stand there; N may be 0.

    NPZ holds an array (N, 3 or more), named `points` where there are several; PCD and PLY need
    Open3D. Raises DriveError with the file where it is missing, of another kind or damaged.
    """
    readers = {".npz": _read_npz, ".pcd": _read_open3d, ".ply": _read_open3d}
    if path.suffix.lower() not in readers:
        raise DriveError(f"{path}: a cloud is one of {', '.join(CLOUD_SUFFIXES)}; convert it")
    if not path.is_file():
        raise DriveError(f"{path}: no such file")
    return readers[path.suffix.lower()](path)


def write_cloud(path: Path, points_m: ArrayLike) -> None:
    """Points (N, 3) as NPZ, in single precision: to a hundredth of a millimetre within 150 m."""
    arrays: dict[str, Any] = {POINTS: np.asarray(points_m, np.float32)}
    np.savez_compressed(path, **arrays)


def _read_npz(path: Path) -> Array:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            names = list(arrays)
            points = arrays[POINTS if POINTS in names or len(names) != 1 else names[0]]
    except KeyError as err:
        raise DriveError(
            f"{path}: holds the arrays {', '.join(names) or '(none)'}; name the one of the points "
            f"{POINTS!r}"
        ) from err
    except _DAMAGED as err:
        raise DriveError(f"{path}: is no NPZ file or is damaged: {err}; copy it again") from err
    if points.ndim != 2 or points.shape[1] < 3 or points.dtype.kind not in "fiu":
        raise DriveError(
            f"{path}: an array of shape {points.shape} and type {points.dtype}: expected numbers "
            "(N, 3)"
        )
    return np.asarray(points[:, :3], np.float64)


def _read_open3d(path: Path) -> Array:
    o3d = import_open3d()
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        points = np.array(o3d.io.read_point_cloud(str(path)).points)  # never raises
    if not len(points) and not _NO_POINTS.search(path.read_bytes()[:_HEADER_BYTES]):
        raise DriveError(
            f"{path}: Open3D finds no points in it; is it damaged, or without x, y, z?"
        )
    return points.reshape(-1, 3)
