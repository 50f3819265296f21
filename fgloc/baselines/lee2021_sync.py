"""Lee et al. (2021), section III-D: everything brought to the stamps of the GPS.

'We assume the vehicle has negligible acceleration so the GPS and ix-node outputs are linearized to
have the same timestamps': velocities and the positions of each object are interpolated linearly.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fgloc.drive import Drive
from fgloc.errors import DriveError
from fgloc.infrastructure import Node
from fgloc.measurements import PEDESTRIAN, Array, EnuVelocities, NodeDetections
from fgloc.timing import Instants, elapsed_s, seconds_to_ns

Late = Literal["as-stamped", "on-arrival"]

WIDEST_S = 0.3
"""Two sightings of an object are joined by a straight line over at most so long."""
CARRIED_S = 0.15
"""One without a partner on the other side of the stamp is carried over at most so long."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """M objects that may be the vehicle, each at the stamp of a fix.

    epoch        (M,) number of the stamp, not decreasing
    rows         (M, 2) rows of the detections it was made from, twice the same if from one
    p_world_m    (M, 2) East and North in m
    distance_m   (M,) from the node
    in_range     (M,) bool: within the node's range
    """

    epoch: NDArray[np.int64]
    rows: NDArray[np.int64]
    p_world_m: Array
    distance_m: Array
    in_range: NDArray[np.bool_]


_NOTHING = Candidates(
    np.zeros(0, np.int64), np.zeros((0, 2), np.int64), np.zeros((0, 2)), np.zeros(0),
    np.zeros(0, bool),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Synchronised:
    """All that the filter takes, at the stamps of K fixes.

    t_ns     (K,) increasing
    fix_row  (K,) rows of the fixes
    fix_m    (K, 2) East and North
    v_mps    (K, 3) velocity of the vehicle, ENU
    seen     the candidates
    """

    t_ns: Instants
    fix_row: NDArray[np.int64]
    fix_m: Array
    v_mps: Array
    seen: Candidates

    def seen_at(self, k: int) -> slice:
        """The candidates at a stamp."""
        first, stop = np.searchsorted(self.seen.epoch, [k, k + 1])
        return slice(int(first), int(stop))


def synchronised(
    drive: Drive, fix_row: NDArray[np.int64], velocity: EnuVelocities, late: Late
) -> Synchronised:
    """The drive at the stamps of some fixes, which lie within the time of the velocities."""
    gnss = drive.gnss
    t_ns = gnss.t_ns[fix_row]
    at, have = (elapsed_s(t, int(velocity.t_ns[0])) for t in (t_ns, velocity.t_ns))
    v = np.stack([np.interp(at, have, column) for column in velocity.v_world_mps.T], -1)
    detections = drive.tables.get("detections")
    seen = _NOTHING
    if isinstance(detections, NodeDetections) and len(detections):
        seen = candidates(detections, drive.infrastructure.nodes, t_ns, v, late)
    return Synchronised(t_ns, fix_row, gnss.p_world_ant_m[fix_row, :2], v, seen)


def velocities(drive: Drive, method: str) -> EnuVelocities:
    """The finite rows of the drive's velocities; DriveError where there are none."""
    table = drive.tables.get("velocity")
    if not isinstance(table, EnuVelocities) or len(table) == 0:
        have = ", ".join(drive.tables) or "nothing"
        raise DriveError(
            f"drive {drive.name!r}: {method} predicts with the table velocity (ENU, m/s), and the "
            f"drive has none (it has {have}); add velocity.csv"
        )
    finite = np.isfinite(table.v_world_mps).all(-1)
    if not finite.any():
        raise DriveError(f"drive {drive.name!r}: none of its {len(table)} velocities is finite")
    return table.take(finite)


def candidates(
    detections: NodeDetections, nodes: tuple[Node, ...], t_ns: Instants, v_world_mps: Array,
    late: Late,
) -> Candidates:  # fmt: skip
    """Objects of all nodes at the stamps (K,), where the vehicle moves with (K, 3) m/s.

    An object is taken where it was between the frames before and after the stamp, if both name it.
    What has no such partner (the node gave no number, or another one) is carried to the stamp by
    the vehicle's own velocity, as linear as the rest and right for the one object that matters.
    """
    times = detections.received_ns if late == "on-arrival" else detections.t_ns
    usable = np.isfinite(detections.p_node_m).all(-1) & (detections.kind != PEDESTRIAN)
    parts = []
    for number, node in enumerate(nodes):
        rows = np.flatnonzero(usable & (detections.node == number))
        rows = rows[np.argsort(times[rows], kind="stable")]
        if len(rows):
            p_world_m = node.to_world(detections.p_node_m[rows])
            seen = _Seen(times[rows], detections.object_id[rows], p_world_m)
            epoch, pairs, p = seen.at(t_ns, v_world_mps[:, :2])
            distance = np.linalg.norm(p - node.p_world_m[:2], axis=-1)
            parts.append((epoch, rows[pairs], p, distance, distance <= node.range_m))
    if not parts:
        return _NOTHING
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    order = np.argsort(columns[0], kind="stable")
    return Candidates(*(column[order] for column in columns))


@dataclass(frozen=True, eq=False)
class _Seen:
    """What one node saw, in the order of time: instants, numbers of objects, East and North."""

    t_ns: Instants
    object_id: NDArray[np.int64]
    p_world_m: Array

    def at(
        self, t_ns: Instants, v_mps: Array
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
        """Stamp, rows (M, 2) and place (M, 2) of everything that can be brought to a stamp."""
        before, after = self._frames(t_ns)
        epoch, left = _expand(*before)
        partner = self._partner(after, epoch, left)
        joined = partner >= 0
        widest = self.t_ns[partner] - self.t_ns[left] <= seconds_to_ns(WIDEST_S)
        joined &= widest | (partner == left)
        epoch_b, right = _expand(*after)
        taken = np.isin(epoch_b * len(self.t_ns) + right,
                        epoch[joined] * len(self.t_ns) + partner[joined])  # fmt: skip
        alone_epoch = np.concatenate([epoch[~joined], epoch_b[~taken]])
        alone = np.concatenate([left[~joined], right[~taken]])
        gap_s = (t_ns[alone_epoch] - self.t_ns[alone]) / 1e9
        near = np.abs(gap_s) <= CARRIED_S
        p = np.concatenate([
            self._between(t_ns[epoch[joined]], left[joined], partner[joined]),
            (self.p_world_m[alone] + v_mps[alone_epoch] * gap_s[:, None])[near],
        ])  # fmt: skip
        pairs = np.concatenate([np.stack([left[joined], partner[joined]], -1),
                                np.stack([alone, alone], -1)[near]])  # fmt: skip
        return np.concatenate([epoch[joined], alone_epoch[near]]), pairs, p

    def _frames(self, t_ns: Instants) -> tuple[tuple[NDArray[np.int64], ...], ...]:
        """First and last row + 1 of the frames at or before, and at or after, each stamp."""
        frame_ns, first = np.unique(self.t_ns, return_index=True)
        ends = np.append(first, len(self.t_ns))
        low = np.searchsorted(frame_ns, t_ns, side="right") - 1
        high = np.searchsorted(frame_ns, t_ns, side="left")
        n = len(frame_ns)
        spans = []
        for frame, there in ((low, low >= 0), (high, high < n)):
            frame = np.clip(frame, 0, n - 1)
            spans.append((np.where(there, ends[frame], 0), np.where(there, ends[frame + 1], 0)))
        return tuple(spans)

    def _partner(
        self, after: tuple[NDArray[np.int64], ...], epoch: NDArray[np.int64],
        left: NDArray[np.int64],
    ) -> NDArray[np.int64]:  # fmt: skip
        """The row of the same object in the frame after the stamp, -1 where there is none."""
        partner = np.full(len(left), -1)
        start, stop = (side[epoch] for side in after)
        for step in range(int((stop - start).max(initial=0))):
            row = np.minimum(start + step, len(self.t_ns) - 1)
            same = (start + step < stop) & (self.object_id[row] == self.object_id[left])
            same &= (self.object_id[left] >= 0) | (row == left)
            partner = np.where(same & (partner < 0), row, partner)
        return partner

    def _between(self, t_ns: Instants, left: NDArray[np.int64], right: NDArray[np.int64]) -> Array:
        span = np.maximum(self.t_ns[right] - self.t_ns[left], 1)
        share = ((t_ns - self.t_ns[left]) / span)[:, None]
        return (1 - share) * self.p_world_m[left] + share * self.p_world_m[right]


def _expand(
    start: NDArray[np.int64], stop: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Number k and row r for each r in start[k]:stop[k]."""
    count = stop - start
    epoch = np.repeat(np.arange(len(start)), count)
    return epoch, np.arange(len(epoch)) - np.repeat(np.cumsum(count) - count - start, count)
