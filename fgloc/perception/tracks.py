"""The rows of a tracker, and how tracks look in an image."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgloc.measurements import Array
from fgloc.perception.heads import Camera
from fgloc.perception.track_filter import S_, YAW, Belief, D, outline

Rows = NDArray[np.int64]


@dataclass(eq=False)
class Tracks:
    """Rows of tracks; arrays of one length T that the tracker writes into.

    x, P         (T, 9), (T, 9, 9) states; see `track_filter`
    alone_x, _P  the same by this frame's measurements alone, with the shape from before
    id           (T,) number, from 0 in the order of birth
    kind         (T,) `UNKNOWN`, `VEHICLE` or `PEDESTRIAN`
    votes        (T, 3) how many boxes said each kind
    hits         (T,) frames that saw it; frames (T,) since its birth
    seen_ns      (T,) when it was seen last
    """

    x: Array
    P: Array
    alone_x: Array
    alone_P: Array
    id: Rows
    kind: Rows
    votes: Rows
    hits: Rows
    frames: Rows
    seen_ns: Rows

    @classmethod
    def born(cls, belief: Belief, first_id: int, t_ns: int) -> "Tracks":
        """New tracks, of measurements alone."""
        n = len(belief.x)
        whole = np.zeros((4, n), np.int64)
        return cls(
            belief.x, belief.P, belief.x.copy(), belief.P.copy(), first_id + np.arange(n), whole[0],
            np.zeros((n, 3), np.int64), whole[1], whole[2], whole[3] + t_ns,
        )  # fmt: skip

    @classmethod
    def none(cls) -> "Tracks":
        """No tracks."""
        return cls.born(Belief(np.zeros((0, D)), np.zeros((0, D, D))), 0, 0)

    def __len__(self) -> int:
        return len(self.id)

    @property
    def belief(self) -> Belief:
        """What is believed, all measurements in."""
        return Belief(self.x, self.P)

    @belief.setter
    def belief(self, belief: Belief) -> None:
        self.x, self.P = belief

    @property
    def alone(self) -> Belief:
        """What this frame's measurements say."""
        return Belief(self.alone_x, self.alone_P)

    @alone.setter
    def alone(self, belief: Belief) -> None:
        self.alone_x, self.alone_P = belief

    def take(self, rows: Any) -> "Tracks":
        """A copy of some rows."""
        return Tracks(*(getattr(self, f.name)[rows] for f in fields(self)))

    def and_(self, more: "Tracks") -> "Tracks":
        """These and some more."""
        pairs = ((getattr(self, f.name), getattr(more, f.name)) for f in fields(self))
        return Tracks(*(np.concatenate(pair) for pair in pairs))


def project(camera: Camera, belief: Belief) -> Array:
    """Boxes (T, 4) around the cuboids of states, cut off at the edge of the image; NaN where
    nothing of one is in it, or a corner lies behind the camera."""
    edge = np.tile(camera.size_px, 2) - 0.5
    box = np.clip(outline(camera, belief.x), -0.5, edge)
    seen = np.asarray((box[:, 2:] > box[:, :2]).all(1))  # a NaN is not larger
    return np.where(seen[:, None], box, np.nan)


def share_inside(box_px: Array, around_px: Array) -> Array:
    """(N, M) which share of each box (N, 4) lies inside each other one (M, 4); NaN holds none."""
    low = np.maximum(box_px[:, None, :2], around_px[:, :2])
    high = np.minimum(box_px[:, None, 2:], around_px[:, 2:])
    shared = np.clip(high - low, 0, None).prod(-1)
    return np.nan_to_num(shared / (box_px[:, 2:] - box_px[:, :2]).prod(-1)[:, None])


def is_inside(point_m: Array, belief: Belief, margin_m: float) -> NDArray[np.bool_]:
    """(N, T) bool: which points (N, 2) lie within the plans of states widened by a margin."""
    arm = point_m[:, None] - belief.x[:, :2]
    c, s = np.cos(belief.x[:, YAW]), np.sin(belief.x[:, YAW])
    ahead, left = arm[..., 0] * c + arm[..., 1] * s, arm[..., 1] * c - arm[..., 0] * s
    half = belief.x[:, S_] / 2 + margin_m
    return np.asarray((np.abs(ahead) < half[:, 0]) & (np.abs(left) < half[:, 1]))
