"""Method `marr2019-smart-code`: dead reckoning, corrected a little by each Smart Code that is read.

T. S. Marr, "Utilizing the Infrastructure for Ground Truth Based Localization", thesis, Texas A&M
University, 2019, section 4.3.

    x, y         position along the sign's normal, and across it    `p_m` turned by `Reads.R`
    x_m, y_m     position by a read, from `fgloc.factors.smart_code`  `Reads.p_world_m`
    alpha, beta  weights of the prediction along and across          `keep_along`, `keep_across`

The x of (4.9) lies along the sign's normal, not along East. The filter starts from the mean of the
first ten reads.

# Differs from the paper: each of these ten is carried forward to the last one first, as at 30
reads a second and 4.5 m/s their plain mean lies 0.7 m behind (`carry_start` False has that). A read
corrects the state when it comes in, carried forward by as much as it is late. Small signs are left
out, as the thesis advises (`signs` 'all' takes them). The road is taken to be at up = 0.
"""

from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fgloc.baselines.dead_reckoning import DeadReckoning
from fgloc.baselines.planar import summarize
from fgloc.drive import Camera, Drive
from fgloc.errors import DriveError
from fgloc.factors.smart_code import Reading, head_on, locate
from fgloc.measurements import Array, SmartCodeSightings
from fgloc.result import Result
from fgloc.timing import Instants
from fgloc.trajectory import Trajectory
from fgloc.verdicts import SourceVerdicts, Verdict

LARGE_M = 0.3
"""Codes of at least this size count as large: the thesis had 0.56 m and 0.13 m."""


@dataclass(frozen=True)
class Marr2019SmartCode:
    """The printed weights, and the choices that the thesis leaves."""

    keep_along: float = 0.96
    keep_across: float = 0.99
    start_reads: int = 10
    carry_start: bool = True
    signs: Literal["large", "all"] = "large"


MARR2019_SMART_CODE = Marr2019SmartCode()


@dataclass(frozen=True, eq=False)
class Reads:
    """Reads that give a position, in the order of arrival: when true and received (N,), the
    camera's position (N, 2) East and North in m, and the sign's axes (N, 2, 2) in the world."""

    t_ns: Instants
    received_ns: Instants
    p_world_m: Array
    R: Array

    def carried(self, reckoning: DeadReckoning, to_ns: Instants | int) -> Array:
        """Positions (N, 2) carried forward by dead reckoning."""
        return self.p_world_m + reckoning.at(to_ns) - reckoning.at(self.t_ns)


def run(
    drive: Drive, parameters: Marr2019SmartCode = MARR2019_SMART_CODE,
    method: str = "marr2019-smart-code",
) -> Result:  # fmt: skip
    """The filter's estimate of a drive: a state at each velocity and each read from the start on.

    The trajectory is the camera's. Raises DriveError where the drive has no velocities, no camera
    or no sightings, or too few of them give a position for the start.
    """
    verdicts = {
        name: SourceVerdicts.of(name, table, Verdict.UNUSED, f"{method} does not take {name}")
        for name, table in drive.tables.items()
    }
    reckoning = DeadReckoning.of(drive, method)
    camera, seen = _camera(drive), _sightings(drive)
    reads = _reads(drive, camera, seen, parameters, verdicts["smart_codes"])
    t_ns, p_m = track(reads, reckoning, parameters, drive.name)
    reckoning.judge(verdicts["velocity"])
    p_world_m = np.c_[p_m, np.full(len(t_ns), camera.p_veh_cam_m[2])]
    trajectory = Trajectory(t_ns, p_world_m, p_veh_point_m=camera.p_veh_cam_m)
    summary = summarize(drive, method, "filter", trajectory, verdicts)
    return Result(trajectory, verdicts, summary, method, causal=True,
                  config={"marr2019_smart_code": asdict(parameters)})  # fmt: skip


def run_all_signs(drive: Drive) -> Result:
    """The same with small signs."""
    return run(drive, Marr2019SmartCode(signs="all"), "marr2019-smart-code:all-signs")


def run_plain_start(drive: Drive) -> Result:
    """The same from the plain mean of the first ten reads."""
    return run(drive, Marr2019SmartCode(carry_start=False), "marr2019-smart-code:plain-start")


def track(
    reads: Reads, reckoning: DeadReckoning, parameters: Marr2019SmartCode, name: str
) -> tuple[Instants, Array]:
    """Instants (K,) and positions (K, 2) of the filter, from the tenth read on.

    Raises DriveError, of the drive so named, where there are fewer reads.
    """
    n = parameters.start_reads
    if len(reads.t_ns) < n:
        raise DriveError(
            f"drive {name!r}: {len(reads.t_ns)} Smart Codes give a position; the filter starts "
            f"from {n}"
        )
    begin_ns = reads.received_ns[n - 1]
    start_m = reads.carried(reckoning, begin_ns)[:n] if parameters.carry_start else (
        reads.p_world_m[:n] + reckoning.at(begin_ns) - reckoning.at(reads.t_ns[n - 1])
    )  # fmt: skip
    later = reckoning.t_ns[reckoning.t_ns > begin_ns]
    t_ns = np.unique(np.r_[reads.received_ns[n - 1 :], later])
    first = np.searchsorted(reads.received_ns, t_ns, side="left")
    stop = np.searchsorted(reads.received_ns, t_ns, side="right")
    first[0] = stop[0]  # what has come in by then is the start
    return t_ns, _corrected(start_m.mean(0), t_ns, first, stop, reads, reckoning, parameters)


def _corrected(
    start_m: Array, t_ns: Instants, first: NDArray[np.int64], stop: NDArray[np.int64],
    reads: Reads, reckoning: DeadReckoning, parameters: Marr2019SmartCode,
) -> Array:  # fmt: skip
    """Positions (K, 2) at instants (K,), at which reads first[k]:stop[k] come in."""
    keep = np.diag([parameters.keep_along, parameters.keep_across])
    travel_m, read_m = reckoning.at(t_ns), reads.carried(reckoning, reads.received_ns)
    p_m = np.empty((len(t_ns), 2))
    p_m[0] = start_m
    for k in range(1, len(t_ns)):
        p_m[k] = p_m[k - 1] + travel_m[k] - travel_m[k - 1]  # (4.1)
        for i in range(first[k], stop[k]):
            kept = reads.R[i] @ keep @ reads.R[i].T
            p_m[k] = kept @ p_m[k] + (np.eye(2) - kept) @ read_m[i]  # (4.9)
    return p_m


def _reads(
    drive: Drive, camera: Camera, seen: SmartCodeSightings, parameters: Marr2019SmartCode,
    verdicts: SourceVerdicts,
) -> Reads:  # fmt: skip
    """The camera's positions by the sightings that give one; each row gets its verdict."""
    signs = [drive.infrastructure.signs[i] for i in seen.sign]
    size_m = np.array([sign.size_m for sign in signs])
    place_m = np.array([sign.p_world_m for sign in signs])
    R = np.array([sign.R_world_sign for sign in signs])
    left = np.array([sign.side == "left" for sign in signs])
    distances = head_on(seen.height_px, seen.width_px, seen.centre_px, size_m, camera.focal_px,
                        camera.principal_px)  # fmt: skip
    found = locate(distances, place_m[:, 2] - camera.p_veh_cam_m[2], left)
    verdicts.set(slice(None), Verdict.USED)
    for status in (Reading.RANGE_ONLY, Reading.TOO_NEAR):
        verdicts.set(found.status == status, Verdict.UNUSED, status.text)
    if parameters.signs == "large":
        verdicts.set(size_m < LARGE_M, Verdict.UNUSED, "a small sign")
    p_world_m = np.einsum("nij,nj->ni", R, found.p_sign_m) + place_m[:, :2]
    rows = np.flatnonzero(verdicts.is_(Verdict.USED))
    rows = rows[np.argsort(seen.received_ns[rows], kind="stable")]
    return Reads(seen.t_ns[rows], seen.received_ns[rows], p_world_m[rows], R[rows])


def _camera(drive: Drive) -> Camera:
    if drive.rig.camera is None:
        raise DriveError(f"drive {drive.name!r} has no [rig.camera]; Smart Codes need its geometry")
    return drive.rig.camera


def _sightings(drive: Drive) -> SmartCodeSightings:
    table = drive.tables.get("smart_codes")
    if not isinstance(table, SmartCodeSightings) or not len(table):
        raise DriveError(f"drive {drive.name!r} has no smart_codes rows")
    return table
