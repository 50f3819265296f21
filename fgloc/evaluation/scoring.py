"""The named metrics of an estimate against the truth."""

from collections.abc import Callable

import numpy as np

from fgloc.evaluation.against_truth import MAX_GAP_S, Errors, errors
from fgloc.evaluation.bootstrap import Bootstrap, Interval
from fgloc.evaluation.consistency import anees_band, chi2_quantile, effective_samples
from fgloc.evaluation.gaps import Spans, error_growth
from fgloc.evaluation.metric import Better, Metric
from fgloc.measurements import Array
from fgloc.parallel import each
from fgloc.timing import Instants, seconds_to_ns
from fgloc.trajectory import Trajectory

Statistic = Callable[[Array, Instants], tuple[float, Interval]]

_COURSE_NOTE = "by the truth's course, since it has no attitude"
_NEES = (
    ("pose", "nees_pose", 6, "position and attitude, 6 degrees of freedom"),
    ("position", "nees_position", 3, "position, 3 degrees of freedom"),
    ("horizontal", "nees_horizontal", 2, "East and North, 2 degrees of freedom"),
)


def score(
    estimate: Trajectory,
    truth: Trajectory,
    *,
    score_from_s: float = 0.0,
    outages: Spans | None = None,
    max_gap_s: float = MAX_GAP_S,
    bootstrap: Bootstrap | None = None,
) -> dict[str, Metric]:
    """Metrics by name; one that cannot be given has the value None and says why.

    `score_from_s` counts from the estimate's first state; truth before it is left out. With
    `outages` (K, 2) there are metrics of the errors inside them. Nothing is aligned: a constant
    offset counts. Raises InputError where the two are of different points of the vehicle and the
    estimate has no attitude.
    """
    start_ns = None
    if len(estimate):
        start_ns = int(estimate.t_ns[0]) + seconds_to_ns(score_from_s)
    return score_errors(
        errors(estimate, truth, score_from_ns=start_ns, max_gap_s=max_gap_s),
        outages=outages, bootstrap=bootstrap,
    )  # fmt: skip


def score_errors(
    e: Errors, *, outages: Spans | None = None, bootstrap: Bootstrap | None = None
) -> dict[str, Metric]:
    """The metrics of `score`, from errors that are already at hand."""
    b = bootstrap or Bootstrap()
    metrics: dict[str, Metric] = {}
    for part in each(lambda told: told(e, b), [_horizontal, _split, _heading, _consistency]):
        metrics |= part
    metrics["scored_share"] = _scored_share(e)
    if outages is not None:
        metrics |= _in_outages(e, outages)
    return metrics


def _horizontal(e: Errors, b: Bootstrap) -> dict[str, Metric]:
    x = e.horizontal_m
    return {
        "horizontal_rmse_m": _metric(e, x, _rmse(b)),
        "horizontal_mean_m": _metric(e, x, _mean(b)),
        "horizontal_std_m": _metric(e, x, _std(b)),
        "horizontal_p95_m": _metric(e, x, _p95(b)),
        "horizontal_max_m": _metric(e, x, lambda x, t_ns: (float(x.max()), (None, None))),
        "up_rmse_m": _metric(e, e.up_m, _rmse(b)),
    }


def _split(e: Errors, b: Bootstrap) -> dict[str, Metric]:
    """Lateral and longitudinal: RMSE, and mean and spread of the absolute error."""
    metrics = {}
    note = _COURSE_NOTE if e.course_based else ""
    for name in ("lateral", "longitudinal"):
        x, why = getattr(e, f"{name}_m"), e.why[f"{name}_m"]
        metrics[f"{name}_rmse_m"] = _metric(e, x, _rmse(b), why, note)
        metrics[f"{name}_mean_abs_m"] = _metric(e, np.abs(x), _mean(b), why, note)
        metrics[f"{name}_std_abs_m"] = _metric(e, np.abs(x), _std(b), why, note)
    return metrics


def _heading(e: Errors, b: Bootstrap) -> dict[str, Metric]:
    note = f"{_COURSE_NOTE}, above 4 m/s" if e.course_based else ""
    return {"yaw_rmse_rad": _metric(e, e.yaw_rad, _rmse(b), e.why["yaw_rad"], note, unit="rad")}


def _consistency(e: Errors, b: Bootstrap) -> dict[str, Metric]:
    """ANEES for pose, position and the plane, its band, and the share inside the 95 % ellipsoid.

    `anees` is that of the pose where it can be had, else of position, else of the plane.
    """
    metrics = {
        f"anees_{name}": _anees(e, getattr(e, column) / dof, b, e.why[column], note)
        for name, column, dof, note in _NEES
    }
    name, column, dof, _ = next(
        (row for row in _NEES if metrics[f"anees_{row[0]}"].value is not None), _NEES[1]
    )
    band = _band(getattr(e, column), dof, e.why[column])
    return {
        "anees": metrics[f"anees_{name}"], **band, **metrics,
        "coverage95": _coverage(e, b),
    }  # fmt: skip


def _anees(e: Errors, x: Array, b: Bootstrap, why: str, note: str) -> Metric:
    return _metric(e, x, _mean(b), why, note, unit="1", better="target", target=1.0)


def _band(x: Array, dof: int, why: str) -> dict[str, Metric]:
    """Where a consistent estimator's `anees` lies 95 times in 100, correlation accounted for."""
    x = x[np.isfinite(x)]
    if len(x) == 0:
        nothing = Metric(None, "1", "neither", why=why)
        return {"anees_band_low": nothing, "anees_band_high": nothing}
    n = effective_samples(x)
    note = f"as of {n:.0f} independent samples"
    low, high = (Metric(v, "1", "neither", len(x), note=note) for v in anees_band(n, dof))
    return {"anees_band_low": low, "anees_band_high": high}


def _coverage(e: Errors, b: Bootstrap) -> Metric:
    """Share of truth positions inside the ellipsoid that should hold 95 % of them."""
    x, dof, note = e.nees_position, 3, "position, 3 degrees of freedom"
    if not np.isfinite(x).any() and np.isfinite(e.nees_horizontal).any():
        x, dof, note = e.nees_horizontal, 2, "East and North, 2 degrees of freedom"
    inside = np.where(np.isfinite(x), x <= chi2_quantile(0.95, dof), np.nan)
    why = e.why["nees_position"]
    return _metric(e, inside, _mean(b), why, note, unit="1", better="target", target=0.95)


def _scored_share(e: Errors) -> Metric:
    """How much of the truth was scored at all, and what became of the rest."""
    if e.n_truth == 0:
        return Metric(None, "1", "higher", why="the truth is empty")
    note = "; ".join(f"{n} rows {reason}" for reason, n in e.left_out.items())
    return Metric(len(e) / e.n_truth, "1", "higher", e.n_truth, note=note)


def _in_outages(e: Errors, outages: Spans) -> dict[str, Metric]:
    """How many outages there were and how large the horizontal error became in them."""
    growth = error_growth(e, outages)
    inside, ends = e.horizontal_m[growth.inside], growth.end_m[np.isfinite(growth.end_m)]
    why = "there was no outage" if len(growth.span_ns) == 0 else "there is no truth in the outages"
    values = {"outage_rmse_m": (np.sqrt(np.mean(inside**2)) if len(inside) else None, len(inside))}
    values["outage_end_mean_m"] = (ends.mean() if len(ends) else None, len(ends))
    values["outage_end_max_m"] = (ends.max() if len(ends) else None, len(ends))
    count = len(growth.span_ns)
    return {"outage_count": Metric(float(count), "1", "neither", count)} | {
        name: Metric(None, "m", why=why) if value is None else Metric(float(value), "m", n=n)
        for name, (value, n) in values.items()
    }


def _metric(
    e: Errors,
    x: Array,
    statistic: Statistic,
    why: str = "",
    note: str = "",
    *,
    unit: str = "m",
    better: Better = "lower",
    target: float | None = None,
) -> Metric:
    """A statistic of the rows of a column (N,) that are known."""
    known = np.isfinite(x)
    if not known.any():
        why = "no truth row could be scored" if len(e) == 0 else why
        return Metric(None, unit, better, target=target, why=why)
    value, (low, high) = statistic(x[known], e.t_ns[known])
    missing = len(x) - int(known.sum())
    if missing and why:
        note = "; ".join(filter(None, [note, f"{missing} of {len(x)} rows unknown"]))
    return Metric(value, unit, better, int(known.sum()), low, high, target, note=note)


def _rmse(b: Bootstrap) -> Statistic:
    return lambda x, t_ns: (float(np.sqrt(np.mean(x**2))), b.rmse(x, t_ns))


def _mean(b: Bootstrap) -> Statistic:
    return lambda x, t_ns: (float(x.mean()), b.mean(x, t_ns))


def _std(b: Bootstrap) -> Statistic:
    return lambda x, t_ns: (float(x.std()), b.std(x, t_ns))


def _p95(b: Bootstrap) -> Statistic:
    return lambda x, t_ns: (float(np.quantile(x, 0.95)), b.quantile(x, t_ns, 0.95))
