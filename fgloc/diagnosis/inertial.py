"""Checks of the IMU against the motion of the fixes: units, axes, signs."""

from collections.abc import Iterator

import numpy as np

from fgloc.diagnosis.finding import Finding, fault, remark, warning
from fgloc.diagnosis.gravity import MISALIGNED_DEG, NEAR, is_upright
from fgloc.diagnosis.motion import FEWEST_STEPS, fit
from fgloc.diagnosis.planar import Planar
from fgloc.diagnosis.witness import Witness
from fgloc.drive import Drive
from fgloc.measurements import ImuSamples

DEGREES = 180 / np.pi
CLEAR = 0.8
"""Of a correlation: slopes and springs leave two thirds of the variance to the pushes, and more."""
FASTEST_RADPS = 3.0
"""A vehicle that turns this fast for more than a moment is spinning."""
_SIGNIFICANT = 5.0


def check_turns(drive: Drive, witness: Witness | None) -> Iterator[Finding]:
    """Turns by the gyro against those of the course: unit and sign; and who is mirrored."""
    found = _turn_gain(witness)
    if found is None:
        yield from _spinning(drive)
        return
    gain, sure = found
    imu = drive.tables["imu"]
    upright = isinstance(imu, ImuSamples) and is_upright(drive, imu)  # else it is told of already
    if in_degrees(witness):
        yield fault(
            "gyro-unit",
            "imu",
            f"the gyro turns {1 / abs(gain):.0f} times as far as the course: it is in deg/s, not "
            "in rad/s",
            "multiply by pi/180",
        )
    elif (
        upright and not 1 - 2 * NEAR < abs(gain) < 1 / (1 - 2 * NEAR) and abs(abs(gain) - 1) > sure
    ):
        yield warning(
            "gyro-unit",
            "imu",
            f"the course turns by {abs(gain):.3g} of what the gyro says",
            "check its unit and scale, and that z is the vertical axis",
        )
    if gain < 0 and upright:
        yield from _opposite(witness)


def in_degrees(witness: Witness | None) -> bool:
    """Whether the gyro turns as far in degrees as the course does in rad."""
    found = _turn_gain(witness)
    return found is not None and abs(abs(found[0]) * DEGREES - 1) < 2 * NEAR


def _opposite(witness: Witness | None) -> Iterator[Finding]:
    """The course turns against the gyro. In a left turn the specific force points to the left."""
    planar = None if witness is None else _pushes(witness)
    told = "the course turns right where the gyro turns left"
    if planar is None:
        yield fault(
            "turn-sign",
            "gnss",
            f"{told}: the gyro's z is down, or the fixes are mirrored (north and east exchanged)",
            "check both: the gyro is positive to the left, positions are east, north, up",
        )
    elif planar.mirrored:
        yield fault(
            "mirrored",
            "gnss",
            f"{told}, and the accelerometer agrees with the gyro: the fixes are mirrored, north "
            "and east exchanged (NED read as ENU)",
            "write east_m, north_m, up_m in that order",
        )
    else:
        yield fault(
            "gyro-sign",
            "imu",
            f"{told}, and the accelerometer agrees with the course: the gyro has the wrong sign",
            "gyro z is positive to the left, seen from above",
        )


def check_pushes(drive: Drive, witness: Witness | None) -> Iterator[Finding]:
    """Forward and sideways force against changes of velocity: the IMU's axes seen from above."""
    imu = drive.tables.get("imu")
    if witness is None or not isinstance(imu, ImuSamples) or not is_upright(drive, imu):
        return
    planar, gain = _pushes(witness), _turn_gain(witness)
    if planar is None:
        yield from _forward(witness)
    elif planar.mirrored and gain is not None and gain[0] > 0:
        yield fault(
            "imu-axes",
            "imu",
            "the accelerometer is the mirror image of the motion, the gyro is not: one of its "
            "axes x, y has the wrong sign, or they are exchanged",
            "x is forward and y is left",
        )
    elif not planar.mirrored and abs(planar.turn_deg) > MISALIGNED_DEG:
        yield fault(
            "imu-axes",
            "imu",
            f"the accelerometer's axes stand {-planar.turn_deg:+.0f} deg about up from forward "
            "and left",
            "state the mounting in rig.T_veh_imu, or exchange the columns",
        )


def _forward(witness: Witness) -> Iterator[Finding]:
    """Where there are no turns, speeding up and braking alone tell which axis is forward."""
    use = witness.use
    if use.sum() < 2 * FEWEST_STEPS:
        return
    told = np.column_stack([witness.motion.push_mps[use, 0], witness.push_mps[use]])
    x, y = np.corrcoef(told.T)[0, 1:]
    found = ((-x, y, "backwards along x"), (abs(y), x, "along y"))
    for clear, other, where in found:
        if clear > CLEAR and abs(other) < clear / 2:
            yield fault(
                "imu-axes",
                "imu",
                f"speeding up reads {where} (correlation {clear:.2f}, of the other axis "
                f"{other:+.2f})",
                "x is forward and y is left: state the mounting in rig.T_veh_imu, or exchange "
                "the columns",
            )


def check_motion(drive: Drive, witness: Witness | None) -> Iterator[Finding]:
    """Whether the vehicle moved enough for anything of this to be seen."""
    if {"gnss", "imu"} <= set(drive.tables) and (
        witness is None or witness.use.sum() < FEWEST_STEPS
    ):
        yield remark(
            "little-motion",
            "drive",
            "too little motion under fixes and IMU to check axes and clocks against each other",
            "none; a drive with turns and stops tells more",
        )


def _turn_gain(witness: Witness | None) -> tuple[float, float] | None:
    """Turn of the course per turn of the gyro and how far it may be out by chance.

    None where the drive does not tell.
    """
    if witness is None or witness.use.sum() < FEWEST_STEPS:
        return None
    turn = witness.turn_rad[witness.use]
    A = np.column_stack([turn, np.ones_like(turn)])
    gain, sigma = fit(A, witness.motion.turn_rad[witness.use])
    sure = _SIGNIFICANT * float(sigma[0])
    return (float(gain[0]), sure) if abs(gain[0]) > sure else None


def _pushes(witness: Witness) -> Planar | None:
    """From the accelerometer's pushes to those of the fixes."""
    use = witness.use
    if use.sum() < FEWEST_STEPS:
        return None
    return Planar.of(witness.motion.push_mps[use], witness.push_mps[use], constant=True)


def _spinning(drive: Drive) -> Iterator[Finding]:
    """Without a course: rates that no vehicle keeps up."""
    imu = drive.tables.get("imu")
    if not isinstance(imu, ImuSamples):
        return
    often = float(np.nanquantile(np.abs(imu.gyro_radps), 0.9)) if len(imu) else 0.0
    if often > FASTEST_RADPS:
        yield fault(
            "gyro-unit",
            "imu",
            f"a tenth of the gyro's values exceed {often:.3g} rad/s: it is in deg/s, not in rad/s",
            "multiply by pi/180",
        )
