"""How far a map from pixels to the road can be trusted, from the calibration itself.

Each calibration point is placed by all the others; around a centre, the mean outer product of
these errors is the covariance of what the map says there. It grows where a pixel covers more road,
and where the boxes of two passes differ. Where the calibration numbers its passes, all of a point's
own pass is left out: its neighbours in time stand closer than any point of another drive will.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from fgloc.errors import InputError
from fgloc.measurements import Array
from fgloc.perception.idw import Calibration, PixelMap

NEIGHBOURS = 30
"""Errors that are averaged: a sigma from 30 of them is known to 13 %."""
LEAST_SIGMA_M = 0.05
"""What the survey of the calibration drive is good for; no covariance is smaller."""


def left_out(kind: Callable[[Calibration], PixelMap], calibration: Calibration) -> Array:
    """Positions (N, 2) of the calibration's centres, each by a map without it, or without its
    whole pass where passes are numbered. Raises InputError where there is only one pass."""
    if calibration.run is None:
        return kind(calibration).without_own()
    placed = np.empty_like(calibration.p_world_m)
    for run in np.unique(calibration.run):
        own = calibration.run == run
        placed[own] = kind(calibration.take(~own)).place(calibration.u_px[own])
    return placed


@dataclass(frozen=True, eq=False)
class ErrorMap:
    """Covariances over the image, by the leave-one-out errors (N, 2) in m of a calibration.

    Raises InputError where fewer than two points could be placed by the others.
    """

    calibration: Calibration
    error_m: Array
    neighbours: int = NEIGHBOURS
    _tree: object = field(init=False, repr=False)
    _outer_m2: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        from scipy.spatial import cKDTree

        placed = np.isfinite(self.error_m).all(-1)
        if placed.sum() < 2:
            raise InputError("calibration: too few points can be placed by the others")
        error = self.error_m[placed]
        object.__setattr__(self, "_tree", cKDTree(self.calibration.u_px[placed]))
        object.__setattr__(self, "_outer_m2", error[:, :, None] * error[:, None, :])

    @classmethod
    def of(
        cls, kind: Callable[[Calibration], PixelMap], calibration: Calibration,
        neighbours: int = NEIGHBOURS,
    ) -> "ErrorMap":  # fmt: skip
        """The error map of the pixel map that `kind` makes of a calibration."""
        return cls(calibration, left_out(kind, calibration) - calibration.p_world_m, neighbours)

    def covariance_m2(self, u_px: ArrayLike) -> Array:
        """(M, 2, 2) East and North in m^2 of what the map says at centres (M, 2), positive."""
        k = np.arange(1, min(self.neighbours, len(self._outer_m2)) + 1)
        _, index = self._tree.query(np.asarray(u_px, float), k)  # type: ignore[attr-defined]
        return self._outer_m2[index].mean(1) + LEAST_SIGMA_M**2 * np.eye(2)
