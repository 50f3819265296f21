"""What stands beside the road: nodes that see vehicles, with their survey."""

import math
from dataclasses import dataclass, field, fields

import numpy as np

from fgloc.errors import DriveError
from fgloc.measurements import Array, freeze

_LEAST = {
    "yaw_rad": -math.inf, "sigma_position_m": 0.0, "sigma_yaw_rad": 0.0, "range_m": 0.0,
    "bias_sigma_m": 0.0, "bias_tau_s": 1e-3,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Node:
    """A roadside node as it was surveyed; its axes are level and turned by the yaw.

    Raises DriveError where a number is not finite or a sigma or the range is negative.

    p_world_m         (3,) place of the sensors, ENU m
    yaw_rad           from East to the node's x axis, counter-clockwise
    sigma_position_m  of the survey, each axis
    sigma_yaw_rad     of the survey
    range_m           beyond this the node's detections are not to be used
    bias_sigma_m      of a slowly varying error of its positions, each axis; 0 is none
    bias_tau_s        over which that error forgets itself (first-order Gauss-Markov)
    """

    name: str
    p_world_m: Array
    yaw_rad: float = 0.0
    sigma_position_m: float = 0.0
    sigma_yaw_rad: float = 0.0
    range_m: float = 100.0
    bias_sigma_m: float = 0.0
    bias_tau_s: float = 60.0

    def __post_init__(self) -> None:
        place = freeze(self.p_world_m)
        if place.shape != (3,) or not np.isfinite(place).all():
            raise DriveError(f"node {self.name!r}: p_world_m: expected three finite numbers in m")
        object.__setattr__(self, "p_world_m", place)
        for name, least in _LEAST.items():
            value = getattr(self, name)
            if not math.isfinite(value) or value < least:
                raise DriveError(
                    f"node {self.name!r}: {name} = {value}: expected a finite number"
                    + (f" from {least:g}" if math.isfinite(least) else "")
                )

    @property
    def R_world_node(self) -> Array:
        """(2, 2) from the node's level axes to East and North."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return np.array([[c, -s], [s, c]])

    def to_world(self, p_node_m: Array) -> Array:
        """Positions (N, 2) East and North in m of points (N, 2) in the node's axes."""
        return p_node_m @ self.R_world_node.T + self.p_world_m[:2]

    def from_world(self, p_world_m: Array) -> Array:
        """Points (N, 2) in the node's axes, m, of positions (N, 2) East and North."""
        return (p_world_m - self.p_world_m[:2]) @ self.R_world_node


@dataclass(frozen=True, eq=False)
class Infrastructure:
    """All that stands beside the road of a drive."""

    nodes: tuple[Node, ...] = field(default=())

    def __post_init__(self) -> None:
        for one in fields(self):
            names = [each.name for each in getattr(self, one.name)]
            double = next((name for name in names if names.count(name) > 1), None)
            if double is not None:
                raise DriveError(f"{one.name}: the name {double!r} occurs twice; names are unique")
