"""Velocities in the world as they arrive: gated, entered, and remembered for a window's regrowth.

They need no heading, so they enter from the first keyframe on; until the yaw is aligned nothing
that they could be gated against is known.
"""

import math

import gtsam
import numpy as np
from gtsam.symbol_shorthand import M, V

from fgloc.measurements import Array
from fgloc.smoother.graph import Factors, GraphModel
from fgloc.smoother.guess import is_course
from fgloc.smoother.tree import Stamps, WholeTree
from fgloc.verdicts import Verdict

ERRORS_S = 1.0
"""Lasting errors are read so often: it takes long, and they change slowly."""


class OnlineVelocities:
    """What of the drive's velocities is in the tree."""

    def __init__(self, model: GraphModel, arriving: list[list[int]]) -> None:
        """`arriving` has, for each keyframe and the end, the keyframes whose velocity came in."""
        self.model, self.told = model, model.car.velocities
        self._arriving = arriving
        self._held: set[int] = set()
        self._accepted_s = 0.0
        self._found_s = -math.inf

    def take_in(
        self, j: int, v_world_mps: Array | None, cov: Array | None, values: gtsam.Values,
        tree: WholeTree, *, aligned: bool,
    ) -> Factors:  # fmt: skip
        """Factors of what came in by keyframe j, whose velocity is predicted with a covariance
        (3, 3); j may be the end, where nothing is. Puts their variables into `values`."""
        factors: Factors = []
        for key in self._arriving[j]:
            if self._enters(key, j, v_world_mps, cov, tree, aligned=aligned):
                self._held.add(key)
                self._accepted_s = float(self.model.t_s[key])
                if self.told.err:
                    about = v_world_mps if key == j else None
                    about = tree.vector(V(key)) if about is None else about
                    self.model.car.insert_velocity(values, key, about)
                factors += self.model.car.velocity_factors(key)
        return factors

    def read(self, j: int, tree: WholeTree) -> None:
        """Take the lasting errors out of the tree, once in `ERRORS_S`."""
        if self.told.err and self.model.t_s[j] - self._found_s >= ERRORS_S:
            self._found_s = float(self.model.t_s[j])
            self.told.found, self.told.found_cov = tree.vector(M(0)), tree.covariance([M(0)])

    def insert(self, values: gtsam.Values, first: int, n: int) -> None:
        """Put in the variables of what is held of keyframes first..first + n - 1."""
        for k in sorted(k for k in self._held if first <= k < first + n):
            self.model.car.insert_velocity(values, k, values.atVector(V(k)))

    def stamps(self, first: int, j: int) -> Stamps:
        """The time in s of the variables of keyframes first..j."""
        return {
            key: float(self.model.t_s[k])
            for k in self._held
            if first <= k <= j
            for key in self.model.car.velocity_keys(k)
        }

    def tells_course(self, first: int) -> bool:
        """Whether one that came in since keyframe `first` is fast enough to tell a course."""
        keys = np.array([k for k in self._held if k >= first], int)
        return bool(is_course(self.told.v_world_mps[keys], self.told.sigma_mps[keys]).any())

    def factors(self, k: int) -> Factors:
        """What a graph over a window holds of keyframe k."""
        return self.model.car.velocity_factors(k) if k in self._held else []

    def forget(self, before: int) -> None:
        """Drop what lies before a keyframe."""
        self._held -= {k for k in self._held if k < before}

    def _enters(
        self, key: int, j: int, v_world_mps: Array | None, cov: Array | None, tree: WholeTree, *,
        aligned: bool,
    ) -> bool:  # fmt: skip
        """Whether a velocity is in time and passes the gate; like a fix's, it opens again."""
        own, row = self.told.verdicts, self.told.row[key]
        if key != j and not tree.holds(V(key)):
            now_s = float(self.model.t_s[min(j, len(self.model) - 1)])
            reason = f"{now_s - self.model.t_s[key]:.2f} s old; its state has left the window"
            own.set(row, Verdict.LATE, reason)
            return False
        if not aligned:
            own.set(row, Verdict.USED, "before the yaw was aligned")
            return True
        if key != j or v_world_mps is None or cov is None:
            v_world_mps, cov = tree.vector(V(key)), tree.covariance([V(key)])
        if self.told.fits(key, v_world_mps, cov):
            return True
        waited = self.model.t_s[key] - self._accepted_s > self.model.config.gnss.gate_reset_s
        if waited:
            own.set(row, Verdict.USED, "no velocity accepted for long: the gate opened")
        return bool(waited)
