"""Linear rows on vectors as native factors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from fgloc.measurements import Array

if TYPE_CHECKING:
    import gtsam

_MOST = 3
"""Vectors that GTSAM's constructor takes from Python."""
_BETWEEN = 2**56 - 1
"""Key of a vector that is gone again: a symbol without a letter, which no graph has."""


def linear_factor(blocks: Mapping[int, Array], z: Array) -> gtsam.LinearContainerFactor:
    """sum_k J_k x_k = z (m,) with unit noise: the Jacobian (m, q) of each vector x (q,), by key;
    of one to four vectors."""
    import gtsam

    # Without a point to be linear about, the factor would take every value for a change from it.
    zero = gtsam.Values()
    for key, J in blocks.items():
        zero.insert(key, np.zeros(J.shape[1]))
    row = _row(blocks, z) if len(blocks) <= _MOST else _long_row(blocks, z)
    return gtsam.LinearContainerFactor(row, zero)


def _row(blocks: Mapping[int, Array], z: Array, *, exact: bool = False) -> gtsam.JacobianFactor:
    """The row of at most three vectors, with unit noise or none."""
    import gtsam

    kind = gtsam.noiseModel.Constrained.All if exact else gtsam.noiseModel.Unit.Create
    terms = [part for pair in blocks.items() for part in pair]
    return gtsam.JacobianFactor(*terms, z, kind(len(z)))  # type: ignore[call-overload]


def _long_row(blocks: Mapping[int, Array], z: Array) -> gtsam.JacobianFactor:
    """The row of more: in two, of which the one says what a vector between them is; with that
    eliminated they are one again."""
    import gtsam

    eye, terms = np.eye(len(z)), list(blocks.items())
    graph, between = gtsam.GaussianFactorGraph(), gtsam.Ordering()
    graph.add(_row({**dict(terms[:2]), _BETWEEN: -eye}, np.zeros(len(z)), exact=True))
    graph.add(_row({**dict(terms[2:]), _BETWEEN: eye}, z))
    between.push_back(_BETWEEN)
    _, rest = graph.eliminatePartialSequential(between)
    row = rest.at(0)
    assert isinstance(row, gtsam.JacobianFactor)
    return row.whiten()
