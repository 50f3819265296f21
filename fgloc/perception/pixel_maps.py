"""Other maps from box centres to the road, with the interface of `IdwMap`: what it is held against.

A homography takes the road and the box centre's height above it to be flat; linear interpolation
(Delaunay) takes the image to be flat between three calibration points.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fgloc.errors import InputError
from fgloc.measurements import Array
from fgloc.perception.idw import Calibration


@dataclass(frozen=True, eq=False)
class HomographyMap:
    """One projective map (3, 3) by least squares; InputError where the points allow none."""

    calibration: Calibration
    matrix: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        import cv2

        points, places = self.calibration.u_px, self.calibration.p_world_m
        matrix, _ = cv2.findHomography(points, places, 0)
        if matrix is None or not np.isfinite(matrix).all():
            raise InputError("calibration: no homography fits; do the centres lie on one line?")
        object.__setattr__(self, "matrix", matrix)

    def place(self, u_px: ArrayLike) -> Array:
        """Positions (M, 2); beyond the horizon they lie behind the camera."""
        u = np.asarray(u_px, float)
        mapped = np.c_[u, np.ones(len(u))] @ self.matrix.T
        return mapped[:, :2] / mapped[:, 2:]

    def without_own(self) -> Array:
        """Positions (N, 2) of the calibration's centres, each by a fit to all the others."""
        u, p = self.calibration.u_px, self.calibration.p_world_m
        others = ~np.eye(len(u), dtype=bool)
        return np.concatenate([HomographyMap(Calibration(u[o], p[o])).place(u[~o]) for o in others])


@dataclass(frozen=True, eq=False)
class LinearMap:
    """Linear between the three calibration points around a centre, NaN outside of all of them."""

    calibration: Calibration

    @cached_property
    def _interpolator(self) -> Any:
        from scipy.interpolate import LinearNDInterpolator
        from scipy.spatial import QhullError

        try:
            return LinearNDInterpolator(self.calibration.u_px, self.calibration.p_world_m)
        except QhullError as err:
            raise InputError(
                "calibration: the centres lie on one line; drive elsewhere too"
            ) from err

    def place(self, u_px: ArrayLike) -> Array:
        """Positions (M, 2), NaN outside of the hull of the calibration's centres."""
        return np.asarray(self._interpolator(np.asarray(u_px, float)), float)

    def without_own(self) -> Array:
        """Positions (N, 2) of the centres, each from a mesh of the others; NaN on the hull."""
        u, p = self.calibration.u_px, self.calibration.p_world_m
        others = ~np.eye(len(u), dtype=bool)
        return np.concatenate([LinearMap(Calibration(u[o], p[o])).place(u[~o]) for o in others])
