"""The epochs of the error-state filter: the graph's where there is an IMU, else those of the
velocities, always with one at every fix and every frame of a node."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc.baselines.eskf_motion import Inertial, Motion, Planar
from fgloc.baselines.eskf_readings import detection_instants
from fgloc.baselines.eskf_state import Slow
from fgloc.config import SmoothConfig
from fgloc.drive import Drive
from fgloc.errors import DriveError
from fgloc.measurements import Array, EnuVelocities, ImuSamples
from fgloc.result import Event
from fgloc.sync import plan
from fgloc.timing import Instants
from fgloc.verdicts import SourceVerdicts, Verdict


@dataclass(frozen=True, eq=False)
class Timeline:
    """K epochs and how the vehicle moves between them.

    t_ns        (K,) increasing
    fix_rows    rows of the fixes that can be taken in; each is true at an epoch
    rate_radps  (K, 3) angular rate in vehicle axes, zero where nothing measures it
    """

    t_ns: Instants
    fix_rows: NDArray[np.int64]
    rate_radps: Array
    motion: Inertial | Planar
    verdicts: dict[str, SourceVerdicts]
    events: tuple[Event, ...]


def timeline(drive: Drive, config: SmoothConfig, slow: Slow) -> Timeline:
    """Epochs from the first usable fix on; DriveError where nothing tells how the vehicle moves."""
    imu, velocity = drive.tables.get("imu"), drive.tables.get("velocity")
    if isinstance(imu, ImuSamples) and len(imu):
        return _inertial(drive, config, slow)
    if isinstance(velocity, EnuVelocities) and len(velocity):
        return _planar(drive, velocity, slow)
    raise DriveError(
        f"drive {drive.name!r}: eskf needs an IMU or the table velocity, and the drive has "
        f"neither (it has {', '.join(drive.tables) or 'nothing'}); add imu.csv or velocity.csv"
    )


def _inertial(drive: Drive, config: SmoothConfig, slow: Slow) -> Timeline:
    planned = plan(drive, config, detection_instants(drive))
    epochs = planned.epochs
    motion = Inertial(drive, epochs, config.imu, slow)
    rows = np.unique(epochs.fix_row[epochs.fix_row >= 0])
    return Timeline(
        epochs.t_ns, rows, epochs.rate_radps, motion, planned.verdicts, planned.events
    )  # fmt: skip


def _planar(drive: Drive, table: EnuVelocities, slow: Slow) -> Timeline:
    verdicts = {
        name: SourceVerdicts.of(name, other, Verdict.UNUSED, f"eskf does not take {name}")
        for name, other in drive.tables.items()
    }
    velocity = _usable_velocities(drive, table, verdicts["velocity"])
    rows = _usable_fixes(drive, velocity, verdicts["gnss"])
    first, last = drive.gnss.t_ns[rows[0]], velocity.t_ns[-1]
    t_ns = np.unique(
        np.concatenate([drive.gnss.t_ns[rows], velocity.t_ns, detection_instants(drive)])
    )
    t_ns = t_ns[(t_ns >= first) & (t_ns <= last)]
    early = verdicts["velocity"].is_(Verdict.USED) & (table.t_ns < first)
    verdicts["velocity"].set(early, Verdict.OUTSIDE, "before the first usable fix")
    return Timeline(
        t_ns, rows, np.zeros((len(t_ns), 3)), Planar(velocity, t_ns, slow), verdicts, ()
    )  # fmt: skip


def _usable_velocities(
    drive: Drive, table: EnuVelocities, verdicts: SourceVerdicts
) -> EnuVelocities:
    sound = np.isfinite(table.v_world_mps).all(-1) & (table.sigma_mps > 0)
    repeats = np.zeros(len(table), bool)
    rows = np.flatnonzero(sound)
    repeats[rows[1:]] = np.diff(table.t_ns[rows]) == 0
    verdicts.set(slice(None), Verdict.USED)
    verdicts.set(repeats, Verdict.DUPLICATE, "an earlier row has the same t_ns")
    verdicts.set(~sound, Verdict.INVALID, "velocity is not finite or sigma is not above 0")
    if not sound.any():
        raise DriveError(f"drive {drive.name!r}: none of its {len(table)} velocities is valid")
    return table.take(sound & ~repeats)


def _usable_fixes(
    drive: Drive, velocity: EnuVelocities, verdicts: SourceVerdicts
) -> NDArray[np.int64]:
    """Rows that are sound, the first of their instant, and where there are velocities."""
    gnss = drive.gnss
    finite = np.isfinite(gnss.p_world_ant_m).all(-1) & np.isfinite(gnss.cov_world_m2).all((-1, -2))
    sound = np.zeros(len(gnss), bool)
    sound[finite] = np.linalg.eigvalsh(gnss.cov_world_m2[finite])[:, 0] > 0
    inside = (gnss.t_ns >= velocity.t_ns[0]) & (gnss.t_ns <= velocity.t_ns[-1])
    rows = np.flatnonzero(sound & inside)
    _, first = np.unique(gnss.t_ns[rows], return_index=True)
    verdicts.set(slice(None), Verdict.DUPLICATE, "an earlier row has the same t_ns")
    verdicts.set(~inside, Verdict.OUTSIDE, "no velocity at this time")
    verdicts.set(~sound, Verdict.INVALID, "not finite, or the covariance is not positive definite")
    verdicts.set(rows[first], Verdict.UNUSED, "not reached")
    if not len(rows):
        raise DriveError(
            f"drive {drive.name!r}: none of its {len(gnss)} fixes is valid and lies within the "
            "time of the velocities (are both on one clock?)"
        )
    return rows[first]


def moves_by(motion: Motion) -> str:
    """What to call the motion in a summary."""
    return "imu" if isinstance(motion, Inertial) else "velocity"
