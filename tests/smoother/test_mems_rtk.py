"""A real drive, a fix a second out of centimetres: how far off the rest of the fixes are.

Cases: A as recorded; B outages of 15 s; C outages of 30 s; D noise of 1, 1, 2 m on every fix.
Scored from 75 s on. The figures to keep are KF-GINS's for the causal run and those of a batch
written by hand for the smoothed one, as the origin of the data states them; case D is held against
bare GTSAM scripts on the same fixes.
"""

import functools
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fgloc.config import load_config
from fgloc.datasets import open_drive
from fgloc.datasets.degrade import degrade
from fgloc.evaluation import error_growth, errors, gnss_outages
from fgloc.smoother import smooth

SCORE_FROM_S = 75
OUTAGES = {"B": (75, 15, 45), "C": (75, 30, 90)}
NUMBER = {"B": 11, "C": 5}
BATCH_WITHIN, LAG_WITHIN = 1.02, 1.05


@functools.cache
def figures(case, mode, *settings):
    """Horizontal RMSE in m over all truth and within outages, and the mean error at their end."""
    drive = open_drive("mems-rtk")
    if case in OUTAGES:
        drive = degrade(drive, outage=OUTAGES[case])
    result = smooth(drive, load_config(mode=mode, settings=settings))
    from_ns = int(drive.gnss.t_ns[0]) + SCORE_FROM_S * 10**9
    scored = errors(result.trajectory, drive.truth, score_from_ns=from_ns)
    growth = error_growth(scored, gnss_outages(result))
    return SimpleNamespace(
        rmse_m=rms(scored.horizontal_m),
        outages=len(growth.span_ns),
        in_outages_m=rms(scored.horizontal_m[growth.inside]) if growth.inside.any() else None,
        mean_end_m=float(growth.end_m.mean()) if len(growth.end_m) else None,
    )


def rms(x):
    return float(np.sqrt((x**2).mean())) if len(x) else 0.0


@pytest.mark.parametrize(
    ("mode", "most_m"), [("batch", 0.021 * BATCH_WITHIN), ("fixed-lag", 0.053 * LAG_WITHIN)]
)
def test_between_fixes_the_imu_carries_to_centimetres(mode, most_m):
    assert figures("A", mode).rmse_m <= most_m


@pytest.mark.parametrize("mode", ["batch", "fixed-lag"])
@pytest.mark.parametrize("case", ["B", "C"])
def test_all_outages_are_whole_and_found(case, mode):
    assert figures(case, mode).outages == NUMBER[case]


@pytest.mark.parametrize(("case", "figure_m"), [("B", 0.365), ("C", 1.90)])
def test_seen_from_both_sides_an_outage_costs_little(case, figure_m):
    assert figures(case, "batch").in_outages_m <= figure_m * BATCH_WITHIN


@pytest.mark.parametrize(("case", "figure_m", "end_m"), [("B", 5.42, 10.04), ("C", 18.6, 38.6)])
def test_seen_from_one_side_an_outage_grows_as_it_must(case, figure_m, end_m):
    got = figures(case, "fixed-lag")
    assert got.in_outages_m <= figure_m * LAG_WITHIN
    assert got.mean_end_m <= end_m * LAG_WITHIN


def test_noisy_fixes_are_smoothed_as_well_as_by_plain_gtsam(monkeypatch):
    """Mean RMSE over three seeds; the benchmark `noise_seeds.py` has twenty."""
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "benchmarks")
    from noise_seeds import rmse_of_seed

    batch, plain_batch, lag, plain_lag = np.mean(
        [rmse_of_seed(seed, loss="none") for seed in range(3)], axis=0
    )
    assert batch <= plain_batch * 1.05
    assert lag <= plain_lag * 1.05


@pytest.mark.parametrize(("case", "kf_gins_m"), [("B", 10.0), ("C", 38.6)])
def test_a_car_that_keeps_its_lane_drifts_half_as_far_as_kf_gins_that_did_not_know(case, kf_gins_m):
    car = "vehicle.non_holonomic=true", "vehicle.zero_velocity=true"
    assert figures(case, "fixed-lag", *car).mean_end_m <= kf_gins_m / 2
