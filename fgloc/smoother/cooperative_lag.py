"""The cooperative graph over a fixed lag.

All factors are linear where they stand, so what leaves the lag is marginalised without loss, and
the estimates of the newest states are those of a Kalman filter. A node's sighting that comes late
enters at its own instant: what was believed before each instant of the lag is kept, and the steps
from there on are done again.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from fgloc.correspondence.epochs import Epoch
from fgloc.measurements import Array
from fgloc.smoother.cooperative_belief import Core, Free, marginals, pulled
from fgloc.smoother.cooperative_model import (
    FIRST_SIGMA_RAD,
    Call,
    Roster,
    forgetting,
    of_node,
    off_survey,
    own_sightings,
    whitener,
)
from fgloc.smoother.cooperative_rows import (
    ERRORS,
    HEADING,
    STEADY,
    Index,
    Name,
    Places,
    Rows,
)

Belief = tuple[Core, Free]


@dataclass(eq=False)
class _Instant:
    """What is known of an instant of the lag, and what was believed just before it.

    places   where the car and others say they are, and of nodes' sightings what has come
    own      what the car sees of others
    """

    epoch: Epoch
    call: Call
    yaw_rad: float
    before: Belief
    own: list[Rows]
    places: Places


class Window:
    """The newest states, with all that came of the last `lag_s` seconds."""

    def __init__(self, roster: Roster, lag_s: float) -> None:
        self._roster, self._lag_s = roster, lag_s
        sigma = {i: roster.survey_sigma(i) for i in range(len(roster.nodes))}
        uncertain = {i: one for i, one in sigma.items() if one is not None}
        self._column = np.full(len(sigma), -1)
        self._column[list(uncertain)] = 3 * np.arange(len(uncertain))
        s = 3 * len(uncertain)
        P = np.diag(np.concatenate([np.empty(0), *uncertain.values()]) ** 2)
        core = Core(tuple(("n", i) for i in uncertain), np.zeros(s), P)
        none = Free(np.empty(0, np.int64), np.zeros((0, 4)), np.zeros((0, 4, s)),
                    np.zeros((0, 4, 4)))  # fmt: skip
        self._belief: Belief = core, none
        self._kept: deque[_Instant] = deque()
        self._gone = 0
        self._sighted: set[int] = set()
        self.factors = s // 3

    def update(self, epoch: Epoch, yaw_rad: float, arrived: dict[int, Index]) -> None:
        """The next instant, with what nodes told: `arrived` has the rows of each instant's epoch.

        What the car sees is linearised about `yaw_rad`. Nothing may arrive that is older than the
        lag.
        """
        call = self._roster.call(epoch, yaw_rad)
        own, fixes = self._own(epoch, call, yaw_rad), self._fixes(epoch)
        now = _Instant(epoch, call, yaw_rad, self._belief, own, fixes)
        self._kept.append(now)
        while (epoch.t_ns - self._kept[0].epoch.t_ns) / 1e9 > self._lag_s:
            self._kept.popleft()
            self._gone += 1
        for of, rows in arrived.items():
            at = self._kept[of - self._gone]
            at.places += self._sightings(at.epoch, rows)
            self._sighted |= {int(node) for node in at.epoch.node[rows]}
        first = min(arrived, default=len(self._kept) + self._gone - 1) - self._gone
        self._belief = self._kept[first].before
        for instant in list(self._kept)[first:]:
            instant.before = self._belief
            self._belief = self._step(instant)
        told = [*fixes.track, *epoch.seen, *(i for rows in arrived.values() for i in rows)]
        self.factors += len(call.tracks) + len(call.sources) + call.heading + len(told)

    @property
    def tracks(self) -> list[int]:
        """All that live now."""
        return self._kept[-1].call.tracks

    @property
    def core_tracks(self) -> set[int]:
        """Of these all that depend on more than the errors of surveys."""
        return {i for letter, i in self._belief[0].names if letter == "s"}

    def states(self, tracks: list[int]) -> tuple[Array, Array]:
        """(n, 4) of some tracks now, with covariances (n, 4, 4)."""
        core, free = self._belief
        x, P = np.zeros((len(tracks), 4)), np.zeros((len(tracks), 4, 4))
        is_free = np.isin(tracks, free.tracks)
        at = np.searchsorted(free.tracks, np.array(tracks, np.int64)[is_free])
        x[is_free], P[is_free] = marginals(core, free[at])
        for i in np.flatnonzero(~is_free):
            x[i], P[i] = core.marginal(("s", tracks[i]))
        return x, P

    def heading(self) -> tuple[float, float]:
        """The car's heading now, rad, and its variance; NaN where it has none."""
        core = self._belief[0]
        if HEADING not in core.column:
            return math.nan, math.nan
        mean, cov = core.marginal(HEADING)
        return float(mean[0]), float(cov[0, 0])

    def survey(self) -> dict[int, Array]:
        """(3,) error found of each node's survey."""
        core = self._belief[0]
        return {i: core.marginal(("n", i))[0] for i in sorted(self._sighted)
                if self._column[i] >= 0}  # fmt: skip

    def _step(self, instant: _Instant) -> Belief:
        """From what was believed before an instant to what is believed at it."""
        call, (core, free) = instant.call, instant.before
        names = self._names(call)
        core, free = core.only(names), free[np.isin(free.tracks, call.tracks)]
        steps = {name: self._forgets(name, call) for name in core.names if name[0] in "bho"}
        core, free = core.moved(call.dt_s, call.turn[0], steps), free.moved(call.dt_s)
        for name in names:
            if name not in core.column and name[0] in "bho":
                core = self._begun(core, name, instant.yaw_rad)
        new = set(call.tracks) - set(free.tracks.tolist()) - {i for c, i in core.names if c == "s"}
        free = free.born(np.array(sorted(new), np.int64))
        core, free = pulled(core, free, self._linked(instant))
        free, evidence = free.told(instant.places.of(free.tracks))
        return core.told([*instant.own, _rows(instant.places, core)], evidence), free

    def _names(self, call: Call) -> list[Name]:
        """The variables of an instant."""
        surveys = [("n", int(i)) for i in np.flatnonzero(self._column >= 0)]
        chains = [*(("b", i) for i in call.sources), *(("s", i) for i in call.tracks)]
        return surveys + [HEADING] * call.heading + [ERRORS] * call.rolls + chains

    def _forgets(self, name: Name, call: Call) -> tuple[float, Array | float]:
        """What is kept over a step of what is no track, and what variance is new."""
        own = self._roster.own
        if name == HEADING:
            return 1.0, call.turn[1]
        if name == ERRORS and own is not None:
            return 1.0, own.error_walk**2 * call.dt_s
        return forgetting(self._roster.slow[name[1]], call.dt_s)

    def _begun(self, core: Core, name: Name, yaw_rad: float) -> Core:
        """With what is no track and begins."""
        own = self._roster.own
        if name == HEADING:
            return core.begun(name, yaw_rad, FIRST_SIGMA_RAD)
        if name == ERRORS and own is not None:
            return core.begun(name, 0.0, own.error_sigma)
        return core.begun(name, 0.0, self._roster.slow[name[1]].sigma_m)

    def _linked(self, instant: _Instant) -> Index:
        """Tracks that are no longer free."""
        slow = instant.places.track[instant.places.slow != STEADY]
        seen = [instant.epoch.seen] if math.isfinite(instant.yaw_rad) else []
        return np.concatenate([[self._roster.ego], *seen, slow])

    def _sightings(self, epoch: Epoch, rows: Index) -> Places:
        """Of nodes."""
        node, z = epoch.node[rows], epoch.z_m[rows]
        W = whitener(epoch.R_m2[rows])
        p_world_m = np.array([one.p_world_m[:2] for one in self._roster.nodes])
        off = W @ off_survey(z, p_world_m[node])
        slow = self._slow(of_node(node))
        return Places(epoch.track[rows], W, _times(W, z), self._column[node], off, slow)

    def _fixes(self, epoch: Epoch) -> Places:
        """Where the car and others say they are."""
        own = epoch.fix_m is not None and epoch.fix_R_m2 is not None
        track = np.append(epoch.told, [self._roster.ego] * own).astype(np.int64)
        z = np.concatenate([epoch.told_m, [epoch.fix_m]]) if own else epoch.told_m
        R = np.concatenate([epoch.told_R_m2, [epoch.fix_R_m2]]) if own else epoch.told_R_m2
        W, n = whitener(R), len(track)
        slow = self._slow(track)
        return Places(track, W, _times(W, z), np.full(n, -1), np.zeros((n, 2, 3)), slow)

    def _slow(self, sources: Index) -> Index:
        """The sources that have a slow error."""
        return np.where(np.isin(sources, list(self._roster.slow)), sources, STEADY)

    def _own(self, epoch: Epoch, call: Call, yaw_rad: float) -> list[Rows]:
        """What the car sees of others, under a heading, and how it moves."""
        ego = self._roster.ego
        if ego not in call.tracks:
            return []
        moves = self._moves(call, yaw_rad)
        if not (math.isfinite(yaw_rad) and len(epoch.seen)):
            return moves
        z, turn, W = own_sightings(epoch, yaw_rad)
        every = np.arange(len(z))
        others: list[Name] = [("s", int(track)) for track in epoch.seen]
        terms = [(every, [("s", ego)] * len(z), -W), (every, others, W),
                 (every, [HEADING] * len(z), -W @ turn)]  # fmt: skip
        return [Rows(_times(W, z), terms), *moves]

    def _moves(self, call: Call, yaw_rad: float) -> list[Rows]:
        """What the car tells of its own motion."""
        own, one, groups = self._roster.own, np.zeros(1, np.int64), []
        for row in [] if own is None else own.rows(call.t_ns, yaw_rad):
            v = np.pad(row.v, ((0, 0), (2, 0)))
            ego: Name = ("s", self._roster.ego)
            terms = [(one, [name], A[None]) for name, A in ((ego, v), (HEADING, row.h),
                     (ERRORS, row.o)) if name == ego or call.heading]  # fmt: skip
            groups.append(Rows(row.b[None], terms))
        return groups


def _rows(places: Places, core: Core) -> Rows:
    """Of tracks in the core."""
    here = places.of(np.array([i for letter, i in core.names if letter == "s"], np.int64))
    tracks: list[Name] = [("s", int(track)) for track in here.track]
    surveyed = np.flatnonzero(here.col >= 0)
    surveys = [core.names[first // 3] for first in here.col[surveyed]]
    drifting = np.flatnonzero(here.slow != STEADY)
    slow: list[Name] = [("b", int(source)) for source in here.slow[drifting]]
    terms = [(np.arange(len(tracks)), tracks, here.W), (surveyed, surveys, here.off[surveyed]),
             (drifting, slow, here.W[drifting])]  # fmt: skip
    return Rows(here.b, terms)


def _times(W: Array, z: Array) -> Array:
    """(n, 2) W z."""
    return np.asarray((W @ z[..., None])[..., 0])
