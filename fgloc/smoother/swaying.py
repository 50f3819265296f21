"""The swaying posts beside a car: their states in the car's graph, and what tells of them there.

A post has a state at every keyframe between the first and the last at which its node sees anything
(`fgloc.watches.beside_cars`), each joined to the next by the bending mode, exactly sampled, with
the wind as noise (`fgloc.factors.post`). Poses of the node tell of a state alone, detections of the
vehicle and of the post together (`fgloc.factors.sway`).

Posts that are not followed at the same time share a slot of six unknowns in each keyframe's block:
where another post takes a slot over, its chain begins at rest, as the wind's spread has it. So the
block grows with the posts that see something at once and not with those along the road.
"""

from collections.abc import Iterator
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fgloc.drive import Drive
from fgloc.factors.post import pose_jacobian, post_spread, whitened_steps
from fgloc.factors.sway import linear_row
from fgloc.infrastructure import Node, Post
from fgloc.measurements import Array, NodeDetections
from fgloc.timing import Instants, elapsed_s
from fgloc.watches import Watch

SIZE = 6
"""Of a post's state."""
MOST_TILT = 0.5
"""What a node reports is taken back by at most this share of the angle below which a camera sees
it; beyond that in a straight line. A solver that has yet to settle may try any tilt."""
Index = NDArray[np.int64]


class Swaying:
    """The posts of n keyframes.

    watches   what is told of each post
    slot      (w,) the slot of each; there are `slots`
    owner     (n, slots) whose state a slot holds at a keyframe: the number of a watch
    begins    (n, slots) bool: whether its chain begins there
    """

    def __init__(self, drive: Drive, watches: tuple[Watch, ...], t_ns: Instants) -> None:
        self.watches, self._t_s = watches, elapsed_s(t_ns, int(t_ns[0]))
        self._nodes = drive.infrastructure.nodes
        seen = drive.tables.get(NodeDetections.KIND)
        self._reported_m = np.zeros((0, 3))
        if watches and isinstance(seen, NodeDetections):
            self._reported_m = seen.place_node_m
        self.spans = np.array([np.searchsorted(t_ns, w.t_ns[[0, -1]]) for w in watches], int)
        self.slot = _slots(self.spans.reshape(-1, 2))
        self.slots = int(self.slot.max(initial=-1)) + 1
        self.owner, self.begins = self._owners(len(t_ns))
        self.of_source = {1 + watch.node: k for k, watch in enumerate(watches)}
        self._told(t_ns)

    def __len__(self) -> int:
        return len(self.watches)

    @property
    def width(self) -> int:
        """Unknowns that all slots add to a keyframe's block."""
        return SIZE * self.slots

    def at(self, slot: int) -> Index:
        """Where a slot's unknowns stand among those of all slots."""
        return SIZE * slot + np.arange(SIZE)

    def post(self, j: int, slot: int) -> Post:
        """The post whose state a slot holds at a keyframe."""
        return self.watches[int(self.owner[j, slot])].post

    def states(self, all_slots: Array, keys: Index, k: int) -> Array:
        """States (m, 6) of the k-th post at some keyframes, of those of all slots (n, width)."""
        return np.asarray(all_slots[keys][:, self.at(int(self.slot[k]))])

    def keys(self, k: int, t_ns: Instants) -> Index:
        """The keyframes of the k-th watch's instants."""
        return np.searchsorted(t_ns, self.watches[k].t_ns)

    @cached_property
    def steps(self) -> tuple[Array, Array]:
        """Blocks (n, slots, 6, 6) of each state and of the one before, with noise of one; where a
        chain begins there is none before."""
        after, before = np.zeros((2, *self.owner.shape, SIZE, SIZE))
        dt_s = np.diff(self._t_s, prepend=0.0)
        for k, watch in enumerate(self.watches):
            own = self.owner == k
            at, slot = np.nonzero(own & ~self.begins)
            after[at, slot], before[at, slot] = whitened_steps(watch.post, dt_s[at])
            after[own & self.begins] = np.linalg.inv(np.linalg.cholesky(post_spread(watch.post)))
        return after, before

    @cached_property
    def damping(self) -> Array:
        """One over the square of how far posts swing (width,)."""
        spread = [np.diag(post_spread(self.watches[k].post)) for k in range(len(self))]
        return np.concatenate([
            1 / np.max([spread[k] for k in np.flatnonzero(self.slot == c)], 0)
            for c in range(self.slots)
        ])  # fmt: skip

    def moved(self, s: int, row: Index, states: Array) -> tuple[Array, Array]:
        """How far sway moves what a node reports, (m, 3) East, North and up in m, and by the
        states. A height that is not told does not move.

        s       number of the node's source; row (m,) of the drive's detections
        states  (m, 6) of its post; the Jacobian is (m, 3, 6)
        """
        watch = self.watches[self.of_source[s]]
        node, post, reported_m = self._node(s), watch.post, self._reported_m[row]
        about = _tamed(states, post, reported_m)
        J, z = linear_row(reported_m, post, node, post.height_m, node.sensor, about)
        carried = z - np.einsum("nij,nj->ni", J, states)
        still_m = np.nan_to_num(reported_m, nan=-post.height_m)
        return carried - node.place_to_world(still_m), -J

    def poses(self, first: int, stop: int) -> Iterator[tuple[int, Index, Array, Array]]:
        """What is told of the states at keyframes first..stop - 1: slot, keyframes (m,) each once,
        whitened values (m, 4) and Jacobians (m, 4, 6)."""
        within = slice(*np.searchsorted(self.pose_key, [first, stop]))
        if within.start == within.stop:
            return
        slot, layer = self.pose_slot[within], self._layer[within]
        for pair in np.unique(np.stack([slot, layer], -1), axis=0).tolist():
            i = within.start + np.flatnonzero((slot == pair[0]) & (layer == pair[1]))
            yield pair[0], self.pose_key[i], self.pose_z[i], self.pose_J[i]

    def _node(self, s: int) -> Node:
        return self._nodes[s - 1]

    def _owners(self, n: int) -> tuple[Index, NDArray[np.bool_]]:
        owner = np.zeros((n, self.slots), int)
        for c in range(self.slots):
            own = np.flatnonzero(self.slot == c)
            own = own[np.argsort(self.spans[own, 0])]
            owner[:, c] = own[0]
            for k in own[1:]:
                owner[self.spans[k, 0] :, c] = k
        return owner, np.diff(owner, axis=0, prepend=-1) != 0

    def _told(self, t_ns: Instants) -> None:
        """The poses of all watches in order of their keyframes, whitened; what is not told is 0."""
        none = np.zeros(0, int)
        keys, slots, rows = [none], [none], [none]
        z, J = [np.zeros((0, 4))], [np.zeros((0, 4, SIZE))]
        for k, watch in enumerate(self.watches):
            known = np.isfinite(watch.told)
            weight = np.where(known, 1 / np.where(known, watch.sigmas, 1.0), 0.0)
            keys.append(self.keys(k, t_ns)[watch.state])
            slots.append(np.full(len(watch.rows), self.slot[k]))
            rows.append(watch.rows)
            z.append(weight * np.where(known, watch.told, 0.0))
            J.append(weight[..., None] * pose_jacobian(watch.post.tip_slope_per_m))
        order = np.argsort(np.concatenate(keys), kind="stable")
        self.pose_key, self.pose_slot = np.concatenate(keys)[order], np.concatenate(slots)[order]
        self.pose_row = np.concatenate(rows)[order]
        self.pose_z, self.pose_J = np.concatenate(z)[order], np.concatenate(J)[order]
        self._layer = occurrence(self.pose_key * max(self.slots, 1) + self.pose_slot)


def occurrence(values: Index) -> Index:
    """(n,) how many equal values stand before each."""
    order = np.argsort(values, kind="stable")
    new = np.diff(values[order], prepend=-1) != 0
    place = np.arange(len(values))
    count = np.empty(len(values), int)
    count[order] = place - np.maximum.accumulate(np.where(new, place, 0))
    return count


def _slots(spans: Index) -> Index:
    """(w,) a slot for each span (w, 2) of keyframes, such that those of one slot do not touch."""
    slot = np.zeros(len(spans), int)
    free_from: list[int] = []
    for k in np.argsort(spans[:, 0], kind="stable").tolist():
        first, last = spans[k]
        c = next((c for c, free in enumerate(free_from) if free < first), len(free_from))
        free_from[c:] = [int(last), *free_from[c + 1 :]]
        slot[k] = c
    return slot


def _tamed(states: Array, post: Post, reported_m: Array) -> Array:
    """States (m, 6) whose tilt leaves what is seen well below the horizon."""
    range_m = np.maximum(np.hypot(*reported_m[:, :2].T), 1e-6)
    most_rad = MOST_TILT * np.arctan2(post.height_m, range_m)
    tilt_rad = post.tip_slope_per_m * np.hypot(states[:, 0], states[:, 3])
    return states * np.minimum(1.0, most_rad / np.maximum(tilt_rad, 1e-12))[:, None]
