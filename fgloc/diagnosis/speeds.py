"""Checks of speeds against the positions: the receiver's velocities, and the wheels."""

from collections.abc import Iterator

import numpy as np

from fgloc.diagnosis.finding import Finding, fault, warning
from fgloc.diagnosis.gnss import fixes_of
from fgloc.diagnosis.motion import FEWEST_STEPS, Motion, Signal, fit
from fgloc.diagnosis.planar import Planar
from fgloc.drive import Drive
from fgloc.measurements import WheelSpeeds

SPEED_UNITS = ((1 / 3.6, "km/h"), (0.44704, "mph"), (0.514444, "knots"), (0.001, "mm/s"))
TURNED_DEG = 30.0
SCALE = 0.1
"""Tyres wear and shrink by a few percent, not by a tenth."""


def check_velocities(drive: Drive) -> Iterator[Finding]:
    """The receiver's velocities against its positions: order of axes, sign of up, unit."""
    gnss, motion = fixes_of(drive), Motion.of(drive)
    if gnss is None or motion is None:
        return
    given = np.isfinite(gnss.v_world_mps).all(-1)
    if given.sum() < FEWEST_STEPS or len(motion.steps) < FEWEST_STEPS:
        return
    signal = Signal.of_level(gnss.t_ns[given], gnss.v_world_mps[given], motion.start_ns)
    said, knots = motion.smoothed(signal), motion.steps
    yield from _horizontal(Planar.of(motion.v_mps[knots, :2], said[knots, :2]))
    (gain,), (sigma,) = fit(said[knots, 2:], motion.v_mps[knots, 2])
    if gain < -0.5 and gain + 5 * sigma < 0:
        yield fault(
            "velocity",
            "gnss",
            "the vertical velocity has the sign of down: heights rise where it is negative",
            "v_up_mps is positive upwards; receivers give down",
        )


def _horizontal(planar: Planar | None) -> Iterator[Finding]:
    if planar is None:
        return
    if planar.mirrored:
        yield fault(
            "velocity",
            "gnss",
            "the velocities are the mirror image of what the positions do (north and east "
            "exchanged)",
            "write v_east_mps and v_north_mps in that order: receivers give NED",
        )
    elif abs(planar.turn_deg) > TURNED_DEG:
        yield fault(
            "velocity",
            "gnss",
            f"the velocities point {-planar.turn_deg:+.0f} deg from where the positions go",
            "check the signs and the order of the columns",
        )
    if abs(np.log(planar.gain)) > np.log(1 + 2 * SCALE):
        yield fault(
            "velocity",
            "gnss",
            f"positions change by {planar.gain:.3g} of what the velocities say (1 km/h is 0.278 "
            "m/s, 1 knot 0.514)",
            "convert the velocities to m/s",
        )


def check_wheel(drive: Drive) -> Iterator[Finding]:
    """The speed of the wheels against that of the fixes: unit, scale, sign."""
    wheel, motion = drive.tables.get("wheel"), Motion.of(drive)
    if not isinstance(wheel, WheelSpeeds) or motion is None or len(wheel) < 2:
        return
    finite = np.isfinite(wheel.speed_mps)
    if finite.sum() < 2 or len(motion.steps) < FEWEST_STEPS:
        return
    signal = Signal.of_level(wheel.t_ns[finite], wheel.speed_mps[finite][:, None], motion.start_ns)
    use = motion.covered(signal)
    if use.sum() < FEWEST_STEPS:
        return
    knots = motion.steps[use]
    (gain,), (sigma,) = fit(motion.smoothed(signal)[knots], motion.speed_mps[knots])
    if abs(gain - 1) <= max(SCALE, 5 * sigma):
        return
    if gain < 0:
        yield fault(
            "wheel-sign",
            "wheel",
            "the speed is negative when the vehicle drives ahead",
            "speed_mps is positive forwards",
        )
        return
    units = [unit for factor, unit in SPEED_UNITS if abs(gain / factor - 1) < SCALE / 2]
    what = f"the fixes move at {gain:.3g} of the wheels' speed"
    if units:
        yield fault(
            "wheel-unit",
            "wheel",
            f"{what}: it is in {units[0]}, not in m/s",
            "convert it to m/s",
        )
    else:
        yield warning(
            "wheel-scale",
            "wheel",
            what,
            "check the unit and the radius of the tyres",
        )
