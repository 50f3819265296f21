"""Requirements of automated driving: who may say yes, who no, and when neither can be said."""

import json
import math
import re

import numpy as np
import pytest
from evaluation.curves import straight
from test_report import made_drive, made_result, without_scripts, written

from fgloc.evaluation import Answer, errors, judge_requirements
from fgloc.evaluation.requirements import (
    ACCURACY,
    ALERT,
    PROFILES,
    as_dict,
    quantile_interval,
)
from fgloc.report.protection import SIGMAS, levels, protection_panels
from fgloc.report.requirements import accuracy_rows, alert_rows, answer_lines, excluded_rate
from fgloc.report.scene import scene
from fgloc.trajectory import Trajectory


def judged(lateral_m, *, yaw_rad=None, ahead_m=0.0, up_m=0.0):
    """Requirements by (profile, kind, column) of errors on a drive due north at 10 Hz."""
    lateral_m = np.asarray(lateral_m, float)
    p = np.stack([-lateral_m, np.full(len(lateral_m), ahead_m), np.full(len(lateral_m), up_m)], -1)
    found = judge_requirements(errors(*straight(p, yaw_rad)))
    return {(row.profile, row.kind, row.column): row for row in found}


def white(n=2000, sigma=1.0, seed=0):
    return np.random.default_rng(seed).normal(0, sigma, n)


def test_the_limits_are_those_of_the_paper():
    freeway, local = PROFILES
    assert list(freeway.alert.values())[:3] == [0.57, 1.40, 1.30]
    assert list(freeway.accuracy95.values())[:3] == [0.20, 0.48, 0.43]
    assert list(local.alert.values())[:2] == [0.29, 0.29]
    assert list(local.accuracy95.values())[:2] == [0.10, 0.10]
    yaw = [limits["yaw_rad"] for p in PROFILES for limits in (p.alert, p.accuracy95)]
    assert [math.degrees(limit) for limit in yaw] == pytest.approx([1.5, 0.51, 0.5, 0.17])
    assert "up_m" not in local.alert and "up_m" not in local.accuracy95


# Binomial tables: of 100 independent errors, 90 to 100 lie below the 95 % figure 97.5 % each way.
@pytest.mark.parametrize(
    ("n", "low", "high"), [(100, 90, 100), (72, 64, 72), (71, 63, None), (1, None, None)]
)
def test_order_statistics_bound_a_quantile(n, low, high):
    assert quantile_interval(np.arange(1, n + 1), n) == (low, high)


def test_fewer_independent_errors_give_a_wider_interval():
    x = np.arange(1, 1001)
    many, few = quantile_interval(x, 1000), quantile_interval(x, 100)
    assert few[0] < many[0] < 950 < many[1] < few[1] == 1000


def test_the_interval_holds_the_quantile_as_often_as_it_says():
    rng = np.random.default_rng(3)
    intervals = [quantile_interval(np.abs(rng.normal(size=400)), 400) for _ in range(400)]
    below = np.mean([high < 1.960 for _, high in intervals])
    above = np.mean([low > 1.960 for low, _ in intervals])
    assert below < 0.05 and above < 0.05


def test_accuracy_is_met_missed_or_open_by_its_confidence_limits():
    found = judged(white(sigma=0.07))  # 95 % of them below 0.137 m
    freeway, local = (found[p, ACCURACY, "lateral_m"] for p in ("freeway", "local_street"))
    assert freeway.answer == Answer.YES and freeway.high < 0.20
    assert local.answer == Answer.NO and local.low > 0.10
    assert freeway.value == pytest.approx(1.96 * 0.07, rel=0.05)
    near = judged(white(sigma=0.20 / 1.96))["freeway", ACCURACY, "lateral_m"]
    assert near.answer == Answer.OPEN and near.low < 0.20 < near.high
    assert near.why == "the limit lies inside the confidence interval"


def test_a_perfect_minute_of_slow_errors_is_not_enough_for_a_yes():
    slow = 0.01 * np.sin(np.linspace(0, 6, 600))
    row = judged(slow)["freeway", ACCURACY, "lateral_m"]
    assert row.answer == Answer.OPEN and row.high is None and row.n == 600
    assert row.n_effective < 72 and "too few" in row.why


def test_one_error_beyond_an_alert_limit_is_a_no():
    x = np.zeros(100)
    x[40] = 0.30
    found = judged(x)
    assert found["local_street", ALERT, "lateral_m"].answer == Answer.NO
    assert found["local_street", ALERT, "lateral_m"].beyond == 1
    assert found["freeway", ALERT, "lateral_m"].answer == Answer.OPEN


def test_no_drive_meets_an_alert_limit_and_the_rule_of_three_says_what_it_excludes():
    found = judged(np.zeros(36_001))  # an hour at 10 Hz
    row = found["freeway", ALERT, "lateral_m"]
    assert row.answer == Answer.OPEN and row.hours == pytest.approx(1.0)
    assert row.rate_high_per_h == pytest.approx(3.0, rel=0.01)  # -ln 0.05
    assert "less than 3 an hour" in row.why and "100,000,000 h" in row.why
    assert all(r.answer != Answer.YES for key, r in found.items() if key[1] == ALERT)


def test_time_that_was_not_scored_does_not_count():
    t = np.concatenate([np.arange(100), np.arange(100) + 36_000]) * 100_000_000
    at_rest = Trajectory(t, np.zeros((200, 3)), np.tile(np.eye(3), (200, 1, 1)))
    found = judge_requirements(errors(at_rest, at_rest))
    assert found[0].hours == pytest.approx(2 * 9.9 / 3600)


def test_heading_is_judged_by_an_attitude_and_not_by_a_course():
    yaw = white(sigma=math.radians(0.05))
    row = judged(np.zeros(2000), yaw_rad=yaw)["local_street", ACCURACY, "yaw_rad"]
    assert row.answer == Answer.YES
    estimate, truth = straight(np.zeros((2000, 3)), np.full(2000, 0.5))
    bare = errors(estimate, Trajectory(truth.t_ns, 10 * truth.p_world_m))
    for row in judge_requirements(bare):
        if row.column == "yaw_rad":
            assert row.answer == Answer.OPEN and "its course is not the heading" in row.why
            assert math.degrees(row.value) == pytest.approx(math.degrees(0.5))


def test_what_cannot_be_scored_says_why():
    estimate, truth = straight(np.zeros((5, 3)))
    rows = judge_requirements(errors(Trajectory(estimate.t_ns, estimate.p_world_m), truth))
    assert {r.why for r in rows if r.column == "yaw_rad"} == {"the estimate has no attitude"}
    nothing = judge_requirements(errors(estimate, truth, score_from_ns=int(truth.t_ns[-1]) + 1))
    assert {(r.answer, r.why) for r in nothing} == {(Answer.OPEN, "no truth row could be scored")}


def test_the_summary_is_plain_and_complete():
    plain = as_dict(tuple(judged(white(100, 0.01)).values()))
    assert json.loads(json.dumps(plain)) == plain
    assert set(plain) == {"source", "confidence", "integrity_per_h", "freeway", "local_street"}
    assert set(plain["freeway"]["alert"]) == {"lateral_m", "longitudinal_m", "up_m", "yaw_rad"}
    row = plain["local_street"]["accuracy95"]["lateral_m"]
    assert row["answer"] in set(map(str, Answer)) and row["limit"] == 0.10 and row["why"]


def test_screen_and_page_say_the_same():
    found = tuple(judged(white(sigma=0.07), up_m=2.0).values())
    freeway, local = answer_lines(as_dict(found))
    assert freeway[0] == "Freeway" and "no: vertical" in freeway[1] and "yes: lateral" in freeway[1]
    assert "no: lateral" in local[1] and local[0] == "Local street"
    lateral, _, up, _ = accuracy_rows(found)
    assert [cell["answer"] for cell in lateral["cells"]] == ["yes", "no"]
    assert [cell["limit"] for cell in lateral["cells"]] == ["0.20 m", "0.10 m"]
    assert [cell["answer"] for cell in up["cells"]] == ["no", ""]
    assert alert_rows(found)[2]["cells"][0]["more"] == "2,000 beyond"
    assert "100,000,000 hours" in excluded_rate(found)


# --- protection levels


def test_the_protection_level_is_as_many_sigmas_as_the_risk_asks():
    assert pytest.approx(5.327, abs=1e-3) == SIGMAS
    cov = np.diag([0.04, 0.01, 0.09, 1e-4, 1e-4, 1e-4])
    estimate, truth = straight([[0.1, 0.2, 0.3]] * 3, cov=np.tile(cov, (3, 1, 1)))
    error, level = levels(errors(estimate, truth), "lateral_m")
    np.testing.assert_allclose(error, 0.1)
    np.testing.assert_allclose(level, SIGMAS * 0.2)


def test_every_instant_is_in_one_cell_of_the_diagram():
    drive = made_drive()
    result = made_result(drive)
    e = errors(result.trajectory, drive.truth)
    panels = protection_panels(scene(drive, result, e))
    assert [title.partition(":")[0] for title in panels] == ["Lateral", "Longitudinal", "Vertical"]
    for column, (title, spec) in zip(("lateral_m", "longitudinal_m", "up_m"), panels.items(),
                                     strict=True):  # fmt: skip
        cells = next(trace for trace in spec["data"] if trace["type"] == "heatmap")
        error, level = levels(e, column)
        assert cells["customdata"].sum() == len(e)
        assert f"{int((error > level).sum()):,} of {len(e):,}" in title


def test_without_claims_there_is_no_diagram_but_there_are_verdicts(tmp_path):
    drive = made_drive()
    text = without_scripts(written(tmp_path, drive, made_result(drive, cov=False)))
    assert 'id="protection"' not in text and 'id="requirements"' in text
    assert re.search(r'class="answer (yes|no|open)"', text)
    assert "no certified bound of integrity" not in text


def test_the_diagram_states_its_caveat_and_the_verdicts_what_they_rest_on(tmp_path):
    drive = made_drive()
    text = without_scripts(written(tmp_path, drive, made_result(drive)))
    assert "no certified bound of integrity" in text and "5.33 claimed sigmas" in text
    assert "once in 100,000,000 hours" in text and "Reid et al. (2019)" in text
