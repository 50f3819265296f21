"""The graph of a drive that measures ranges to anchors: a whole drive at once, or a fixed lag.

The states are planar; motion is the drive's odometry, or a velocity that stays about the same.
Scale and biases of the ranges, the tag's height and the yaw rate's bias are variables. Where the
drive starts is sought among many places and headings by the cost of its first part; no truth and
no fix is used.
"""

from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from fgloc.arrays import Array, finite_rows
from fgloc.drive import Drive
from fgloc.errors import DriveError
from fgloc.factors.noise import weight
from fgloc.frames import yaw_matrix
from fgloc.measurements import Odometry, Ranges
from fgloc.result import Result
from fgloc.smoother.ranges_lag import run_lag
from fgloc.smoother.ranges_model import (
    BIASES,
    HEIGHT,
    SCALE,
    TURN,
    ConstantVelocity,
    Motion,
    OdometrySteps,
    RangeModel,
    RangeSettings,
    range_errors,
)
from fgloc.smoother.ranges_solve import covariances
from fgloc.smoother.ranges_start import optimize, start, with_priors
from fgloc.timing import Instants, seconds_to_ns
from fgloc.trajectory import Trajectory
from fgloc.verdicts import SourceVerdicts, Verdict, counts

SETTINGS = RangeSettings()
UNKNOWN_RAD2, UNKNOWN_M2 = np.pi**2 / 3, 1.0
"""Variances of what a planar graph does not know: attitude, and height."""
DOWN_WEIGHTED = 0.25
"""Weight below which a range counts as one that the loss did not believe."""


def smooth_ranges(
    drive: Drive, lag_s: float | None = None, settings: RangeSettings = SETTINGS
) -> Result:
    """The estimate of a drive with ranges; of the tag, on the level.

    Without `lag_s` all of the drive is solved at once; with it each state is given as it was when
    it was the newest, from the end of the part that the start was found in. Raises DriveError where
    there are no ranges, SolverError where they do not determine the path.
    """
    verdicts = {
        name: SourceVerdicts.of(name, table, Verdict.UNUSED, "no factor in the range graph")
        for name, table in drive.tables.items()
    }
    model, used = build(drive, settings)
    states, globals_ = start(model)
    online = run_lag(model, states, globals_, lag_s or START_LAG_S)
    if lag_s is not None:
        trajectory = _trajectory(model, online.states, online.cov, online.first)
        states, globals_ = online.last, online.globals_
    else:
        states, globals_, _ = optimize(model, online.last, online.globals_)
        trajectory = _whole(model, states, globals_)
    _judge(model, states, globals_, used, verdicts)
    method = "graph-batch" if lag_s is None else "graph-lag"
    summary = {
        "drive": drive.name,
        "method": method,
        "mode": "batch" if lag_s is None else "fixed-lag",
        "states": len(trajectory),
        "factors": len(model.ranges) + len(model.epochs_ns) - 1,
        "counts": counts(verdicts),
        "origin": asdict(drive.origin),
        "duration_s": float(trajectory.t_ns[-1] - trajectory.t_ns[0]) / 1e9,
        "ranges": _globals(drive, globals_),
    }
    lag = {} if lag_s is None else {"lag_s": lag_s}
    return Result(trajectory, verdicts, summary, method, causal=lag_s is not None,
                  config={"mode": summary["mode"]} | lag)  # fmt: skip


START_LAG_S = 10.0
"""Of the pass that the whole-drive solution starts from."""


def build(drive: Drive, settings: RangeSettings) -> tuple[RangeModel, NDArray[np.int64]]:
    """The model of a drive, and which rows (M,) of its ranges it has.

    Raises DriveError where fewer than ten ranges are finite and within the odometry.
    """
    table = drive.tables.get("ranges")
    if not isinstance(table, Ranges):
        raise DriveError(f"drive {drive.name!r} has no ranges table")
    odometry = drive.tables.get("odometry")
    rows = np.flatnonzero(finite_rows(table.range_m, table.sigma_m))
    if isinstance(odometry, Odometry):
        t_ns = table.t_ns[rows]
        rows = rows[(t_ns >= odometry.t_ns[0]) & (t_ns <= odometry.t_ns[-1])]
    if len(rows) < 10:
        raise DriveError(f"drive {drive.name!r}: {len(rows)} ranges can be used, too few")
    ranges = table.take(rows)
    step_ns = seconds_to_ns(settings.interval_s)
    count = int((ranges.t_ns[-1] - ranges.t_ns[0]) // step_ns) + 2
    epochs_ns: Instants = ranges.t_ns[0] + np.arange(count, dtype=np.int64) * step_ns
    epoch = (ranges.t_ns - epochs_ns[0]) // step_ns
    share = (ranges.t_ns - epochs_ns[epoch]) / step_ns
    place_m = np.array([a.p_world_m for a in drive.infrastructure.anchors])[ranges.anchor]
    first_row = np.searchsorted(epoch, np.arange(count))
    motion: Motion = (
        OdometrySteps.of(odometry, epochs_ns, settings.slip_m_per_sqrt_s)
        if isinstance(odometry, Odometry)
        else ConstantVelocity(settings.interval_s, settings.accel_mps2_per_sqrt_hz)
    )
    model = RangeModel(epochs_ns, ranges, epoch, share, place_m, first_row, motion, settings,
                       len(drive.infrastructure.anchors))  # fmt: skip
    return model, rows


def _globals(drive: Drive, globals_: Array) -> dict[str, object]:
    """The globals by their names, for the summary."""
    biases = zip(drive.infrastructure.anchors, globals_[BIASES:], strict=True)
    return {
        "scale": float(globals_[SCALE]),
        "tag_height_m": float(globals_[HEIGHT]),
        "yaw_rate_bias_radps": float(globals_[TURN]),
        "bias_m": {anchor.name: float(bias) for anchor, bias in biases},
    }


def _whole(model: RangeModel, states: Array, globals_: Array) -> Trajectory:
    cov, _ = covariances(with_priors(model, states, globals_))
    return _trajectory(model, states, cov, 0)


def _trajectory(model: RangeModel, states: Array, cov: Array, first: int) -> Trajectory:
    """Poses from states (K, m) at the epochs from `first` on, with covariances (K, m, m)."""
    t_ns = model.epochs_ns[first : first + len(states)]
    wide = np.zeros((len(states), 6, 6))
    wide[:, :2, :2] = cov[:, :2, :2]
    wide[:, 2, 2] = UNKNOWN_M2
    wide[:, 3:, 3:] = UNKNOWN_RAD2 * np.eye(3)
    p_m = np.c_[states[:, :2], np.zeros(len(states))]
    if states.shape[1] == 3:
        wide[:, 5, 5], wide[:, :2, 5], wide[:, 5, :2] = cov[:, 2, 2], cov[:, :2, 2], cov[:, 2, :2]
        return Trajectory(t_ns, p_m, yaw_matrix(states[:, 2]), cov=wide)
    v_mps = np.c_[states[:, 2:4], np.zeros(len(states))]
    return Trajectory(t_ns, p_m, v_world_mps=v_mps, cov=wide)


def _judge(
    model: RangeModel, states: Array, globals_: Array, used: NDArray[np.int64],
    verdicts: dict[str, SourceVerdicts],
) -> None:  # fmt: skip
    """Verdicts on the ranges by what the loss made of them at the end, and on the odometry."""
    norm = np.abs(range_errors(model, states, globals_, 0, slice(None)).error[:, 0])
    doubted = weight(norm, "cauchy", model.settings.loss_width) < DOWN_WEIGHTED
    own = verdicts["ranges"]
    own.set(slice(None), Verdict.OUTSIDE, "not finite, or outside of the odometry's time")
    own.set(used, Verdict.USED)
    own.set(used[doubted], Verdict.DOWN_WEIGHTED, "far from what all others say")
    if "odometry" in verdicts and model.motion.size == 3:
        verdicts["odometry"].set(slice(None), Verdict.USED)
