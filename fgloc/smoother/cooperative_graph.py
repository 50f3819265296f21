"""The cooperative graph in GTSAM: its keys, its factors, and iSAM2 over all that came so far."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from fgloc.correspondence.epochs import Epoch
from fgloc.measurements import Array
from fgloc.smoother.cooperative_model import (
    FIRST_SIGMA_RAD,
    FIRST_SIGMAS,
    Call,
    Roster,
    forgetting,
    motion,
    of_node,
    off_survey,
    own_sightings,
    whitener,
)

_UNIT = {m: gtsam.noiseModel.Unit.Create(m) for m in (1, 2, 3, 4)}
_I2, _POSITION, _VELOCITY = np.eye(2), np.eye(2, 4), np.eye(2, 4, 2)


def state_key(track: int, k: int) -> int:
    """Of a road user at an instant; there is room for 10 million instants."""
    return int(gtsam.symbol("s", track * 10_000_000 + k))


def heading_key(k: int) -> int:
    """Of the ego car's heading at an instant."""
    return int(gtsam.symbol("h", k))


def survey_key(node: int) -> int:
    """Of the error of a node's survey."""
    return int(gtsam.symbol("n", node))


def slow_key(source: int, k: int) -> int:
    """Of a slow error at an instant: of a track's own fixes, or, below 0, of a node."""
    return int(gtsam.symbol("b" if source >= 0 else "c", abs(source) * 10_000_000 + k))


def errors_key(k: int) -> int:
    """Of the errors of the car's yaw rate and wheels at an instant."""
    return int(gtsam.symbol("o", k))


@dataclass(eq=False)
class Part:
    """Factors and first values that one instant adds."""

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values


class Builder:
    """Turns instants into factors, one after the other."""

    def __init__(self, roster: Roster) -> None:
        self.roster = roster
        self.zeros = gtsam.Values()  # where the factors are linear from
        self.last = Call(0, 0.0, [], [], heading=False)
        self.k = -1
        self.survey: set[int] = set()
        self.factors = 0

    def begin(self, epoch: Epoch, yaw_rad: float) -> Part:
        """The states of an instant, joined to the instant before; tracks are born and die here.

        The heading's chain begins about `yaw_rad`, once one is known.
        """
        self.k += 1
        part = Part(gtsam.NonlinearFactorGraph(), gtsam.Values())
        call, before = self.roster.call(epoch, yaw_rad), self.last
        lived, drifted = set(before.tracks), set(before.sources)
        F, Q = motion(call.dt_s)
        W = whitener(Q) if call.dt_s else Q
        for track in call.tracks:
            first = None if track in lived else FIRST_SIGMAS
            self._chain(part, partial(state_key, track), first, F, W)
        for source in call.sources:
            bias = self.roster.slow[source]
            kept, variance = forgetting(bias, call.dt_s)
            first = None if source in drifted else np.full(2, bias.sigma_m)
            key = partial(slow_key, source)
            self._chain(part, key, first, kept, _I2 / math.sqrt(variance or math.inf))
        self._turn(part, call, yaw_rad)
        self.last = call
        return part

    def sightings(self, part: Part, epoch: Epoch, k: int, yaw_rad: float) -> None:
        """All that was measured at instant k, with own sightings linearised about a heading."""
        for i in range(len(epoch.track)):
            self.node_sighting(part, epoch, i, k)
        self.car_sightings(part, epoch, k, yaw_rad)
        self.own_motion(part, epoch.t_ns, k, yaw_rad)

    def node_sighting(self, part: Part, epoch: Epoch, i: int, k: int) -> None:
        """One sighting of a node."""
        node, key = int(epoch.node[i]), state_key(int(epoch.track[i]), k)
        W, z = whitener(epoch.R_m2[i]), epoch.z_m[i]
        terms = [(key, W @ _POSITION), *self._slowly(of_node(node), k, W)]
        if self._has_survey(part, node):
            off = off_survey(z[None], self.roster.nodes[node].p_world_m[None, :2])[0]
            terms.append((survey_key(node), W @ off))
        self._add(part, W @ z, *terms)

    def car_sightings(self, part: Part, epoch: Epoch, k: int, yaw_rad: float) -> None:
        """The car's fix, what others say of theirs, and where it sees others under a heading."""
        ego = self.roster.ego
        if epoch.fix_m is not None and epoch.fix_R_m2 is not None:
            self._fix(part, ego, k, epoch.fix_m, epoch.fix_R_m2)
        for track, z, cov in zip(epoch.told, epoch.told_m, epoch.told_R_m2, strict=True):
            self._fix(part, int(track), k, z, cov)
        if not math.isfinite(yaw_rad) or ego not in self.last.tracks:
            return
        for track, z, turn, W in zip(epoch.seen, *own_sightings(epoch, yaw_rad), strict=True):
            self._add(
                part, W @ z, (state_key(ego, k), -W @ _POSITION),
                (state_key(int(track), k), W @ _POSITION), (heading_key(k), -W @ turn),
            )  # fmt: skip

    def own_motion(self, part: Part, t_ns: int, k: int, yaw_rad: float) -> None:
        """What the car tells of its own motion, about a heading."""
        own, ego = self.roster.own, self.roster.ego
        if own is None or ego not in self.last.tracks:
            return
        for row in own.rows(t_ns, yaw_rad):
            terms = [(state_key(ego, k), row.v @ _VELOCITY)]
            if self.last.heading:
                terms += [(heading_key(k), row.h), (errors_key(k), row.o)]
            self._add(part, row.b, *terms)

    def _turn(self, part: Part, call: Call, yaw_rad: float) -> None:
        """The heading's chain, from where one is known, and that of the errors of the car."""
        k, own, lived = self.k, self.roster.own, self.last.heading
        if not call.heading:
            return
        if call.rolls and own is not None:
            first = None if lived else own.error_sigma
            W = np.diag(1 / (own.error_walk * math.sqrt(call.dt_s or math.inf)))
            self._chain(part, errors_key, first, 1.0, W)
        if not lived:
            first, mean = np.array([FIRST_SIGMA_RAD]), np.array([yaw_rad])
            self._chain(part, heading_key, first, 1.0, np.eye(1), mean)
            return
        self._begin(part, heading_key(k), 1)
        turned, variance = call.turn
        W = np.eye(1) / math.sqrt(variance)
        terms = [(heading_key(k - 1), -W), (heading_key(k), W)]
        if call.rolls:
            terms.append((errors_key(k - 1), W @ [[call.dt_s, 0.0]]))
        self._add(part, W[0] * turned, *terms)

    def _fix(self, part: Part, track: int, k: int, z_m: Array, R_m2: Array) -> None:
        """Where a road user says it is."""
        W = whitener(R_m2)
        self._add(part, W @ z_m, (state_key(track, k), W @ _POSITION), *self._slowly(track, k, W))

    def _slowly(self, source: int, k: int, W: Array) -> tuple[tuple[int, Array], ...]:
        """The term of a source's slow error, where it has one."""
        return ((slow_key(source, k), W),) if source in self.roster.slow else ()

    def _has_survey(self, part: Part, node: int) -> bool:
        """Whether a node's survey is uncertain; its variable begins with its first sighting."""
        sigma = self.roster.survey_sigma(node)
        if sigma is None:
            return False
        if node not in self.survey:
            self.survey.add(node)
            self._chain(part, lambda _: survey_key(node), sigma, 1.0, np.eye(3))
        return True

    def _chain(
        self, part: Part, key_at: Callable[[int], int], first: Array | None,
        F: Array | float, W: Array,
        mean: Array | None = None,
    ) -> None:  # fmt: skip
        """A variable that follows from the one before by F, with whitener W of what is new; or
        begins, with the sigmas `first`, about `mean`, by default 0."""
        key = key_at(self.k)
        self._begin(part, key, len(W))
        if first is None:
            before = -W @ F if isinstance(F, np.ndarray) else -F * W
            self._add(part, np.zeros(len(W)), (key_at(self.k - 1), before), (key, W))
        else:
            self._add(part, (0 if mean is None else mean) / first, (key, np.diag(1 / first)))

    def _begin(self, part: Part, key: int, size: int) -> None:
        for values in (part.values, self.zeros):
            values.insert(key, np.zeros(size))

    def _add(self, part: Part, b: Array, *terms: tuple[int, Array]) -> None:
        """A factor |sum A x - b| of whitened rows."""
        flat: list[Any] = [item for term in terms for item in term]
        factor = gtsam.JacobianFactor(*[*flat, b, _UNIT[len(b)]])
        part.graph.add(gtsam.LinearContainerFactor(factor, self.zeros))
        self.factors += 1


class Grown:
    """iSAM2 over all instants so far. All factors are linear where they stand, so nothing is
    relinearised.
    """

    def __init__(self, roster: Roster) -> None:
        params = gtsam.ISAM2Params()
        params.setRelinearizeThreshold(1e9)
        params.findUnusedFactorSlots = True
        # Cholesky loses a track of which little is known, and instants a fraction of a ms apart.
        params.setFactorization("QR")
        self._tree, self._builder = gtsam.ISAM2(params), Builder(roster)
        self._epochs: list[Epoch] = []

    def update(self, epoch: Epoch, yaw_rad: float, arrived: dict[int, NDArray[np.int64]]) -> None:
        """The next instant, with what nodes told: `arrived` has the rows of each instant's epoch.

        What the car sees is linearised about `yaw_rad`.
        """
        builder, k = self._builder, len(self._epochs)
        self._epochs.append(epoch)
        part = builder.begin(epoch, yaw_rad)
        for of, rows in arrived.items():
            for i in rows:
                builder.node_sighting(part, self._epochs[of], int(i), of)
        builder.car_sightings(part, epoch, k, yaw_rad)
        builder.own_motion(part, epoch.t_ns, k, yaw_rad)
        self._tree.update(part.graph, part.values)

    @property
    def factors(self) -> int:
        """How many there are."""
        return self._builder.factors

    @property
    def tracks(self) -> list[int]:
        """All that live now."""
        return self._builder.last.tracks

    def states(self, tracks: list[int]) -> tuple[Array, Array]:
        """(n, 4) of some tracks now, with covariances (n, 4, 4)."""
        found = [self._estimate(state_key(track, self._builder.k)) for track in tracks]
        return (np.array([mean for mean, _ in found]).reshape(-1, 4),
                np.array([cov for _, cov in found]).reshape(-1, 4, 4))  # fmt: skip

    def heading(self) -> tuple[float, float]:
        """The car's heading now, rad, and its variance; NaN where it has none."""
        if not self._builder.last.heading:
            return math.nan, math.nan
        mean, cov = self._estimate(heading_key(self._builder.k))
        return float(mean[0]), float(cov[0, 0])

    def survey(self) -> dict[int, Array]:
        """(3,) error found of each node's survey."""
        return {i: self._tree.calculateEstimateVector(survey_key(i)) for i in self._builder.survey}

    def _estimate(self, key: int) -> tuple[Array, Array]:
        return self._tree.calculateEstimateVector(key), self._tree.marginalCovariance(key)
