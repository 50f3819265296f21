"""The banded system against a dense one of the same terms."""

import numpy as np
import pytest

from fgloc.smoother import band, half
from fgloc.smoother.band import Band, Vector
from fgloc.smoother.half import NotPositiveError

TERMS = (
    (range(8), [0, 1, 3, 4, 5, 6, 7]),
    (range(9), [0, 1, 2, 3]),
    ([1, 4], [1, 2]),
    ([0, 2, 5], [2, 3, 6, 7]),
)


@pytest.fixture
def systems():
    """A band of 9 blocks of 4 unknowns with a border of 2, and the same dense."""
    rng = np.random.default_rng(0)
    banded, H, g = Band(9, 4, 2), np.zeros((38, 38)), np.zeros(38)
    for blocks, at in TERMS:
        q = len(at) + 2 * (len(blocks) < 5)  # some know the border, some do not
        J, error = rng.normal(size=(len(blocks), 6, q)), rng.normal(size=(len(blocks), 6))
        curvature, gradient = J.swapaxes(1, 2) @ J, np.einsum("nm,nmq->nq", error, J)
        banded.add(np.array(blocks), np.array(at), J, gradient)
        for j, square, slope in zip(blocks, curvature, gradient, strict=True):
            rows = np.append(4 * j + np.array(at), [36, 37])[:q]
            H[np.ix_(rows, rows)] += square
            g[rows] += slope
    return banded, H, g


def flat(vector):
    return np.append(vector.blocks.ravel(), vector.border)


def test_terms_add_up_and_the_solution_is_that_of_the_dense_system(systems):
    banded, H, g = systems
    np.testing.assert_allclose(flat(banded.gradient), g)
    x = banded.factor().solve(banded.gradient)
    np.testing.assert_allclose(flat(x), np.linalg.solve(H, g))
    assert x.dot(banded.gradient) == pytest.approx(flat(x) @ g)


def test_damping_lies_on_the_diagonal_of_every_block_and_of_the_border(systems):
    banded, H, g = systems
    damping = Vector(np.array([1.0, 2.0, 3.0, 4.0]), np.array([5.0, 6.0]))
    x = banded.factor(damping).solve(banded.gradient)
    dense = np.diag(np.append(np.tile(damping.blocks, 9), damping.border))
    np.testing.assert_allclose(flat(x), np.linalg.solve(H + dense, g))


def test_a_band_that_was_factorised_and_cleared_takes_terms_as_a_new_one_does(systems):
    used, _, _ = systems
    fresh, rng = Band(9, 4, 2), np.random.default_rng(3)
    J, slope = rng.normal(size=(8, 10, 10)), rng.normal(size=(8, 10))
    at_the_end = np.array([8]), np.arange(4), rng.normal(size=(1, 4, 4)), rng.normal(size=(1, 4))
    used.factor()
    used.clear()
    for banded in (used, fresh):
        banded.add(np.arange(8), np.arange(8), J, slope)
        banded.add(*at_the_end)
    assert (flat(used.gradient) == flat(fresh.gradient)).all()
    for one, other in zip(used.halves, fresh.halves, strict=True):
        assert (one.panels == other.panels).all()
    x, again = (banded.factor().solve(banded.gradient) for banded in (fresh, used))
    assert (flat(x) == flat(again)).all()


@pytest.mark.parametrize("at_once", [1, 2, 5, 7, 100])
def test_blocks_of_the_inverse_are_those_of_the_dense_one(systems, monkeypatch, at_once):
    banded, H, _ = systems
    monkeypatch.setattr(half, "BLOCKS_AT_ONCE", at_once)
    keep, inverse, factor = np.array([0, 3]), np.linalg.inv(H), banded.factor()
    blocks = factor.inverse_blocks(keep)
    for j in range(9):
        np.testing.assert_allclose(blocks[j], inverse[np.ix_(4 * j + keep, 4 * j + keep)])
    np.testing.assert_allclose(factor.cov_border, inverse[36:, 36:])
    across = factor.inverse_border(keep)
    for j in range(9):
        np.testing.assert_allclose(across[j], inverse[4 * j + keep, 36:])


@pytest.mark.parametrize("portions", [[range(8)], [range(4, 8), range(4)], [range(4), range(4, 8)]])
def test_steps_and_portions_from_either_end_add_up_to_the_same(portions):
    rng = np.random.default_rng(1)
    at, phi = np.array([1, 2]), rng.uniform(size=8)
    change, sigma = rng.normal(size=(8, 2)), rng.uniform(1, 2, size=(8, 2))
    other, slope = rng.normal(size=(8, 3, 8)), rng.normal(size=(8, 8))
    there, once = Band(9, 4), Band(9, 4)
    for rows in map(list, portions):
        there.add(np.array(rows), np.arange(8), other[rows], slope[rows])
        there.add_steps(np.array(rows), at, phi[rows], change[rows], sigma[rows])
    J = np.concatenate([-phi[:, None, None] * np.eye(2), np.tile(np.eye(2), (8, 1, 1))], -1)
    J /= sigma[..., None]
    gradient = np.einsum("nm,nmq->nq", change / sigma, J)
    once.add(np.arange(8), np.append(at, 4 + at), J, gradient)
    once.add(np.arange(8), np.arange(8), other, slope)
    for one_half, half_there in zip(once.halves, there.halves, strict=True):
        np.testing.assert_allclose(half_there.panels, one_half.panels, atol=1e-12)
    damping, right = Vector(np.ones(4), np.zeros(0)), Vector(rng.normal(size=(9, 4)), np.zeros(0))
    np.testing.assert_allclose(flat(there.gradient), flat(once.gradient), atol=1e-12)
    a, b = (flat(one.factor(damping).solve(right)) for one in (there, once))
    np.testing.assert_allclose(a, b, atol=1e-12)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
@pytest.mark.parametrize("long", [0, 1000])
def test_a_chain_of_any_length_is_solved_from_both_ends(monkeypatch, n, long):
    monkeypatch.setattr(band, "LONG", long)
    rng, d = np.random.default_rng(n), 3
    banded, H = Band(n, d, 1), np.zeros((n * d, n * d))
    # All that is known of the border is about itself.
    banded.add(np.array([0]), np.arange(0), np.full((1, 1, 1), 2.0), np.ones((1, 1)))
    for j in range(n):
        at = np.arange(2 * d if j < n - 1 else d)
        J = rng.normal(size=(1, 6, len(at)))
        banded.add(np.array([j]), at, J, np.zeros((1, len(at))))
        own = slice(j * d, j * d + len(at))
        H[own, own] += J[0].T @ J[0]
    factor, keep, right = banded.factor(), np.arange(d), rng.normal(size=(n, d))
    inverse = np.linalg.inv(H)
    x = factor.solve(Vector(right, banded.gradient.border))
    np.testing.assert_allclose(x.blocks.ravel(), inverse @ right.ravel(), rtol=1e-9)
    assert x.border == pytest.approx([0.25])
    blocks = [inverse[j : j + d, j : j + d] for j in range(0, n * d, d)]
    np.testing.assert_allclose(factor.inverse_blocks(keep), blocks, rtol=1e-9)
    assert factor.log_determinant == pytest.approx(np.linalg.slogdet(H)[1] + np.log(4))


@pytest.mark.parametrize("unknown", range(10))
def test_what_nothing_holds_is_named(unknown):
    banded, J = Band(5, 2), np.tile(np.eye(2), (5, 1, 1))
    J[unknown // 2, :, unknown % 2] = 0
    banded.add(np.arange(5), np.arange(2), J, np.zeros((5, 2)))
    with pytest.raises(NotPositiveError) as caught:
        banded.factor()
    assert caught.value.unknown == unknown


def test_a_border_that_nothing_holds_is_named():
    banded = Band(3, 2, 1)
    banded.add(np.arange(3), np.arange(2), np.tile(np.eye(2), (3, 1, 1)), np.zeros((3, 2)))
    with pytest.raises(NotPositiveError) as caught:
        banded.factor()
    assert caught.value.unknown == 6
