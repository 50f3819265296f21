"""Calibration sets of roadside cameras as files: a CSV of `u_px,v_px,east_m,north_m[,run]`.

Each row is one moment of a calibration drive: the centre of the car's box in the image, and where
a differential GPS had the car, metres about the drive's origin; `run` numbers the passes.
"""

from pathlib import Path

from fgloc.datasets.columns import Group, Layout
from fgloc.datasets.csv_table import read_csv, write_csv
from fgloc.datasets.trajectory_columns import stack, unstack
from fgloc.errors import DriveError, InputError
from fgloc.perception.idw import Calibration

CENTRE, PLACE = ("u_px", "v_px"), ("east_m", "north_m")
_LAYOUT = Layout((Group.of(*CENTRE), Group.of(*PLACE), Group.of("run", required=False)))


def read_calibration(path: str | Path) -> Calibration:
    """The calibration set in a file.

    Raises DriveError, naming file, line and column, where a cell is no finite number or there
    are too few rows. A centre may occur twice: its places are averaged.
    """
    path = Path(path)
    columns = read_csv(path, _LAYOUT)
    u_px, p_world_m = stack(columns, CENTRE), stack(columns, PLACE)
    try:
        return Calibration(u_px, p_world_m, columns.get("run"))
    except InputError as err:
        raise DriveError(f"{path}: {err}") from err


def write_calibration(calibration: Calibration, path: str | Path) -> None:
    """Write a calibration set so that it reads back exactly."""
    columns = unstack(CENTRE, calibration.u_px) | unstack(PLACE, calibration.p_world_m)
    if calibration.run is not None:
        columns["run"] = calibration.run
    write_csv(Path(path), columns)
