"""The swaying posts as factors and variables of the native graph.

Slot c has the state P(c, j), a vector of six, at keyframe j. A detection of its node ties the
measured point A(i), which the graph of the car has as a variable, to the state: with that, a
detection is a linear row between point and state, exact and native (`fgloc.factors.sway`). It is
linear about what is believed of the state: a batch renews it, online it stays as it was entered. A
user whose place is known is a point U(i) of its own, held by what it says.
"""

from collections.abc import Iterable
from typing import NamedTuple

import gtsam
import numpy as np
from gtsam.symbol_shorthand import U

from fgloc.drive import Drive
from fgloc.factors import gnss
from fgloc.factors.linear import linear_factor
from fgloc.factors.post import post_spread
from fgloc.measurements import Array
from fgloc.smoother.swaying import SIZE, Swaying
from fgloc.timing import Instants
from fgloc.watches import Watch

Factors = list[gtsam.NonlinearFactor]
ROOM = 10_000_000
"""Keyframes that a slot's keys have room for."""


def post_key(slot: int, j: int) -> int:
    """P(slot, j)."""
    return int(gtsam.symbol("p", slot * ROOM + j))


class LinearRow(NamedTuple):
    """place + J state = z + moved_m, with the key of the state, J (3, 6) and moved_m (3,); where
    the state is what is believed, the place is z + believed_m."""

    key: int
    J: Array
    moved_m: Array
    believed_m: Array


class NativePosts(Swaying):
    """Posts that build their factors; `about` (n, width) is what detections are linear about."""

    def __init__(self, drive: Drive, watches: tuple[Watch, ...], t_ns: Instants) -> None:
        super().__init__(drive, watches, t_ns)
        self.about = np.zeros((len(self.owner), self.width))

    def keys_at(self, j: int) -> list[int]:
        """The variables of a keyframe."""
        return [post_key(c, j) for c in range(self.slots)]

    def factors(self, j: int, *, begins: bool = False) -> Factors:
        """How the states of keyframe j were reached, and what is told of them alone.

        `begins` is of a keyframe with none before it in the graph.
        """
        return [*self.chain_factors(j, begins=begins), *self.pose_factors(self.poses_at(j))]

    def chain_factors(self, j: int, *, begins: bool = False) -> Factors:
        """The bending mode from the keyframe before, or rest."""
        after, before = (block[j] for block in self.steps)
        factors: Factors = []
        for c in range(self.slots):
            blocks = {post_key(c, j): after[c]}
            if begins:
                spread = post_spread(self.post(j, c))
                blocks = {post_key(c, j): np.linalg.inv(np.linalg.cholesky(spread))}
            elif not self.begins[j, c]:
                blocks = {post_key(c, j - 1): before[c], **blocks}
            factors.append(linear_factor(blocks, np.zeros(SIZE)))
        return factors

    def poses_at(self, j: int) -> list[int]:
        """Which of the poses are of keyframe j."""
        return list(range(*np.searchsorted(self.pose_key, [j, j + 1]).tolist()))

    def pose_factors(self, rows: Iterable[int]) -> Factors:
        """The native factors of some poses."""
        return [
            linear_factor(
                {post_key(int(self.pose_slot[i]), int(self.pose_key[i])): self.pose_J[i]},
                self.pose_z[i],
            )
            for i in rows
        ]  # fmt: skip

    def row(self, s: int, row: int, j: int) -> LinearRow:
        """A detection of source s at keyframe j as a linear row about what is believed."""
        slot = int(self.slot[self.of_source[s]])
        x = self.about[j, self.at(slot)]
        moved, by_state = self.moved(s, np.array([row]), x[None])
        return LinearRow(post_key(slot, j), -by_state[0], moved[0] - by_state[0] @ x, moved[0])

    def insert(self, values: gtsam.Values, j: int, states: Array | None = None) -> None:
        """Put in the variables of keyframe j, from (width,) or at rest."""
        x = np.zeros(self.width) if states is None else states
        for c, key in enumerate(self.keys_at(j)):
            values.insert(key, x[self.at(c)])

    def read(self, values: gtsam.Values, n: int) -> Array:
        """States (n, width) of the first keyframes as a solution has them."""
        rows = [[values.atVector(key) for key in self.keys_at(j)] for j in range(n)]
        return np.array(rows).reshape(n, self.width)


def told_factors(
    i: int, told_m: Array, z_world_m: Array, model: gtsam.noiseModel.Base, by: dict[int, Array]
) -> Factors:
    """A node's detection (3,) of a user who says where it is (3,): U(i) is that place, and
    U + sum of by[key] x_key = z. `model` is of what is told and of the detection together."""
    tie = gtsam.PriorFactorPoint3(U(i), told_m, model)
    return [tie, linear_factor(
        {key: J / gnss.TIE_SIGMA_M for key, J in ((U(i), np.eye(3)), *by.items())},
        z_world_m / gnss.TIE_SIGMA_M,
    )]  # fmt: skip
