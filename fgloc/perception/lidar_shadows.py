"""Which clusters stand partly in the shadow of something nearer.

Of a car whose rear a lorry hides, the rest would be taken for its near end and be lengthened the
wrong way, by metres. Nothing but something nearer gives a return beside a cluster, at the elevation
of its beams, from less far than the cluster itself: the ground there is farther.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fgloc.frames import wrap_pi
from fgloc.measurements import Array
from fgloc.perception.heads import Lidar

NEARER_M = 1.0
LEAST_SHARE = 0.5
"""Of the rays beside a cluster, at the elevations of its beams, that meet something nearer."""


def shadowed(
    lidar: Lidar, cloud_m: Array, parts: Sequence[Array], unseen_m: Array
) -> NDArray[np.bool_]:
    """(P,) bool: beside which clusters, points (N, 3) each, of a cloud (M, 3) something nearer
    hides as much as is unseen of it, (P,) across the line of sight; all in the node's axes."""
    azimuth, elevation, range_m = lidar.angles(cloud_m)
    result = np.zeros(len(parts), bool)
    for k, part in enumerate(parts):
        own_azimuth, own_elevation, own_range_m = lidar.angles(part)
        nearest_m = own_range_m.min()
        beams = np.unique(_beam(lidar, own_elevation))
        rays = len(beams) * unseen_m[k] / nearest_m / lidar.step_rad[0]
        near = range_m < nearest_m - NEARER_M
        near &= np.isin(_beam(lidar, elevation), beams)
        away = wrap_pi(azimuth[near] - own_azimuth[0])  # a full turn has a seam
        own = wrap_pi(own_azimuth - own_azimuth[0])
        for gap in (own.min() - away, away - own.max()):
            beside = (gap > 0) & (gap < unseen_m[k] / nearest_m)
            result[k] |= beside.sum() >= LEAST_SHARE * rays
    return result


def _beam(lidar: Lidar, elevation_rad: Array) -> Array:
    """(N,) number of the beam that sees each elevation (N,)."""
    return np.rint((elevation_rad - lidar.elevation_rad[0]) / lidar.step_rad[1])
