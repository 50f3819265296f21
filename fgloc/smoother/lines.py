"""Straight lines through neighbouring samples: how fast what is measured changes."""

import numpy as np

from fgloc.measurements import Array
from fgloc.timing import Instants, elapsed_s

SLOPE_HALF_S = 0.5
"""Wheels at 50 Hz whose speeds are good to 0.1 m/s tell their acceleration to 0.05 m/s^2 by lines
over twice this; a car's acceleration lasts longer."""


class Lines:
    """Of each of n increasing times (n,), in s, the samples within `half_s` to either side, or both
    neighbours where those are farther.

    count   (n,) how many they are
    spread  (n,) sum of squares of their times about the mean, s^2: white noise of sigma s in the
            values leaves s over its root in the slope
    """

    def __init__(self, t_s: Array, half_s: float) -> None:
        n = len(t_s)
        first, stop = t_s.searchsorted(t_s - half_s), t_s.searchsorted(t_s + half_s, "right")
        self._low = np.minimum(first, np.maximum(np.arange(n) - 1, 0))
        self._high = np.maximum(stop, np.minimum(np.arange(n) + 2, n))
        self._t_s, self.count = t_s, self._high - self._low
        self.spread = np.maximum(self._sum(t_s**2) - self._sum(t_s) ** 2 / self.count, 1e-9)

    def slope(self, values: Array) -> Array:
        """Slopes (n, c) per second of values (n, c)."""
        zero = values - values[:1]
        middle = (self._sum(self._t_s) / self.count)[:, None]
        rise = self._sum(self._t_s[:, None] * zero) - middle * self._sum(zero)
        return np.asarray(rise / self.spread[:, None])

    def mean(self, values: Array) -> Array:
        """Means (n,) of values (n,)."""
        return np.asarray(self._sum(values) / self.count)

    def _sum(self, values: Array) -> Array:
        total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
        return np.asarray(total[self._high] - total[self._low])


def slopes(t_ns: Instants, values: Array) -> Array:
    """Slopes (n, c) per second of values (n, c) of which some may not be finite: 0 for those."""
    slope = np.zeros_like(values)
    rows = np.flatnonzero(np.isfinite(values).all(-1))
    rows = rows[np.append(True, np.diff(t_ns[rows]) > 0)[: len(rows)]]
    if len(rows) > 1:
        lines = Lines(elapsed_s(t_ns[rows], int(t_ns[rows[0]])), SLOPE_HALF_S)
        slope[rows] = lines.slope(values[rows])
    return slope
