"""What detectors find: boxes in images, and cuboids among the points of a LiDAR.

Columns of one length N, read-only. `frame` counts the frames of the one sensor that a row is from,
from 0: frame k of a camera and frame k of a LiDAR are not the same instant.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from fgloc.arrays import Array, freeze
from fgloc.errors import InputError
from fgloc.frames import yaw_matrix
from fgloc.measurements import PEDESTRIAN, UNKNOWN, VEHICLE, check_symmetric

KINDS = (UNKNOWN, VEHICLE, PEDESTRIAN)


def upright_corners(centre_m: Array, size_m: Array, yaw_rad: Array) -> Array:
    """(N, 8, 3) corners of upright boxes of centre (N, 3), length, width and height (N, 3) and yaw
    (N,): the lower four counter-clockwise from the one at the rear right, then the upper."""
    at = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
    unit = np.concatenate([np.column_stack([at, np.full(4, z)]) for z in (-0.5, 0.5)])
    R = yaw_matrix(yaw_rad)
    return np.asarray((unit * size_m[:, None]) @ R.swapaxes(1, 2) + centre_m[:, None])


@dataclass(frozen=True, eq=False)
class _Rows:
    """Columns of one length; InputError where a shape does not fit or a number is not finite."""

    frame: NDArray[np.int64]

    NAME: ClassVar[str]
    SHAPES: ClassVar[dict[str, tuple[int, ...]]]
    WHOLE: ClassVar[frozenset[str]]

    def __post_init__(self) -> None:
        for one in fields(self):
            dtype = np.int64 if one.name in self.WHOLE else np.float64
            column = freeze(getattr(self, one.name), dtype)
            expected = (len(self.frame), *self.SHAPES.get(one.name, ()))
            if column.shape != expected:
                raise InputError(
                    f"{self.NAME}.{one.name} has shape {column.shape}, expected {expected}"
                )
            object.__setattr__(self, one.name, column)
            self.check(one.name, ~np.isfinite(column), "expected finite numbers")
        self.check("frame", self.frame < 0, "frames count from 0")

    def __len__(self) -> int:
        return len(self.frame)

    def take(self, index: Any) -> Self:
        """The rows that a slice, mask or index array selects."""
        return replace(self, **{f.name: getattr(self, f.name)[index] for f in fields(self)})

    @classmethod
    def concat(cls, parts: Sequence[Self]) -> Self:
        """The rows of some tables one after the other; none where there are no tables."""
        return cls(*(
            np.concatenate([np.empty((0, *cls.SHAPES.get(f.name, ()))),
                            *(getattr(part, f.name) for part in parts)])
            for f in fields(cls)
        ))  # fmt: skip

    @classmethod
    def none(cls) -> Self:
        """A table without rows."""
        return cls.concat([])

    def check(self, name: str, bad: NDArray[np.bool_], wanted: str) -> None:
        """Raise InputError at the first row of a column that is bad."""
        rows = np.flatnonzero(bad.any(tuple(range(1, bad.ndim))))
        if len(rows):
            value = getattr(self, name)[rows[0]].tolist()
            raise InputError(f"{self.NAME} row {rows[0]}: {name} = {value}: {wanted}")


@dataclass(frozen=True, eq=False)
class ImageBoxes(_Rows):
    """2-D boxes of any detector.

    Raises InputError where a box has no width or height or a kind or score is none.

    frame    (N,) frame of the camera
    camera   (N,) number of the camera among the node's cameras
    box_px   (N, 4) left, upper, right, lower edge: right and down in px
    kind     (N,) `UNKNOWN`, `VEHICLE` or `PEDESTRIAN`
    score    (N,) the detector's own confidence, 0 to 1
    """

    camera: NDArray[np.int64]
    box_px: Array
    kind: NDArray[np.int64]
    score: Array

    NAME = "image boxes"
    SHAPES: ClassVar = {"box_px": (4,)}
    WHOLE: ClassVar = frozenset({"frame", "camera", "kind"})

    def __post_init__(self) -> None:
        super().__post_init__()
        low, high = self.box_px[:, :2], self.box_px[:, 2:]
        self.check("box_px", high <= low, "x0, y0, x1, y1 with x0 < x1 and y0 < y1 are needed")
        self.check("camera", self.camera < 0, "cameras count from 0")
        self.check("kind", ~np.isin(self.kind, KINDS), f"expected one of {KINDS}")
        self.check("score", (self.score < 0) | (self.score > 1), "expected 0 to 1")


@dataclass(frozen=True, eq=False)
class Cuboids(_Rows):
    """Upright cuboids around clusters of points.

    Raises InputError where a size or covariance is none.

    frame     (N,) frame of the head's LiDAR
    head      (N,) number of the head among the node's heads
    centre_m  (N, 3) in the node's level axes, origin at the node
    size_m    (N, 3) length, width, height; the length lies along the yaw
    yaw_rad   (N,) from the node's x axis to the length, counter-clockwise, in [-pi/2, pi/2): which
              end is the front a cuboid does not tell
    points    (N,) how many points of the cloud are on it
    cov_m2    (N, 2, 2) of the centre along the node's x and y
    """

    head: NDArray[np.int64]
    centre_m: Array
    size_m: Array
    yaw_rad: Array
    points: NDArray[np.int64]
    cov_m2: Array

    NAME = "cuboids"
    SHAPES: ClassVar = {"centre_m": (3,), "size_m": (3,), "cov_m2": (2, 2)}
    WHOLE: ClassVar = frozenset({"frame", "head", "points"})

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check("size_m", self.size_m <= 0, "expected m above 0")
        check_symmetric(self.NAME, self.cov_m2)

    def corners_m(self) -> Array:
        """(N, 8, 3) corners in the node's axes, as `upright_corners` has them."""
        return upright_corners(self.centre_m, self.size_m, self.yaw_rad)
