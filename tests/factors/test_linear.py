"""Linear rows on vectors as native factors."""

import gtsam
import numpy as np
import pytest

from fgloc.factors.linear import linear_factor


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_a_row_of_any_number_of_vectors_charges_its_square(count):
    rng = np.random.default_rng(count)
    sizes = (3, 4, 6, 3)[:count]
    blocks = {key: rng.standard_normal((3, q)) for key, q in enumerate(sizes)}
    z, values = rng.standard_normal(3), gtsam.Values()
    x = [rng.standard_normal(q) for q in sizes]
    for key, value in enumerate(x):
        values.insert(key, value)
    factor = linear_factor(blocks, z)
    error = sum(J @ x[key] for key, J in blocks.items()) - z
    assert factor.error(values) == pytest.approx(error @ error / 2)
    # Its linearisation has the same curvature, and no noise model that would slow elimination.
    linear = factor.linearize(values)
    J = np.hstack(list(blocks.values()))
    np.testing.assert_allclose(linear.information(), J.T @ J, atol=1e-12)
    assert not linear.isConstrained()
