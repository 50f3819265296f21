"""What stands beside the car in its graph: swaying posts, and users who say where they are.

A node on a post that sways sees what is further along where it says as less far along, so its
detections depend on the post's state at their keyframe (`swaying.py`). Users whose places are known
tell of post and survey alone: the car has no part in them.
"""

from collections.abc import Iterator
from copy import copy

import numpy as np
from numpy.typing import NDArray

from fgloc.factors import gnss
from fgloc.measurements import Array
from fgloc.smoother.model import Model
from fgloc.smoother.states import States
from fgloc.smoother.term import POSE, Border, Term, whitened, whitening


class Beside:
    """Terms of the posts and users of a model's first n keyframes, whose blocks are `width` wide:
    the posts' states come last."""

    def __init__(self, model: Model, border: Border, n: int, width: int) -> None:
        self.model, self.n, self._border, self._width = model, n, border, width
        self._first = width - model.swaying.width
        self._told = int(np.searchsorted(model.reference_key, n))
        cov = model.references.cov_world_m2[: self._told] + gnss.TIE_SIGMA_M**2 * np.eye(3)
        self._whiten = whitening(model, cov, model.reference_key[: self._told])

    def of(self, model: Model) -> "Beside":
        """The same for a model with other numbers of its posts."""
        other = copy(self)
        other.model = model
        return other

    @property
    def factors(self) -> int:
        """How many there are: states of posts, poses of nodes, detections of users."""
        swaying = self.model.swaying
        poses = int(np.searchsorted(swaying.pose_key, self.n))
        return swaying.slots * self.n + poses + self._told

    def by_post(
        self, states: States, s: int, row: NDArray[np.int64], keys: NDArray[np.int64]
    ) -> tuple[Array, NDArray[np.int64]]:
        """Jacobians (m, 3, 6) of detections of source s by its post, and the unknowns they are by.

        What lies further along where the node says is less far along than the car.
        """
        swaying = self.model.swaying
        k = swaying.of_source[s]
        _, J = swaying.moved(s, row, swaying.states(states.posts, keys, k))
        own = self._first + swaying.at(int(swaying.slot[k]))
        return -J, own

    def references(self, states: States, first: int, stop: int) -> Iterator[Term]:
        """What nodes see of users whose places are known, at keyframes first..stop - 1."""
        model, found = self.model, self.model.references
        within = slice(*np.searchsorted(model.reference_key[: self._told], [first, stop]))
        if within.start == within.stop:
            return
        kind = np.stack([found.source[within], model.reference_layer[within]], -1)
        for s, layer in np.unique(kind, axis=0).tolist():
            rows = within.start + np.flatnonzero((kind == [s, layer]).all(-1))
            yield self._reference(states, s, rows)

    def _reference(self, states: States, s: int, rows: NDArray[np.int64]) -> Term:
        """Those rows of the references, all of source s and each of another keyframe."""
        model, found = self.model, self.model.references
        keys, W = model.reference_key[rows], self._whiten[rows]
        parts, at = [], POSE[:0]
        if s in model.swaying.of_source:
            by_post, at = self.by_post(states, s, found.row[rows], keys)
            parts = [by_post]
        if s in self._border.survey:
            by = found.by_survey(rows, model.sources[s].p_world_m)[:, :, : model.survey_size]
            parts.append(self._border.by(self._border.survey[s], -by))
        error, settings = reference_errors(model, states, rows, s), model.sources[s].settings
        J = W @ np.concatenate(parts, -1)
        return Term(keys, at, whitened(W, error), J, settings.loss, settings.loss_width)

    def posts(self, states: States, first: int, stop: int) -> Iterator[Term]:
        """How the posts go on from keyframes first..stop - 1, and what is told of them alone."""
        swaying, end = self.model.swaying, min(stop + 1, self.n)
        for c in range(swaying.slots):
            own = self._first + swaying.at(c)
            x = states.posts[:, swaying.at(c)]
            after, earlier = (block[:, c] for block in swaying.steps)
            if first == 0:
                yield Term(np.array([0]), own, whitened(after[:1], x[:1]), after[:1])
            if first + 1 < end:
                rows, back = slice(first + 1, end), slice(first, end - 1)
                error = whitened(after[rows], x[rows]) + whitened(earlier[rows], x[back])
                J = np.concatenate([earlier[rows], after[rows]], -1)
                at = np.append(own, self._width + own)
                yield Term(np.arange(first, end - 1), at, error, J)
        for c, keys, z, J in swaying.poses(first, stop):
            x = states.posts[keys][:, swaying.at(c)]
            yield Term(keys, self._first + swaying.at(c), whitened(J, x) - z, J)


def reference_errors(model: Model, states: States, rows: NDArray[np.int64], s: int) -> Array:
    """Where users are less where node s sees them, (m, 3) East, North and up in m; 0 for a height
    that is not told."""
    found = model.references
    z = found.z_world_m[rows]
    if model.sources[s].surveyed:
        z = z + found.by_survey(rows, model.sources[s].p_world_m) @ states.survey[s]
    if s in model.swaying.of_source:
        z = z + moved(model, states, s, found.row[rows], model.reference_key[rows])
    return found.told_m[rows] - z


def moved(
    model: Model, states: States, s: int, row: NDArray[np.int64], keys: NDArray[np.int64]
) -> Array:
    """How far sway moves detections (m, 3) of source s at some keyframes, along ENU in m."""
    swaying = model.swaying
    own = swaying.states(states.posts, keys, swaying.of_source[s])
    return swaying.moved(s, row, own)[0]
