"""Checks of the rig: lever arms, and the noise that is claimed for the IMU."""

from collections.abc import Iterator

import numpy as np

from fgloc.diagnosis.finding import MEDIAN_SIGMAS, Finding, fault, warning
from fgloc.diagnosis.gravity import NEAR, in_mps2
from fgloc.diagnosis.inertial import in_degrees
from fgloc.diagnosis.lag import sideslip
from fgloc.diagnosis.motion import FEWEST_STEPS, LONGEST_M, fit
from fgloc.diagnosis.sampling import usual_interval_s
from fgloc.diagnosis.witness import Witness
from fgloc.drive import Drive, ImuNoise
from fgloc.measurements import Array, ImuSamples

BELOW_M = -0.5
"""Antennas see the sky, so they are not under the vehicle."""
NOISE = {
    "accel_noise_mps2_per_sqrt_hz": (1e-5, 0.3, "m/s^2 per sqrt(Hz)"),
    "gyro_noise_radps_per_sqrt_hz": (1e-7, 0.02, "rad/s per sqrt(Hz)"),
}
"""From the best tactical IMU to a phone in a rattling car; a figure in deg/sqrt(h), in deg/h or in
micro-g lies outside."""
QUIETER = 3.0
"""So many times more noise than claimed at the quietest moments is no accident."""
_QUIETEST = 0.1
_BLOCK = 50
_SIGNIFICANT = 4.0


def check_lever_arms(drive: Drive) -> Iterator[Finding]:
    """Where antenna and IMU are said to be."""
    places = {"p_veh_ant_m": drive.rig.p_veh_ant_m, "T_veh_imu": drive.rig.T_veh_imu[:3, 3]}
    for name, place_m in places.items():
        length_m = float(np.linalg.norm(place_m))
        if length_m > LONGEST_M:
            yield fault(
                "lever-arm",
                "rig",
                f"rig.{name} is {length_m:,.4g} m long ({_text(place_m)})",
                "lever arms are in m in the vehicle frame, from the rear axle: is it in mm or "
                "cm, or from another point?",
            )
    up_m = float(drive.rig.p_veh_ant_m[2])
    if up_m < BELOW_M and np.linalg.norm(drive.rig.p_veh_ant_m) <= LONGEST_M:
        yield warning(
            "lever-arm-sign",
            "rig",
            f"rig.p_veh_ant_m puts the antenna {-up_m:g} m under the vehicle's origin",
            "z is up: change the sign if it was measured downwards",
        )


def check_slip(drive: Drive, witness: Witness | None) -> Iterator[Finding]:
    """An antenna ahead of the rear axle turns into a bend before the vehicle does."""
    claimed_m = float(drive.rig.p_veh_ant_m[0])
    if witness is None or witness.use.sum() < FEWEST_STEPS or abs(claimed_m) > LONGEST_M:
        return
    if witness.lag is not None and witness.lag.is_significant:
        return
    motion, use = witness.motion, witness.use
    slip = sideslip(motion, motion.smoothed(witness.imu)[:, 0])[use]
    A = np.column_stack([slip, witness.turn_rad[use], np.ones_like(slip)])
    (ahead_m, gain, _), (sigma_m, gain_sigma, _) = fit(A, motion.turn_rad[use])
    if abs(gain - 1) > NEAR + 3 * gain_sigma:
        return  # the gyro has other troubles
    opposite = claimed_m * ahead_m < 0 and abs(ahead_m + claimed_m) < abs(claimed_m)
    if opposite and abs(ahead_m - claimed_m) > _SIGNIFICANT * sigma_m:
        yield warning(
            "lever-arm-sign",
            "rig",
            f"in bends the antenna moves as if {ahead_m:+.1f} m (sigma {sigma_m:.1f} m) ahead of "
            f"the rear axle; rig.p_veh_ant_m says {claimed_m:+.1f} m",
            "x is forward: check the sign of p_veh_ant_m[0]",
        )


def check_noise(drive: Drive, witness: Witness | None) -> Iterator[Finding]:
    """The claimed noise: there, in its unit, and not below what the IMU shows."""
    imu, noise = drive.tables.get("imu"), drive.rig.imu_noise
    if not isinstance(imu, ImuSamples):
        return
    if noise is None:
        yield fault(
            "no-noise",
            "rig",
            "the drive has an IMU, but no [rig.imu_noise]",
            "give it in drive.toml, from the data sheet or an Allan plot",
        )
        return
    yield from _impossible(noise)
    yield from _too_quiet(imu, noise, (in_mps2(drive, imu), not in_degrees(witness)))


def _impossible(noise: ImuNoise) -> Iterator[Finding]:
    for name, value in vars(noise).items():
        if not (np.isfinite(value) and value > 0):
            yield fault(
                "noise",
                "rig",
                f"rig.imu_noise.{name} = {value:g}",
                "a noise must be above 0, or its measurements are taken for exact",
            )
    for name, (low, high, unit) in NOISE.items():
        value = getattr(noise, name)
        if value > high or 0 < value < low:
            yield warning(
                "noise",
                "rig",
                f"rig.imu_noise.{name} = {value:g}, outside {low:g} to {high:g} {unit}",
                "is it in deg, in deg/sqrt(h) or in micro-g? Convert it: 1 deg/sqrt(h) is 2.9e-4 "
                "rad/s per sqrt(Hz), 100 micro-g are 9.8e-4 m/s^2",
            )


def _too_quiet(imu: ImuSamples, noise: ImuNoise, in_si: tuple[bool, bool]) -> Iterator[Finding]:
    """White noise of density d has differences of d sqrt(2 rate).

    `in_si` tells of accelerometer and gyro whether their unit is right; others are told of already.
    """
    for (name, (_, high, unit)), values, trusted in zip(
        NOISE.items(), (imu.accel_mps2, imu.gyro_radps), in_si, strict=True
    ):
        shown, claimed = _shown_noise(values, usual_interval_s(imu)), getattr(noise, name)
        if trusted and 0 < QUIETER * claimed < shown <= high:
            yield warning(
                "noise",
                "rig",
                f"at its quietest the IMU shows {shown:.2g} {unit}, rig.imu_noise.{name} is "
                f"{claimed:.2g}",
                "raise it to at least what is shown; is it in another unit?",
            )


def _shown_noise(values: Array, interval_s: float) -> float:
    """Density of the white noise in the quietest tenth of blocks, the median of the axes."""
    blocks = len(values) // _BLOCK
    if blocks < 1 / _QUIETEST:
        return 0.0
    steps = np.diff(values[: blocks * _BLOCK].reshape(blocks, _BLOCK, 3), axis=1)
    sigma = np.median(np.abs(steps), axis=1) / MEDIAN_SIGMAS
    quiet = np.nanquantile(np.median(sigma, axis=1), _QUIETEST)
    return float(quiet * np.sqrt(interval_s / 2))


def _text(vector: Array) -> str:
    return ", ".join(f"{value:g}" for value in vector)
