"""What always stands in a fixed LiDAR's view, as voxels: learnt from frames, then taken away.

Lee et al. (2021), section III-B: "background removal and then clustering in a Voxel grid
representation"; the paper says no more. A voxel is background where it holds points in a stated
share of the learning frames. So a car that passes is not, and one that stands for most of these
frames is.

Beams lie apart: on a wall 40 m away by 0.7 m. A node that sways moves them to where other frames
had none. So what a frame fills grows by one voxel before it is counted, the ground's layer sideways
alone, or it would swallow the feet of what stands there; and gaps in upright columns are filled.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc.errors import InputError
from fgloc.measurements import Array
from fgloc.perception.lidar_settings import LidarConfig

Keys = NDArray[np.int64]

_BITS = 20
_HALF = 1 << (_BITS - 1)
"""Voxels are counted from the node up to so far each way; 150 m are 500 of them."""
LEAST_FRAMES = 2


@dataclass(frozen=True, eq=False)
class VoxelBackground:
    """Voxels of a fixed view that are background.

    keys      (K,) rising: place of each along x, then y, then z, in one number
    voxel_m   their side
    ground_m  z of the ground, in the middle of a layer
    """

    keys: Keys
    voxel_m: float
    ground_m: float

    @classmethod
    def learn(
        cls, clouds: Iterable[Array], ground_m: float, config: LidarConfig | None = None
    ) -> "VoxelBackground":
        """The background of some frames, points (M, 3) each in the node's axes.

        Raises InputError for fewer than two frames that hold points.
        """
        config = config or LidarConfig()
        plain = cls(np.empty(0, np.int64), config.voxel_m, ground_m)
        frames = [_grown(_distinct([plain.key(cloud)])) for cloud in clouds if len(cloud)]
        if len(frames) < LEAST_FRAMES:
            raise InputError(
                f"the background needs {LEAST_FRAMES} clouds with points, there are {len(frames)}"
            )
        keys, count = np.unique(np.concatenate(frames), return_counts=True)
        keys = keys[count >= max(LEAST_FRAMES, config.least_share * len(frames))]
        keys = _filled(keys, round(config.fill_m / config.voxel_m))
        return cls(keys, config.voxel_m, ground_m)

    def key(self, points_m: Array) -> Keys:
        """The number (N,) of the voxel that each point (N, 3) lies in."""
        from_ground = np.asarray(points_m, float) - [0, 0, self.ground_m]
        place = np.floor(from_ground / self.voxel_m + [0, 0, 0.5]).astype(np.int64)
        return _key(np.clip(place + _HALF, 1, 2 * _HALF - 2))

    def holds(self, points_m: Array) -> NDArray[np.bool_]:
        """(N,) bool: which points (N, 3) are background."""
        key = self.key(points_m)
        at = np.minimum(np.searchsorted(self.keys, key), max(len(self.keys) - 1, 0))
        return self.keys[at] == key if len(self.keys) else np.zeros(len(key), bool)


def _key(place: Keys) -> Keys:
    return np.asarray((place[:, 0] << 2 * _BITS) | (place[:, 1] << _BITS) | place[:, 2])


def _filled(keys: Keys, gap: int) -> Keys:
    """The voxels and those between two of a column that are at most `gap` layers apart. Keys of one
    column follow each other, its z being their lowest digits."""
    step = np.diff(keys)
    between = np.where(step <= gap, step - 1, 0)  # in a column; columns are farther apart
    start = np.repeat(keys[:-1], between)
    nth = np.arange(len(start)) - np.repeat(np.cumsum(between) - between, between)
    return np.union1d(keys, start + nth + 1)


def _grown(keys: Keys) -> Keys:
    """The voxels and their neighbours, rising: those of the ground's layer, or below, sideways
    alone."""
    above = keys[(keys & ((1 << _BITS) - 1)) > _HALF]
    keys = _distinct([keys, above - 1, above + 1])
    for step in (1 << _BITS, 1 << 2 * _BITS):
        keys = _distinct([keys - step, keys, keys + step])
    return keys


def _distinct(parts: list[Keys]) -> Keys:
    keys = np.sort(np.concatenate(parts))
    return keys[np.concatenate([[True], keys[1:] != keys[:-1]])]
