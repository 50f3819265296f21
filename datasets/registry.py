"""Every drive that can be opened by name: real samples, simulated scenarios, importers."""

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from fgloc.drive import Drive
from fgloc.errors import InputError, nearest

DEFAULT_SEED = 0
"""Seed of a scenario that is opened by name without one."""

_REAL = Path(__file__).parent / "real"


@dataclass(frozen=True)
class DatasetInfo:
    """One line of the list: `duration_s` is None where the source or an option decides."""

    name: str
    kind: Literal["real", "scenario", "importer"]
    duration_s: float | None
    sensors: tuple[str, ...]
    licence: str
    description: str


_INFOS = (
    DatasetInfo(
        "mems-rtk", "real", 542.0, ("gnss", "imu"), "BSD-3-Clause",
        "car with a consumer IMU at 100 Hz and RTK: 1 Hz in, the other 3 Hz as truth",
    ),
    DatasetInfo(
        "city", "scenario", 120.0, ("gnss", "imu", "wheel"), "MIT",
        "plain simulated drive: GNSS 10 Hz, IMU 100 Hz, wheel speed 50 Hz; option duration_s",
    ),
    DatasetInfo(
        "mems-rtk", "importer", None, ("gnss", "imu"), "the source's",
        "folder with imu.csv and rtk.csv stamped with GPS seconds of the week",
    ),
)  # fmt: skip


def available() -> list[DatasetInfo]:
    """All that can be opened, made or imported by name."""
    return list(_INFOS)


def open_drive(name_or_path: str | Path, /, *, seed: int | None = None, **options: Any) -> Drive:
    """The drive in a folder, or the one of a registered name.

    A folder that holds a drive comes before a name of the same spelling, unless a seed is given:
    only scenarios take one, and `DEFAULT_SEED` stands in where it is left out. Raises InputError
    for an unknown name (with the nearest valid one) or option, DriveError for a faulty folder.
    """
    from fgloc.datasets.drive_folder import is_drive_folder

    name = str(name_or_path)
    asks_for_scenario = seed is not None or bool(options)
    if isinstance(name_or_path, Path) or (is_drive_folder(name) and not asks_for_scenario):
        return _open_folder(Path(name_or_path), name, asks_for_scenario)
    if name in _names("scenario"):
        return make(name, DEFAULT_SEED if seed is None else seed, **options)
    if name in _names("real"):
        return _open_folder(_REAL / name, name, asks_for_scenario)
    if Path(name).exists():
        return _open_folder(Path(name), name, asks_for_scenario)
    raise InputError(
        f"no drive named {name!r} and no folder of that path; {_nearest(name, 'real', 'scenario')}"
    )


def make(name: str, /, seed: int = DEFAULT_SEED, **options: Any) -> Drive:
    """A simulated drive; equal seeds and options give equal drives, bit for bit.

    Raises InputError for an unknown scenario or option.
    """
    if name not in _names("scenario"):
        raise InputError(f"no scenario named {name!r}; {_nearest(name, 'scenario')}")
    return _call(_scenario(name), f"scenario {name!r}", {"seed": seed}, options)


def import_recording(format: str, source: str | Path, /, **options: Any) -> Drive:
    """A recording in a known format as a drive; InputError for an unknown format or option."""
    if format not in _names("importer"):
        raise InputError(f"no import format named {format!r}; {_nearest(format, 'importer')}")
    return _call(_importer(format), f"format {format!r}", {"source": source}, options)


def _scenario(name: str) -> Callable[..., Drive]:
    """The function that makes a scenario, imported when it is wanted."""
    from fgloc.datasets.city import make_city

    return {"city": make_city}[name]


def _importer(name: str) -> Callable[..., Drive]:
    """The function that imports a format, imported when it is wanted."""
    from fgloc.datasets.mems_rtk import import_mems_rtk

    return {"mems-rtk": import_mems_rtk}[name]


def _open_folder(folder: Path, name: str, asks_for_scenario: bool) -> Drive:
    from fgloc.datasets.drive_folder import read_drive

    if asks_for_scenario:
        raise InputError(
            f"{name!r} is a recorded drive; a seed and options are for scenarios: leave them out"
        )
    return read_drive(folder)


def _call(
    function: Callable[..., Drive], what: str, given: dict[str, Any], options: dict[str, Any]
) -> Drive:
    """Call with options whose names and types are checked against the function's own."""
    parameters = inspect.signature(function).parameters
    valid = [name for name in parameters if name not in given]
    for name, value in options.items():
        if name not in valid:
            raise InputError(
                f"{what} has no option {name!r}; the nearest valid name is "
                f"{nearest(name, valid)!r} (there are: {', '.join(valid)})"
            )
        _check_number(what, name, value)
    return function(**given, **options)


def _check_number(what: str, name: str, value: Any) -> None:
    """So far every option of every scenario and importer is a number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{what}: option {name} = {value!r} is not a number")


def _names(*kinds: str) -> list[str]:
    return [info.name for info in _INFOS if info.kind in kinds]


def _nearest(name: str, *kinds: str) -> str:
    valid = _names(*kinds)
    return f"the nearest is {nearest(name, valid)!r} (there are: {', '.join(valid)})"
