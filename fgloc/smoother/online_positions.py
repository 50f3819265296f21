"""Measured positions as they arrive: gated, told apart from other objects, entered, remembered.

Fixes enter when they were received, at the state of the instant when they were true. Until the yaw
is aligned nothing gates them, and candidates wait for that: what surrounds the car is not known.
"""

from bisect import insort
from collections.abc import Mapping
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C, X

from fgloc.association import Witness
from fgloc.factors import noise
from fgloc.measurements import Array
from fgloc.result import Event
from fgloc.smoother.batch import explain
from fgloc.smoother.graph import Factors, GraphModel
from fgloc.smoother.online_car import arrivals
from fgloc.smoother.online_posts import OnlinePosts
from fgloc.smoother.tree import Stamps, WholeTree
from fgloc.verdicts import SourceVerdicts, Verdict

OPEN_ANYWAY = 2.0
"""After so many times the reset the gate opens to any fix, not only to two that agree."""


@dataclass(frozen=True, eq=False)
class Told:
    """Row i of the positions against a prediction: its error (3,) m and how well it fits.

    `far` is whether it lies far from where the state is, in its own sigmas.
    """

    i: int
    error: Array
    nis: float
    limit: float
    far: bool

    @property
    def fits(self) -> bool:
        """Whether it passes the gate."""
        return self.nis <= self.limit


class OnlinePositions:
    """Which positions are in the tree, and what became of the others."""

    def __init__(self, model: GraphModel, events: list[Event]) -> None:
        """What there is to remark is added to `events`."""
        self.model, self._events = model, events
        p = model.positions
        self.arriving = arrivals(model.t_ns, np.arange(len(p)), p.received_ns, model.key_of)
        self.accepted: list[int] = []
        self._last = dict.fromkeys(range(len(model.sources)), -1)
        self._accepted_s = 0.0
        self._refused: Array | None = None
        self._witness = Witness()
        self._fits = np.zeros(len(p), bool)
        self._used = np.zeros(len(p), bool)
        self._weighed = np.zeros(len(p), bool)

    def take_in(
        self, j: int, rows: list[int], values: gtsam.Values, pose: gtsam.Pose3,
        covs: Mapping[int, Array], tree: WholeTree, posts: OnlinePosts, *, aligned: bool,
    ) -> tuple[Factors, list[int]]:  # fmt: skip
        """Factors of the rows that are in time and pass the gate, and those of them that lie far.

        `pose` is predicted for keyframe j. `covs` are the covariances of keyframes, pose first, as
        they were when each was the newest: what came later has only made them smaller, and to read
        them again for every late row takes as long as to solve.
        """
        told, at = [], {j: pose}
        for i in rows:
            if self._is_late(i, j, tree):
                continue
            key = int(self.model.key_of[i])
            if key not in at:
                at[key] = tree.pose(X(key))
            told.append(self._compare(i, at[key], covs[key][:6, :6], posts))
        accepted = [one for one in told if not self._is_candidate(one.i)
                    and self._accept_fix(one, aligned=aligned)]  # fmt: skip
        frames: dict[int, list[Told]] = {}
        for one in told:
            if self._is_candidate(one.i):
                frames.setdefault(int(self.model.positions.frame[one.i]), []).append(one)
        accepted += [car for seen in frames.values() if (car := self._car(seen, aligned=aligned))]
        factors = [factor for one in accepted for factor in self._enter(one, j, values, tree)]
        return factors, [one.i for one in accepted if one.far]

    def _is_candidate(self, i: int) -> bool:
        return bool(self.model.positions.candidates[i])

    def _verdicts(self, i: int) -> tuple[SourceVerdicts, int]:
        """The verdicts that row i has its own among, and which it is."""
        p = self.model.positions
        table = self.model.sources[int(p.source[i])].table
        return self.model.plan.verdicts[table], int(p.row[i])

    def _enter(self, one: Told, j: int, values: gtsam.Values, tree: WholeTree) -> Factors:
        source, i = int(self.model.positions.source[one.i]), one.i
        before = self._last[source]
        slow = np.zeros(3)
        if before >= 0 and self.model.sources[source].bias is not None:
            slow = tree.vector(C(before)) if tree.holds(C(before)) else values.atVector(C(before))
        self.model.insert_position(values, i, slow)
        factors = self.model.slow_factors(i, before if before >= 0 else None)
        insort(self.accepted, i)
        self._last[source] = max(before, i)
        self._used[i] = True
        if not self._is_candidate(i):
            self._accepted_s = float(self.model.t_s[j])
        return factors + self.model.position_factors(i)

    def _is_late(self, i: int, j: int, tree: WholeTree) -> bool:
        """Give a row its verdict where its state, or its source's slow error, has passed it by."""
        model, key = self.model, int(self.model.key_of[i])
        s = int(model.positions.source[i])
        passed = model.sources[s].bias is not None and i < self._last[s]
        if not passed and (key == j or tree.holds(X(key))):
            return False
        age_s = model.t_s[min(j, len(model) - 1)] - model.t_s[key]
        why = "its state has left the window"
        if passed:
            why = "a later one is in the chain of the slow error"
        verdicts, row = self._verdicts(i)
        verdicts.set(row, Verdict.LATE, f"{age_s:.2f} s old; {why}")
        return True

    def _compare(self, i: int, pose: gtsam.Pose3, cov: Array, posts: OnlinePosts) -> Told:
        """Row i against a predicted pose with its covariance (6, 6), and its node's post."""
        model, p = self.model, self.model.positions
        s = int(p.source[i])
        source, R = model.sources[s], pose.rotation().matrix()
        H, R_own = R @ model.point_by_pose[s], model.cov_world_m2[i]
        error = pose.transformFrom(model.levers[s]) - p.z_world_m[i]
        S = H @ cov @ H.T + R_own + source.point_sigma_m**2 * np.eye(3)
        S += (source.bias.sigma_m**2 if source.bias else 0.0) * np.eye(3)
        if s in model.swaying.of_source:
            moved, spread = posts.moved(s, int(p.row[i]), int(model.key_of[i]))
            error, S = error - moved, S + spread
        nis = float(noise.nis(error, S))
        # What a slow error can take up does not move the state.
        alone = 0.0 if source.linked else float(noise.nis(error, R_own))
        limit = float(model.gate_nis[i])
        return Told(i, error, nis, limit, alone > source.settings.loss_width**2)

    def _note(self, one: Told) -> None:
        verdicts, row = self._verdicts(one.i)
        verdicts.nis[row], verdicts.threshold[row] = one.nis, one.limit
        verdicts.dof[row] = self.model.positions.dof[one.i]

    def _accept_fix(self, one: Told, *, aligned: bool) -> bool:
        """Whether a fix is accepted: it fits, or none has for so long that the gate opens."""
        model, i = self.model, one.i
        reset_s = model.config.gnss.gate_reset_s
        waited = float(model.t_s[model.key_of[i]] - self._accepted_s) / reset_s
        agrees = self._agrees_with_the_last(one.error, model.cov_world_m2[i])
        opens = waited > (1 if agrees else OPEN_ANYWAY)
        accepted = one.fits or opens or not aligned
        self._refused = None if accepted else one.error
        verdicts, row = self._verdicts(i)
        if aligned:
            self._note(one)
        if not accepted:
            verdicts.set(row, Verdict.GATED, "does not fit the prediction")
            return False
        verdicts.set(row, Verdict.USED, "" if aligned else "before the yaw was aligned")
        if not one.fits and aligned:
            text = f"no fix accepted for {waited * reset_s:.1f} s: the gate opened"
            at_ns = int(model.positions.t_ns[i])
            self._events.append(Event(at_ns, "gate reset", text))
        return True

    def _agrees_with_the_last(self, error: Array, cov: Array) -> bool:
        """Whether a fix that does not fit errs as the one refused before it did: one that is wrong
        by itself must not move the state to where it is."""
        if self._refused is None:
            return False
        apart = error - self._refused
        return float(noise.nis(apart, 2 * cov)) <= self.model.sources[0].gate_nis

    def _car(self, seen: list[Told], *, aligned: bool) -> Told | None:
        """The candidate of a frame that is the car, if one is."""
        p = self.model.positions
        if not aligned:
            for one in seen:
                verdicts, row = self._verdicts(one.i)
                verdicts.set(row, Verdict.UNUSED, "before the yaw was aligned")
            return None
        for one in seen:
            self._note(one)
            self._fits[one.i], self._weighed[one.i] = one.fits, True
        fitting = [one for one in seen if one.fits]
        if not fitting:
            return None
        named = {one.i: (int(p.source[one.i]), int(p.object_id[one.i])) for one in seen}
        # A height that is told must not make a candidate look further away.
        car = min(
            fitting, key=lambda one: one.nis - p.dof[one.i] + self._witness.cost(*named[one.i])
        )
        for one in seen:
            self._witness.note(*named[one.i], car=one is car)
        verdicts, row = self._verdicts(car.i)
        verdicts.set(row, Verdict.USED)
        return car

    def weigh(self, rows: list[int], tree: WholeTree) -> None:
        """Note which of the rows that lay far the loss still weighs down, now that they are in."""
        model, p = self.model, self.model.positions
        for i in rows:
            s = int(p.source[i])
            source = model.sources[s]
            pose = tree.pose(X(int(model.key_of[i])))
            error = pose.transformFrom(model.levers[s]) - p.z_world_m[i]
            norm = np.sqrt(noise.nis(error, model.cov_world_m2[i]))
            weight = float(noise.weight(norm, source.settings.loss, source.settings.loss_width))
            if weight < 1:
                reason = f"{source.settings.loss} weight {weight:.3g}"
                verdicts, row = self._verdicts(i)
                verdicts.set(row, Verdict.DOWN_WEIGHTED, reason)

    def since(self, first: int) -> list[int]:
        """Accepted rows at keyframe `first` and later."""
        return [i for i in self.accepted if self.model.key_of[i] >= first]

    def factors(self, first: int) -> list[tuple[int, Factors]]:
        """What a graph over a window holds of the rows since keyframe `first`, each with its
        keyframe."""
        before: dict[int, int] = {}
        told = []
        for i in self.since(first):
            s = int(self.model.positions.source[i])
            own = [*self.model.slow_factors(i, before.get(s)), *self.model.position_factors(i)]
            told.append((int(self.model.key_of[i]), own))
            before[s] = i
        return told

    def stamps(self, first: int) -> Stamps:
        """The time in s of the variables of the rows since keyframe `first`."""
        return {
            key: float(self.model.t_s[self.model.key_of[i]])
            for i in self.since(first)
            for key in self.model.position_keys(i)
        }

    def alive(self) -> list[int]:
        """Variables that a later row will touch, whatever their age."""
        return [
            key
            for s, i in self._last.items()
            if i >= 0 and self.model.sources[s].bias is not None
            for key in self.model.position_keys(i)[1:]
        ]

    def forget(self, before: int) -> None:
        """Drop what lies before a keyframe."""
        while len(self.accepted) > 1 and self.model.key_of[self.accepted[0]] < before:
            del self.accepted[0]

    def finish(self) -> None:
        """Say of each candidate that was not the car what it was."""
        explain(self.model, self._used, self._fits, self._weighed)
