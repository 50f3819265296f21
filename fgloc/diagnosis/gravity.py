"""Checks of the IMU against gravity: its unit, and which axis is up."""

from collections.abc import Iterator

import numpy as np

from fgloc.diagnosis.finding import Finding, fault, warning
from fgloc.drive import Drive
from fgloc.measurements import Array, ImuSamples

GRAVITY_MPS2 = 9.80665
NEAR = 0.2
"""Gravity with the bias of the worst sensor and the sway of a whole drive is known better."""
UNITS = (
    (1.0, "g", "multiply by 9.80665"),
    (1000.0, "mg", "multiply by 0.00980665"),
    (32.174, "ft/s^2", "multiply by 0.3048"),
    (980.665, "cm/s^2", "divide by 100"),
)
"""What one g reads in other units."""
TILT_DEG = 15.0
"""Streets and springs tilt a car by less on average over a drive."""
MISALIGNED_DEG = 30.0


def check_gravity(drive: Drive) -> Iterator[Finding]:
    """The median specific force: one g, upwards, in m/s^2."""
    imu = drive.tables.get("imu")
    if not isinstance(imu, ImuSamples):
        return
    force = mean_force(drive, imu)
    size = float(np.linalg.norm(force))
    if not in_mps2(drive, imu):
        yield _unit(size)
    if size > 0 and not _weightless(size):
        yield from _upright(force / size)


def _unit(size: float) -> Finding:
    for one_g, unit, remedy in UNITS:
        if abs(size / one_g - 1) < NEAR:
            return fault(
                "accel-unit",
                "imu",
                f"the accelerometer reads {size:.4g} at rest: it is in {unit}, not in m/s^2",
                remedy,
            )
    if _weightless(size):
        return fault(
            "accel-gravity",
            "imu",
            f"the accelerometer reads {size:.3g} m/s^2 on average: gravity has been taken out",
            "record the specific force itself, which is 9.8 m/s^2 upwards at rest",
        )
    return fault(
        "accel-unit",
        "imu",
        f"the accelerometer reads {size:.4g} on average, gravity is {GRAVITY_MPS2:.2f} m/s^2",
        "check its unit and scale",
    )


def _weightless(size: float) -> bool:
    return size < GRAVITY_MPS2 / 4 and not abs(size - 1) < NEAR


def _upright(up: Array) -> Iterator[Finding]:
    tilt_deg = float(np.degrees(np.arccos(np.clip(up[2], -1, 1))))
    if tilt_deg > 180 - MISALIGNED_DEG:
        yield fault(
            "imu-axes",
            "imu",
            "gravity reads along -z: the axes are z-down (forward-right-down, NED), or gravity "
            "has the wrong sign",
            "turn y and z of accel and gyro round when you convert, or state the mounting in "
            "rig.T_veh_imu",
        )
    elif tilt_deg > MISALIGNED_DEG:
        axis = "xyz"[int(np.argmax(np.abs(up)))]
        yield fault(
            "imu-axes",
            "imu",
            f"gravity reads {tilt_deg:.0f} deg from the vehicle's z, most of it along {axis}",
            "the axes are exchanged: state the mounting in rig.T_veh_imu",
        )
    elif tilt_deg > TILT_DEG:
        yield warning(
            "imu-axes",
            "imu",
            f"gravity reads {tilt_deg:.0f} deg from the vehicle's z",
            "state the tilt of the mounting in rig.T_veh_imu",
        )


def is_upright(drive: Drive, imu: ImuSamples) -> bool:
    """Whether gravity, if there is any, reads along the vehicle's z."""
    force = mean_force(drive, imu)
    size = float(np.linalg.norm(force))
    return _weightless(size) or bool(force[2] > np.cos(np.radians(MISALIGNED_DEG)) * size)


def mean_force(drive: Drive, imu: ImuSamples) -> Array:
    """Median specific force (3,), vehicle axes, in the unit of the table."""
    finite = np.isfinite(imu.accel_mps2).all(-1)
    if not finite.any():
        return np.zeros(3)
    median = np.median(imu.accel_mps2[finite], axis=0)
    return np.asarray(drive.rig.T_veh_imu[:3, :3] @ median, float)


def in_mps2(drive: Drive, imu: ImuSamples) -> bool:
    """Whether the accelerometer reads gravity in its unit."""
    return bool(abs(np.linalg.norm(mean_force(drive, imu)) / GRAVITY_MPS2 - 1) < NEAR)
