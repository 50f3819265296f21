"""Metrics and scores, by hand: each has a value or says why not."""

import json

import numpy as np
import pytest

from fgloc.errors import InputError
from fgloc.evaluation import (
    Metric,
    score,
)
from fgloc.trajectory import Trajectory

from .curves import CONTRACT, S, curve, straight


def test_metrics_of_five_errors_by_hand():
    # Horizontal 0, 1, 2, 3, 4: mean 2, mean square 6, population variance 2, p95 = 3.8.
    scores = score(*straight([[0, 0, 1], [0, 1, 1], [0, -2, 1], [0, 3, 1], [0, 4, 1]]))
    assert scores["horizontal_rmse_m"].value == pytest.approx(np.sqrt(6))
    assert scores["horizontal_mean_m"].value == pytest.approx(2)
    assert scores["horizontal_std_m"].value == pytest.approx(np.sqrt(2))
    assert scores["horizontal_p95_m"].value == pytest.approx(3.8)
    assert scores["horizontal_max_m"].value == pytest.approx(4)
    assert scores["up_rmse_m"].value == pytest.approx(1)
    assert scores["longitudinal_mean_abs_m"].value == pytest.approx(2)
    assert scores["longitudinal_std_abs_m"].value == pytest.approx(np.sqrt(2))
    assert scores["lateral_rmse_m"].value == pytest.approx(0, abs=1e-12)
    assert scores["horizontal_rmse_m"].n == 5


def test_score_holds_the_promised_names_and_says_why_a_value_is_missing():
    scores = score(curve(attitude=False), curve(attitude=False))
    assert set(scores) >= CONTRACT
    assert scores["yaw_rmse_rad"].why == "the estimate has no attitude"
    assert scores["anees"].why == scores["coverage95"].why == "the estimate has no covariance"
    assert scores["lateral_rmse_m"].note.startswith("by the truth's course")
    written = json.loads(json.dumps({name: m.to_dict() for name, m in scores.items()}))
    assert written["anees"]["value"] is None
    assert {"value", "unit", "better", "n"} <= written["horizontal_rmse_m"].keys()


def test_score_starts_so_many_seconds_after_the_first_state():
    truth = curve(100)
    scores = score(truth.take(slice(10, None)), truth, score_from_s=2.0)
    assert scores["horizontal_rmse_m"].n == 70
    assert scores["scored_share"].value == pytest.approx(0.7)
    assert "30 rows before the start of scoring" in scores["scored_share"].note


def test_nothing_to_score_is_said_and_not_raised():
    truth = curve(20)
    later = Trajectory(truth.t_ns + 100 * S, truth.p_world_m, truth.R_world_veh)
    for estimate in (later, truth.take(slice(0, 0))):
        scores = score(estimate, truth)
        assert scores["horizontal_rmse_m"].value is None
        assert scores["horizontal_rmse_m"].why == "no truth row could be scored"
        assert scores["scored_share"].value == 0.0


def test_a_metric_has_a_finite_value_or_a_reason():
    with pytest.raises(InputError, match="must say why"):
        Metric(None, "m")
    with pytest.raises(InputError, match="finite"):
        Metric(float("nan"), "m")
