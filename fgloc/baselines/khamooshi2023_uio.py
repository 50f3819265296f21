"""Methods `khamooshi2023-uio-printed` and `khamooshi2023-uio`: unknown input observers of a post.

Khamooshi (2023), section 3.7: the wind's load is not known, so the observer is to be blind for it,

    z' = F z + K y,  x_hat = z + H y                                                   # Eq. (3.29)
    (H C - I) B = 0,  T = I - H C,  F = T A - K1 C,  K2 = F H,  K = K1 + K2            # Eq. (3.31)

which needs rank(C B) = rank(B). One axis:

x, x'     displacement and velocity of the tip       state
A, B      Eqs. (3.23), (3.24)                        `oscillator`, LOAD_INPUT
C         displacement and angle, Eq. (3.28)         `printed_outputs`
K1        free, makes F stable                       CORRECTION_PER_S

As printed the condition fails: a load changes velocity at once, displacement and angle only later,
so C B = 0 while rank(B) = 1. Sampling makes the ranks agree, but leaves a zero near -1: a motion
that changes sign with every sample, that the outputs do not show and that dies slowly. The printed
method therefore says so, with the numbers of the drive's posts, and gives no estimate.

# Differs from the paper: `khamooshi2023-uio` takes the velocity as a second output, the difference
of two poses over their time. Then C = I and the condition holds, but T A = [[0, 1], [0, 0]]: no
frequency and no damping are left, it is a kinematic observer. The outputs are joined by straight
lines, as which the differenced velocity is exact; held until the next pose, as in section 3.3.2, it
would be half a period late. What remains of the correction then is the pose itself: it does not
filter. Displacement and angle tell the same of a bent post, so they are weighed by their stated
variances into one.
"""

from typing import NamedTuple

import numpy as np

from fgloc.drive import Drive
from fgloc.errors import DriveError, SolverError
from fgloc.factors.post import oscillator
from fgloc.infrastructure import Post
from fgloc.measurements import Array
from fgloc.result import Result
from fgloc.sway import result, table
from fgloc.watches import Watch, watches

PRINTED, KINEMATIC = "khamooshi2023-uio-printed", "khamooshi2023-uio"
LOAD_INPUT = np.array([[0.0], [1.0]])
"""B over one over the modal mass, which changes no rank."""
CORRECTION_PER_S = 5.0
"""# Differs from the paper: it states no K1. How fast an error of the observer dies."""


class Existence(NamedTuple):
    """Whether an observer exists: the ranks that have to agree, and the sampled system's zero."""

    rank_cb: int
    rank_b: int
    zero: float


def existence(post: Post, dt_s: float) -> Existence:
    """The condition of the printed observer, checked in numbers, and the zero over a sample."""
    from scipy.signal import cont2discrete

    A, C = oscillator(post.frequency_hz, post.damping), printed_outputs(post)
    phi, gamma, *_ = cont2discrete((A, LOAD_INPUT, C, np.zeros((2, 1))), dt_s, "zoh")
    # The motion of the velocity while a load keeps the displacement at zero.
    zero = phi[1, 1] - gamma[1, 0] * phi[0, 1] / gamma[0, 0]
    rank = np.linalg.matrix_rank
    return Existence(int(rank(C @ LOAD_INPUT)), int(rank(LOAD_INPUT)), float(zero))


def printed_outputs(post: Post) -> Array:
    """C of one axis. # Eq. (3.28), the angle in degrees"""
    return np.array([[1.0, 0.0], [180 / (np.pi * post.height_m), 0.0]])


def run_printed(drive: Drive) -> Result:
    """Raises SolverError that tells the ranks and the zero; DriveError where there are no poses."""
    found, _ = watches(drive, PRINTED)
    watch = found[0]
    dt_s = _period_s(watch)
    said = existence(watch.post, dt_s)
    lasts_s = -dt_s / np.log(abs(said.zero))
    raise SolverError(
        f"{PRINTED}: no such observer of the post of node {watch.name!r} exists: rank(C B) = "
        f"{said.rank_cb} and rank(B) = {said.rank_b}, and Eq. (3.31) wants them equal. Sampled "
        f"every {dt_s:g} s the ranks agree, but a zero at {said.zero:.3f} hides a motion that "
        f"lasts for {lasts_s:.1f} s; use {KINEMATIC} or sway-kf"
    )


def run_kinematic(drive: Drive) -> Result:
    """The observed states of every post; DriveError where the drive has no poses of one."""
    found, verdicts = watches(drive, KINEMATIC)
    tables = [table(watch, *observed(watch)) for watch in found]
    return result(drive, KINEMATIC, tables, verdicts, causal=True, mode="observer")


def observed(watch: Watch) -> tuple[Array, Array, Array, Array]:
    """Displacement and velocity (k, 2) of the tip and their sigmas, both axes alike."""
    p_m, sigma_m = combined(watch)
    dt_s = watch.steps_s[:, None]
    v_mps = np.concatenate([np.zeros((1, 2)), np.diff(p_m, axis=0) / dt_s])
    spread = np.hypot(sigma_m[1:], sigma_m[:-1])
    sigma_v = np.concatenate([np.full((1, 2), np.nan), spread / dt_s])
    x = np.zeros_like(p_m)
    x[0] = p_m[0]
    for k, step_s in enumerate(watch.steps_s):
        # z' = F z + K y of straight lines, solved: the error to the pose dies, whatever the load.
        x[k + 1] = p_m[k + 1] + np.exp(-CORRECTION_PER_S * step_s) * (x[k] - p_m[k])
    return x, v_mps, sigma_m, sigma_v


def combined(watch: Watch) -> tuple[Array, Array]:
    """Displacement (k, 2) from all that is told of an instant, angles included, and its sigma."""
    slope = watch.post.tip_slope_per_m
    signs = np.array([1.0, -1.0])
    told = np.concatenate([watch.told[:, :2], signs * watch.told[:, :1:-1] / slope], -1)
    weight = np.concatenate([watch.sigmas[:, :2], watch.sigmas[:, :1:-1] / slope], -1) ** -2.0
    weight = np.where(np.isfinite(told), weight, 0.0)
    # Rows of one instant are added up.
    member = watch.state == np.arange(len(watch.t_ns))[:, None]
    total, moment = member @ weight, member @ (weight * np.nan_to_num(told))
    total, moment = total[:, :2] + total[:, 2:], moment[:, :2] + moment[:, 2:]
    return moment / total, total**-0.5


def _period_s(watch: Watch) -> float:
    if len(watch.t_ns) < 2:
        raise DriveError(f"node {watch.name!r}: two poses are needed to speak of a period")
    return float(np.median(watch.steps_s))
