"""The graph that suits a drive: a planar one where ranges or Smart Codes are what it has."""

import time
from collections.abc import Callable

from fgloc import smoother
from fgloc.config import SmoothConfig
from fgloc.drive import Drive
from fgloc.errors import InputError
from fgloc.result import Result


def smooth(drive: Drive, config: SmoothConfig) -> Result:
    """Estimate the drive's trajectory with the graph, as `config.mode` says.

    A drive with ranges and without fixes takes the planar range graph, one with Smart Codes and
    without an IMU that of codes; both have the modes batch and fixed-lag. Raises InputError for
    another mode there, DriveError where the drive lacks what the graph needs, and SolverError where
    it cannot be solved.
    """
    planar = _planar(drive)
    if planar is None:
        return smoother.smooth(drive, config)
    if config.mode == "incremental":
        raise InputError(
            f"drive {drive.name!r} takes a planar graph, which has the modes batch and fixed-lag, "
            "not incremental"
        )
    began = time.perf_counter()
    result = planar(drive, config.lag_s if config.mode == "fixed-lag" else None)
    wall_s = time.perf_counter() - began
    realtime = result.summary["duration_s"] / wall_s
    result.summary.update(wall_s=wall_s, realtime_factor=realtime)
    return result


def _planar(drive: Drive) -> Callable[[Drive, float | None], Result] | None:
    """The planar graph that a drive takes, if it does."""
    if "ranges" in drive.tables and "gnss" not in drive.tables:
        from fgloc.smoother.ranges import smooth_ranges

        return smooth_ranges
    if "smart_codes" in drive.tables and "imu" not in drive.tables:
        from fgloc.smoother.codes import smooth_codes

        return smooth_codes
    return None
