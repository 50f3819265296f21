"""Linear rows on vectors as native factors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from fgloc.measurements import Array

if TYPE_CHECKING:
    import gtsam


def linear_factor(blocks: Mapping[int, Array], z: Array) -> gtsam.LinearContainerFactor:
    """sum_k J_k x_k = z (m,) with unit noise: the Jacobian (m, q) of each vector x (q,), by key."""
    import gtsam

    # Without a point to be linear about, the factor would take every value for a change from it.
    zero = gtsam.Values()
    for key, J in blocks.items():
        zero.insert(key, np.zeros(J.shape[1]))
    terms = [part for pair in blocks.items() for part in pair]
    model = gtsam.noiseModel.Unit.Create(len(z))
    row = gtsam.JacobianFactor(*terms, z, model)  # type: ignore[call-overload]
    return gtsam.LinearContainerFactor(row, zero)
