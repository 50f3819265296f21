"""The fixes as the checks want them."""

import numpy as np
from numpy.typing import NDArray

from fgloc.arrays import Array, finite_rows
from fgloc.diagnosis.finding import robust_sigma
from fgloc.diagnosis.sampling import usual_interval_s
from fgloc.drive import Drive
from fgloc.measurements import GnssFixes
from fgloc.timing import elapsed_s

FASTEST_MPS = 70.0
"""A road vehicle: 250 km/h."""
SIGMAS = 6.0
"""So far out lies one honest fix of a thousand million."""


def fixes_of(drive: Drive) -> GnssFixes | None:
    """The GNSS table of a drive, or None where there are no rows."""
    gnss = drive.tables.get("gnss")
    return gnss if isinstance(gnss, GnssFixes) and len(gnss) else None


def sound_fixes(drive: Drive) -> GnssFixes | None:
    """The fixes with finite positions and positive variances, the first of each instant."""
    gnss = fixes_of(drive)
    if gnss is None:
        return None
    variance = np.diagonal(gnss.cov_world_m2, axis1=-2, axis2=-1)
    gnss = gnss.take(finite_rows(gnss.p_world_ant_m, variance) & (variance > 0).all(-1))
    if not len(gnss):
        return None
    return gnss.take(np.concatenate([[True], np.diff(gnss.t_ns) > 0]))


def strays(t_s: Array, p_m: Array, sigma_m: float | Array) -> NDArray[np.int64]:
    """Rows (M,) to which and from which no vehicle comes, of times (N,) and positions (N, 2)."""
    return np.flatnonzero((fast := too_fast(t_s, p_m, sigma_m))[1:] & fast[:-1]) + 1


def too_fast(t_s: Array, p_m: Array, sigma_m: float | Array) -> NDArray[np.bool_]:
    """(N - 1,) bool: the steps that no vehicle takes, whatever the noise of sigma (N,)."""
    sigma_m = np.broadcast_to(sigma_m, t_s.shape)
    step_m = np.hypot(*np.diff(p_m, axis=0).T)
    noise_m = SIGMAS * np.hypot(sigma_m[1:], sigma_m[:-1])
    return np.asarray(step_m > FASTEST_MPS * np.diff(t_s) + noise_m)


def even_triples(gnss: GnssFixes) -> NDArray[np.int64]:
    """Rows (M,) with a fix one usual interval before and one after."""
    dt_s = usual_interval_s(gnss)
    step_s = np.diff(elapsed_s(gnss.t_ns, int(gnss.t_ns[0])))
    usual = np.abs(step_s - dt_s) < 0.1 * dt_s
    return np.flatnonzero(usual[1:] & usual[:-1]) + 1


def second_differences(gnss: GnssFixes, rows: NDArray[np.int64]) -> Array:
    """(M, 3) in m: what is left of the positions beside the rows when steady motion is gone."""
    p = gnss.p_world_ant_m
    return p[rows + 1] - 2 * p[rows] + p[rows - 1]


def noise_m(gnss: GnssFixes) -> Array:
    """(N, 3) sigma of the fixes: what is claimed, or how they scatter where that is more.

    White errors of sigma s have second differences of sigma sqrt(6) s.
    """
    claimed_m = np.sqrt(np.diagonal(gnss.cov_world_m2, axis1=-2, axis2=-1))
    rows = even_triples(gnss)
    if not len(rows):
        return claimed_m
    scatter_m = [robust_sigma(axis) / np.sqrt(6) for axis in second_differences(gnss, rows).T]
    return np.maximum(claimed_m, scatter_m)
