"""Open3D, brought in where a point cloud is matched and nowhere else."""

import ctypes
from typing import Any

from fgloc.errors import InputError


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
            f"matching point clouds needs {err.name}; install it with: pip install 'fgloc[lidar]'"
        ) from err
    except OSError as err:
        raise InputError(
            f"open3d does not load: {err}; what it is linked to comes with: apt-get install "
            "libusb-1.0-0 libgl1 libgomp1"
        ) from err
    return open3d
