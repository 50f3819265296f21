"""NEES, its bands, chi-square quantiles and effective samples."""

import numpy as np
import pytest
import scipy.special

from fgloc import frames
from fgloc.errors import InputError
from fgloc.evaluation import (
    anees_band,
    chi2_quantile,
    effective_samples,
    nees,
    score,
)
from fgloc.evaluation.consistency import leading_nees
from fgloc.trajectory import Trajectory

from .curves import curve, straight


def test_nees_by_hand():
    cov = np.array([np.diag([4.0, 9.0]), [[2.0, 1.0], [1.0, 2.0]]])
    np.testing.assert_allclose(nees(np.array([[2.0, 3.0], [1.0, 1.0]]), cov), [2.0, 2 / 3])


def test_nees_of_a_singular_covariance_is_unknown():
    cov = np.array([np.diag([1.0, 0.0]), np.ones((2, 2)), np.eye(2)])
    result = nees(np.ones((3, 2)), cov)
    assert np.isnan(result[:2]).all() and result[2] == pytest.approx(2)


def test_nees_of_the_leading_components_is_theirs_alone():
    rng = np.random.default_rng(1)
    A, error = rng.standard_normal((9, 6, 6)), rng.standard_normal((9, 6))
    cov = A @ A.swapaxes(-1, -2)
    error[2, 4], cov[5, 3:, 3:], cov[7, :, 5], cov[7, 5, :] = np.nan, 0.0, 0.0, 0.0
    told = leading_nees(error, cov, [2, 3, 6])
    for size, values in zip([2, 3, 6], told, strict=True):
        np.testing.assert_allclose(values, nees(error[:, :size], cov[:, :size, :size]))
    assert np.isfinite(told[0]).all() and np.isnan(told[2][[2, 5, 7]]).all()


def test_a_planar_estimate_is_judged_in_the_plane():
    cov = np.tile(np.diag([1.0, 1.0, 0, 0, 0, 0.01]), (5, 1, 1))
    scores = score(*straight([[1.0, 1.0, 0]] * 5, cov=cov))
    assert scores["anees"].value == pytest.approx(1.0)
    assert scores["anees"].note == "East and North, 2 degrees of freedom"
    assert scores["anees_position"].why.startswith("a covariance is not positive definite")
    assert scores["coverage95"].value == 1.0


def test_chi_square_quantiles_of_the_tables():
    expected = [3.841, 5.991, 7.815, 12.592]
    np.testing.assert_allclose(chi2_quantile(0.95, [1, 2, 3, 6]), expected, atol=5e-4)


@pytest.mark.parametrize("probability", [1e-9, 0.025, 0.5, 0.95, 0.9999, 1 - 1e-12])
def test_chi_square_quantiles_are_scipys(probability):
    dof = np.array([0.5, 1, 2, 3, 6, 59.5, 61, 1234.5, 1e5])
    expected = 2 * scipy.special.gammaincinv(dof / 2, probability)
    np.testing.assert_allclose(chi2_quantile(probability, dof), expected, rtol=1e-10)


def test_chi_square_quantiles_at_the_ends():
    assert chi2_quantile(1.0, 3) == np.inf
    assert chi2_quantile(0.0, 3) == 0.0
    with pytest.raises(ValueError, match="no quantile"):
        chi2_quantile(0.5, 0)


def test_band_of_a_hundred_runs():
    # Bar-Shalom's form: 200 degrees of freedom, two-sided 95 %: [162.7, 241.1] / 200.
    assert anees_band(100, 2) == pytest.approx((0.8136, 1.2053), abs=1e-3)
    with pytest.raises(InputError):
        anees_band(0, 3)


def test_anees_of_honest_errors_lies_in_its_band():
    rng = np.random.default_rng(7)
    A = rng.normal(size=(6, 6))
    P = np.diag([1, 1, 1, 0.01, 0.01, 0.01]) @ (A @ A.T + np.eye(6))
    P = 1e-4 * (P + P.T) + np.diag([1, 1, 1, 1e-3, 1e-3, 1e-3])
    truth = curve(2000)
    x = rng.multivariate_normal(np.zeros(6), P, 2000)
    estimate = Trajectory(
        truth.t_ns, truth.p_world_m + x[:, :3], frames.exp_so3(x[:, 3:]) @ truth.attitude(), None,
        np.tile(P, (2000, 1, 1)),
    )  # fmt: skip
    scores = score(estimate, truth)
    low, high = anees_band(2000, 6)
    assert low < scores["anees"].value < high
    assert scores["anees"].note == "position and attitude, 6 degrees of freedom"
    assert scores["anees_band_low"].value < scores["anees"].value < scores["anees_band_high"].value
    assert scores["coverage95"].value == pytest.approx(0.95, abs=0.015)
    assert scores["coverage95"].low < 0.95 < scores["coverage95"].high


def test_effective_samples_of_white_and_of_correlated_noise():
    rng = np.random.default_rng(1)
    white = rng.normal(size=20_000)
    assert effective_samples(white) > 15_000
    a = 0.9
    correlated = np.zeros(20_000)
    for k in range(1, len(white)):
        correlated[k] = a * correlated[k - 1] + white[k]
    # First-order autoregression: N (1 - a) / (1 + a).
    assert effective_samples(correlated) == pytest.approx(20_000 * 0.1 / 1.9, rel=0.25)
    assert effective_samples(np.ones(50)) == 50
