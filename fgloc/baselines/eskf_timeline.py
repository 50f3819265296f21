"""The epochs of the error-state filter: the graph's where there is an IMU, else those of the
velocities; there is one at every position that was measured."""

from dataclasses import dataclass

import numpy as np

from fgloc.baselines.eskf_motion import Inertial, Planar
from fgloc.baselines.eskf_state import Slow
from fgloc.config import SmoothConfig
from fgloc.constraints import velocity_with_errors
from fgloc.drive import Drive
from fgloc.errors import DriveError
from fgloc.measurements import Array, EnuVelocities, ImuSamples
from fgloc.positions import Positions, measured_positions, repeats
from fgloc.result import Event
from fgloc.sync import plan
from fgloc.timing import Instants
from fgloc.verdicts import SourceVerdicts, Verdict


@dataclass(frozen=True, eq=False)
class Timeline:
    """K epochs, the positions measured at them, and how the vehicle moves between them.

    t_ns        (K,) increasing
    rate_radps  (K, 3) angular rate in vehicle axes, zero where nothing measures it
    """

    t_ns: Instants
    positions: Positions
    rate_radps: Array
    motion: Inertial | Planar
    verdicts: dict[str, SourceVerdicts]
    events: tuple[Event, ...]


def timeline(drive: Drive, config: SmoothConfig, slow: Slow) -> Timeline:
    """Epochs from the first usable fix on; DriveError where nothing tells how the vehicle moves."""
    imu, velocity = drive.tables.get("imu"), velocity_with_errors(drive, config.motion)
    if isinstance(imu, ImuSamples) and len(imu):
        planned = plan(drive, config)
        epochs = planned.epochs
        return Timeline(
            epochs.t_ns, planned.positions, epochs.rate_radps,
            Inertial(drive, epochs, config.imu, slow), planned.verdicts, planned.events,
        )  # fmt: skip
    if velocity is not None and len(velocity):
        return _planar(drive, velocity, config, slow)
    raise DriveError(
        f"drive {drive.name!r}: eskf needs an IMU or the table velocity, and the drive has "
        f"neither (it has {', '.join(drive.tables) or 'nothing'}); add imu.csv or velocity.csv"
    )


def _planar(drive: Drive, table: EnuVelocities, config: SmoothConfig, slow: Slow) -> Timeline:
    verdicts = {
        name: SourceVerdicts.of(name, other, Verdict.UNUSED, f"eskf does not take {name}")
        for name, other in drive.tables.items()
    }
    own = verdicts["velocity"]
    velocity = _usable_velocities(drive, table, own)
    span_ns = (int(velocity.t_ns[0]), int(velocity.t_ns[-1]))
    positions = measured_positions(drive, config, span_ns, verdicts)
    fixes = verdicts["gnss"]
    fixes.set(fixes.is_(Verdict.OUTSIDE), Verdict.OUTSIDE, "no velocity at this time")
    first = positions.t_ns[0]
    t_ns = np.unique(np.concatenate([positions.t_ns, velocity.t_ns[velocity.t_ns >= first]]))
    early = own.is_(Verdict.USED) & (table.t_ns < first)
    own.set(early, Verdict.OUTSIDE, "before the first usable fix")
    return Timeline(
        t_ns, positions, np.zeros((len(t_ns), 3)), Planar(velocity, t_ns, slow), verdicts, ()
    )


def _usable_velocities(
    drive: Drive, table: EnuVelocities, verdicts: SourceVerdicts
) -> EnuVelocities:
    sound = np.asarray(np.isfinite(table.v_world_mps).all(-1) & (table.sigma_mps > 0))
    double = repeats(table.t_ns, sound)
    verdicts.set(slice(None), Verdict.USED)
    verdicts.set(double, Verdict.DUPLICATE, "an earlier row has the same t_ns")
    verdicts.set(~sound, Verdict.INVALID, "velocity is not finite or sigma is not above 0")
    if not sound.any():
        raise DriveError(f"drive {drive.name!r}: none of its {len(table)} velocities is valid")
    return table.take(sound & ~double)
