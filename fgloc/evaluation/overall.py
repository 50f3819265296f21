"""What comparisons come to over several drives, and under conditions such as being near a node."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fgloc.evaluation.bootstrap import Bootstrap
from fgloc.evaluation.metric import Metric
from fgloc.measurements import Array

MAIN = "horizontal_rmse_m"
"""The metric that methods are compared by over several drives."""
MEAN = "horizontal_mean_m"
AVERAGED = (
    MEAN, "horizontal_std_m", MAIN, "horizontal_p95_m", "lateral_rmse_m", "longitudinal_rmse_m",
    "anees_horizontal", "scored_share",
)  # fmt: skip
"""The metrics that are averaged over the drives under each condition."""
WHOLE = "whole drive"
"""The condition that every row of the truth fulfils."""


@dataclass(frozen=True)
class Scores:
    """Metrics by name, and how they compare to the first method; see `Row`.

    means  mean horizontal errors, this method's and the first one's, at the instants of both
    """

    metrics: Mapping[str, Metric]
    difference: Metric | None = None
    ratio: Metric | None = None
    means: tuple[float, float] | None = None

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        metrics = {name: metric.to_dict() for name, metric in self.metrics.items()}
        return {"metrics": metrics, "difference": plain(self.difference),
                "ratio": plain(self.ratio)}  # fmt: skip


@dataclass(frozen=True)
class Overall:
    """One method over several drives.

    mean        of the horizontal RMSE over `n` drives, with a Student-t interval
    difference  mean over the drives of what the rows say of the difference to the first method
    wall_s      time spent; `failed` how many drives it failed on
    """

    method: str
    mean: Metric
    difference: Metric | None
    wall_s: float
    failed: int

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "method": self.method, MAIN: self.mean.to_dict(), "difference": plain(self.difference),
            "wall_s": self.wall_s, "failed": self.failed,
        }  # fmt: skip


@dataclass(frozen=True)
class Standing:
    """One method under one condition, over several drives.

    averages  of the metrics `AVERAGED`, over the drives that have a value
    ratio     sum of the mean horizontal errors over that of the first method, at the instants that
              both were scored at; None for the first method
    """

    condition: str
    method: str
    averages: Mapping[str, Metric]
    ratio: Metric | None

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        averages = {name: metric.to_dict() for name, metric in self.averages.items()}
        return {"condition": self.condition, "method": self.method, "averages": averages,
                "ratio": plain(self.ratio)}  # fmt: skip


def plain(metric: Metric | None) -> dict[str, Any] | None:
    """A metric for JSON."""
    return None if metric is None else metric.to_dict()


def average(metrics: Sequence[Metric | None], *, signed: bool = False) -> Metric:
    """The mean over drives that have a value, with its Student-t interval from two drives on.

    Of a metric that is not `signed` no interval reaches below zero. One drive keeps its own.
    """
    known = [m for m in metrics if m is not None and m.value is not None]
    if not known:
        return Metric(None, "m", why="no drive has a value")
    if len(known) == 1:
        return replace(known[0], n=1, note="")
    from scipy.special import stdtrit  # 0.3 s to import

    x = np.array([m.value for m in known], float)
    mean = float(x.mean())
    half = float(stdtrit(len(x) - 1, 0.975) * x.std(ddof=1) / np.sqrt(len(x)))
    low = mean - half if signed else max(mean - half, 0.0)
    unit, better, target = known[0].unit, known[0].better, known[0].target
    return Metric(mean, unit, better, len(x), low, mean + half, target)


def ratio_over_drives(scores: Sequence[Scores]) -> Metric:
    """Of the mean errors at common instants, summed over drives; these are drawn anew for the
    interval. One drive keeps the ratio and the interval of its own."""
    pairs = [one.means for one in scores if one.means is not None]
    if len(pairs) < 2:
        alone = next((one.ratio for one in scores if one.ratio is not None), None)
        return alone or Metric(None, "1", why="no drive has a value for both")
    x: Array = np.array(pairs, float)
    if not x[:, 1].any():
        return Metric(None, "1", why="what it is compared to has no error")
    rng = np.random.default_rng(0)
    drawn = x[rng.integers(0, len(x), (Bootstrap().resamples, len(x)))].sum(axis=1)
    low, high = np.quantile(drawn[:, 0] / np.maximum(drawn[:, 1], 1e-12), [0.025, 0.975])
    value = float(x[:, 0].sum() / x[:, 1].sum())
    return Metric(value, "1", "lower", len(x), float(low), float(high))
