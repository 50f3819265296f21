"""What stands beside the road, with its survey: nodes that see vehicles, signs that vehicles read,
anchors that they measure distances to."""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fgloc.arrays import Array, freeze
from fgloc.errors import DriveError

_LEAST = {
    "yaw_rad": -math.inf, "sigma_position_m": 0.0, "sigma_yaw_rad": 0.0, "sigma_level_rad": 0.0,
    "range_m": 0.0, "bias_sigma_m": 0.0, "bias_tau_s": 1e-3,
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
    sensor            'lidar' where what it reports is rigid in space, 'camera' where it is the
                      ground seen along a ray: what a sway of the node does to it depends on that,
                      and only a LiDAR's detections may tell a height
    sigma_level_rad   of its axes being level, turns about East and North; only heights feel it
    """

    name: str
    p_world_m: Array
    yaw_rad: float = 0.0
    sigma_position_m: float = 0.0
    sigma_yaw_rad: float = 0.0
    range_m: float = 100.0
    bias_sigma_m: float = 0.0
    bias_tau_s: float = 60.0
    sensor: Literal["camera", "lidar"] = "lidar"
    sigma_level_rad: float = 0.0

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

    def place_to_world(self, place_node_m: Array) -> Array:
        """Places (N, 3) East, North and up in m of points (N, 3) in the node's axes."""
        up_m = self.p_world_m[2] + place_node_m[:, 2]
        return np.column_stack([self.to_world(place_node_m[:, :2]), up_m])

    def from_world(self, p_world_m: Array) -> Array:
        """Points (N, 2) in the node's axes, m, of positions (N, 2) East and North."""
        return (p_world_m - self.p_world_m[:2]) @ self.R_world_node


@dataclass(frozen=True)
class Post:
    """A post that carries a node and sways: its first bending mode, alike along x and y.

    Raises DriveError where a number is not finite and above 0.

    node             name of the node at its tip
    height_m         of the tip above the ground
    frequency_hz     natural, of the first mode without damping
    damping          ratio, below 1
    modal_mass_kg    what a load at the tip has to move
    tip_slope_per_m  tilt in rad for each metre that the tip is displaced
    load_sigma_n     standard deviation of the wind's load about its mean, each axis
    load_tau_s       over which that load forgets itself (first-order Gauss-Markov)
    """

    node: str
    height_m: float
    frequency_hz: float
    damping: float
    modal_mass_kg: float
    tip_slope_per_m: float
    load_sigma_n: float
    load_tau_s: float

    def __post_init__(self) -> None:
        numbers = {name: value for name, value in vars(self).items() if name != "node"}
        for name, value in numbers.items():
            if not math.isfinite(value) or value <= 0:
                raise DriveError(
                    f"post of node {self.node!r}: {name} = {value}: expected a number above 0"
                )
        if self.damping >= 1:
            raise DriveError(
                f"post of node {self.node!r}: damping = {self.damping}: expected a ratio below 1; "
                "is it in per cent?"
            )

    @property
    def name(self) -> str:
        """That of its node."""
        return self.node


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
    posts: tuple[Post, ...] = field(default=())
    signs: tuple[Sign, ...] = field(default=())
    anchors: tuple[Anchor, ...] = field(default=())

    def post_of(self, node: int) -> Post | None:
        """The post that carries a node, given by its number; None where it does not sway."""
        name = self.nodes[node].name
        return next((post for post in self.posts if post.node == name), None)

    def refuse_camera_heights(
        self, node: NDArray[np.int64], up_m: Array, where: Callable[[int], str]
    ) -> None:
        """Raise DriveError at the first of detections (N,) that tells a finite height, in m, though
        its node is a camera; `where` names the height of a row in the message."""
        camera = np.array([one.sensor == "camera" for one in self.nodes], bool)
        told = np.flatnonzero(np.isfinite(up_m))
        wrong = told[camera[node[told]]]
        if len(wrong):
            row = int(wrong[0])
            raise DriveError(
                f"{where(row)} = {up_m[row]} of node {self.nodes[int(node[row])].name!r}: a camera "
                "sees the ground along a ray and tells no height; leave the height out, or say of "
                'the node that its sensor is a "lidar"'
            )

    def __post_init__(self) -> None:
        for one in fields(self):
            names = [each.name for each in getattr(self, one.name)]
            double = next((name for name in names if names.count(name) > 1), None)
            if double is not None:
                raise DriveError(f"{one.name}: the name {double!r} occurs twice; names are unique")
        known = {node.name for node in self.nodes}
        astray = next((post.node for post in self.posts if post.node not in known), None)
        if astray is not None:
            raise DriveError(f"posts: there is no node named {astray!r}; add it as [[node]]")
