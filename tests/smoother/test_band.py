"""The banded system against a dense one of the same terms."""

import numpy as np
import pytest

from fgloc.smoother import band
from fgloc.smoother.band import Band, NotPositiveError

TERMS = (
    (range(8), [0, 1, 3, 4, 5, 6, 7]),
    (range(9), [0, 1, 2, 3]),
    ([1, 4], [1, 2]),
    ([0, 2, 5], [2, 3, 6, 7]),
)


@pytest.fixture(params=["numpy", "lapack"])
def systems(request, monkeypatch):
    """A band of 9 blocks of 4 unknowns and the same as a dense matrix and vector."""
    monkeypatch.setattr(band, "MANY_BLOCKS", 100 if request.param == "numpy" else 0)
    rng = np.random.default_rng(0)
    banded, H, g = Band(9, 4), np.zeros((36, 36)), np.zeros(36)
    portions = [banded.portion(0, 5), banded.portion(5, 20)]
    for blocks, at in TERMS:
        J = rng.normal(size=(len(blocks), 6, len(at)))
        error = rng.normal(size=(len(blocks), 6))
        curvature, gradient = J.swapaxes(1, 2) @ J, np.einsum("nm,nmq->nq", error, J)
        for portion in portions:
            rows = [k for k, j in enumerate(blocks) if portion.first <= j < portion.stop]
            if rows:
                those = np.array(blocks)[rows]
                portion.add(those, np.array(at), curvature[rows], gradient[rows])
        for j, square, slope in zip(blocks, curvature, gradient, strict=True):
            rows = 4 * j + np.array(at)
            H[np.ix_(rows, rows)] += square
            g[rows] += slope
    for portion in portions:
        banded.take(portion)
    return banded, H, g


def test_terms_add_up_and_the_solution_is_that_of_the_dense_system(systems):
    banded, H, g = systems
    np.testing.assert_allclose(banded.gradient.ravel(), g)
    x = banded.factor(0.0).solve(banded.gradient)
    np.testing.assert_allclose(x.ravel(), np.linalg.solve(H, g))


def test_what_is_solved_often_is_solved_by_lapack_to_the_same_answer(systems, monkeypatch):
    banded, dense, gradient = systems
    monkeypatch.setattr(band, "MANY_BLOCKS", 100)
    factor = banded.factor(0.0, often=True)
    assert isinstance(factor, band._Lapack)
    np.testing.assert_allclose(
        factor.solve(banded.gradient).ravel(), np.linalg.solve(dense, gradient), rtol=1e-9
    )


def test_damping_lies_on_the_diagonal_of_every_block(systems):
    banded, H, g = systems
    damping = np.array([1.0, 2.0, 3.0, 4.0])
    x = banded.factor(damping).solve(banded.gradient)
    np.testing.assert_allclose(x.ravel(), np.linalg.solve(H + np.diag(np.tile(damping, 9)), g))


@pytest.mark.parametrize("at_once", [2, 100])
def test_blocks_of_the_inverse_are_those_of_the_dense_one(systems, monkeypatch, at_once):
    banded, H, _ = systems
    monkeypatch.setattr(band, "BLOCKS_AT_ONCE", at_once)
    keep, inverse = np.array([0, 3]), np.linalg.inv(H)
    blocks = banded.factor(0.0).inverse_blocks(9, keep)
    for j in range(9):
        np.testing.assert_allclose(blocks[j], inverse[np.ix_(4 * j + keep, 4 * j + keep)])


@pytest.mark.parametrize("many", [0, 100])
def test_what_nothing_holds_is_named(monkeypatch, many):
    monkeypatch.setattr(band, "MANY_BLOCKS", many)
    banded = Band(3, 2)
    portion = banded.portion(0, 3)
    portion.add(np.array([0, 2]), np.arange(2), np.tile(np.eye(2), (2, 1, 1)), np.zeros((2, 2)))
    banded.take(portion)
    with pytest.raises(NotPositiveError) as caught:
        banded.factor(0.0)
    assert caught.value.unknown == 2
