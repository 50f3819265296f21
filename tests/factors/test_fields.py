"""Small matrices side by side: what numpy and scipy make of them one by one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fgloc.factors import fields, noise
from fgloc.frames import right_jacobian_inverse_so3, right_jacobian_so3

INDEFINITE = [np.diag([1.0, -1.0, 1.0]), np.diag([1.0, 0.0, 1.0]), np.full((3, 3), np.nan),
              np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]])]  # fmt: skip


def covariances(n, size, seed=0):
    root = np.random.default_rng(seed).normal(size=(n, size, size))
    return root @ root.swapaxes(-1, -2) + 0.1 * np.eye(size)


@pytest.mark.parametrize("size", [1, 2, 3, 6, 9])
def test_a_factor_and_its_inverse_are_those_of_lapack(size):
    A = covariances(50, size)
    L = fields.cholesky(fields.of(A))
    np.testing.assert_allclose(fields.rows(L), np.linalg.cholesky(A), rtol=1e-10, atol=1e-12)
    assert fields.positive(L).all()
    inverse = fields.rows(fields.inverse_of_lower(L))
    np.testing.assert_allclose(inverse @ fields.rows(L), np.tile(np.eye(size), (50, 1, 1)),
                               atol=1e-9)  # fmt: skip


@pytest.mark.parametrize("bad", INDEFINITE)
def test_only_what_is_not_positive_definite_is_told_so(bad):
    A = np.stack([np.eye(3), bad, 2 * np.eye(3)])
    assert fields.positive(fields.cholesky(fields.of(A))).tolist() == [True, False, True]
    sound = np.isfinite(noise.whitening(A)).all((1, 2))
    assert sound.tolist() == [True, False, True]


def test_a_whitened_covariance_is_the_identity():
    cov = covariances(20, 3)
    W = noise.whitening(cov)
    np.testing.assert_allclose(W @ cov @ W.swapaxes(-1, -2), np.tile(np.eye(3), (20, 1, 1)),
                               atol=1e-12)  # fmt: skip


@pytest.mark.parametrize("others", [[], INDEFINITE[3:]])
def test_inverses_are_those_of_lapack_whether_all_are_definite_or_not(others):
    A = np.concatenate([covariances(20, 3), np.reshape(others, (-1, 3, 3))])
    np.testing.assert_allclose(noise.inverse(A), np.linalg.inv(A), rtol=1e-9, atol=1e-12)


@given(st.floats(0, 3.1), st.integers(0, 1000))
def test_a_turn_and_its_jacobians_are_right_at_any_angle(angle_rad, seed):
    axis = np.random.default_rng(seed).normal(size=3)
    theta = angle_rad * axis / np.linalg.norm(axis)
    R, Jr = (field[..., 0] for field in fields.exp(theta[:, None]))
    np.testing.assert_allclose(R, Rotation.from_rotvec(theta).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(Jr, right_jacobian_so3(theta), atol=1e-9)
    inverse, *_ = fields.inverse_jacobian(theta[:, None])
    np.testing.assert_allclose(inverse[..., 0], right_jacobian_inverse_so3(theta), atol=1e-9)
    np.testing.assert_allclose(inverse[..., 0] @ Jr, np.eye(3), atol=1e-11)


def test_a_turn_is_smooth_where_its_series_ends():
    just = np.sqrt(fields.SERIES) * (1 + np.array([-1e-12, 1e-12]))
    R, Jr = fields.exp(np.outer([0.6, 0.0, 0.8], just))
    np.testing.assert_allclose(R[..., 0], R[..., 1], atol=1e-11)
    np.testing.assert_allclose(Jr[..., 0], Jr[..., 1], atol=1e-11)
