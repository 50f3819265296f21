"""An estimate held against the truth: one row of errors per truth instant it covers."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from fgloc import frames
from fgloc.arrays import Array, freeze
from fgloc.errors import InputError
from fgloc.evaluation.consistency import leading_nees
from fgloc.parallel import each, portions
from fgloc.timing import Instants, elapsed_s
from fgloc.trajectory import Trajectory

MAX_GAP_S = 1.5
"""Truth between two states further apart than this is left out: the estimate said nothing there.
States once a second are still joined."""
MIN_SPEED_MPS = 1.0
"""Slower than this a truth without attitude has no direction."""
MIN_YAW_SPEED_MPS = 4.0
"""Slower than this the course of a truth without attitude is too rough to judge a heading by."""
AT_ONCE = 8000
"""So many rows of the truth are gone through at a time."""
_COURSE_SPAN_S = 0.5
"""Truth without velocity is differenced over this time, or noise of close rows would turn it."""


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors, estimate minus truth, at the truth's instants and the truth's point of the vehicle.

    t_ns             (N,)
    p_world_m        (N, 3) of position, ENU m
    longitudinal_m   (N,) along the truth's heading, positive ahead
    lateral_m        (N,) across it, positive to the left
    yaw_rad          (N,) in [-pi, pi)
    rotvec_rad       (N, 3) world-side rotation vector: R_estimate = Exp(rotvec) R_truth
    sigma_..         (N,) what the estimate claims for the four errors (with the truth's own
                     covariance added, where it has one)
    nees_position    (N,) 3 degrees of freedom; nees_horizontal 2; nees_pose 6
    course_based     True where the truth has no attitude and its course stands in: errors are
                     split above 1 m/s, yaw is judged above 4 m/s, side slip and a drive in
                     reverse count as yaw errors
    left_out         why and how many truth rows are not here; with N they add up to `n_truth`
    why              reason for each column that is NaN throughout

    A column is NaN where it is not known.
    """

    t_ns: Instants
    p_world_m: Array
    longitudinal_m: Array
    lateral_m: Array
    yaw_rad: Array
    rotvec_rad: Array
    sigma_longitudinal_m: Array
    sigma_lateral_m: Array
    sigma_up_m: Array
    sigma_yaw_rad: Array
    nees_horizontal: Array
    nees_position: Array
    nees_pose: Array
    course_based: bool
    n_truth: int
    left_out: Mapping[str, int]
    why: Mapping[str, str]

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, field.name, freeze(value, value.dtype.type))

    def __len__(self) -> int:
        return len(self.t_ns)

    @property
    def horizontal_m(self) -> Array:
        """Length of the horizontal error, (N,)."""
        return np.hypot(self.p_world_m[:, 0], self.p_world_m[:, 1])

    @property
    def up_m(self) -> Array:
        """Vertical error, (N,), positive where the estimate is too high."""
        return self.p_world_m[:, 2]


def check_points(estimate: Trajectory, truth: Trajectory) -> None:
    """Raise InputError where the two tell of different points and neither has an attitude."""
    own, point = estimate.p_veh_point_m, truth.p_veh_point_m
    turns = estimate.R_world_veh is not None or truth.R_world_veh is not None
    if not turns and not np.array_equal(own, point):
        raise InputError(
            f"the estimate is of the vehicle's point {own.tolist()} m and the truth of "
            f"{point.tolist()} m, and neither has an attitude to carry it from one to the other; "
            "give both for the same point, or an estimate with attitude"
        )


def errors(
    estimate: Trajectory,
    truth: Trajectory,
    *,
    score_from_ns: int | None = None,
    max_gap_s: float = MAX_GAP_S,
    min_speed_mps: float = MIN_SPEED_MPS,
) -> Errors:
    """Errors of an estimate at every truth instant that it covers.

    The estimate is interpolated to the truth's instants and carried to the truth's point of the
    vehicle through its own attitude; its covariance goes with it. Where the estimate has no
    attitude, such as GNSS alone, the truth is carried to the estimate's point instead. Truth rows
    before `score_from_ns`, outside the estimate's time, or between two states more than
    `max_gap_s` apart are left out and counted in `left_out`.

    Raises InputError where the points differ and neither has an attitude.
    """
    check_points(estimate, truth)
    if estimate.R_world_veh is None and truth.R_world_veh is not None:
        truth = truth.at_point(estimate.p_veh_point_m)
    keep, left_out = _covered(estimate, truth, score_from_ns, max_gap_s)
    headings, kept = [a[keep] for a in _headings(truth, min_speed_mps)], truth.take(keep)
    parts = each(lambda rows: _rows(estimate, kept.take(rows), *(a[rows] for a in headings)),
                 portions(max(len(kept), 1), AT_ONCE))  # fmt: skip
    columns: dict[str, Any] = {
        name: np.concatenate([part[name] for part in parts]) for name in parts[0]
    }
    return Errors(
        t_ns=kept.t_ns,
        **columns,
        course_based=truth.R_world_veh is None,
        n_truth=len(truth),
        left_out=left_out,
        why=_reasons(estimate, truth),
    )


def _rows(
    estimate: Trajectory, truth: Trajectory, heading: Array, yaw_truth: Array
) -> dict[str, Array]:
    """The columns of errors at some rows of the truth, all of which the estimate covers."""
    estimate = _at(estimate, truth)
    p_error = estimate.p_world_m - truth.p_world_m
    rotvec = _rotation_errors(estimate, truth)
    yaw = np.full(len(p_error), np.nan)
    if estimate.R_world_veh is not None:
        yaw = frames.wrap_pi(estimate.yaw_rad - yaw_truth)
    along = np.stack([np.cos(heading), np.sin(heading)], -1)
    across = np.stack([-np.sin(heading), np.cos(heading)], -1)
    return {
        "p_world_m": p_error,
        "longitudinal_m": (along * p_error[:, :2]).sum(-1),
        "lateral_m": (across * p_error[:, :2]).sum(-1),
        "yaw_rad": yaw,
        "rotvec_rad": rotvec,
        **_claims(estimate, truth, along, across, np.hstack([p_error, rotvec])),
    }


def _covered(
    estimate: Trajectory, truth: Trajectory, score_from_ns: int | None, max_gap_s: float
) -> tuple[np.ndarray, dict[str, int]]:
    """Which truth rows (M,) can be scored, and how many cannot for which reason."""
    t = truth.t_ns
    early = np.zeros(len(t), bool) if score_from_ns is None else t < score_from_ns
    if len(estimate) == 0:
        inside = near = np.zeros(len(t), bool)
    else:
        inside = (t >= estimate.t_ns[0]) & (t <= estimate.t_ns[-1])
        near = estimate.covers(t, max_gap_s)
    counts = {
        "before the start of scoring": int(early.sum()),
        "outside the time of the estimate": int((~early & ~inside).sum()),
        f"in a gap of the estimate over {max_gap_s:g} s": int((~early & inside & ~near).sum()),
    }
    return near & ~early, {reason: n for reason, n in counts.items() if n}


def _at(estimate: Trajectory, truth: Trajectory) -> Trajectory:
    """The estimate at the truth's instants and point."""
    at = estimate.at(truth.t_ns) if len(truth) else estimate.take(slice(0, 0))
    return at.at_point(truth.p_veh_point_m)


def _headings(truth: Trajectory, min_speed_mps: float) -> tuple[Array, Array]:
    """Direction (N,) to split errors by and direction (N,) to judge yaw by, NaN where unknown."""
    if truth.R_world_veh is not None:
        return truth.yaw_rad, truth.yaw_rad
    v = _velocity_mps(truth)
    speed, course = np.hypot(v[:, 0], v[:, 1]), np.arctan2(v[:, 1], v[:, 0])
    return (
        np.where(speed >= min_speed_mps, course, np.nan),
        np.where(speed >= MIN_YAW_SPEED_MPS, course, np.nan),
    )


def _velocity_mps(truth: Trajectory) -> Array:
    """Velocity (N, 3): the truth's own, or its positions differenced over half a second."""
    if truth.v_world_mps is not None or len(truth) < 2:
        return np.zeros((len(truth), 3)) if truth.v_world_mps is None else truth.v_world_mps
    t = elapsed_s(truth.t_ns, int(truth.t_ns[0]))
    before = np.maximum(t - _COURSE_SPAN_S / 2, t[0])
    after = np.minimum(t + _COURSE_SPAN_S / 2, t[-1])
    step = [np.interp(after, t, p) - np.interp(before, t, p) for p in truth.p_world_m.T]
    return np.stack(step, -1) / (after - before)[:, None]


def _rotation_errors(estimate: Trajectory, truth: Trajectory) -> Array:
    """World-side rotation vectors (N, 3) from truth to estimate, NaN where either is unknown."""
    if estimate.R_world_veh is None or truth.R_world_veh is None:
        return np.full((len(truth), 3), np.nan)
    return frames.log_so3(estimate.R_world_veh @ truth.R_world_veh.swapaxes(-1, -2))


def _claims(
    estimate: Trajectory, truth: Trajectory, along: Array, across: Array, error: Array
) -> dict[str, Array]:
    """The columns that come from covariance: sigmas and normalised squared errors."""
    names = (
        "sigma_longitudinal_m", "sigma_lateral_m", "sigma_up_m", "sigma_yaw_rad",
        "nees_horizontal", "nees_position", "nees_pose",
    )  # fmt: skip
    if estimate.cov is None:
        return {name: np.full(len(error), np.nan) for name in names}
    # The difference of two independent estimates has the sum of their covariances.
    cov = estimate.cov if truth.cov is None else estimate.cov + truth.cov
    flat = cov[:, :2, :2]
    columns = (
        _sigma(flat, along), _sigma(flat, across), np.sqrt(cov[:, 2, 2]),
        _sigma(cov[:, 3:, 3:], _yaw_gradient(estimate)),
        *leading_nees(error, cov, [2, 3, 6]),
    )  # fmt: skip
    return dict(zip(names, columns, strict=True))


def _sigma(cov: Array, direction: Array) -> Array:
    """Standard deviation (N,) of covariances (N, d, d) along directions (N, d)."""
    return np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", direction, cov, direction), 0.0))


def _yaw_gradient(estimate: Trajectory) -> Array:
    """How yaw changes with a world-side rotation, (N, 3); (0, 0, 1) where the vehicle is level."""
    if estimate.R_world_veh is None:
        return np.full((len(estimate), 3), np.nan)
    x, y, z = estimate.R_world_veh[:, :, 0].T
    flat = np.maximum(x**2 + y**2, 1e-12)
    return np.stack([-z * x / flat, -z * y / flat, np.ones_like(z)], -1)


def _reasons(estimate: Trajectory, truth: Trajectory) -> dict[str, str]:
    """Why columns are empty, by the column's name."""
    slow = "the truth has no attitude and never moves fast enough to have a course"
    why = dict.fromkeys(("lateral_m", "longitudinal_m", "yaw_rad"), slow)
    why["nees_pose"] = "a covariance is not positive definite in position and attitude"
    why["nees_position"] = "a covariance is not positive definite in position"
    why["nees_horizontal"] = "a covariance is not positive definite in East and North"
    if truth.R_world_veh is None:
        why |= dict.fromkeys(("rotvec_rad", "nees_pose"), "the truth has no attitude")
    if estimate.R_world_veh is None:
        no_attitude = ("yaw_rad", "rotvec_rad", "nees_pose", "sigma_yaw_rad")
        why |= dict.fromkeys(no_attitude, "the estimate has no attitude")
    if estimate.cov is None:
        claims = [f"sigma_{name}" for name in ("longitudinal_m", "lateral_m", "up_m", "yaw_rad")]
        claims += ["nees_horizontal", "nees_position", "nees_pose"]
        why |= dict.fromkeys(claims, "the estimate has no covariance")
    return why
