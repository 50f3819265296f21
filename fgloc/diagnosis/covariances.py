"""Checks of the fixes' covariances: by themselves, and against how the fixes scatter."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fgloc.diagnosis.finding import Finding, fault, remark, robust_sigma, rows_of, warning
from fgloc.diagnosis.gnss import even_triples, fixes_of, second_differences, sound_fixes
from fgloc.diagnosis.gravity import in_mps2
from fgloc.diagnosis.motion import Signal
from fgloc.diagnosis.sampling import usual_interval_s
from fgloc.drive import Drive
from fgloc.factors.noise import positive_definite
from fgloc.measurements import Array, GnssFixes, ImuSamples
from fgloc.timing import elapsed_s

SMALLEST_SIGMA_M, LARGEST_SIGMA_M = 5e-4, 100.0
"""A carrier phase is read to millimetres; beyond 100 m a fix helps no vehicle."""
SCATTER_FACTOR = 3.0
"""The estimator's gate forgives sigmas that are too small by less."""
BUMPY_MPS2 = 0.5
"""Vertical acceleration of roads at the speed that belongs to them."""
PUSH_MPS2 = 4.0
"""Firm braking: what to expect of a vehicle where no IMU tells."""
_FEWEST = 30


def check_covariances(drive: Drive) -> Iterator[Finding]:
    """Covariances that cannot be one, or that no receiver states."""
    gnss = fixes_of(drive)
    if gnss is None:
        return
    finite = np.isfinite(gnss.cov_world_m2).all((-1, -2))
    variance = np.diagonal(gnss.cov_world_m2, axis1=-2, axis2=-1)
    zero = finite & (variance <= 0).any(-1)
    definite = np.zeros(len(gnss), bool)
    definite[finite] = positive_definite(gnss.cov_world_m2[finite])
    for rows, what in (
        (~finite, "is infinite or NaN"),
        (zero, "has a zero or negative variance"),
        (finite & ~zero & ~definite, "is not positive definite"),
    ):
        if rows.any():
            yield fault(
                "covariance",
                "gnss",
                f"the covariance {what} in {rows_of(gnss, np.flatnonzero(rows))}",
                "give what the receiver states, or remove the rows: they cannot be weighted",
            )
    yield from _odd_sigmas(gnss, definite, variance)


def _odd_sigmas(gnss: GnssFixes, sound: NDArray[np.bool_], variance: Array) -> Iterator[Finding]:
    sigma_m = np.sqrt(np.where(sound[:, None], variance, 1.0))
    for rows, what, remedy in (
        (
            (sigma_m < SMALLEST_SIGMA_M).any(-1), f"below {SMALLEST_SIGMA_M * 1000:g} mm",
            "is it in km, or in degrees? No receiver is so good",
        ),
        (
            (sigma_m > LARGEST_SIGMA_M).all(-1), f"above {LARGEST_SIGMA_M:g} m",
            "is it in mm or cm, or a variance in place of a sigma?",
        ),
    ):  # fmt: skip
        if rows.any():
            yield warning(
                "sigma",
                "gnss",
                f"a claimed sigma {what} in {rows_of(gnss, np.flatnonzero(rows))}",
                remedy,
            )


def check_scatter(drive: Drive) -> Iterator[Finding]:
    """Claimed sigmas against how the fixes scatter about a smooth motion."""
    gnss = sound_fixes(drive)
    if gnss is None:
        return
    even = even_triples(gnss)
    if len(even) < _FEWEST:
        return
    second = second_differences(gnss, even)
    sigma_m = np.sqrt(np.diagonal(gnss.cov_world_m2[even], axis1=-2, axis2=-1))
    dt_s = usual_interval_s(gnss)
    push = _push_mps2(drive, gnss, even) * dt_s**2
    calm = push <= np.median(push)
    bump = np.full(int(calm.sum()), BUMPY_MPS2 * dt_s**2)
    for axes, what, motion_m in (
        ([0, 1], "horizontally", push[calm]), ([2], "vertically", bump),
    ):  # fmt: skip
        yield from _scatter(what, second[calm][:, axes], sigma_m[calm][:, axes], motion_m)


def _scatter(what: str, second: Array, sigma_m: Array, motion_m: Array) -> Iterator[Finding]:
    """White errors of sigma s have second differences of sigma sqrt(6) s."""
    scatter_m = robust_sigma(second) / np.sqrt(6)
    claimed_m = float(np.median(sigma_m))
    beyond_m = np.sqrt(max(scatter_m**2 - float(np.median(motion_m)) ** 2, 0.0))
    told = f"the fixes scatter {what} by {scatter_m:.3g} m from one to the next"
    if beyond_m > SCATTER_FACTOR * claimed_m:
        yield warning(
            "scatter",
            "gnss",
            f"{told}, the claimed sigma is {claimed_m:.3g} m",
            f"the covariance is too small by about {(beyond_m / claimed_m):.0f} in sigma: take it "
            f"from the receiver, or set gnss.sigma_scale={beyond_m / claimed_m:.1f}",
        )
    elif scatter_m * SCATTER_FACTOR < claimed_m:
        yield remark(
            "scatter",
            "gnss",
            f"{told}, less than the claimed sigma of {claimed_m:.3g} m",
            "errors that drift slowly do so, and then gnss.bias_sigma_m describes them; if they "
            "do not, the sigma is too large",
        )


def _push_mps2(drive: Drive, gnss: GnssFixes, rows: NDArray[np.int64]) -> Array:
    """(M,) how hard the vehicle was pushed at the fixes: by the IMU, or what may be expected."""
    imu = drive.tables.get("imu")
    if not isinstance(imu, ImuSamples) or len(imu) < 2 or not in_mps2(drive, imu):
        return np.full(len(rows), PUSH_MPS2)
    start_ns = int(gnss.t_ns[0])
    accel = imu.accel_mps2 @ drive.rig.T_veh_imu[:3, :3].T
    accel = np.nan_to_num(accel[:, :2] - np.nanmedian(accel[:, :2], axis=0))
    signal = Signal.of_level(imu.t_ns, accel, start_ns)
    t_s = elapsed_s(gnss.t_ns, start_ns)
    width_s = t_s[rows + 1] - t_s[rows - 1]
    mean = (signal.at(t_s[rows + 1]) - signal.at(t_s[rows - 1])) / width_s[:, None]
    covered = (t_s[rows - 1] >= signal.t_s[0]) & (t_s[rows + 1] <= signal.t_s[-1])
    return np.where(covered, np.hypot(*mean.T), PUSH_MPS2)
