"""Inverse distance weighting: from a car's box in an image to its place on the road, unmodelled.

T. S. Marr, "Utilizing the Infrastructure for Ground Truth Based Localization", thesis, Texas A&M
University, 2019, section 2.4. A calibration drive pairs the box centre x_i in pixels with the
car's surveyed position v_i; a new centre x is mapped to the weighted mean of these positions.

    x, x_i   u_px, calibration.u_px   d     pixel distance
    v, f(x)  p_world_m                p     power, 5 was best in the thesis
    w_i      weights

# Differs from the paper: only the nearest `neighbours` points are summed, found by a tree; with
p = 5 the others hardly weigh. Beyond the calibrated part of the image a mean of positions stays
behind at its edge, so such a centre is refused (`inside`).
"""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgloc.arrays import Array, finite_rows, freeze
from fgloc.errors import InputError

POWER = 5.0
NEIGHBOURS = 32
LEAST_POINTS = 4
REACH = 3.0
"""A centre is inside where its nearest calibration point is at most so many spacings away."""
SPACING_QUANTILE = 0.9


@dataclass(frozen=True, eq=False)
class Calibration:
    """Box centres (N, 2) in px and positions (N, 2) East and North in m that belong together.

    `run` (N,) numbers the passes of the calibration drive, or is None. Raises InputError where
    shapes do not fit, there are fewer than four pairs, or one is not finite.
    """

    u_px: Array
    p_world_m: Array
    run: NDArray[np.int64] | None = None

    def __post_init__(self) -> None:
        if self.run is not None:
            object.__setattr__(self, "run", freeze(self.run, np.int64))
            if self.run.shape != self.u_px.shape[:1]:
                raise InputError(f"calibration: run has shape {self.run.shape}, expected (N,)")
        for name in ("u_px", "p_world_m"):
            object.__setattr__(self, name, freeze(getattr(self, name)))
        if self.u_px.shape != self.p_world_m.shape or self.u_px.shape[1:] != (2,):
            raise InputError(
                f"calibration: centres of shape {self.u_px.shape} and positions of shape "
                f"{self.p_world_m.shape}; both must be (N, 2)"
            )
        if len(self.u_px) < LEAST_POINTS:
            raise InputError(
                f"calibration: {len(self.u_px)} pairs; at least {LEAST_POINTS} are needed"
            )
        bad = ~finite_rows(self.u_px, self.p_world_m)
        if bad.any():
            raise InputError(f"calibration: pair {int(np.argmax(bad))} is not finite; remove it")

    def __len__(self) -> int:
        return len(self.u_px)

    def take(self, rows: NDArray[np.bool_]) -> "Calibration":
        """The pairs that a mask (N,) selects."""
        run = None if self.run is None else self.run[rows]
        return Calibration(self.u_px[rows], self.p_world_m[rows], run)


class PixelMap(Protocol):
    """What all maps from box centres to the road have in common."""

    def place(self, u_px: ArrayLike) -> Array:
        """Positions (M, 2) East and North in m of centres (M, 2); NaN where it knows of none."""
        ...

    def without_own(self) -> Array:
        """Positions (N, 2) of the calibration's own centres, each from all the others."""
        ...


@dataclass(frozen=True, eq=False)
class IdwMap:
    """The thesis's map. Raises InputError where `power` is not above 1 (the weight's p)."""

    calibration: Calibration
    power: float = POWER
    neighbours: int = NEIGHBOURS
    _tree: object = field(init=False, repr=False)

    def __post_init__(self) -> None:
        from scipy.spatial import cKDTree

        if not self.power > 1:
            raise InputError(
                f"power = {self.power}: the weights' p must be above 1 (the thesis: 5)"
            )
        if self.neighbours < 1:
            raise InputError(f"neighbours = {self.neighbours}: expected a whole number from 1")
        object.__setattr__(self, "_tree", cKDTree(self.calibration.u_px))

    def place(self, u_px: ArrayLike) -> Array:
        """Positions (M, 2); exact at a calibration point, never NaN: see `inside`."""
        distance, index = self._nearest(np.asarray(u_px, float), self.neighbours)
        return self._mean(distance, index)

    def without_own(self) -> Array:
        """Positions (N, 2) of the calibration's centres, each from all others but itself."""
        own = np.arange(len(self.calibration))[:, None]
        distance, index = self._nearest(self.calibration.u_px, self.neighbours + 1)
        distance = np.where(index == own, np.inf, distance)
        return self._mean(distance, index)

    def inside(self, u_px: ArrayLike) -> NDArray[np.bool_]:
        """(M,) bool: centres close enough to the calibration for the map to be one."""
        distance, _ = self._nearest(np.asarray(u_px, float), 1)
        return np.asarray(distance[:, 0] <= REACH * self.spacing_px)

    @property
    def spacing_px(self) -> float:
        """How far a calibration point has its nearest neighbour, in all but a tenth of cases."""
        distance, _ = self._nearest(self.calibration.u_px, 2)
        return float(np.quantile(distance[:, 1], SPACING_QUANTILE))

    def _nearest(self, u_px: Array, count: int) -> tuple[Array, NDArray[np.int64]]:
        """Pixel distances (M, k) and indices (M, k) of the nearest points, nearest first."""
        k = np.arange(1, min(count, len(self.calibration)) + 1)
        found: tuple[Array, NDArray[np.int64]] = self._tree.query(u_px, k)  # type: ignore[attr-defined]
        return found

    def _mean(self, distance: Array, index: NDArray[np.int64]) -> Array:
        """Eqs. (2.1), (2.3), (2.4) from the nearest points; scaled by the smallest distance, so
        that no power overflows and a distance of 0 takes all the weight."""
        least = distance.min(-1, keepdims=True)
        at_point = distance == least
        ratio = np.where(at_point, 1.0, least / np.where(at_point, 1.0, distance))
        weights = ratio**self.power
        weights /= weights.sum(-1, keepdims=True)
        return np.einsum("mk,mkj->mj", weights, self.calibration.p_world_m[index])
