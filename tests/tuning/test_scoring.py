"""The score of a prediction, and what its slope says of a setting."""

import numpy as np
import pytest

from fgloc.chi_square import chi2_quantile
from fgloc.tuning.bench import Predictions
from fgloc.tuning.scoring import HEAVY_CURVATURE, HEAVY_SCALE, HEAVY_TAIL, scores, slope, weights

NIS = np.array([chi2_quantile((i + 0.5) / 4000, 3) for i in range(4000)])
"""Chi-square with 3 degrees of freedom, as evenly as it can be laid out."""


def predictions(nis=NIS, sigma=1.0, fixes=None, stretch=None):
    """Errors of some NIS under sigma 1 along east, claimed as `sigma`."""
    n = len(nis)
    return Predictions(
        np.sqrt(nis)[:, None] * [1.0, 0.0, 0.0], np.tile(np.eye(3) * sigma**2, (n, 1, 1)),
        np.zeros(n), np.ones(n, int) if fixes is None else np.array(fixes),
        np.arange(n) if stretch is None else np.array(stretch), np.arange(float(n)),
    )  # fmt: skip


def tuned(told_at, heavy):
    """The log of sigma that scores best."""
    grid = np.linspace(-0.3, 0.3, 121)
    return grid[np.argmin([scores(told_at(np.exp(x)), heavy=heavy).mean() for x in grid])]


def test_score_of_one_fix_by_hand():
    told = predictions(np.array([8.0]), sigma=2.0)  # log 4^3 and 8 / 4
    assert scores(told) == pytest.approx([(np.log(64) + 2) / 2])


@pytest.mark.parametrize("heavy", [False, True])
def test_gaussian_errors_score_best_under_their_own_sigma(heavy):
    assert tuned(lambda sigma: predictions(sigma=sigma), heavy) == pytest.approx(0, abs=0.006)


def test_the_constants_of_the_heavy_tail_are_its_expectations():
    share = NIS / (HEAVY_TAIL + NIS)
    assert pytest.approx(3 / ((HEAVY_TAIL + 3) * share.mean()), rel=1e-3) == HEAVY_SCALE
    curvature = HEAVY_TAIL * (HEAVY_TAIL + 3) / 3 * (NIS / (HEAVY_TAIL + NIS) ** 2).mean()
    assert pytest.approx(HEAVY_SCALE * curvature, rel=1e-3) == HEAVY_CURVATURE


def test_outliers_rule_the_plain_score_and_not_the_heavy_one():
    spoilt = NIS.copy()
    spoilt[:80] = 1e6  # one in fifty, a thousand sigmas off
    sigma = np.sqrt(spoilt.mean() / 3)
    assert sigma > 50
    assert abs(tuned(lambda sigma: predictions(spoilt, sigma), True)) < 0.12


def test_all_lengths_count_alike():
    w = weights(predictions(NIS[:6], fixes=[1, 1, 1, 1, 9, 9]))
    np.testing.assert_allclose(w, [1 / 8] * 4 + [1 / 4] * 2)


def test_slope_of_a_scale_by_hand():
    by, n = 1e-4, 100
    told, nudged = predictions(NIS[:n]), predictions(NIS[:n], sigma=np.exp(1e-4))
    found = slope(told, [nudged], by)
    assert found.gradient == pytest.approx([3 - NIS[:n].mean()], abs=1e-2)
    assert found.curvature == pytest.approx(np.array([[6.0]]), rel=1e-3)
    assert found.informed == pytest.approx(np.array([[6.0 * n]]), rel=1e-3)
    freedom = n - 2  # a mean and one setting
    assert found.scatter == pytest.approx(np.array([[NIS[:n].var() / freedom]]), rel=1e-2)


def test_a_block_counts_as_one_fix():
    told, nudged = (predictions(NIS[:8], sigma, [4] * 8, [0] * 4 + [1] * 4) for sigma in (1, 1.001))
    found = slope(told, [nudged], np.log(1.001))
    assert found.informed == pytest.approx(np.array([[12.0]]), rel=1e-2)
