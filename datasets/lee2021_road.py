"""The road of scenario `lee2021/mcity`: three laps by the node, each with a tunnel in its view.

The car waits, drives three laps of a rectangle with rounded corners, and stops. The northern side
leads past the node, heading East; the other three are out of its range. All seeds drive the same
way: the paper has one run.

Distances are East and North of the map's origin, true ones. The paper's are those of the UTM grid,
which is turned by 1.8 deg here (the convergence at 2.7 deg west of the zone's meridian) and
0.02 % longer; the places that the paper prints are carried over, its axes are not.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from fgloc.datasets.road import STEEPEST, Phase, road_motion
from fgloc.datasets.simulator import Motion, instants
from fgloc.frames import Origin, utm_to_geodetic
from fgloc.infrastructure import Node
from fgloc.measurements import Array
from fgloc.timing import elapsed_s

START_NS = 1_600_000_000 * 1_000_000_000
DURATION_S = 300.0
RATE_HZ = 100

UTM_ZONE = 17
UTM_ORIGIN_M = (277_495.0, 4_686_600.0)
NODE_FROM_ORIGIN_M = (7.13, 62.19)
"""Places that the paper prints (section III-D): the map's origin, and the node from there."""
HEIGHT_M = 240.0
"""Of the ground above the ellipsoid, roughly that of Ann Arbor; the paper has none."""

NODE_HEIGHT_M = 6.0
NODE_RANGE_M = 45.0
"""Height of the sensors above the ground and reach along it: not in the paper."""
NODE_TO_ROAD_M = 10.0
"""From the node to the middle of the lane, which passes south of it."""

SIDE_M, SHORT_SIDE_M, CORNER_M = 180.0, 45.0, 30.0
WAIT_S = 4.0
CORNER_MPS, PASSING_MPS, CRUISE_MPS = 5.0, 6.0, 10.0
PEAK_ACCEL_MPS2 = 1.5
LAPS = 3

TUNNEL_M = (-26.0, -8.0)
"""Stretch of the northern side, East of the node, that has a roof."""
OCCLUDED_M = (None, (6.0, 14.0), (2.0, 14.0))
"""Stretch of each pass in which something stands between the node and the car."""

_RIGHT_RAD = -np.pi / 2


@dataclass(frozen=True)
class Case:
    """One pass by the node, in seconds from the start: in its range, in the tunnel, occluded."""

    covered_s: tuple[float, float]
    tunnel_s: tuple[float, float]
    occluded_s: tuple[float, float] | None


def origin() -> Origin:
    """The map's origin on the ground."""
    lat_deg, lon_deg = utm_to_geodetic(UTM_ORIGIN_M, UTM_ZONE).tolist()
    return Origin(lat_deg, lon_deg, HEIGHT_M)


def node_place_m() -> Array:
    """(3,) the node's sensors, ENU m from the map's origin."""
    grid_m = np.add(UTM_ORIGIN_M, NODE_FROM_ORIGIN_M)
    lat_deg, lon_deg = utm_to_geodetic(grid_m, UTM_ZONE)
    return origin().to_world(lat_deg, lon_deg, HEIGHT_M + NODE_HEIGHT_M)


def in_range(node: Node, p_world_m: Array) -> NDArray[np.bool_]:
    """(N,) bool: which of the places (N, 2 or 3) a node reaches, along the ground."""
    from_node_m = p_world_m[:, :2] - node.p_world_m[:2]
    return np.asarray(np.hypot(*from_node_m.T) <= node.range_m)


@cache
def motion() -> Motion:
    """The vehicle frame at 100 Hz, on the ground."""
    t_ns = instants(START_NS, DURATION_S, RATE_HZ)
    moved = road_motion(t_ns, _phases(), np.pi)
    # The road is laid so that the northern side passes the node in its middle.
    east, north = moved.p_world_m[:, 0], moved.p_world_m[:, 1]
    middle_m = (east.min() + east.max()) / 2, north.max()
    node_m = node_place_m()
    shift_m = np.array([node_m[0] - middle_m[0], node_m[1] - NODE_TO_ROAD_M - middle_m[1], 0.0])
    return Motion(**{**vars(moved), "p_world_m": moved.p_world_m + shift_m})


def cases(p_veh_box_m: Array, node: Node) -> tuple[Case, ...]:
    """The three passes: while the centre of the car's box is in the node's range.

    p_veh_box_m  (3,) that centre in the vehicle frame
    """
    at = motion().every(RATE_HZ // 10)
    p_box_m = at.p_world_m + at.R_world_veh @ p_veh_box_m
    t_s = elapsed_s(at.t_ns, START_NS)
    reached = in_range(node, p_box_m)
    begins = np.flatnonzero(reached & ~np.roll(reached, 1))
    ends = np.flatnonzero(reached & ~np.roll(reached, -1))
    east_m = p_box_m[:, 0] - node.p_world_m[0]
    passes = []
    for begin, end, occluded_m in zip(begins, ends, OCCLUDED_M, strict=True):
        t, e = t_s[begin : end + 1], east_m[begin : end + 1]
        occluded_s = None if occluded_m is None else _between(t, e, occluded_m)
        passes.append(Case((float(t[0]), float(t[-1])), _between(t, e, TUNNEL_M), occluded_s))
    return tuple(passes)


def _between(t_s: Array, east_m: Array, stretch_m: tuple[float, float]) -> tuple[float, float]:
    begin_s, end_s = np.interp(stretch_m, east_m, t_s)
    return float(begin_s), float(end_s)


def _phases() -> list[Phase]:
    """A wait in the middle of the southern side, the laps, and a wait for the rest."""
    half_m = SIDE_M / 2
    phases = [Phase(WAIT_S, 0.0, 0.0), *_straight(half_m, 0.0, CRUISE_MPS, CORNER_MPS)]
    for lap in range(LAPS):
        phases += [*_end(), *_straight(SIDE_M, CORNER_MPS, PASSING_MPS, CORNER_MPS), *_end()]
        if lap < LAPS - 1:
            phases += _straight(SIDE_M, CORNER_MPS, CRUISE_MPS, CORNER_MPS)
    return [*phases, *_straight(half_m, CORNER_MPS, CRUISE_MPS, 0.0), Phase(DURATION_S, 0.0, 0.0)]


def _end() -> list[Phase]:
    """A short side with the corners before and after it, to the right."""
    corner = Phase(CORNER_M / CORNER_MPS, CORNER_MPS, CORNER_MPS, _RIGHT_RAD)
    return [corner, Phase(SHORT_SIDE_M / CORNER_MPS, CORNER_MPS, CORNER_MPS), corner]


def _straight(length_m: float, from_mps: float, cruise_mps: float, to_mps: float) -> list[Phase]:
    """Speed up, cruise and slow down over a length."""
    up, down = _ramp(from_mps, cruise_mps), _ramp(cruise_mps, to_mps)
    cruise_s = (length_m - up.length_m - down.length_m) / cruise_mps
    return [up, Phase(cruise_s, cruise_mps, cruise_mps), down]


def _ramp(from_mps: float, to_mps: float) -> Phase:
    return Phase(STEEPEST * abs(to_mps - from_mps) / PEAK_ACCEL_MPS2, from_mps, to_mps)
