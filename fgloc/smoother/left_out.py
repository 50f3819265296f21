"""Measurements as all others predict them: what leaving each one out of a graph would give."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fgloc.factors import noise
from fgloc.measurements import Array
from fgloc.parallel import each, portions

ALONE = 1e-9
"""A measurement that leaves the rest of the graph less than this share of its own information is
all that holds its state."""
AT_ONCE = 8000
"""So many measurements are left out at a time."""


@dataclass(frozen=True, eq=False)
class LeftOut:
    """M measurements of d numbers, and their predictions by a graph without them.

    keys      (M,) keyframes
    error     (M, d) predicted minus measured
    cov       (M, d, d) covariance of the prediction
    own       (M, d, d) that of the measurement
    weight    (M,) what the loss gave it in the graph, 1 = full
    informed  (M,) bool: the others tell anything of it
    kept      (M,) bool: it is in the graph
    """

    keys: NDArray[np.int64]
    error: Array
    cov: Array
    own: Array
    weight: Array
    informed: NDArray[np.bool_]
    kept: NDArray[np.bool_]

    @cached_property
    def nis(self) -> Array:
        """(M,) of each measurement against all others; 0 where they tell nothing."""
        return np.where(self.informed, noise.nis(self.error, self.cov + self.own), 0.0)

    def take(self, rows: NDArray[np.bool_], dof: int) -> "LeftOut":
        """Those that a mask selects, of their first `dof` numbers."""
        few, square = slice(dof), (rows, slice(dof), slice(dof))
        return LeftOut(self.keys[rows], self.error[rows, few], self.cov[square], self.own[square],
                       self.weight[rows], self.informed[rows], self.kept[rows])  # fmt: skip


def leave_out(
    keys: NDArray[np.int64], error: Array, predicted: Array, own: Array, weight: Array,
    kept: NDArray[np.bool_],
) -> LeftOut:  # fmt: skip
    """Of residuals (M, d) at the optimum, predicted with covariances (M, d, d); `kept` are in it.

    With P the posterior of a measurement's prediction, R_w its covariance as it was weighted and r
    the residual, the prediction without it has the error R_w (R_w - P)^-1 r and the covariance
    R_w (R_w - P)^-1 R_w - R_w.
    """
    spread, without, informed = predicted.copy(), error.copy(), np.ones(len(error), bool)

    def fill(rows: NDArray[np.int64]) -> None:
        weighted = own[rows] / weight[rows, None, None]
        rest = weighted - predicted[rows]
        gain = weighted @ noise.inverse(rest)
        without[rows] = np.einsum("nij,nj->ni", gain, error[rows])
        spread[rows] = gain @ weighted - weighted
        least = ALONE * weighted.trace(axis1=1, axis2=2)
        share = least[:, None, None] * np.eye(error.shape[1])
        informed[rows] = noise.positive_definite(rest - share)

    rows = np.flatnonzero(kept)
    each(fill, [rows[part] for part in portions(len(rows), AT_ONCE)])
    return LeftOut(keys, without, spread, own, weight, informed, kept)
