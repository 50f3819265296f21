"""Intervals and paired differences by resampling blocks."""

import numpy as np
import pytest

from fgloc.errors import InputError
from fgloc.evaluation import (
    Bootstrap,
    errors,
    paired_difference,
    score,
    score_errors,
)
from fgloc.trajectory import Trajectory

from .curves import START, S, curve, straight


def test_interval_of_independent_errors_is_the_textbook_one():
    rng = np.random.default_rng(3)
    x = rng.normal(1.0, 1.0, 4000)
    t = START + np.arange(4000) * S // 10
    low, high = Bootstrap(block_s=0.1).mean(x, t)
    assert low < x.mean() < high
    assert high - low == pytest.approx(2 * 1.96 / np.sqrt(4000), rel=0.15)


def test_blocks_widen_the_interval_of_correlated_errors():
    rng = np.random.default_rng(4)
    x = np.repeat(rng.normal(size=400), 10)
    t = START + np.arange(4000) * S // 10
    narrow, wide = (Bootstrap(block_s=b).mean(x, t) for b in (0.1, 10.0))
    assert wide[1] - wide[0] > 2 * (narrow[1] - narrow[0])


def test_intervals_hold_their_values_and_repeat():
    rng = np.random.default_rng(5)
    estimate, truth = straight(rng.normal(0, 1, (500, 3)))
    first, second = score(estimate, truth), score(estimate, truth)
    for name in ("horizontal_rmse_m", "horizontal_mean_m", "horizontal_std_m", "horizontal_p95_m"):
        assert first[name].low <= first[name].value <= first[name].high
        assert first[name] == second[name]


def test_the_interval_of_a_quantile_is_not_misled_by_errors_that_come_and_go():
    """Ten rows between two fixes, the error largest at the fix: every tenth row sees no other."""
    n = 20_000
    x = np.abs(np.random.default_rng(0).normal(size=n)) * np.where(np.arange(n) % 10 == 0, 3.0, 0.5)
    low, high = Bootstrap().quantile(x, np.arange(n) * (S // 10), 0.95)
    assert low <= np.quantile(x, 0.95) <= high


def test_too_few_errors_have_no_interval():
    metric = score(*straight(np.ones((5, 3))))["horizontal_rmse_m"]
    assert metric.low is None and metric.high is None


def test_paired_difference_of_the_same_luck():
    rng = np.random.default_rng(8)
    common = rng.normal(0, 1, (1000, 3))
    better, truth = straight(common)
    worse, _ = straight(1.1 * common)
    a, b = errors(better, truth), errors(worse, truth)
    difference = paired_difference(a, b)
    rmse = np.sqrt(np.mean(a.horizontal_m**2))
    assert difference.value == pytest.approx(-0.1 * rmse)
    assert difference.low < difference.value < difference.high < 0
    assert difference.n == 1000
    # Unpaired intervals of the two overlap; only the pairing tells them apart.
    separate = [score_errors(e)["horizontal_rmse_m"] for e in (a, b)]
    assert difference.high - difference.low < 0.5 * (separate[0].high - separate[0].low)
    assert paired_difference(a, a).value == 0.0


def test_paired_difference_needs_common_instants():
    a = errors(*straight(np.ones((10, 3))))
    truth = curve(20)
    with pytest.raises(InputError, match="no instant in common"):
        paired_difference(a, errors(truth, Trajectory(truth.t_ns + 7, truth.p_world_m).take([0])))
