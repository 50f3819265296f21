"""The drive as it arrives: what becomes of the past, of late fixes, and of a solver that fails."""

import dataclasses

import numpy as np
import pytest

from fgloc.config import load_config
from fgloc.datasets import open_drive
from fgloc.datasets.degrade import degrade
from fgloc.errors import SolverError
from fgloc.smoother import smooth
from fgloc.smoother.graph import GraphModel
from fgloc.smoother.online import Online
from fgloc.sync import plan
from fgloc.verdicts import Verdict

CAUSAL = ["incremental", "fixed-lag"]
DEGRADED = {
    "A": {},
    "B": {"outage": (75, 15, 45)},
    "C": {"outage": (75, 30, 90)},
    "D": {"noise_enu_m": (1, 1, 2), "seed": 0},
}


def mems_rtk(case):
    drive = open_drive("mems-rtk")
    return degrade(drive, **DEGRADED[case]) if DEGRADED[case] else drive


def late(altered, drive, by_s, rows=slice(None)):
    """The drive with some fixes received later than they were true."""
    received = drive.gnss.received_ns.copy()
    received[rows] += round(by_s * 1e9)
    return altered.with_fixes(drive, received_ns=received)


# The last word is that of the batch


@pytest.mark.parametrize("name", ["A", "B", "C", "D", 0, 1, 2])
def test_relinearised_to_the_end_incremental_equals_batch(city, run, apart, name):
    drive = mems_rtk(name) if isinstance(name, str) else city(name, 60.0)
    off = apart(run(drive, "incremental", smoothed=True).smoothed, run(drive).trajectory)
    assert len(off.t_ns) > 600
    assert off.m.max() < 1e-3
    assert off.rad.max() < 1e-4
    assert off.cov.max() < 0.01


def test_a_fixed_lags_last_estimates_are_better_than_its_first(city, run, rmse_m):
    drive = city(1, 40.0)
    result = run(drive, "fixed-lag", smoothed=True)
    np.testing.assert_array_equal(result.smoothed.t_ns, result.trajectory.t_ns)
    assert rmse_m(result.smoothed, drive, 5.0) < 0.8 * rmse_m(result.trajectory, drive, 5.0)


# Causality


@pytest.mark.parametrize("mode", CAUSAL)
@pytest.mark.parametrize("name", ["city", "B"])
def test_what_is_yet_to_come_changes_nothing(city, run, name, mode):
    drive = city(3, 40.0) if name == "city" else mems_rtk(name)
    until_ns = drive.gnss.t_ns[len(drive.gnss) // 2]
    known = drive.with_tables(
        gnss=drive.gnss.take(drive.gnss.t_ns <= until_ns),
        imu=drive.imu.take(drive.imu.t_ns <= until_ns),
    )
    whole, part = run(drive, mode).trajectory, run(known, mode).trajectory
    assert part.t_ns[-1] == until_ns
    assert part.same_as(whole.take(whole.t_ns <= until_ns))


def test_a_fix_is_not_known_before_it_is_received(city, altered, run):
    drive = late(altered, city(3, 30.0), 0.3)
    until_ns = drive.gnss.t_ns[200]
    arrived = drive.gnss.received_ns <= until_ns
    moved = drive.gnss.p_world_ant_m + 5.0 * ~arrived[:, None]
    whole = run(drive, "fixed-lag").trajectory
    other = run(altered.with_fixes(drive, p_world_ant_m=moved), "fixed-lag").trajectory
    before = whole.t_ns <= until_ns
    assert whole.take(before).same_as(other.take(before))
    assert not whole.same_as(other)


# Late fixes


@pytest.mark.parametrize("mode", CAUSAL)
def test_fixes_that_come_late_are_used_all_the_same(city, altered, run, rmse_m, mode):
    drive = city(2, 40.0)
    delayed = run(late(altered, drive, 0.3), mode)
    assert set(delayed.verdicts["gnss"].verdict) <= {Verdict.USED, Verdict.DOWN_WEIGHTED}
    in_time = rmse_m(run(drive, mode).trajectory, drive, 15.0)
    assert rmse_m(delayed.trajectory, drive, 15.0) < 1.5 * in_time


def test_late_fixes_are_used_with_a_bias_variable_too(city, altered, run):
    drive = late(altered, degrade(city(2, 30.0), keep_every=5), 0.7)
    result = run(drive, "fixed-lag", gnss={"bias_sigma_m": 2.0})
    assert result.summary["counts"]["gnss"] == {"used": len(drive.gnss)}


def test_a_fix_older_than_the_lag_is_late(city, altered, run):
    drive = late(altered, city(2, 60.0), 8.0, slice(400, 500, 20))
    verdicts = run(drive, "fixed-lag").verdicts["gnss"]
    assert np.flatnonzero(verdicts.is_(Verdict.LATE)).tolist() == list(range(400, 500, 20))
    assert verdicts.reason[400] == "8.00 s old; its state has left the window"
    assert len(verdicts) == sum(verdicts.counts().values()) == 601


def test_nothing_is_too_late_for_a_run_that_keeps_everything(city, altered, run):
    drive = late(altered, city(2, 60.0), 8.0, slice(400, 500, 20))
    verdicts = run(drive, "incremental").verdicts["gnss"]
    assert not verdicts.is_(Verdict.LATE).any()
    assert np.isfinite(verdicts.nis[400:500:20]).all()


@pytest.mark.parametrize("mode", CAUSAL)
def test_a_fix_that_arrives_after_the_end_is_not_lost(city, altered, run, mode):
    drive = late(altered, city(2, 50.0), 100.0, [300, 498, 499])
    verdicts = run(drive, mode).verdicts["gnss"]
    assert not verdicts.is_(Verdict.UNUSED).any()
    old = Verdict.LATE if mode == "fixed-lag" else Verdict.USED
    assert verdicts.verdict[[300, 498, 499]].tolist() == [old, Verdict.USED, Verdict.USED]


# A fixed lag forgets


def stores(online) -> dict[str, int]:
    """How much a run still holds of what lay within its window."""
    held = {name: len(getattr(online, name)) for name in
            ("_states", "_covs", "_intervals")}  # fmt: skip
    held["accepted"] = len(online._positions.accepted)
    return held | {"factors": online.factors, "variables": online._tree.isam.getDelta().size()}


@pytest.mark.parametrize("settings", [{}, {"gnss": {"bias_sigma_m": 1.0}}])
def test_a_fixed_lag_holds_no_more_after_a_longer_drive(city, settings):
    held = []
    for duration_s in (100.0, 200.0):
        drive = degrade(city(0, duration_s), keep_every=10)
        config = load_config(mode="fixed-lag", **settings)
        online = Online(GraphModel(drive, plan(drive, config), config), config.lag_s)
        online.run()
        held.append(stores(online))
    assert held[0] == held[1]
    assert all(held[1][name] < 12 for name in ("_states", "_covs", "_intervals", "accepted"))


# Yaw


@pytest.mark.parametrize("mode", CAUSAL)
def test_the_yaw_is_observable_once_the_car_has_moved(city, run, against_truth, mode):
    drive = city(0, 40.0)
    result = run(drive, mode)
    seen_s = result.summary["yaw_observable_s"]
    assert 5 < seen_s < 30
    scored = against_truth(result.trajectory, drive, seen_s)
    assert np.rad2deg(np.abs(scored.yaw_rad)).max() < 15
    sigma = np.sqrt(result.trajectory.cov[:, 5, 5])
    assert sigma[result.trajectory.t_ns < drive.start_ns + seen_s * 1e9].min() >= 0.1


@pytest.mark.parametrize("mode", ["batch", *CAUSAL])
def test_a_car_that_never_moves_has_no_yaw_and_a_place(altered, run, against_truth, mode):
    drive = altered.standing(30.0)
    result = run(drive, mode)
    assert result.summary["yaw_observable_s"] is None
    scored = against_truth(result.trajectory, drive, 20.0)
    around_the_antenna_m = 2 * np.hypot(*drive.rig.p_veh_ant_m[:2])
    assert scored.horizontal_m.max() < around_the_antenna_m + 0.5
    assert np.sqrt(result.trajectory.cov[:, 5, 5]).min() > 0.5
    assert sum(result.verdicts["gnss"].counts().values()) == len(drive.gnss)


def test_a_wait_longer_than_the_window_does_no_harm(altered, run):
    drive = degrade(altered.standing(100.0), keep_every=5)
    result = run(drive, "fixed-lag")
    assert result.summary["yaw_observable_s"] is None
    assert np.isfinite(result.trajectory.cov).all()


# A solver that fails


@pytest.mark.parametrize("mode", CAUSAL)
def test_a_failing_cholesky_is_survived_and_told(city, run, apart, mode):
    drive = city(0, 40.0)
    failed = run(drive, mode, solver={"factorization": "cholesky"})
    told = [event.text for event in failed.events if event.kind == "solver"]
    assert told, "this drive was chosen because Cholesky fails on it"
    assert "IMU bias of keyframe 0, t = 0.00 s (2025-10-09T08:53:20.000Z)" in told[0]
    assert "its random walk is too small" in told[0]
    # Solved anew, the first keyframes are iterated further than iSAM2 had done.
    off = apart(failed.trajectory, run(drive, mode).trajectory, from_s=1.0)
    assert off.m.max() < 0.01
    assert off.rad.max() < 1e-3


def test_a_drive_without_hope_names_keyframe_and_time(city, run):
    drive = city(0, 20.0)
    accel = drive.imu.accel_mps2.copy()
    accel[600:] = 1e9
    drive = drive.with_tables(imu=dataclasses.replace(drive.imu, accel_mps2=accel))
    message = r"failed at (the pose of )?keyframe \d+, t = 1\d\.\d\d s \(2025-.*Z\): "
    with pytest.raises(SolverError, match=message):
        run(drive, "fixed-lag")


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("mode", ["batch", *CAUSAL])
def test_a_measurement_beyond_all_bounds_is_refused(city, run, mode):
    drive = city(0, 20.0)
    accel = drive.imu.accel_mps2.copy()
    accel[1200:] = 1e160
    drive = drive.with_tables(imu=dataclasses.replace(drive.imu, accel_mps2=accel))
    with pytest.raises(SolverError):
        run(drive, mode)


@pytest.mark.parametrize("mode", ["incremental", "fixed-lag"])
def test_late_fixes_and_a_gnss_bias_go_together(mode):
    drive = open_drive("city", seed=1, duration_s=20)
    late = dataclasses.replace(drive.gnss, received_ns=drive.gnss.t_ns + 300_000_000)
    settings = ["gnss.bias_sigma_m=1"]
    result = smooth(drive.with_tables(gnss=late), load_config(mode=mode, settings=settings))
    assert [event.kind for event in result.events] == ["aligned"]
    assert sum(result.verdicts["gnss"].counts().values()) == len(late)
