"""Which candidates are the car, before any of them is in the solution.

The error of fixes that drift is nearly the same over many frames, and for a while it may lie on
another car: frame by frame the nearest is then the wrong one, and once it is in the solution it
holds on to itself. The car goes on from frame to frame as one object does, though, and over all
frames its error is the smaller. So of all ways through the candidates the one is taken that gains
most: each gains by how far its NIS is below the limit, counted once in the time over which the
error forgets itself, and going on with what is elsewhere costs a limit. Frames may be passed over.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fgloc.chi_square import chi2_quantile
from fgloc.factors import noise
from fgloc.measurements import Array

Rows = NDArray[np.int64]
LEAP_NIS = chi2_quantile(0.99, 2)
"""Between two frames nothing but noise, drift and a step of the box moves an error."""
STEP_M = 0.5
"""A box is drawn about what shows of a car: as more of it shows, its middle steps by so much."""
MOST_PATHS = 30
"""So many ways to go on are kept: the best that ends in each number, and of these the latest."""


@dataclass(frozen=True, eq=False)
class Strays:
    """How far n candidates, in the order of time, are from where the car would be seen.

    t_s      (n,) when they were seen, and frame (n,) in which
    number   (n,) which object the node calls it, the same for no other node's; below 0 for none
    error_m  (n, 2) predicted minus seen, East and North
    P_m2     (n, 2, 2) covariance of the prediction, R_m2 (n, 2, 2) of what was seen
    tau_s    over which the prediction's error forgets itself
    limit    (n,) NIS above which a candidate is not the car
    """

    t_s: Array
    frame: Rows
    number: Rows
    error_m: Array
    P_m2: Array
    R_m2: Array
    tau_s: float
    limit: Array

    @cached_property
    def nis(self) -> Array:
        """(n,) of each as the car."""
        return noise.nis(self.error_m, self.P_m2 + self.R_m2)

    def gains(self, fits: Rows) -> Array:
        """What each of the candidates (m,) that fit gains: once in `tau_s` how far it is below the
        limit."""
        _, frame = np.unique(self.frame[fits], return_inverse=True)
        t_s = np.full(frame.max(initial=-1) + 1, -np.inf)
        np.maximum.at(t_s, frame, self.t_s[fits])
        order = np.argsort(t_s, kind="stable")
        share = np.zeros(len(t_s))
        share[order] = np.minimum(np.diff(t_s[order], prepend=t_s[order[:1]]) / self.tau_s, 1.0)
        return np.asarray(share[frame] * (self.limit[fits] - self.nis[fits]))

    def leaps(self, a: Rows, b: Rows) -> NDArray[np.bool_]:
        """Whether going on from candidates a to later ones b is a leap: of the error, which else
        drifts, or away from a number that the later frame still has. They broadcast."""
        drift = -np.expm1((self.t_s[a] - self.t_s[b]) / self.tau_s)[..., None, None]
        S = self.R_m2[a] + self.R_m2[b] + drift * (self.P_m2[a] + self.P_m2[b])
        gap = self.error_m[b] - self.error_m[a]
        nis = noise.nis(gap, S + STEP_M**2 * np.eye(2))
        left = (self.number[a] >= 0) & (self.number[a] != self.number[b])
        return np.asarray((nis > LEAP_NIS) | (left & self._has(self.frame[b], self.number[a])))

    def _has(self, frame: Rows, number: Rows) -> NDArray[np.bool_]:
        """Whether a frame has a candidate of a number."""
        wanted = frame * self._numbers + number
        at = np.searchsorted(self._keys, wanted).clip(max=len(self._keys) - 1)
        return np.asarray(self._keys[at] == wanted)

    @cached_property
    def _numbers(self) -> int:
        return int(self.number.max()) + 1

    @cached_property
    def _keys(self) -> Rows:
        own = self.number >= 0
        keys = self.frame[own] * self._numbers + self.number[own]
        return np.unique(keys) if own.any() else np.array([-1])


def followed(told: Strays) -> NDArray[np.bool_]:
    """Which of n candidates (n,) are the car, at most one of each frame."""
    chosen = np.zeros(len(told.t_s), bool)
    fits = np.flatnonzero(told.nis <= told.limit)
    if not len(fits):
        return chosen
    gain = np.zeros(len(chosen))
    gain[fits] = told.gains(fits)
    paths = _Paths(told)
    for runs in _steps(told, fits):
        paths.go_on(runs, [float(gain[run].sum()) for run in runs])
    for run in paths.best():
        chosen[run] = True
    return chosen


def _steps(told: Strays, fits: Rows) -> Iterator[list[Rows]]:
    """The candidates that fit in steps, of which a way takes one run each: those of a frame, or as
    one run those of frames that have one each, without a leap between."""
    alone = np.bincount(told.frame[fits])[told.frame[fits]] == 1
    new = np.diff(told.frame[fits], prepend=-1) != 0
    new[1:] &= ~(alone[1:] & alone[:-1] & ~told.leaps(fits[:-1], fits[1:]))
    for step in np.split(np.arange(len(fits)), np.flatnonzero(new)[1:]):
        yield [fits[step]] if alone[step[0]] else [fits[[i]] for i in step]


class _Paths:
    """Ways through the candidates so far: what each ends with, and what it gained."""

    def __init__(self, told: Strays) -> None:
        self._told = told
        self._runs: list[Rows] = []
        self._before: list[int] = []  # the run before each, -1 for none
        self._ends, self._gains = np.zeros(0, np.int64), np.zeros(0)  # numbers of runs

    def go_on(self, runs: list[Rows], gains: list[float]) -> None:
        """Let every run be the end of the best way that leads to it."""
        last = np.array([self._runs[i][-1] for i in self._ends], np.int64)[:, None]
        first = np.array([run[0] for run in runs])[None]
        so_far = self._gains[:, None] - self._told.limit[first] * self._told.leaps(last, first)
        so_far = np.concatenate([so_far, np.zeros((1, len(runs)))])
        best = np.argmax(so_far, axis=0)
        ends = np.append(self._ends, -1)
        self._before += ends[best].tolist()
        own = len(self._runs) + np.arange(len(runs))
        self._runs += runs
        self._gains = np.append(self._gains, so_far[best, np.arange(len(runs))] + gains)
        self._ends = np.append(self._ends, own)
        self._prune()

    def best(self) -> Iterator[Rows]:
        """The runs of the way that gained most, the last first."""
        i = int(self._ends[np.argmax(self._gains)])
        while i >= 0:
            yield self._runs[i]
            i = self._before[i]

    def _prune(self) -> None:
        number = self._told.number[[self._runs[i][-1] for i in self._ends]]
        number = np.where(number >= 0, number, -1 - self._ends)
        order = np.lexsort((-self._gains, number))
        kept = order[np.diff(number[order], prepend=number[order[0]] - 1) != 0]
        kept = kept[np.argsort(-self._ends[kept])][:MOST_PATHS]
        kept = np.union1d(kept, np.argmax(self._gains))
        self._ends, self._gains = self._ends[kept], self._gains[kept]
