"""How posts sway over time: as it was (truth), or as somebody estimates it."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from fgloc.measurements import Array, Table
from fgloc.timing import Instants


@dataclass(frozen=True, eq=False)
class PostStates(Table):
    """States of the tips of posts, against where they are without wind.

    node            (N,) number of the node that the post carries, from 0
    p_node_m        (N, 2) displacement along the node's level axes, m
    v_node_mps      (N, 2) velocity along them
    tilt_rad        (N, 2) roll and pitch: turns about these axes
    sigma_p_m, sigma_v_mps, sigma_tilt_rad  (N, 2) what is claimed of them; NaN in a truth
    """

    node: NDArray[np.int64]
    p_node_m: Array
    v_node_mps: Array
    tilt_rad: Array
    sigma_p_m: Array
    sigma_v_mps: Array
    sigma_tilt_rad: Array

    KIND = "posts"
    WHOLE = frozenset({"node"})
    SHAPES: ClassVar = {
        "node": (), "p_node_m": (2,), "v_node_mps": (2,), "tilt_rad": (2,), "sigma_p_m": (2,),
        "sigma_v_mps": (2,), "sigma_tilt_rad": (2,),
    }  # fmt: skip

    @classmethod
    def truth(cls, t_ns: Instants, node: int, p_m: Array, v_mps: Array, tilt_rad: Array) -> Self:
        """The true states of one post, (N, ...)."""
        unknown = np.full((len(t_ns), 2), np.nan)
        return cls(
            t_ns, t_ns, np.full(len(t_ns), node), p_m, v_mps, tilt_rad, unknown, unknown, unknown
        )

    def of(self, node: int) -> Self:
        """The states of one node's post."""
        return self.take(self.node == node)
