"""The graph of a drive that reads Smart Codes and tells its velocity: whole, or over a fixed lag.

Fixes, where there are any, are not used: like the documented filter it lives on signs alone. Errors
of speed and heading are variables, and for each size of sign a bias of the ranges to it, or where
the corners are told a share of its side.
"""

from dataclasses import asdict

import numpy as np

from fgloc.drive import Drive
from fgloc.factors.noise import weight
from fgloc.measurements import Array
from fgloc.result import Result
from fgloc.smoother.codes_build import build
from fgloc.smoother.codes_model import CodeModel, CodeSettings
from fgloc.smoother.codes_sightings import BIASES, HEADING, SPEED
from fgloc.smoother.ranges_lag import run_lag
from fgloc.smoother.ranges_solve import covariances
from fgloc.smoother.ranges_start import optimize, with_priors
from fgloc.trajectory import Trajectory
from fgloc.verdicts import SourceVerdicts, Verdict, counts

SETTINGS = CodeSettings()
UNKNOWN_RAD2, UNKNOWN_M2, DOWN_WEIGHTED = np.pi**2 / 3, 1.0, 0.25


def smooth_codes(
    drive: Drive, lag_s: float | None = None, settings: CodeSettings = SETTINGS
) -> Result:
    """The estimate of a drive that reads Smart Codes; of the camera, on the level.

    Without `lag_s` all of the drive is solved at once; with it each state is given as it was when
    it was the newest, from the tenth sighting on. The road is taken to be at up = 0. Raises
    DriveError where velocities, a camera or ten sightings are missing.
    """
    verdicts = {
        name: SourceVerdicts.of(name, table, Verdict.UNUSED, "no factor in the Smart Code graph")
        for name, table in drive.tables.items()
    }
    model = build(drive, settings, verdicts["smart_codes"])
    verdicts["velocity"].set(slice(None), Verdict.USED)
    states, globals_, _ = optimize(model, model.first_path(), model.prior[0])
    online = run_lag(model, states, globals_, lag_s or float("1e9"))
    if lag_s is None:
        states, globals_, _ = optimize(model, online.last, online.globals_)
        cov, _ = covariances(with_priors(model, states, globals_))
        trajectory = _trajectory(model, states, cov, 0, drive)
    else:
        states, globals_ = online.last, online.globals_
        trajectory = _trajectory(model, online.states, online.cov, online.first, drive)
    _judge(model, states, globals_, verdicts["smart_codes"])
    method = "graph-batch" if lag_s is None else "graph-lag"
    mode = {"mode": "batch"} if lag_s is None else {"mode": "fixed-lag", "lag_s": lag_s}
    summary = {
        "drive": drive.name,
        "method": method,
        "mode": mode["mode"],
        "states": len(trajectory),
        "factors": sum(one.size * len(one.at.row) for one in model.sightings)
        + len(model.epochs_ns)
        - 1,
        "counts": counts(verdicts),
        "origin": asdict(drive.origin),
        "duration_s": float(trajectory.t_ns[-1] - trajectory.t_ns[0]) / 1e9,
        "codes": {
            "speed_scale": float(1 + globals_[SPEED]),
            "heading_error_rad": float(globals_[HEADING]),
            "range_bias_m": globals_[BIASES : BIASES + model.biases].tolist(),
            "side_share": globals_[BIASES + model.biases :].tolist(),
        },
    }
    return Result(trajectory, verdicts, summary, method, causal=lag_s is not None, config=mode)


def _trajectory(
    model: CodeModel, states: Array, cov: Array, first: int, drive: Drive
) -> Trajectory:
    """The camera's positions from states (K, 2) with covariances (K, 2, 2)."""
    wide = np.zeros((len(states), 6, 6))
    wide[:, :2, :2] = cov
    wide[:, 2, 2], wide[:, 3:, 3:] = UNKNOWN_M2, UNKNOWN_RAD2 * np.eye(3)
    p_m = np.c_[states, np.full(len(states), model.height_m)]
    t_ns = model.epochs_ns[first : first + len(states)]
    camera = drive.rig.camera
    point = np.zeros(3) if camera is None else camera.p_veh_cam_m
    return Trajectory(t_ns, p_m, cov=wide, p_veh_point_m=point)


def _judge(model: CodeModel, states: Array, globals_: Array, verdicts: SourceVerdicts) -> None:
    """Verdicts on the sightings by what the loss made of them at the end."""
    for seen in model.sightings:
        error = model.errors(seen, states, globals_, 0, slice(None)).error
        norm = np.linalg.norm(error, axis=1)
        doubted = weight(norm, "cauchy", seen.loss_width) < DOWN_WEIGHTED
        verdicts.set(seen.at.row, Verdict.USED)
        verdicts.set(seen.at.row[doubted], Verdict.DOWN_WEIGHTED, "far from what all others say")
