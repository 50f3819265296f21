"""Seeded layouts of objects, as a node and as a car see them. Khamooshi (2023), section 4.5.5.

A car and other objects lie uniformly in a square. Node and car each miss some, see some that are
not there, and measure all with white noise; the car knows itself, at 0 of its own axes.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc.datasets.simulator import stream
from fgloc.errors import InputError
from fgloc.measurements import Array

SIDE_M = 80.0
SIGMA_M = 0.3
MISSING = 0.2
GHOSTS = 0.2
STEP_S = 0.1  # between the last step and this one, for the warm start
_FASTEST_MPS, _TURN_RADPS = 15.0, 0.5
LEAST_OBJECTS, MOST_OBJECTS = 3, 200


@dataclass(frozen=True, eq=False)
class Layout:
    """One layout with its answer.

    p_world_m        (N, 2) what the node broadcasts, in no order
    p_veh_m          (M, 2) what the car has, itself first at 0
    yaw_rad, t_m     the car's true heading and position (2,)
    pairs            (K, 2) true pairs: index among the car's, index among the node's
    last_yaw_rad, last_t_m  where the car was a step before: what a warm start begins from
    sigma_m          of each axis of each measured position
    """

    p_world_m: Array
    p_veh_m: Array
    yaw_rad: float
    t_m: Array
    pairs: NDArray[np.int64]
    last_yaw_rad: float
    last_t_m: Array
    sigma_m: float


def make_layout(
    rng: np.random.Generator,
    objects: int,
    *,
    sigma_m: float = SIGMA_M,
    missing: float = MISSING,
    ghosts: float = GHOSTS,
    one_sided: bool = False,
) -> Layout:
    """One layout of so many objects, the car included.

    missing    share of the objects that the node does not see, and that the car does not
    ghosts     as many again, as a share of the objects, that are not there, in both sets
    one_sided  only the car misses objects and only the node has ghosts, as where others hide some
               from the car
    Raises InputError where a share is outside [0, 1) or the count outside 3 to 200.
    """
    _check(objects, sigma_m, missing, ghosts)
    place = rng.uniform(-SIDE_M / 2, SIDE_M / 2, (objects, 2))
    yaw = rng.uniform(-math.pi, math.pi)
    by_node = (rng.random(objects) >= missing) | one_sided
    by_car = rng.random(objects) >= missing
    by_car[0] = True
    world, names_world = _seen(rng, place, by_node, sigma_m, ghosts)
    car, names_car = _seen(rng, place, by_car, sigma_m, 0.0 if one_sided else ghosts, first=True)
    c, s = math.cos(yaw), math.sin(yaw)
    veh = (car - place[0]) @ np.array([[c, -s], [s, c]])
    veh[0] = 0.0
    own, theirs = np.nonzero((names_car[:, None] == names_world) & (names_car[:, None] >= 0))
    speed, turn = rng.uniform(0, _FASTEST_MPS), rng.uniform(-_TURN_RADPS, _TURN_RADPS)
    last = place[0] - STEP_S * speed * np.array([c, s])
    return Layout(
        world, veh, yaw, place[0], np.stack([own, theirs], -1), yaw - STEP_S * turn, last, sigma_m
    )


def make_layouts(
    seed: int,
    objects: int,
    count: int,
    *,
    sigma_m: float = SIGMA_M,
    missing: float = MISSING,
    ghosts: float = GHOSTS,
    one_sided: bool = False,
) -> list[Layout]:
    """So many layouts; equal seeds and sizes give equal layouts, and the first of many are those
    of few.
    """
    rng = stream(seed, f"layouts of {objects}")
    options = {"sigma_m": sigma_m, "missing": missing, "ghosts": ghosts}
    return [make_layout(rng, objects, one_sided=one_sided, **options) for _ in range(count)]


def _seen(
    rng: np.random.Generator,
    place: Array,
    seen: NDArray[np.bool_],
    sigma_m: float,
    ghosts: float,
    *,
    first: bool = False,
) -> tuple[Array, NDArray[np.int64]]:
    """Noisy places (N, 2) in no order, and the object of each, -1 for a ghost.

    `first` keeps object 0 in front.
    """
    names = np.flatnonzero(seen)
    count = rng.binomial(len(place), ghosts)
    there = place[names] + sigma_m * rng.standard_normal((len(names), 2))
    not_there = rng.uniform(-SIDE_M / 2, SIDE_M / 2, (count, 2))
    points, names = np.concatenate([there, not_there]), np.r_[names, np.full(count, -1)]
    order = rng.permutation(len(points))
    if first:
        order = np.r_[0, order[order != 0]]
    return points[order], names[order]


def _check(objects: int, sigma_m: float, missing: float, ghosts: float) -> None:
    if not LEAST_OBJECTS <= objects <= MOST_OBJECTS:
        raise InputError(f"{objects} objects: expected {LEAST_OBJECTS} to {MOST_OBJECTS}")
    for name, share in (("missing", missing), ("ghosts", ghosts)):
        if not 0 <= share < 1:
            raise InputError(f"{name} = {share}: expected a share from 0 to below 1")
    if not 0 <= sigma_m <= SIDE_M:
        raise InputError(f"sigma_m = {sigma_m}: expected 0 to {SIDE_M:g} m")
