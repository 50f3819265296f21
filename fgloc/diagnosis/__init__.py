"""What is wrong with a drive, before it is fused: findings with numbers and a remedy each.

Thresholds come from physics (what gravity, roads, tyres and quartz do), stand as named constants
beside their reasons, and are compared with what the drive itself can tell: where the motion is too
little or the fixes too coarse for a verdict there is none.
"""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from fgloc.datasets.drive_folder import salvage_drive
from fgloc.diagnosis import (
    clocks,
    covariances,
    gravity,
    inertial,
    jumps,
    lags,
    node_heights,
    rig,
    sampling,
    speeds,
    truth,
)
from fgloc.diagnosis.finding import SEVERITIES, Finding, fault
from fgloc.diagnosis.witness import Witness
from fgloc.drive import Drive
from fgloc.errors import InputError

__all__ = ["CHECKS", "MOTION_CHECKS", "SEVERITIES", "Finding", "diagnose", "diagnose_folder"]

CHECKS: tuple[Callable[[Drive], Iterator[Finding]], ...] = (
    clocks.check_epochs,
    clocks.check_overlap,
    sampling.check_rates,
    sampling.check_gaps,
    sampling.check_duplicates,
    sampling.check_stuck,
    sampling.check_range,
    clocks.check_latency,
    covariances.check_covariances,
    covariances.check_scatter,
    jumps.check_jumps,
    jumps.check_frozen,
    jumps.check_heights,
    jumps.check_place,
    node_heights.check_node_heights,
    speeds.check_velocities,
    gravity.check_gravity,
    rig.check_lever_arms,
    speeds.check_wheel,
    truth.check_truth,
)
"""Checks of tables by themselves, or against one other, where there are rows to check."""

MOTION_CHECKS: tuple[Callable[[Drive, Witness | None], Iterator[Finding]], ...] = (
    inertial.check_motion,
    lags.check_lags,
    inertial.check_turns,
    inertial.check_pushes,
    rig.check_slip,
    rig.check_noise,
)
"""Checks of the IMU against the motion of the jumps."""


def diagnose(drive: Drive) -> list[Finding]:
    """All findings about a drive, by source, the worst first; an empty list finds nothing."""
    found = [*sampling.check_rows(drive), *sampling.check_finite(drive)]
    drive = sampling.usable(drive)
    found += [finding for check in CHECKS for finding in check(drive)]
    witness = Witness.of(drive)
    found += [finding for check in MOTION_CHECKS for finding in check(drive, witness)]
    return in_order(found)


def diagnose_folder(folder: str | Path) -> list[Finding]:
    """Findings about a drive folder, also one that cannot be read as a drive.

    What stands in the way of reading is a fault; the tables that can be read are checked. Raises
    DriveError where the folder is no drive at all.
    """
    drive, faults = salvage_drive(folder)
    found = [_unreadable(part, err) for part, err in faults.items()]
    if drive is not None:
        rest = diagnose(drive)
        found += [one for one in rest if one.check != "no-table" or one.source not in faults]
    return in_order(found)


def _unreadable(part: str, err: InputError) -> Finding:
    return fault(
        "unreadable",
        part,
        str(err),
        "repair it as said: no command reads this drive",
    )


def in_order(findings: Iterable[Finding]) -> list[Finding]:
    """Findings by source and then by severity; sources with a fault come first."""
    found = list(findings)
    rank = {severity: i for i, severity in enumerate(SEVERITIES)}
    worst: dict[str, int] = {}
    for one in found:
        worst[one.source] = min(worst.get(one.source, len(rank)), rank[one.severity])
    return sorted(found, key=lambda one: (worst[one.source], one.source, rank[one.severity]))
