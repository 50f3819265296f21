"""Importer `plaza`: ranges to four radio anchors and odometry of a mower, from the gtsam wheel.

Recorded by Djugash et al. on a plaza in Pittsburgh, two runs. The files are read where gtsam keeps
them; nothing of them is in this package.

* `PlazaN_DR.txt`: time, distance and turn since the row before.
* `PlazaN_TD.txt`: time, sender, receiver, range.
* `PlazaN_.mat`: `TL` the anchors, `GT` the truth, both on the level in m.

Speeds and yaw rates are means over each interval, and stand at its middle. What the ranges' scale
is wrong by is for the estimator to find: nothing here is corrected. The source is 1 or 2.
"""

from pathlib import Path
from typing import Any

import numpy as np

from fgloc.datasets.kitti import example_file
from fgloc.datasets.recording import check_sigma, left_out, number, read_lines
from fgloc.drive import About, Drive, Rig
from fgloc.errors import DriveError, InputError
from fgloc.frames import Origin
from fgloc.infrastructure import Anchor, Infrastructure
from fgloc.measurements import Array, Odometry, Ranges
from fgloc.timing import Instants
from fgloc.trajectory import Trajectory

SIGMA_M = 0.5
"""Of a range beside its scale and bias: the radios' own figure is between half a metre and one."""
SPEED_SIGMA_MPS, YAW_RATE_SIGMA_RADPS = 0.05, 0.01
"""Of a wheel encoder and a fibre-optic gyro, with what the ground does to them."""
ORIGIN = Origin(40.44, -79.95, 280.0)
"""Pittsburgh: good for gravity, not for maps."""
RUNS = ("1", "2")


def import_plaza(source: str | Path, sigma_m: float = SIGMA_M) -> Drive:
    """The drive of run 1 or 2.

    Raises InputError for another run, DriveError where the installed gtsam lacks the files or they
    are not as known.
    """
    check_sigma("sigma_m", sigma_m)
    run = str(source)
    if run not in RUNS:
        raise InputError(f"plaza: run {run!r}: there are {' and '.join(RUNS)}")
    places = example_file(f"Plaza{run}_.mat")
    anchors, truth = _matrix(places, "TL", 3), _matrix(places, "GT", 4)
    odometry = _odometry(example_file(f"Plaza{run}_DR.txt"), truth[0, 0])
    ranges, lost = _ranges(example_file(f"Plaza{run}_TD.txt"), anchors[:, 0], sigma_m)
    level = np.zeros(len(truth))
    told = Trajectory(_instants(truth[:, 0]), np.c_[truth[:, 1:3], level])
    beside = Infrastructure(
        anchors=tuple(Anchor(f"{int(i)}", np.array([x, y, 0.0])) for i, x, y in anchors)
    )
    about = About(
        title=f"Ranges to four radio anchors and odometry of a mower, run {run}",
        licence="as the gtsam wheel has it",
        source=f"Plaza{run} (Djugash et al.), from the gtsam wheel; {left_out(lost)}",
    )
    tables = {"odometry": odometry, "ranges": ranges}
    return Drive("plaza", ORIGIN, Rig(), tables, told, about, beside)


def _matrix(path: Path, name: str, width: int) -> Array:
    from scipy.io import loadmat

    try:
        content: dict[str, Any] = loadmat(path)
    except (OSError, ValueError) as err:
        raise DriveError(f"{path}: not a MATLAB file: {err}") from err
    matrix = np.asarray(content.get(name, np.zeros(0)), float)
    if matrix.ndim != 2 or matrix.shape[1] != width or not np.isfinite(matrix).all():
        raise DriveError(f"{path}: {name} should be finite numbers of shape (N, {width})")
    return matrix


def _table(path: Path, names: tuple[str, ...]) -> Array:
    rows = []
    for i, line in enumerate(read_lines(path), 1):
        cells = line.split()
        if len(cells) != len(names):
            raise DriveError(f"{path}:{i}: {len(cells)} values, expected {len(names)}")
        rows.append([number(f"{path}:{i}", n, cell) for n, cell in zip(names, cells, strict=True)])
    return np.array(rows)


def _instants(t_s: Array) -> Instants:
    return np.rint(t_s * 1e9).astype(np.int64)


def _odometry(path: Path, start_s: float) -> Odometry:
    t_s, along_m, turn_rad = _table(path, ("time", "distance", "turn")).T
    began_s = np.r_[min(start_s, t_s[0] - 0.1), t_s[:-1]]
    dt_s = t_s - began_s
    if (dt_s <= 0).any():
        raise DriveError(f"{path}:{int(np.argmax(dt_s <= 0)) + 1}: time does not increase")
    t_ns = _instants((t_s + began_s) / 2)
    n = len(t_ns)
    return Odometry(t_ns, _instants(t_s), along_m / dt_s, turn_rad / dt_s,
                    np.full(n, SPEED_SIGMA_MPS), np.full(n, YAW_RATE_SIGMA_RADPS))  # fmt: skip


def _ranges(path: Path, anchor_ids: Array, sigma_m: float) -> tuple[Ranges, dict[str, int]]:
    t_s, _, receiver, range_m = _table(path, ("time", "sender", "receiver", "range")).T
    known = np.isin(receiver, anchor_ids) & (range_m > 0)
    which = np.argmax(receiver[known, None] == anchor_ids, axis=1)
    order = np.argsort(t_s[known], kind="stable")
    t_ns = _instants(t_s[known][order])
    ranges = Ranges(t_ns, t_ns, which[order], range_m[known][order], np.full(len(t_ns), sigma_m))
    return ranges, {"ranges of unknown anchors or not above 0": int((~known).sum())}
