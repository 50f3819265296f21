"""Outages without a fix, and how errors grow in them."""

import numpy as np
import pytest

from fgloc.evaluation import (
    error_growth,
    errors,
    gnss_outages,
    outages,
    score_errors,
    used_fixes_ns,
)
from fgloc.measurements import GnssFixes
from fgloc.result import Result
from fgloc.verdicts import SourceVerdicts, Verdict

from .curves import START, S, curve, straight


def test_outages_are_gaps_longer_than_three_seconds():
    t = START + np.r_[np.arange(10), 15, 16, 18, 25] * S
    np.testing.assert_array_equal(outages(t), START + np.array([[9, 15], [18, 25]]) * S)
    np.testing.assert_array_equal(outages(t, min_length_s=6.5), START + np.array([[18, 25]]) * S)


def test_slow_receivers_are_not_always_in_an_outage():
    t = START + np.r_[np.arange(0, 50, 5), 70] * S
    np.testing.assert_array_equal(outages(t), START + np.array([[45, 70]]) * S)


def test_the_ends_of_the_drive_count_when_asked():
    t = START + np.arange(10, 20) * S
    assert len(outages(t)) == 0
    span = (START, START + 22 * S)
    np.testing.assert_array_equal(outages(t, span_ns=span), [[START, START + 10 * S]])
    np.testing.assert_array_equal(outages([], span_ns=span), [list(span)])
    assert outages([]).shape == (0, 2)


def test_only_measurements_that_entered_count_as_fixes():
    t = START + np.arange(4) * S
    zeros = np.zeros((4, 3))
    table = GnssFixes(t, t, zeros, np.tile(np.eye(3), (4, 1, 1)), zeros)
    verdicts = SourceVerdicts.of("gnss", table)
    verdicts.set(0, Verdict.USED)
    verdicts.set(1, Verdict.GATED)
    verdicts.set(2, Verdict.DOWN_WEIGHTED)
    np.testing.assert_array_equal(used_fixes_ns({"gnss": verdicts}), t[[0, 2]])
    assert len(used_fixes_ns({})) == 0


def test_outages_of_a_result_reach_to_the_ends_of_its_trajectory():
    t = START + np.arange(4) * S
    zeros = np.zeros((4, 3))
    table = GnssFixes(t, t, zeros, np.tile(np.eye(3), (4, 1, 1)), zeros)
    verdicts = {"gnss": SourceVerdicts.of("gnss", table, Verdict.USED)}
    driven = curve(200)
    result = Result(driven, verdicts, {}, "x", causal=False)
    np.testing.assert_array_equal(gnss_outages(result), [[t[-1], driven.t_ns[-1]]])
    assert len(gnss_outages(Result(driven, {}, {}, "x", causal=False))) == 0


def test_growth_in_two_outages_by_hand():
    # Errors of 1 m, but in [10 s, 15 s] and [20 s, 25 s] they grow by 1 and by 2 m each second.
    seconds = np.arange(31)
    size = np.ones(31)
    size[11:15], size[21:25] = [1, 2, 3, 4], [2, 4, 6, 8]
    e = errors(*straight(np.outer(size, [1, 0, 0]), rate_hz=1.0))
    spans = START + np.array([[10, 15], [20, 25]]) * S
    growth = error_growth(e, spans)
    np.testing.assert_array_equal(growth.n, [4, 4])
    np.testing.assert_allclose(growth.rmse_m, np.sqrt([7.5, 30]))
    np.testing.assert_allclose(growth.end_m, [4, 8])
    np.testing.assert_allclose(growth.end_since_s, [4, 4])
    np.testing.assert_allclose(growth.bin_s, np.arange(6))
    np.testing.assert_allclose(growth.bin_mean_m, [np.nan, 1.5, 3.0, 4.5, 6.0])
    np.testing.assert_array_equal(growth.bin_outages, [0, 2, 2, 2, 2])
    assert seconds[growth.inside].tolist() == [11, 12, 13, 14, 21, 22, 23, 24]
    scores = score_errors(e, outages=spans)
    assert scores["outage_count"].value == 2
    assert scores["outage_rmse_m"].value == pytest.approx(np.sqrt(18.75))
    assert scores["outage_end_mean_m"].value == pytest.approx(6)
    assert scores["outage_end_max_m"].value == pytest.approx(8)


def test_without_outages_their_metrics_say_so():
    e = errors(*straight(np.ones((10, 3))))
    scores = score_errors(e, outages=outages([]))
    assert scores["outage_count"].value == 0
    assert scores["outage_rmse_m"].why == "there was no outage"
    assert "outage_count" not in score_errors(e)
    elsewhere = score_errors(e, outages=np.array([[0, 10 * S]]))
    assert elsewhere["outage_rmse_m"].why == "there is no truth in the outages"
