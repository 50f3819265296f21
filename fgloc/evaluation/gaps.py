"""Outages of GNSS, and how errors grow while they last."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgloc.arrays import Array, freeze
from fgloc.evaluation.against_truth import Errors
from fgloc.result import Result
from fgloc.timing import NS_PER_S, Instants
from fgloc.verdicts import Verdict, Verdicts

Spans = NDArray[np.int64]
"""(K, 2) instants: the start and the end of each outage."""

MIN_OUTAGE_S = 3.0
_MEDIANS = 3.0


def used_fixes_ns(verdicts: Verdicts, source: str = "gnss") -> Instants:
    """Instants of the measurements of a source that entered the estimate, in order of time."""
    rows = verdicts.get(source)
    if rows is None:
        return np.zeros(0, np.int64)
    used = rows.is_(Verdict.USED) | rows.is_(Verdict.DOWN_WEIGHTED)
    return np.sort(np.asarray(rows.t_ns, np.int64)[used])


def outages(
    gnss_t_ns: ArrayLike,
    *,
    min_length_s: float = MIN_OUTAGE_S,
    span_ns: tuple[int, int] | None = None,
) -> Spans:
    """Gaps (K, 2) between used fixes, from the last fix before to the first fix after.

    A gap is an outage where it lasts longer than `min_length_s` and than three median intervals,
    so that a receiver that gives a fix every five seconds is not forever in an outage. With
    `span_ns` the time before the first and after the last fix counts as well.
    """
    t = np.asarray(gnss_t_ns, np.int64)
    intervals_ns = np.diff(t)
    median_ns = float(np.median(intervals_ns)) if len(intervals_ns) else 0.0
    if span_ns is not None:
        inner = t[(t > span_ns[0]) & (t < span_ns[1])]
        t = np.concatenate([[span_ns[0]], inner, [span_ns[1]]]).astype(np.int64)
    gaps = np.flatnonzero(np.diff(t) > max(min_length_s * NS_PER_S, _MEDIANS * median_ns))
    return np.stack([t[gaps], t[gaps + 1]], -1) if len(gaps) else np.zeros((0, 2), np.int64)


def gnss_outages(result: Result, source: str = "gnss") -> Spans:
    """Outages (K, 2) of a result's GNSS, up to both ends of its trajectory.

    None where the source has no verdicts at all: without GNSS in a drive there is no outage.
    """
    rows, states = result.verdicts.get(source), result.trajectory.t_ns
    if rows is None or len(rows) == 0 or len(states) == 0:
        return np.zeros((0, 2), np.int64)
    return outages(
        used_fixes_ns(result.verdicts, source), span_ns=(int(states[0]), int(states[-1]))
    )


@dataclass(frozen=True, eq=False)
class Growth:
    """Horizontal errors in outages: one row per outage, and a table over the time since its start.

    span_ns      (K, 2); length_s (K,); n (K,) truth rows strictly inside
    rmse_m       (K,) NaN where there is no truth inside
    end_m        (K,) error at the last truth inside, `end_since_s` (K,) after the outage began
    inside       (N,) bool, which rows of the errors lie in an outage
    bin_s        (B + 1,) edges of the table, seconds since the outage began
    bin_mean_m   (B,) mean error over all outages; bin_outages (B,) how many outages reach there
    """

    span_ns: Spans
    length_s: Array
    n: NDArray[np.int64]
    rmse_m: Array
    end_m: Array
    end_since_s: Array
    inside: NDArray[np.bool_]
    bin_s: Array
    bin_mean_m: Array
    bin_outages: NDArray[np.int64]


def error_growth(errors: Errors, outages: Spans) -> Growth:
    """Errors in each outage (K, 2) and their mean against the time since it began."""
    spans = np.asarray(outages, np.int64).reshape(-1, 2)
    lengths_s = (spans[:, 1] - spans[:, 0]) / NS_PER_S
    outage = _outage_of(errors.t_ns, spans)
    begun_ns = spans[outage, 0] if len(spans) else errors.t_ns
    since_s = (errors.t_ns - begun_ns) / NS_PER_S
    per_outage = [_in_one(errors.horizontal_m, since_s, outage == k) for k in range(len(spans))]
    n, rmse, end, end_since = np.array(per_outage, float).reshape(-1, 4).T
    edges = _edges_s(float(lengths_s.max(initial=0.0)))
    mean, count = _binned(errors.horizontal_m, since_s, outage, edges)
    return Growth(
        span_ns=freeze(spans, np.int64), length_s=lengths_s, n=n.astype(np.int64), rmse_m=rmse,
        end_m=end, end_since_s=end_since, inside=outage >= 0, bin_s=edges, bin_mean_m=mean,
        bin_outages=count,
    )  # fmt: skip


def _outage_of(t_ns: Instants, spans: Spans) -> NDArray[np.int64]:
    """Number of the outage that an instant lies strictly inside, -1 for none, (N,)."""
    k = np.searchsorted(spans[:, 0], t_ns, side="left") - 1
    inside = (k >= 0) & (t_ns < spans[k, 1]) if len(spans) else np.zeros(len(t_ns), bool)
    return np.where(inside, k, -1)


def _in_one(error_m: Array, since_s: Array, rows: np.ndarray) -> tuple[float, float, float, float]:
    """Count, RMSE, last error and its time since the start."""
    if not rows.any():
        return 0, np.nan, np.nan, np.nan
    inside = error_m[rows]
    return len(inside), float(np.sqrt(np.mean(inside**2))), inside[-1], since_s[rows][-1]


def _edges_s(longest_s: float) -> Array:
    """Edges of 1, 2 or 5 s wide bins, so that there are about twenty at most, up to 100 s."""
    width_s = 1.0 if longest_s <= 20 else 2.0 if longest_s <= 40 else 5.0
    return np.arange(int(np.ceil(longest_s / width_s)) + 1, dtype=np.float64) * width_s


def _binned(
    error_m: Array, since_s: Array, outage: NDArray[np.int64], edges: Array
) -> tuple[Array, NDArray[np.int64]]:
    """Mean error (B,) per bin, NaN where there is none, and the number of outages in it (B,)."""
    bins = np.clip(np.searchsorted(edges, since_s, side="right") - 1, 0, max(len(edges) - 2, 0))
    mean = np.full(len(edges) - 1, np.nan)
    count = np.zeros(len(edges) - 1, np.int64)
    for b in range(len(mean)):
        rows = (outage >= 0) & (bins == b)
        if rows.any():
            mean[b], count[b] = error_m[rows].mean(), len(np.unique(outage[rows]))
    return mean, count
