"""What stands beside the road, with its survey: nodes that see vehicles, signs that vehicles read,
anchors that they measure distances to."""

import math
import re
from dataclasses import dataclass, field, fields
from typing import Literal

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
        object.__setattr__(self, "p_world_m", _place(f"node {self.name!r}", self.p_world_m))
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
class Sign:
    """A sign with a square Smart Code on it, upright.

    Raises DriveError where a number is not finite, the size is not above 0, the code is not
    hexadecimal or the side is neither left nor right.

    code            what the sign encodes, hexadecimal in lower case
    p_world_m       (3,) middle of the code, ENU m
    normal_yaw_rad  from East to the direction that its face looks to, counter-clockwise
    size_m          side of the code
    side            of the road that it stands on, as the driver who reads it sees the road
    """

    name: str
    code: str
    p_world_m: Array
    normal_yaw_rad: float
    size_m: float
    side: Literal["left", "right"] = "right"

    def __post_init__(self) -> None:
        what = f"sign {self.name!r}"
        object.__setattr__(self, "p_world_m", _place(what, self.p_world_m))
        if not re.fullmatch("[0-9a-f]+", self.code):
            raise DriveError(f"{what}: code = {self.code!r}: expected hexadecimal, in lower case")
        if self.side not in ("left", "right"):
            raise DriveError(f"{what}: side = {self.side!r}: expected 'left' or 'right'")
        if not (math.isfinite(self.size_m) and self.size_m > 0):
            raise DriveError(f"{what}: size_m = {self.size_m}: expected a finite number above 0")
        if not math.isfinite(self.normal_yaw_rad):
            raise DriveError(f"{what}: normal_yaw_rad = {self.normal_yaw_rad}: expected finite rad")

    @property
    def R_world_sign(self) -> Array:
        """(2, 2) from the sign's level axes, x along its normal, to East and North."""
        c, s = math.cos(self.normal_yaw_rad), math.sin(self.normal_yaw_rad)
        return np.array([[c, -s], [s, c]])


@dataclass(frozen=True, eq=False)
class Anchor:
    """What a tag on the vehicle measures its distance to, at p_world_m (3,), ENU m."""

    name: str
    p_world_m: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "p_world_m", _place(f"anchor {self.name!r}", self.p_world_m))


def _place(what: str, p_world_m: Array) -> Array:
    place = freeze(p_world_m)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise DriveError(f"{what}: p_world_m: expected three finite numbers in m")
    return place


@dataclass(frozen=True, eq=False)
class Infrastructure:
    """All that stands beside the road of a drive."""

    nodes: tuple[Node, ...] = field(default=())
    signs: tuple[Sign, ...] = field(default=())
    anchors: tuple[Anchor, ...] = field(default=())

    def __post_init__(self) -> None:
        for one in fields(self):
            names = [each.name for each in getattr(self, one.name)]
            double = next((name for name in names if names.count(name) > 1), None)
            if double is not None:
                raise DriveError(f"{one.name}: the name {double!r} occurs twice; names are unique")
