"""Method `raw:node_poses`: what the pose estimators of the posts say, taken as it is.

The yardstick of everything that filters them. Of several poses of one instant the first is taken;
velocities are not told.
"""

import numpy as np

from fgloc.baselines import RAW
from fgloc.drive import Drive
from fgloc.posts import PostStates
from fgloc.result import Result
from fgloc.sway import result
from fgloc.verdicts import Verdict
from fgloc.watches import SOURCE, Watch, watches

METHOD = f"{RAW}{SOURCE}"


def run_raw_poses(drive: Drive) -> Result:
    """The poses as states; DriveError where the drive has none of a node with a post."""
    found, verdicts = watches(drive, METHOD)
    tables = []
    for watch in found:
        rows = np.unique(watch.state, return_index=True)[1]
        later = np.setdiff1d(np.arange(len(watch.rows)), rows)
        reason = "an earlier row has the same t_ns"
        verdicts[SOURCE].set(watch.rows[later], Verdict.DUPLICATE, reason)
        tables.append(_states(watch, watch.told[rows], watch.sigmas[rows]))
    return result(drive, METHOD, tables, verdicts, causal=True, mode="raw")


def _states(watch: Watch, told: np.ndarray, sigmas: np.ndarray) -> PostStates:
    unknown = np.full((len(told), 2), np.nan)
    return PostStates(
        watch.t_ns, watch.t_ns, np.full(len(told), watch.node), told[:, :2], unknown, told[:, 2:],
        sigmas[:, :2], unknown, sigmas[:, 2:],
    )  # fmt: skip
