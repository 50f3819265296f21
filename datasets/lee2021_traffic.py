"""What the node of scenario `lee2021/mcity` follows: the car, a second one behind it, and ghosts.

A track ends where the car is hidden or leaves the node's range; the node finds it again under a
new number.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fgloc.datasets.lee2021_road import Case, in_range
from fgloc.datasets.node_simulator import Track, numbers
from fgloc.datasets.simulator import stream
from fgloc.infrastructure import Node
from fgloc.measurements import Array

FRAMES_HZ = 10
CAR_ID, FOLLOWER_ID, GHOST_ID = 100, 500, 900
"""Numbers that objects begin with; each later track begins 20 higher."""
IDS_PER_TRACK = 20
CHANGE_CHANCE = 0.01
FOLLOWING_S = 2.0
"""How long after the car the second car is at the same place."""
GHOSTS_PER_PASS, GHOST_S = 3, (0.3, 1.0)
GHOST_AWAY_M = (2.0, 6.0)


def tracks(
    p_box_m: Array,
    error_m: Array,
    t_s: Array,
    node: Node,
    cases: Sequence[Case],
    others: bool,
    seed: int,
) -> list[Track]:
    """The tracks in frames at times (N,) in s from the start.

    p_box_m  (N, 2) centre of the car's box, East and North
    error_m  (N, 2) error of the node then, of all that it sees
    others   whether there is more to see than the car
    """
    rng = stream(seed, "node/tracks")
    seen = in_range(node, p_box_m)
    hidden = np.any([_within(t_s, case.occluded_s) for case in cases if case.occluded_s], axis=0)
    own = _tracks(seen & ~hidden, p_box_m + error_m, CAR_ID, rng)
    if not others:
        return own
    p_second_m = np.stack([np.interp(t_s - FOLLOWING_S, t_s, axis) for axis in p_box_m.T], -1)
    second = _tracks(in_range(node, p_second_m), p_second_m + error_m, FOLLOWER_ID, rng)
    return [*own, *second, *_ghosts(seen, p_box_m + error_m, rng)]


def _within(t_s: Array, span_s: tuple[float, float]) -> NDArray[np.bool_]:
    return (t_s >= span_s[0]) & (t_s <= span_s[1])


def _tracks(
    seen: NDArray[np.bool_], p_seen_m: Array, first_id: int, rng: np.random.Generator
) -> list[Track]:
    """A track of each unbroken run of frames that show an object."""
    return [
        Track(
            run, p_seen_m[run], numbers(len(run), first_id + IDS_PER_TRACK * k, CHANGE_CHANCE, rng)
        )
        for k, run in enumerate(_runs(seen))
    ]


def _runs(seen: NDArray[np.bool_]) -> list[NDArray[np.int64]]:
    """The frames that show an object, as unbroken runs."""
    frame = np.flatnonzero(seen)
    return np.split(frame, np.flatnonzero(np.diff(frame) > 1) + 1)


def _ghosts(seen: NDArray[np.bool_], p_seen_m: Array, rng: np.random.Generator) -> list[Track]:
    """Short-lived echoes beside the car, that move with it."""
    tracks: list[Track] = []
    for run in _runs(seen):
        for _ in range(GHOSTS_PER_PASS):
            length = round(rng.uniform(*GHOST_S) * FRAMES_HZ)
            first = int(rng.integers(len(run) - length))
            shown = run[first : first + length]
            away_m, way_rad = rng.uniform(*GHOST_AWAY_M), rng.uniform(-np.pi, np.pi)
            aside_m = away_m * np.array([np.cos(way_rad), np.sin(way_rad)])
            ids = np.full(length, GHOST_ID + len(tracks))
            tracks.append(Track(shown, p_seen_m[shown] + aside_m, ids))
    return tracks
