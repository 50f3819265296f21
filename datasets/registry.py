"""Every drive that can be opened by name: real samples, simulated scenarios, importers."""

import importlib
import inspect
import typing
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
        "khamooshi2023/one-node", "scenario", 4.0, ("detections", "gnss", "relative"), "MIT",
        "one node, the ego car at 20 m/s, another at 50 m/s",
    ),
    DatasetInfo(
        "khamooshi2023/two-nodes", "scenario", 2.4, ("detections", "gnss", "relative"), "MIT",
        "two nodes 40 m apart, two cars at 30 m/s",
    ),
    DatasetInfo(
        "khamooshi2023/acceleration", "scenario", 4.0, ("detections", "gnss", "relative"), "MIT",
        "one node; a car at 10 m/s^2 from rest, another braking",
    ),
    DatasetInfo(
        "khamooshi2023/correspondence", "scenario", 4.0, ("detections", "relative"), "MIT",
        "five objects under any heading, one node, no fixes",
    ),
    DatasetInfo(
        "khamooshi2023/intersection", "scenario", 10.0, ("detections", "gnss", "relative"), "MIT",
        "bus, car and pedestrian; the car is hidden for a while",
    ),
    DatasetInfo(
        "khamooshi2023/constant-velocity", "scenario", 4.0, ("detections", "odometry"), "MIT",
        "a car from one node to another; a camera and a LiDAR on each",
    ),
    DatasetInfo(
        "khamooshi2023/right-turn", "scenario", 7.1,
        ("detections", "odometry", "gnss", "velocity"), "MIT",
        "a right turn at 10 m/s past a node; the car has GNSS/INS",
    ),
    DatasetInfo(
        "lee2021/mcity", "scenario", 300.0, ("gnss", "imu", "velocity", "detections"), "MIT",
        "three passes by a roadside node (Lee et al. 2021); options errors, latency_s",
    ),
    DatasetInfo(
        "khamooshi2023/sway-low", "scenario", 60.0, ("node_poses",), "MIT",
        "a node on a post that sways at 0.5 and 1 Hz, poses 10 Hz; options duration_s, wind, "
        "tilt_noise",
    ),
    DatasetInfo(
        "khamooshi2023/sway-high", "scenario", 60.0, ("node_poses",), "MIT",
        "the same under a load at 1, 3 and 10 Hz, faster than the poses can show",
    ),
    DatasetInfo(
        "khamooshi2023/sway-drive", "scenario", 84.0, ("gnss", "imu", "detections", "node_poses"),
        "MIT", "a car passes a node on a swaying post; options duration_s, sensor, gnss_sigma_m, "
        "sways, poses, users",
    ),
    DatasetInfo(
        "marr2019/iea", "scenario", 20.0, ("gnss", "velocity", "detections"), "MIT",
        "two roadside cameras without a model (Marr 2019); options calibration_passes, power",
    ),
    DatasetInfo(
        "marr2019/smart-code", "scenario", 11.1, ("gnss", "velocity", "smart_codes"), "MIT",
        "a camera reads three signs (Marr 2019); options path, camera_yaw_deg, corners, ...",
    ),
    DatasetInfo(
        "comma2k19", "real", 60.0, ("gnss", "imu", "wheel", "steering"), "MIT",
        "car on a motorway: phone IMU 104 Hz, u-blox 10 Hz, CAN; the makers' pose as truth",
    ),
    DatasetInfo(
        "mcity-13", "real", 60.0, ("gnss", "odometry", "velocity", "detections"), "MIT",
        "real roadside detections of two cars, RTK 50 Hz; GPS and odometry simulated from the RTK",
    ),
    DatasetInfo(
        "kitti", "real", 469.6, ("gnss", "imu"), "CC-BY-NC-SA-3.0",
        "KITTI drive 0027 in a town, from the gtsam wheel: IMU 100 Hz, fixes 1 Hz, no truth",
    ),
    DatasetInfo(
        "mems-rtk", "importer", None, ("gnss", "imu"), "the source's",
        "folder with imu.csv and rtk.csv stamped with GPS seconds of the week",
    ),
    DatasetInfo(
        "comma2k19", "importer", None, ("gnss", "imu", "wheel", "steering"), "the source's",
        "one-minute segment of comma2k19, as published",
    ),
    DatasetInfo(
        "kitti", "importer", 469.6, ("gnss", "imu"), "CC-BY-NC-SA-3.0",
        "the KITTI example of the gtsam wheel; takes no source",
    ),
    DatasetInfo(
        "kitti-raw", "importer", None, ("gnss", "imu"), "the source's",
        "KITTI raw folder with oxts/: fixes, IMU, and the device's own pose as truth",
    ),
    DatasetInfo(
        "euroc", "importer", None, ("gnss", "imu"), "the source's",
        "EuRoC folder with imu0/; positions and truth from TUM files (--positions, --truth)",
    ),
    DatasetInfo(
        "rtklib-pos", "importer", None, ("gnss",), "the source's",
        "RTKLIB solution file; IMU from a CSV of ours (--imu, --imu-noise)",
    ),
    DatasetInfo(
        "nmea", "importer", None, ("gnss",), "the source's",
        "NMEA-0183 log with GGA, RMC, GST; IMU from a CSV of ours (--imu, --imu-noise)",
    ),
    DatasetInfo(
        "mcity-roadside", "importer", None, ("gnss", "odometry", "velocity", "detections"),
        "the source's", "roadside node at Mcity (--trial); GPS and odometry simulated from the RTK",
    ),
    DatasetInfo(
        "outdoor-uwb", "importer", None, ("ranges",), "Apache-2.0",
        "one run's folder of the UWB-dataset: ranges to four anchors; truth where it is scored",
    ),
    DatasetInfo(
        "plaza", "importer", None, ("odometry", "ranges"), "as the gtsam wheel",
        "source 1 or 2: ranges to four anchors and odometry of a mower, from the gtsam wheel",
    ),
)  # fmt: skip

_IMPORTERS = {
    "mems-rtk": "mems_rtk.import_mems_rtk",
    "comma2k19": "comma2k19.import_comma2k19",
    "kitti": "kitti.import_kitti",
    "kitti-raw": "kitti_raw.import_kitti_raw",
    "euroc": "euroc.import_euroc",
    "rtklib-pos": "rtklib_pos.import_rtklib_pos",
    "nmea": "nmea.import_nmea",
    "mcity-roadside": "mcity_roadside.import_mcity_roadside",
    "outdoor-uwb": "outdoor_uwb.import_outdoor_uwb",
    "plaza": "plaza.import_plaza",
}
"""Module and function of each format."""

_SCENARIOS = {
    "city": "city.make_city",
    "lee2021/mcity": "lee2021.make_lee2021_mcity",
    "khamooshi2023/constant-velocity": "khamooshi2023_node.make_constant_velocity",
    "khamooshi2023/one-node": "khamooshi2023_cooperative.make_one_node",
    "khamooshi2023/two-nodes": "khamooshi2023_cooperative.make_two_nodes",
    "khamooshi2023/acceleration": "khamooshi2023_cooperative.make_acceleration",
    "khamooshi2023/correspondence": "khamooshi2023_cooperative.make_correspondence",
    "khamooshi2023/intersection": "khamooshi2023_cooperative.make_intersection",
    "khamooshi2023/right-turn": "khamooshi2023_node.make_right_turn",
    "khamooshi2023/sway-low": "khamooshi2023_sway.make_sway_low",
    "khamooshi2023/sway-drive": "khamooshi2023_sway_drive.make_sway_drive",
    "khamooshi2023/sway-high": "khamooshi2023_sway.make_sway_high",
    "marr2019/iea": "marr2019_iea.make_marr2019_iea",
    "marr2019/smart-code": "marr2019_smart_code.make_marr2019_smart_code",
}
"""Module and function of each scenario."""

_WITHOUT_FOLDER = {"kitti"}
"""Real drives that are imported each time they are opened."""

_KINDS: dict[type, tuple[str, tuple[type, ...]]] = {
    float: ("a number", (int, float)),
    int: ("a whole number", (int,)),
    bool: ("true or false", (bool,)),
    str: ("text", (str,)),
    Path: ("a path", (str, Path)),
}
"""For each type that an option may have: its name for people, and what is taken for it."""


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
    if name in _WITHOUT_FOLDER and not asks_for_scenario:
        return import_recording(name)
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


def import_recording(format: str, source: str | Path | None = None, /, **options: Any) -> Drive:
    """A recording in a known format as a drive.

    Raises InputError for an unknown format or option, or where the format wants a source and has
    none, or the other way round.
    """
    if format not in _names("importer"):
        raise InputError(f"no import format named {format!r}; {_nearest(format, 'importer')}")
    function = _importer(format)
    takes_source = "source" in inspect.signature(function).parameters
    if takes_source and source is None:
        raise InputError(f"format {format!r} needs a source: give the path of the recording")
    if not takes_source and source is not None:
        raise InputError(f"format {format!r} takes no source; leave {str(source)!r} out")
    given = {"source": source} if takes_source else {}
    return _call(function, f"format {format!r}", given, options)


def _scenario(name: str) -> Callable[..., Drive]:
    """The function that makes a scenario, imported when it is wanted."""
    return _imported(_SCENARIOS[name])


def _importer(name: str) -> Callable[..., Drive]:
    """The function that imports a format, imported when it is wanted."""
    return _imported(_IMPORTERS[name])


def _imported(place: str) -> Callable[..., Drive]:
    module, _, function = place.partition(".")
    found: Callable[..., Drive] = getattr(
        importlib.import_module(f"fgloc.datasets.{module}"), function
    )
    return found


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
    hints = typing.get_type_hints(function)
    for name, value in options.items():
        if name not in valid:
            raise InputError(f"{what} has no option {name!r}; {_valid_options(name, valid)}")
        _check_type(f"{what}: option {name} = {value!r}", value, hints[name])
    return function(**given, **options)


def _valid_options(name: str, valid: list[str]) -> str:
    if not valid:
        return "it takes none"
    return f"the nearest valid name is {nearest(name, valid)!r} (there are: {', '.join(valid)})"


def _check_type(what: str, value: Any, annotation: Any) -> None:
    """Raise InputError where a value is none of those that the function's annotation names."""
    kinds = [kind for kind in typing.get_args(annotation) or (annotation,) if kind in _KINDS]
    # Of Python's types bool is an int; for people a truth value is no number.
    taken = tuple(kind for one in kinds for kind in _KINDS[one][1])
    if isinstance(value, taken) and (bool in kinds or not isinstance(value, bool)):
        return
    # A path is given as text anyway: what it is for people is the last and widest kind.
    raise InputError(f"{what} is not {_KINDS[kinds[-1]][0]}")


def _names(*kinds: str) -> list[str]:
    return [info.name for info in _INFOS if info.kind in kinds]


def _nearest(name: str, *kinds: str) -> str:
    valid = _names(*kinds)
    return f"the nearest is {nearest(name, valid)!r} (there are: {', '.join(valid)})"
