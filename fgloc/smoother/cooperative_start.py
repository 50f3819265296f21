"""The car's first heading in the cooperative graph, where wheels and yaw rates tell its way."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from fgloc.correspondence.epochs import Epoch
from fgloc.correspondence.rigid import fit
from fgloc.measurements import Array
from fgloc.smoother.cooperative_odometry import OwnMotion

START_S, START_SIGMA_RAD = 10.0, 0.1
"""A heading begins once so much time tells it so well; rows about it are then off by 0.5 %."""


class Start:
    """The first heading: dead reckoning is laid over where the car was seen or says it is."""

    def __init__(self, ego: int, own: OwnMotion | None) -> None:
        self._ego, self._own = ego, own
        self._placed: list[tuple[int, Array, Array, float]] = []

    def heading(self, now: Epoch, arrived: Iterable[tuple[Epoch, NDArray[np.int64]]]) -> float:
        """At an instant, rad, with what came by then: rows of epochs; NaN until it is known."""
        if self._own is None:
            return np.nan
        if now.fix_m is not None and now.fix_R_m2 is not None:
            self._place(now.t_ns, now.fix_m, now.fix_R_m2)
        for epoch, rows in arrived:
            for i in rows[epoch.track[rows] == self._ego]:
                self._place(epoch.t_ns, epoch.z_m[i], epoch.R_m2[i])
        self._placed = [one for one in self._placed if now.t_ns - one[0] < START_S * 1e9]
        if len(self._placed) < 2:
            return np.nan
        _, reckoned, world, w = map(np.array, zip(*self._placed, strict=True))
        spread = reckoned - w @ reckoned / w.sum()
        if w @ (spread**2).sum(-1) < START_SIGMA_RAD**-2:
            return np.nan
        return fit(reckoned, world, w).yaw_rad + self._own.reckoned(now.t_ns)[1]

    def _place(self, t_ns: int, z_m: Array, R_m2: Array) -> None:
        if self._own is not None:
            weight = 2 / float(R_m2.trace())
            self._placed.append((t_ns, self._own.reckoned(t_ns)[0], z_m, weight))
