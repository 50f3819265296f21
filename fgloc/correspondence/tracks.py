"""Whose number is whose: the objects of nodes and of the car become tracks.

A node, and the car, keep the number that they gave an object; so a number is matched once, when it
is new. To a node's new number belongs the track that is nearest to where it is seen, of another
node's or of one whose number the node has dropped; it is sought where it was heading. The car is
the track where its fix is; without fixes it finds itself by `match`. To a number of the car's own
belongs the track on which it falls under the heading that the objects agree on.

Where other road users say where they are, they and the car are tracks from their first fix on, and
what nodes see is theirs as `tellers` has it.
"""

import math
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from fgloc.arrays import Array, finite_rows
from fgloc.correspondence.epochs import Epoch, Epochs
from fgloc.correspondence.matching import match
from fgloc.correspondence.rigid import Rigid, Status, fit, rotation, wrapped
from fgloc.correspondence.tellers import Tellers
from fgloc.drive import Drive, GnssBias
from fgloc.errors import DriveError
from fgloc.measurements import (
    PEDESTRIAN,
    GnssFixes,
    NodeDetections,
    RelativeSightings,
    Table,
    UserFixes,
)
from fgloc.verdicts import SourceVerdicts, Verdict

T = TypeVar("T", bound=Table)

GATE_SIGMA = 5.0
_TURN_VARIANCE = 0.1**2  # rad^2 per s that an old heading loses
_LONGEST_S = 1.0
"""A track that was not seen for longer is not found again under another number."""
_SPEED_SIGMA_MPS = 3.0
_VELOCITY_NS = 500_000_000
A_UNSTATED = 3e-4
"""Variance over the square of the slant range where a node states no covariance."""
_NO_TRACK = -1
_FAR_OFF = "far from where all else puts it"


def track_objects(drive: Drive, method: str) -> Epochs:
    """The sightings of a drive by track, in the order of time.

    Raises DriveError where no node sees anything, or where the car is never found among what the
    nodes see although it measures something itself.
    """
    return _Tracker(drive, method).run()


class _Tracker:
    """Numbers that are known already, and where each track was last."""

    def __init__(self, drive: Drive, method: str) -> None:
        self.drive = drive
        self.verdicts = {
            name: SourceVerdicts.of(name, table, Verdict.UNUSED, f"{method} does not take {name}")
            for name, table in drive.tables.items()
        }
        self.by_node: dict[tuple[int, int], int] = {}
        self.by_car: dict[int, int] = {}
        self.last: dict[int, tuple[int, Array, Array, Array, int, Array]] = {}
        self.tracks = 0
        self.ego = _NO_TRACK
        self.yaw = (math.nan, math.nan, 0)
        self.users: dict[int, int] = {}
        self.slow: dict[int, GnssBias] = {}
        self.tellers = Tellers()

    def run(self) -> Epochs:
        """Go through all instants."""
        seen = self._table(NodeDetections)
        if seen is None or not len(seen):
            have = ", ".join(self.drive.tables) or "nothing"
            raise DriveError(
                f"drive {self.drive.name!r} has no detections of nodes (it has {have})"
            )
        fixes, own = self._table(GnssFixes), self._table(RelativeSightings)
        users = self._table(UserFixes)
        if users is not None:
            self._reserve(users, fixes)
        tables = [table for table in (seen, fixes, own, users) if table is not None and len(table)]
        epochs = [self._epoch(seen, int(t), fixes, own, users)
                  for t in np.unique(np.concatenate([table.t_ns for table in tables]))]  # fmt: skip
        if self.ego == _NO_TRACK and len(tables) == 1:
            self.ego = self.by_node[min(self.by_node, key=lambda key: key[::-1])]
        if self.ego == _NO_TRACK:
            raise DriveError(
                f"drive {self.drive.name!r}: the car is never found among what the nodes see; it "
                "needs fixes, or three objects that it sees and that nodes see"
            )
        return Epochs(epochs, self.tracks, self.ego, self.verdicts, self.users, self.slow)

    def _epoch(
        self,
        seen: NodeDetections,
        t_ns: int,
        fixes: GnssFixes | None,
        own: RelativeSightings | None,
        users: UserFixes | None,
    ) -> Epoch:
        epoch = self._by_nodes(seen, t_ns)
        if fixes is not None:
            self._fix(epoch, fixes)
        if users is not None:
            self._told(epoch, users)
        if own is not None:
            self._by_car(epoch, own)
        return epoch

    def _by_nodes(self, seen: NodeDetections, t_ns: int) -> Epoch:
        rows = np.flatnonzero(seen.t_ns == t_ns)
        nodes = self.drive.infrastructure.nodes
        kept, places, noises = [], [], []
        for row in rows:
            node, z = nodes[seen.node[row]], seen.p_node_m[row]
            cov = seen.cov_node_m2[row]
            if np.isnan(cov).all():
                cov = A_UNSTATED * float(z @ z + node.p_world_m[2] ** 2) * np.eye(2)
            cov = node.R_world_node @ cov @ node.R_world_node.T
            if not (np.isfinite(z).all() and np.isfinite(cov).all()):
                self._set(seen, row, Verdict.INVALID, "position or covariance is not finite")
                continue
            if np.linalg.norm(z) > node.range_m:
                self._set(seen, row, Verdict.OUTSIDE, "beyond the range of the node")
                continue
            place = node.to_world(z[None])[0]
            kept.append(row)
            places.append(place)
            noises.append(cov)
            self._set(seen, row, Verdict.USED)
        index = np.array(kept, np.int64)
        z_m, R_m2 = np.array(places).reshape(-1, 2), np.array(noises).reshape(-1, 2, 2)
        claimed = self._claimed(seen, index, t_ns, z_m, R_m2)
        tracks = [
            self._track(seen, row, t_ns, z_m[i], R_m2[i]) if claimed[i] == _NO_TRACK else claimed[i]
            for i, row in enumerate(index)
        ]
        return Epoch(
            t_ns, seen.node[index], np.array(tracks, np.int64), z_m, R_m2, index,
            seen.received_ns[index],
        )  # fmt: skip

    def _claimed(
        self, seen: NodeDetections, index: NDArray[np.int64], t_ns: int, z_m: Array, R_m2: Array
    ) -> NDArray[np.int64]:
        """Tracks (n,) of rows that are of somebody who says where it is; else `_NO_TRACK`."""
        claimed = np.full(len(index), _NO_TRACK)
        for node in np.unique(seen.node[index]).tolist():
            at = np.flatnonzero((seen.node[index] == node) & (seen.kind[index] != PEDESTRIAN))
            number = seen.object_id[index[at]]
            claimed[at] = self.tellers.claim(t_ns, node, number, z_m[at], R_m2[at])
        return claimed

    def _track(self, seen: NodeDetections, row: Any, t_ns: int, place: Array, cov: Array) -> int:
        """The track of a node's number: the one it had, the nearest of others, or a new one."""
        key = (int(seen.node[row]), int(seen.object_id[row]))
        if key not in self.by_node or key[1] < 0:
            # A track that this node tells of at this instant is another object.
            taken = {
                self.by_node[other]
                for other in self._numbers(seen, t_ns, key[0]) & self.by_node.keys()
            }
            nearest = self._nearest(place, cov, t_ns, taken)
            self.by_node[key] = self.tracks if nearest is None else nearest
            self.tracks += nearest is None
        track = self.by_node[key]
        self._moved(track, t_ns, place, cov)
        return track

    def _numbers(self, seen: NodeDetections, t_ns: int, node: int) -> set[tuple[int, int]]:
        """What a node tells of at an instant."""
        rows = (seen.t_ns == t_ns) & (seen.node == node)
        return {(node, int(number)) for number in seen.object_id[rows]}

    def _moved(self, track: int, t_ns: int, place: Array, cov: Array) -> None:
        """A track's last place, and its velocity over the last half second or more."""
        _, _, _, velocity, since_ns, since = self.last.get(
            track, (t_ns, place, cov, np.zeros(2), t_ns, place)
        )
        if t_ns - since_ns >= _VELOCITY_NS:
            velocity = (place - since) / ((t_ns - since_ns) / 1e9)
            since_ns, since = t_ns, place
        self.last[track] = (t_ns, place, cov, velocity, since_ns, since)

    def _nearest(self, place: Array, cov: Array, t_ns: int, taken: set[int]) -> int | None:
        """The free track that, as it was moving, is within the gate of a place."""
        found = []
        for track, (when, p, other, velocity, *_) in self.last.items():
            dt_s = (t_ns - when) / 1e9
            if track in taken or dt_s > _LONGEST_S:
                continue
            gap = place - p - dt_s * velocity
            spread = cov + other + (_SPEED_SIGMA_MPS * dt_s) ** 2 * np.eye(2)
            found.append((float(gap @ np.linalg.solve(spread, gap)), track))
        best = min(found, default=(math.inf, 0))
        return best[1] if best[0] < GATE_SIGMA**2 else None

    def _fix(self, epoch: Epoch, fixes: GnssFixes) -> None:
        rows = np.flatnonzero(fixes.t_ns == epoch.t_ns)
        fine = rows[finite_rows(fixes.p_world_ant_m[rows], fixes.cov_world_m2[rows])]
        self._set(fixes, rows, Verdict.INVALID, "not finite, or one of two at an instant")
        if not len(fine):
            return
        self._set(fixes, fine[0], Verdict.USED)
        z_m, R_m2 = fixes.p_world_ant_m[fine[0], :2], fixes.cov_world_m2[fine[0], :2, :2]
        if self.users and not self._says(self.ego, epoch.t_ns, z_m, R_m2):
            self._set(fixes, fine[0], Verdict.GATED, _FAR_OFF)
            return
        epoch.fix_m, epoch.fix_R_m2 = z_m, R_m2
        if self.ego == _NO_TRACK:
            nearest = self._nearest(epoch.fix_m, epoch.fix_R_m2, epoch.t_ns, set())
            self.ego = _NO_TRACK if nearest is None else nearest

    def _reserve(self, users: UserFixes, fixes: GnssFixes | None) -> None:
        """Tracks of all that say where they are, the car first; and how slow their errors are."""
        if fixes is not None and len(fixes):
            self.ego, self.tracks = self.tracks, self.tracks + 1
        for number in np.unique(users.user_id).tolist():
            self.users[number], self.tracks = self.tracks, self.tracks + 1
        rig = self.drive.rig
        if rig.user_bias is not None:
            self.slow |= dict.fromkeys(self.users.values(), rig.user_bias)
        if rig.gnss_bias is not None and self.ego != _NO_TRACK:
            self.slow[self.ego] = rig.gnss_bias

    def _told(self, epoch: Epoch, users: UserFixes) -> None:
        """What road users say of themselves; of two fixes of one at an instant the first."""
        rows = np.flatnonzero(users.t_ns == epoch.t_ns)
        self._set(users, rows, Verdict.INVALID, "not finite, or one of two at an instant")
        rows = rows[finite_rows(users.p_world_m[rows], users.cov_m2[rows])]
        rows = rows[np.unique(users.user_id[rows], return_index=True)[1]]
        fits = np.array([
            self._says(self.users[int(users.user_id[row])], epoch.t_ns, users.p_world_m[row],
                       users.cov_m2[row]) for row in rows
        ], bool)  # fmt: skip
        self._set(users, rows[~fits], Verdict.GATED, _FAR_OFF)
        rows = rows[fits]
        self._set(users, rows, Verdict.USED)
        epoch.told = np.array([self.users[int(one)] for one in users.user_id[rows]], np.int64)
        epoch.told_m, epoch.told_R_m2 = users.p_world_m[rows], users.cov_m2[rows]

    def _says(self, track: int, t_ns: int, z_m: Array, R_m2: Array) -> bool:
        """A track says where it is; whether that can be."""
        nodes = [GnssBias(node.bias_sigma_m, node.bias_tau_s)
                 for node in self.drive.infrastructure.nodes if node.bias_sigma_m]  # fmt: skip
        worst = max(nodes, key=lambda bias: bias.sigma_m, default=None)
        return self.tellers.told(track, t_ns, z_m, R_m2, self.slow.get(track), worst)

    def _by_car(self, epoch: Epoch, own: RelativeSightings) -> None:
        rows = np.flatnonzero(own.t_ns == epoch.t_ns)
        if self.ego == _NO_TRACK:
            self._find_itself(epoch, own, rows)
        place = {int(track): z for track, z in zip(epoch.track, epoch.z_m, strict=True)}
        if self.ego in place and any(int(own.object_id[row]) not in self.by_car for row in rows):
            self._name(epoch, own, rows, place)
        known = [row for row in rows if int(own.object_id[row]) in self.by_car]
        self._set(own, rows, Verdict.UNUSED, "not found among what nodes have seen")
        self._set(own, known, Verdict.USED)
        epoch.seen = np.array([self.by_car[int(own.object_id[row])] for row in known], np.int64)
        epoch.seen_m, epoch.seen_R_m2 = own.p_veh_m[known], own.cov_veh_m2[known]
        self._heading(epoch)

    def _find_itself(self, epoch: Epoch, own: RelativeSightings, rows: NDArray[np.int64]) -> None:
        """Without fixes: the layout of all objects says which of them is the car."""
        veh = np.concatenate([np.zeros((1, 2)), own.p_veh_m[rows]])
        sigma = math.sqrt(float(np.mean([*epoch.R_m2[:, 0, 0], *own.cov_veh_m2[rows, 0, 0]]))
                          ) if len(epoch.z_m) and len(rows) else 1.0  # fmt: skip
        found = match(epoch.z_m, veh, sigma_m=sigma, doubt=0.05)
        if found.status != Status.MATCHED:
            return
        pairs = {int(a): int(b) for a, b in np.concatenate([found.pairs, found.likely])}
        if 0 not in pairs:
            return
        self.ego = int(epoch.track[pairs.pop(0)])
        for own_index, theirs in pairs.items():
            self.by_car[int(own.object_id[rows[own_index - 1]])] = int(epoch.track[theirs])

    def _name(
        self, epoch: Epoch, own: RelativeSightings, rows: NDArray[np.int64], place: dict[int, Array]
    ) -> None:
        """Tracks of the car's new numbers, under the heading on which most objects fall."""
        others = [track for track in place if track != self.ego]
        best: tuple[int, float, dict[int, int]] = (0, 0.0, {})
        for row in rows:
            for track in others:
                ray, seen = place[track] - place[self.ego], own.p_veh_m[row]
                yaw = math.atan2(ray[1], ray[0]) - math.atan2(seen[1], seen[0])
                named, cost = self._fall(epoch, own, rows, place, yaw)
                if (len(named), -cost) > (best[0], -best[1]):
                    best = (len(named), cost, named)
        for number, track in best[2].items():
            self.by_car.setdefault(number, track)

    def _fall(
        self, epoch: Epoch, own: RelativeSightings, rows: NDArray[np.int64],
        place: dict[int, Array], yaw: float,
    ) -> tuple[dict[int, int], float]:  # fmt: skip
        """Which numbers fall on which tracks under a heading, and the sum of squared distances."""
        named: dict[int, int] = {}
        cost = 0.0
        noise = {int(t): R for t, R in zip(epoch.track, epoch.R_m2, strict=True)}
        for row in rows:
            at = place[self.ego] + rotation(yaw) @ own.p_veh_m[row]
            scale = float(own.cov_veh_m2[row].trace()) / 2 + float(noise[self.ego].trace()) / 2
            squares = {
                track: float(((at - p) ** 2).sum()) / (scale + float(noise[track].trace()) / 2)
                for track, p in place.items()
                if track != self.ego and track not in named.values()
            }
            near = min(squares, key=squares.__getitem__, default=None)
            if near is not None and squares[near] < GATE_SIGMA**2:
                named[int(own.object_id[row])] = near
                cost += squares[near]
        return named, cost

    def _heading(self, epoch: Epoch) -> None:
        """The rotation that carries what the car sees to what nodes see, with its variance."""
        place: dict[int, tuple[Array, float]] = {}
        for track, z, R in zip(epoch.track, epoch.z_m, epoch.R_m2, strict=True):
            place[int(track)] = (z, float(R.trace()) / 2)
        pairs = [(m, cov, *place[int(t)]) for t, m, cov in
                 zip(epoch.seen, epoch.seen_m, epoch.seen_R_m2, strict=True)
                 if int(t) in place]  # fmt: skip
        if self.ego in place and pairs:
            veh = np.array([np.zeros(2), *(p[0] for p in pairs)])
            world = np.array([place[self.ego][0], *(p[2] for p in pairs)])
            w = 1 / np.array([place[self.ego][1], *(p[3] + p[1].trace() / 2 for p in pairs)])
            pose: Rigid = fit(veh, world, w)
            spread = veh - w @ veh / w.sum()
            self.yaw = (pose.yaw_rad, 1 / float(w @ (spread**2).sum(-1)), epoch.t_ns)
        yaw, variance, when = self.yaw
        epoch.yaw_rad = wrapped(yaw) if math.isfinite(yaw) else yaw
        epoch.yaw_var = variance + _TURN_VARIANCE * (epoch.t_ns - when) / 1e9

    def _table(self, kind: type[T]) -> T | None:
        table = self.drive.tables.get(kind.KIND)
        return table if isinstance(table, kind) else None

    def _set(self, table: Table, rows: Any, verdict: Verdict, reason: str = "") -> None:
        self.verdicts[table.KIND].set(rows, verdict, reason)
