"""The swaying posts as a drive arrives: predicted, told of, read, and remembered for a regrowth.

Poses of nodes and what users tell enter when they have arrived, at the states of the instants when
they were true. Detections of the car enter with its positions (`online_positions.py`), about the
state that is believed here. Where a window is grown anew its first states are at rest, as far as
the wind lets them: a post forgets faster than any window ends. What users tell is taken at full
weight, whatever the loss: what the survey is off would look like their error until it is known.
"""

import gtsam
import numpy as np
from gtsam.symbol_shorthand import U

from fgloc.factors import noise
from fgloc.measurements import Array, NodePoses
from fgloc.references import judge_references
from fgloc.smoother.graph import Factors, GraphModel
from fgloc.smoother.native_posts import post_key
from fgloc.smoother.online_car import arrivals
from fgloc.smoother.tree import Stamps, WholeTree
from fgloc.verdicts import Verdict
from fgloc.watches import SOURCE, judge_poses


class OnlinePosts:
    """Which posts are in the tree, and what is believed of them.

    x, P  (n, width) and (n, width, width): each keyframe's states as they were when it was the
          newest, NaN before; those of different slots count as independent
    """

    def __init__(self, model: GraphModel) -> None:
        self.model, self.swaying = model, model.swaying
        n, width = len(model), self.swaying.width
        self.x, self.P = np.full((n, width), np.nan), np.full((n, width, width), np.nan)
        self._poses, self._users = self._arriving_poses(), self._arriving_users()
        self._told: dict[int, list[int]] = {}
        self._seen: dict[int, list[int]] = {}

    def take_in(self, j: int, values: gtsam.Values, tree: WholeTree) -> Factors:
        """The states of keyframe j as predicted, and factors of what has come in by it."""
        factors: Factors = []
        if j < len(self.model):
            self._predict(j)
            self.swaying.insert(values, j, self.x[j])
            factors = self.swaying.chain_factors(j)
        told = [i for i in self._poses[j] if self._pose_is_in_time(i, j, tree)]
        seen = [i for i in self._users[j] if self._user_is_in_time(i, j, tree)]
        for i in told:
            self._told.setdefault(int(self.swaying.pose_key[i]), []).append(i)
        for i in seen:
            self._seen.setdefault(int(self.model.reference_key[i]), []).append(i)
            values.insert(U(i), self.model.references.told_m[i])
        factors += self.swaying.pose_factors(told)
        return factors + [factor for i in seen for factor in self.model.reference_factors(i)]

    def read(self, j: int, tree: WholeTree) -> None:
        """Take the states of keyframe j out of the tree."""
        for c, key in enumerate(self.swaying.keys_at(j)):
            own = self.swaying.at(c)
            self.x[j, own] = tree.vector(key)
            self.P[j, own[:, None], own] = tree.covariance([key])
        self.swaying.about[j] = self.x[j]

    def moved(self, s: int, row: int, k: int) -> tuple[Array, Array]:
        """How far sway is believed to move a detection (3,) of source s at keyframe k, and the
        covariance of that (3, 3); what pose and post have in common is left out."""
        slot = int(self.swaying.slot[self.swaying.of_source[s]])
        own = self.swaying.at(slot)
        moved, J = self.swaying.moved(s, np.array([row]), self.x[k, own][None])
        return moved[0], J[0] @ self.P[k][own[:, None], own] @ J[0].T

    def factors(self, k: int, first: int) -> Factors:
        """What a graph over a window from keyframe `first` on holds of keyframe k."""
        told = self.swaying.pose_factors(self._told.get(k, ()))
        seen = (self.model.reference_factors(i) for i in self._seen.get(k, ()))
        chain = self.swaying.chain_factors(k, begins=k == first)
        return [*chain, *told, *(factor for factors in seen for factor in factors)]

    def insert(self, values: gtsam.Values, first: int, n: int) -> None:
        """Put in the variables of n keyframes of a window."""
        for k in range(first, first + n):
            self.swaying.insert(values, k, self.x[k])
            for i in self._seen.get(k, ()):
                values.insert(U(i), self.model.references.told_m[i])

    def stamps(self, first: int, j: int) -> Stamps:
        """The time in s of the variables of keyframes first..j."""
        t_s = self.model.t_s
        return {
            key: float(t_s[k])
            for k in range(first, j + 1)
            for key in (*self.swaying.keys_at(k), *(U(i) for i in self._seen.get(k, ())))
        }

    def forget(self, before: int) -> None:
        """Drop what lies before a keyframe."""
        for store in (self._told, self._seen):
            for k in [k for k in store if k < before]:
                del store[k]

    def _predict(self, j: int) -> None:
        """The states of keyframe j from those of the keyframe before."""
        swaying, self.x[j], self.P[j] = self.swaying, 0.0, 0.0
        for c in range(swaying.slots):
            own = swaying.at(c)
            block = own[:, None], own
            after, before = (part[j, c] for part in swaying.steps)
            root = np.linalg.inv(after)
            self.P[j][block] = root @ root.T
            if not swaying.begins[j, c]:
                transition = -root @ before
                self.x[j, own] = transition @ self.x[j - 1, own]
                self.P[j][block] += transition @ self.P[j - 1][block] @ transition.T
        swaying.about[j] = self.x[j]

    def _pose_is_in_time(self, i: int, j: int, tree: WholeTree) -> bool:
        """Give a pose its NIS, or its verdict where its state has left the window."""
        swaying, judged = self.swaying, self.model.plan.verdicts[SOURCE]
        k, c, row = int(swaying.pose_key[i]), int(swaying.pose_slot[i]), int(swaying.pose_row[i])
        if k != j and not tree.holds(post_key(c, k)):
            judged.set(row, Verdict.LATE, "its state has left the window")
            return False
        own = swaying.at(c)
        J = swaying.pose_J[i]
        S = J @ self.P[k][own[:, None], own] @ J.T + np.eye(len(J))
        judged.nis[row] = float(noise.nis(J @ self.x[k, own] - swaying.pose_z[i], S))
        judged.dof[row] = int(J.any(-1).sum())
        return True

    def _user_is_in_time(self, i: int, j: int, tree: WholeTree) -> bool:
        """Give what is seen of a user its verdict where its state has left the window."""
        model = self.model
        k, s = int(model.reference_key[i]), int(model.references.source[i])
        if k == j or s not in self.swaying.of_source:
            return True
        c = int(self.swaying.slot[self.swaying.of_source[s]])
        if tree.holds(post_key(c, k)):
            return True
        row, reason = int(model.references.row[i]), "its state has left the window"
        model.plan.verdicts["detections"].set(row, Verdict.LATE, reason)
        return False

    def _arriving_poses(self) -> list[list[int]]:
        """Which poses come in by each keyframe; all get a first verdict."""
        model, swaying = self.model, self.swaying
        poses = model.drive.tables.get(SOURCE)
        received = np.zeros(0, np.int64)
        if isinstance(poses, NodePoses):
            received = poses.received_ns[swaying.pose_row]
            if model.config.posts.compensate:
                judge_poses(model.drive, swaying.watches, model.plan.verdicts[SOURCE])
        return arrivals(model.t_ns, np.arange(len(received)), received, swaying.pose_key)

    def _arriving_users(self) -> list[list[int]]:
        """Which detections of users come in by each keyframe; all get a first verdict."""
        model, found = self.model, self.model.references
        judge_references(found, model.plan.verdicts)
        return arrivals(model.t_ns, np.arange(len(found)), found.received_ns, model.reference_key)
