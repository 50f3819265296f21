"""The graph that suits a drive: that of ranges where nothing else tells positions."""

import time

from fgloc import smoother
from fgloc.config import SmoothConfig
from fgloc.drive import Drive
from fgloc.errors import InputError
from fgloc.result import Result


def smooth(drive: Drive, config: SmoothConfig) -> Result:
    """Estimate the drive's trajectory with the graph, as `config.mode` says.

    A drive with ranges and without fixes takes the planar range graph, which has the modes batch
    and fixed-lag. Raises InputError for another mode there, DriveError where the drive lacks what
    the graph needs, and SolverError where it cannot be solved.
    """
    if "ranges" not in drive.tables or "gnss" in drive.tables:
        return smoother.smooth(drive, config)
    if config.mode == "incremental":
        raise InputError(
            f"drive {drive.name!r} has ranges and no fixes: its graph has the modes batch and "
            "fixed-lag, not incremental"
        )
    from fgloc.smoother.ranges import smooth_ranges

    began = time.perf_counter()
    result = smooth_ranges(drive, config.lag_s if config.mode == "fixed-lag" else None)
    wall_s = time.perf_counter() - began
    realtime = result.summary["duration_s"] / wall_s
    result.summary.update(wall_s=wall_s, realtime_factor=realtime)
    return result
