"""Method `sway-kf`: a Kalman filter of each post with the wind's load as part of the state.

Not in Khamooshi (2023), whose observer has to work without any model of the load; see
`khamooshi2023_uio` for what that costs. The state is that of `fgloc.factors.post`: displacement,
velocity and load along both axes, the load an Ornstein-Uhlenbeck process whose sigma and memory
the drive states. Pose estimates enter one by one with the covariance that they state. Causal.
"""

import numpy as np

from fgloc.drive import Drive
from fgloc.factors import noise
from fgloc.factors.post import pose_jacobian, post_spread, post_step
from fgloc.measurements import Array
from fgloc.result import Result
from fgloc.sway import post_states, result
from fgloc.verdicts import SourceVerdicts
from fgloc.watches import SOURCE, Watch, watches

METHOD = "sway-kf"


def run_sway_kf(drive: Drive) -> Result:
    """The filtered states of every post; DriveError where the drive has no poses of one."""
    found, verdicts = watches(drive, METHOD)
    tables = [post_states(watch, *filtered(watch, verdicts[SOURCE])) for watch in found]
    return result(drive, METHOD, tables, verdicts, causal=True, mode="filter")


def filtered(watch: Watch, judged: SourceVerdicts) -> tuple[Array, Array]:
    """States (k, 6) and covariances (k, 6, 6) after all that is told up to their instant.

    The NIS of every row goes to its verdict.
    """
    x, P = np.zeros(6), post_spread(watch.post)
    states, covs = np.zeros((len(watch.t_ns), 6)), np.zeros((len(watch.t_ns), 6, 6))
    steps_s = np.concatenate([[0.0], watch.steps_s])
    for k, dt_s in enumerate(steps_s):
        if dt_s > 0:
            step = post_step(watch.post, dt_s)
            x, P = step.transition @ x, step.transition @ P @ step.transition.T + step.noise
        for row in watch.rows_of(k):
            x, P = _update(x, P, watch, row, judged)
        states[k], covs[k] = x, P
    return states, covs


def _update(
    x: Array, P: Array, watch: Watch, row: int, judged: SourceVerdicts
) -> tuple[Array, Array]:
    known = np.isfinite(watch.told[row])
    H = pose_jacobian(watch.post.tip_slope_per_m)[known]
    R = np.diag(watch.sigmas[row, known] ** 2)
    error = watch.told[row, known] - H @ x
    S = H @ P @ H.T + R
    K = np.linalg.solve(S, H @ P).T
    judged.nis[watch.rows[row]], judged.dof[watch.rows[row]] = noise.nis(error, S), len(error)
    rest = np.eye(6) - K @ H
    return x + K @ error, rest @ P @ rest.T + K @ R @ K.T
