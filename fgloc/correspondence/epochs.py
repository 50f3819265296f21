"""What was measured at each instant, by track."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fgloc.drive import GnssBias
from fgloc.measurements import Array
from fgloc.timing import Instants
from fgloc.verdicts import SourceVerdicts


@dataclass(eq=False)
class Epoch:
    """What was measured at one instant, by track.

    node, track, z_m, R_m2   of nodes (n,), (n,), (n, 2) East and North, (n, 2, 2)
    fix_m, fix_R_m2          of the car itself (2,), (2, 2), or None
    seen, seen_m, seen_R_m2  by the car: track (m,), position in its axes (m, 2), covariance
    row, received_ns         (n,) of the nodes' sightings: row of the table, when it arrived
    yaw_rad, yaw_var         heading of the car, by what it sees and what nodes see; NaN if unknown
    told, told_m, told_R_m2  by other road users of themselves: track (u,), (u, 2), (u, 2, 2)
    """

    t_ns: int
    node: NDArray[np.int64]
    track: NDArray[np.int64]
    z_m: Array
    R_m2: Array
    row: NDArray[np.int64]
    received_ns: Instants
    fix_m: Array | None = None
    fix_R_m2: Array | None = None
    seen: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    seen_m: Array = field(default_factory=lambda: np.empty((0, 2)))
    seen_R_m2: Array = field(default_factory=lambda: np.empty((0, 2, 2)))
    yaw_rad: float = math.nan
    yaw_var: float = math.nan
    told: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    told_m: Array = field(default_factory=lambda: np.empty((0, 2)))
    told_R_m2: Array = field(default_factory=lambda: np.empty((0, 2, 2)))

    @classmethod
    def empty(cls, t_ns: int) -> "Epoch":
        """An instant at which nothing was measured."""
        none = np.empty(0, np.int64)
        return cls(t_ns, none, none, np.empty((0, 2)), np.empty((0, 2, 2)), none, none)


@dataclass(frozen=True, eq=False)
class Epochs:
    """All instants of a drive with their sightings by track; `ego` is the track of the car.

    users  the track of each road user that says where it is, by its number
    slow   the slow error of their own fixes, by track, of users and the car; none where it is white
    """

    epochs: list[Epoch]
    tracks: int
    ego: int
    verdicts: Mapping[str, SourceVerdicts]
    users: Mapping[int, int] = field(default_factory=dict)
    slow: Mapping[int, GnssBias] = field(default_factory=dict)

    @property
    def t_ns(self) -> Instants:
        """(N,) the instants."""
        return np.array([epoch.t_ns for epoch in self.epochs], np.int64)

    def with_instants(self, t_ns: Instants) -> "Epochs":
        """The same with empty ones at more instants."""
        more = [Epoch.empty(int(t)) for t in np.setdiff1d(t_ns, self.t_ns)]
        epochs = sorted([*self.epochs, *more], key=lambda epoch: epoch.t_ns)
        return replace(self, epochs=epochs)
