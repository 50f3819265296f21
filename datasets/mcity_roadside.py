"""Importer `mcity-roadside`: a real roadside node at Mcity and the RTK of the cars that pass it.

The source folder is as published with R. Zhang et al., "Evaluating roadside perception for
autonomous vehicles: insights from field testing" (arXiv 2401.12392): `dets/detection_K.json`, what
a node says at 10 Hz, and `gts/gps_data_K.json` (or `..._K_c.json`), RTK of one or two cars at
50 Hz. The drive gets

* detections: every object of every frame, real. Positions are the file's latitudes and longitudes;
  the file's own x and y are a mirrored plane (y to the South) and are not read;
* gnss, and with `odometry` also odometry and velocity: made from the RTK of the vehicle with
  stated noise, and thus simulated;
* users, with `others`: fixes of the other vehicle, made likewise from its RTK, as if it broadcast
  them; and objects: the rows of it that no fix was made from, as its truth;
* truth: the RTK rows of the vehicle that no fix was made from.

Ids such as '0-cut' are vehicle 0 after the authors cut the lap of the trial in two: its rows follow
on those of '0' without a gap, so both are one vehicle.

Stamps of detections are late by `LATENCY_S`: they are true that much earlier and are received at
the stamp. Heights are unknown: all is at 0, and the origin's height is about that of the place.

The vehicle frame's origin is the RTK antenna and its x axis the course, see `rtk_simulation.py`.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgloc.datasets.mcity_json import Sightings, read_sightings, vehicle_of
from fgloc.datasets.recording import check_sigma, left_out
from fgloc.datasets.rtk_simulation import (
    Ride,
    change_rate,
    dead_reckoned,
    every,
    ride,
    simulated_gps,
    simulated_odometry,
)
from fgloc.drive import About, Drive, GnssBias, Rig
from fgloc.errors import DriveError, InputError
from fgloc.frames import Origin
from fgloc.infrastructure import Infrastructure, Node
from fgloc.measurements import Array, NodeDetections, ObjectTruth, Table, UserFixes
from fgloc.timing import Instants, elapsed_s, seconds_to_ns

ORIGIN = Origin(42.300947, -83.698649, 240.0)
"""Centre of the authors' local plane (`config.yaml`); the height is rough."""
NODE_EN_M, NODE_YAW_RAD = (12.328, -13.052), -0.0139
"""Where x and y of the files are zero, and the direction of their x axis: fitted to the files."""

LATENCY_S = 0.15
NODE_RANGE_M = 60.0
NODE_WHITE_M, NODE_BIAS_SIGMA_M, NODE_BIAS_TAU_S = 0.1, 0.32, 5.0
P_VEH_BOX_M = (0.0, 0.0, 0.0)
"""Measured on trial 2 alone (`tests/benchmarks/mcity_trial2.py`) and used for all.

Latency is 0.150 s. The box's centre is 0.06 m ahead of the antenna and 0.03 m to the left, which is
not told from 0. From 60 m on errors are metres, where the node begins to see a car. Nearer they are
0.32 m rms on each axis and forget themselves over 4.7 s, which has in it what the node's survey is
off by. White noise is 0.06 m; a frame's stamp jitters by 0.01 s, which is as much again.
"""

GPS_HZ, GPS_SIGMA_M, GPS_BIAS_SIGMA_M, GPS_BIAS_TAU_S = 10.0, 0.5, 1.3, 60.0
RTK_HZ = 50.0
FASTEST_MPS = 40.0
"""A longer step between rows of the RTK is no motion of a car."""

_FEWEST = 3
Columns = tuple[NDArray[Any], ...]


def import_mcity_roadside(
    source: str | Path,
    *,
    trial: int | None = None,
    vehicle: int = 0,
    gps_rate_hz: float = GPS_HZ,
    gps_sigma_m: float = GPS_SIGMA_M,
    gps_bias_sigma_m: float = GPS_BIAS_SIGMA_M,
    gps_bias_tau_s: float = GPS_BIAS_TAU_S,
    odometry: bool = False,
    others: bool = False,
    seed: int = 0,
) -> Drive:
    """One trial as the drive of one of its vehicles; the seed is that of the simulated sensors.

    A bias sigma of 0 is no bias. Raises DriveError where a file is missing or wrong, InputError
    where there is no such trial or vehicle or an option makes no sense.
    """
    bias = _checked_bias(gps_rate_hz, gps_sigma_m, gps_bias_sigma_m, gps_bias_tau_s)
    detections_path, rtk_path = _paths(Path(source), trial)
    rtk, seen = read_sightings(rtk_path), read_sightings(detections_path, whole_ids=True)
    t_ns, p_world_m = _rows_of(rtk_path, rtk, vehicle)
    car = ride(f"{rtk_path}: vehicle {vehicle}", t_ns, p_world_m)
    at_fix = every(car.t_ns, gps_rate_hz)
    tables: dict[str, Table] = {
        "gnss": simulated_gps(t_ns[at_fix], p_world_m[at_fix], gps_sigma_m, bias, seed)
    }
    if odometry:
        tables["odometry"] = told = simulated_odometry(car, seed)
        tables["velocity"] = dead_reckoned(told, float(car.course_rad[0]))
    objects, leaps = None, _leaps(t_ns, p_world_m)
    if others:
        users, objects = _others(rtk_path, rtk, vehicle, gps_rate_hz, gps_sigma_m, bias, seed)
        tables["users"] = users
        leaps += sum(_leaps(*_rows_of(rtk_path, rtk, int(one))) for one in np.unique(users.user_id))
    tables["detections"], outside = _detections(detections_path, seen, car)
    account = left_out(
        {
            "detections outside the time of the RTK": outside,
            "rows of other vehicles in the RTK": 0 if others else len(rtk.stamp_ns) - len(t_ns),
        }
    )
    account += (
        f"; frames sorted into place ({seen.turned + rtk.turned}); steps of the RTK above "
        f"{FASTEST_MPS:g} m/s, kept ({leaps})"
    )
    rig = Rig(p_veh_box_m=np.array(P_VEH_BOX_M), gnss_bias=bias, user_bias=bias if others else None)
    about = _about(f"trial {trial}, vehicle {vehicle}", f"seed {seed}", account)
    nodes = Infrastructure((mcity_node(),))
    return Drive(f"mcity-{trial}", ORIGIN, rig, tables, car.truth(~at_fix), about, nodes, objects)


def mcity_node() -> Node:
    """The node, its axes level and right-handed: x as the files have it, y to about North."""
    return Node(
        "mcity", np.array([*NODE_EN_M, 0.0]), NODE_YAW_RAD, range_m=NODE_RANGE_M,
        bias_sigma_m=NODE_BIAS_SIGMA_M, bias_tau_s=NODE_BIAS_TAU_S,
    )  # fmt: skip


def _checked_bias(
    gps_rate_hz: float, gps_sigma_m: float, gps_bias_sigma_m: float, gps_bias_tau_s: float
) -> GnssBias | None:
    """The bias of the GPS that is asked for; InputError where an option makes no sense."""
    if not 0 < gps_rate_hz <= RTK_HZ / 2:
        raise InputError(
            f"gps_rate_hz = {gps_rate_hz}: expected above 0 to {RTK_HZ / 2:g} Hz, so that at least "
            "every other row of the RTK stays truth"
        )
    check_sigma("gps_sigma_m", gps_sigma_m)
    if not (math.isfinite(gps_bias_sigma_m) and gps_bias_sigma_m >= 0):
        raise InputError(f"gps_bias_sigma_m = {gps_bias_sigma_m}: expected metres, 0 or more")
    if not (math.isfinite(gps_bias_tau_s) and gps_bias_tau_s > 0):
        raise InputError(f"gps_bias_tau_s = {gps_bias_tau_s}: expected seconds above 0")
    return GnssBias(gps_bias_sigma_m, gps_bias_tau_s) if gps_bias_sigma_m > 0 else None


def _paths(source: Path, trial: int | None) -> tuple[Path, Path]:
    """The files of detections and RTK of a trial; InputError that lists what trials there are."""
    there = sorted(
        int(path.stem.removeprefix("detection_"))
        for path in source.glob("dets/detection_*.json")
        if path.stem.removeprefix("detection_").isdecimal()
    )
    if not there:
        raise DriveError(f"{source}: holds no dets/detection_K.json; give the folder above dets")
    trials = ", ".join(map(str, there))
    if trial is None:
        raise InputError(f"format 'mcity-roadside' needs trial, one of {trials}: give --trial K")
    if trial not in there:
        raise InputError(f"{source}: has no dets/detection_{trial}.json (trials: {trials})")
    names = [f"gps_data_{trial}.json", f"gps_data_{trial}_c.json"]
    for name in names:
        if (source / "gts" / name).exists():
            return source / "dets" / f"detection_{trial}.json", source / "gts" / name
    raise DriveError(
        f"{source / 'gts'}: has neither {' nor '.join(names)}; copy the RTK of the trial"
    )


def _rows_of(path: Path, rtk: Sightings, vehicle: int) -> tuple[Instants, Array]:
    """Instants (N,) and places (N, 3) of one vehicle; of rows with one stamp the first."""
    ids = np.array([vehicle_of(one) for one in rtk.object_id])
    own = np.flatnonzero(ids == str(vehicle))
    if not len(own):
        raise InputError(
            f"{path}: has no vehicle {vehicle} (there are: {', '.join(np.unique(ids))})"
        )
    own = own[np.diff(rtk.stamp_ns[own], prepend=0) > 0]
    if len(own) < _FEWEST:
        raise DriveError(
            f"{path}: {len(own)} rows of vehicle {vehicle}; at least {_FEWEST} are needed"
        )
    return rtk.stamp_ns[own], _to_plane(rtk.place_deg[own])


def _others(
    path: Path, rtk: Sightings, vehicle: int, rate_hz: float, sigma_m: float,
    bias: GnssBias | None, seed: int,
) -> tuple[UserFixes, ObjectTruth]:  # fmt: skip
    """What the other vehicles say of their places, and where they were at all other rows."""
    names = sorted({vehicle_of(one) for one in rtk.object_id} - {str(vehicle)})
    if not names or not all(name.isdecimal() for name in names):
        raise InputError(
            f"{path}: others asks for vehicles beside {vehicle} with whole numbers "
            f"(there are: {', '.join(names) or 'none'}); leave it out"
        )
    fixes: list[Columns] = []
    truths: list[Columns] = []
    for number in map(int, names):
        t_ns, p_world_m = _rows_of(path, rtk, number)
        at_fix = every(t_ns, rate_hz)
        fix = simulated_gps(
            t_ns[at_fix], p_world_m[at_fix], sigma_m, bias, seed, f"rtk/vehicle {number}"
        )
        who, p_m = np.full(len(t_ns), number), p_world_m[:, :2]
        fixes.append((fix.t_ns, fix.received_ns, who[at_fix], fix.p_world_ant_m[:, :2],
                      fix.cov_world_m2[:, :2, :2]))  # fmt: skip
        columns = (t_ns, t_ns, who, p_m, change_rate(t_ns, p_m))
        truths.append(tuple(column[~at_fix] for column in columns))
    return UserFixes(*_by_time(fixes)), ObjectTruth(*_by_time(truths))


def _by_time(parts: list[Columns]) -> list[NDArray[Any]]:
    """The columns of several vehicles as those of one table, the instants first."""
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    order = np.argsort(columns[0], kind="stable")
    return [column[order] for column in columns]


def _to_plane(place_deg: Array) -> Array:
    """(N, 3) ENU m at height 0, of latitudes and longitudes (N, 2)."""
    p_world_m = ORIGIN.to_world(place_deg[:, 0], place_deg[:, 1], ORIGIN.height_m)
    p_world_m[:, 2] = 0.0
    return p_world_m


def _detections(path: Path, seen: Sightings, car: Ride) -> tuple[NodeDetections, int]:
    """What the node saw while the car was known, and how many detections fall outside."""
    t_ns = seen.stamp_ns - seconds_to_ns(LATENCY_S)
    inside = (t_ns >= car.t_ns[0]) & (t_ns <= car.t_ns[-1])
    if not inside.any():
        raise DriveError(f"{path}: no frame falls into the time of the RTK; are both of one trial?")
    object_id = seen.object_id[inside].astype(np.int64)
    p_node_m = mcity_node().from_world(_to_plane(seen.place_deg[inside])[:, :2])
    n = len(p_node_m)
    cov_m2 = np.tile(NODE_WHITE_M**2 * np.eye(2), (n, 1, 1))
    table = NodeDetections(
        t_ns[inside], seen.stamp_ns[inside], np.zeros(n, np.int64), object_id, seen.kind[inside],
        p_node_m, cov_m2,
    )  # fmt: skip
    return table, int((~inside).sum())


def _leaps(t_ns: Instants, p_world_m: Array) -> int:
    """Steps between rows that no car takes: there the RTK was lost for a moment."""
    step_m = np.linalg.norm(np.diff(p_world_m, axis=0), axis=1)
    return int((step_m > FASTEST_MPS * np.diff(elapsed_s(t_ns, int(t_ns[0])))).sum())


def _about(what: str, simulated: str, account: str) -> About:
    return About(
        title=(
            f"Roadside node at Mcity, {what}: real detections and RTK; GPS and odometry simulated "
            "from the RTK"
        ),
        licence="MIT",
        source=(
            "GitHub michigan-traffic-lab/perception_evaluation, example_data/data-1; gnss, "
            f"odometry and velocity are simulated from the RTK ({simulated}), detections and "
            f"truth are real; {account}"
        ),
    )
