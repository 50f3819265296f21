"""Intervals of error statistics by the circular block bootstrap.

Politis, Romano, A circular block-resampling procedure for stationary data (1992). Errors along a
drive are correlated; drawing whole stretches of time keeps that correlation, where drawing single
rows would give intervals that are far too narrow.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from fgloc.errors import InputError
from fgloc.evaluation.against_truth import Errors
from fgloc.evaluation.metric import Metric
from fgloc.measurements import Array
from fgloc.timing import Instants

Interval = tuple[float, float] | tuple[None, None]

_MAX_QUANTILE_ROWS = 2000
"""Quantiles are resampled from at most this many rows, one of each stretch: close rows say the
same."""
_MIN_ROWS = 8


@dataclass(frozen=True)
class Bootstrap:
    """How to resample: blocks of `block_s`, at most a quarter of the whole, seeded."""

    block_s: float = 10.0
    resamples: int = 500
    probability: float = 0.95
    seed: int = 0

    def mean(self, x: Array, t_ns: Instants) -> Interval:
        """Interval of the mean of a series (N,) at its instants."""
        return self._of_means([x], t_ns, lambda mean: mean)

    def rmse(self, x: Array, t_ns: Instants) -> Interval:
        """Interval of the root mean square."""
        return self._of_means([x**2], t_ns, lambda square: np.sqrt(np.maximum(square, 0.0)))

    def std(self, x: Array, t_ns: Instants) -> Interval:
        """Interval of the standard deviation."""
        return self._of_means(
            [x, x**2], t_ns, lambda mean, square: np.sqrt(np.maximum(square - mean**2, 0.0))
        )

    def quantile(self, x: Array, t_ns: Instants, share: float) -> Interval:
        """Interval of a quantile, e.g. share 0.95."""
        if len(x) < _MIN_ROWS:
            return None, None
        rows = self._thinned(len(x))
        x, t_ns = x[rows], t_ns[rows]
        length = self.block_rows(t_ns)
        rows = (self._starts(len(x), length)[..., None] + np.arange(length)) % len(x)
        return self._interval(np.quantile(x[rows.reshape(len(rows), -1)], share, axis=1))

    def block_rows(self, t_ns: Instants) -> int:
        """Length of a block in rows, at the median spacing of the instants."""
        spacing_s = max(float(np.median(np.diff(t_ns))) / 1e9, 1e-9)
        return int(np.clip(round(self.block_s / spacing_s), 1, max(len(t_ns) // 4, 1)))

    def resampled_means(self, columns: Array, t_ns: Instants) -> Array:
        """Means (resamples, k) of columns (N, k), all drawn at the same rows."""
        n, length = len(columns), self.block_rows(t_ns)
        around = np.concatenate([columns, columns[: length - 1]])
        total = np.concatenate([np.zeros((1, columns.shape[1])), np.cumsum(around, axis=0)])
        blocks = (total[length:] - total[:-length]) / length
        starts = self._starts(n, length)
        return np.stack([column[starts].mean(axis=-1) for column in blocks.T.copy()], -1)

    def _thinned(self, n: int) -> np.ndarray:
        """A row of each stretch of n, drawn at random: rows evenly apart could beat with errors
        that come and go between two fixes, and see only the largest or the smallest of them."""
        step = -(-n // _MAX_QUANTILE_ROWS)
        first = np.arange(0, n, step)
        ahead = np.random.default_rng(self.seed).integers(0, step, len(first))
        return np.minimum(first + ahead, n - 1)

    def _of_means(
        self, columns: list[Array], t_ns: Instants, statistic: Callable[..., Array]
    ) -> Interval:
        """Interval of what is made of the means of columns (N,) that are drawn at the same rows."""
        if len(t_ns) < _MIN_ROWS:
            return None, None
        return self._interval(statistic(*self.resampled_means(np.stack(columns, -1), t_ns).T))

    def _starts(self, n: int, length: int) -> np.ndarray:
        """First rows (resamples, blocks) of as many blocks as fill a series of n rows."""
        return _drawn(self.seed, n, self.resamples, -(-n // length))

    def _interval(self, values: Array) -> Interval:
        tail = (1 - self.probability) / 2
        low, high = np.quantile(values, [tail, 1 - tail])
        return float(low), float(high)


@lru_cache(maxsize=2)
def _drawn(seed: int, n: int, resamples: int, blocks: int) -> np.ndarray:
    """Random rows (resamples, blocks) below n; all columns of a drive are drawn at the same."""
    return np.random.default_rng(seed).integers(0, n, (resamples, blocks))


def paired_difference(
    errors_a: Errors,
    errors_b: Errors,
    *,
    column: str = "horizontal_m",
    bootstrap: Bootstrap | None = None,
) -> Metric:
    """RMSE of a minus RMSE of b in one column, over the instants both have.

    Below zero means that a is better; where the interval leaves out zero, the difference is more
    than the luck of this drive. Both are drawn at the same rows, so what is common to both (a hard
    stretch of road) cancels. Raises InputError where the two share no instant.
    """
    values, t_ns = _paired(errors_a, errors_b, column)
    squares = values**2
    low, high = _difference_interval(squares, t_ns, bootstrap or Bootstrap())
    rmse = np.sqrt(squares.mean(axis=0))
    unit = "rad" if column.endswith("_rad") else "m"
    return Metric(float(rmse[0] - rmse[1]), unit, "lower", len(squares), low, high)


def _difference_interval(squares: Array, t_ns: Instants, bootstrap: Bootstrap) -> Interval:
    if len(squares) < _MIN_ROWS:
        return None, None
    rmse = np.sqrt(np.maximum(bootstrap.resampled_means(squares, t_ns), 0.0))
    return bootstrap._interval(rmse[:, 0] - rmse[:, 1])


def paired_ratio(
    errors_a: Errors,
    errors_b: Errors,
    *,
    column: str = "horizontal_m",
    bootstrap: Bootstrap | None = None,
) -> Metric:
    """Mean of a over the mean of b in one column of errors that are not negative, paired as in
    `paired_difference`; below 1 means that a is better.

    Raises InputError where the two share no instant.
    """
    values, t_ns = _paired(errors_a, errors_b, column)
    mean = values.mean(axis=0)
    if mean[1] == 0:
        return Metric(None, "1", why="what it is compared to has no error")
    low, high = None, None
    if len(values) >= _MIN_ROWS:
        b = bootstrap or Bootstrap()
        drawn = b.resampled_means(values, t_ns)
        low, high = b._interval(drawn[:, 0] / np.maximum(drawn[:, 1], 1e-12))
    return Metric(float(mean[0] / mean[1]), "1", "lower", len(values), low, high)


def paired_means(
    errors_a: Errors, errors_b: Errors, *, column: str = "horizontal_m"
) -> tuple[float, float]:
    """The means that `paired_ratio` is of; raises InputError where the two share no instant."""
    a, b = _paired(errors_a, errors_b, column)[0].mean(axis=0)
    return float(a), float(b)


def _paired(errors_a: Errors, errors_b: Errors, column: str) -> tuple[Array, Instants]:
    """A column of both (n, 2) at the instants (n,) at which both are known."""
    _, rows_a, rows_b = np.intersect1d(errors_a.t_ns, errors_b.t_ns, return_indices=True)
    both = np.stack([getattr(errors_a, column)[rows_a], getattr(errors_b, column)[rows_b]], -1)
    known = np.isfinite(both).all(-1)
    if not known.any():
        raise InputError(f"the two estimates have no instant in common where {column} is known")
    return both[known], errors_a.t_ns[rows_a][known]
