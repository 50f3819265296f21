"""Drives without an IMU: constant velocity, odometry, steering with wheels; velocities."""

import dataclasses

import numpy as np
import pytest

from fgloc.config import load_config
from fgloc.errors import DriveError
from fgloc.smoother import smooth
from fgloc.verdicts import Verdict

from .test_chain import assert_same_optimum
from .without_imu import STEERING_RATIO, WHEELBASE_M, drive_of, wandering

STEERED = {"wheelbase_m": WHEELBASE_M, "steering_ratio": STEERING_RATIO}
DRIVES = {
    "constant velocity": ((), {}),
    "wheels": (("wheel",), {}),
    "odometry": (("odometry",), {}),
    "bicycle": (("wheel", "steering"), STEERED),
    "velocities": (("velocity",), {}),
}


def of_kind(name, **more):
    """A drive of `DRIVES`, and its settings of motion."""
    kinds, motion = DRIVES[name]
    return drive_of(*kinds, **more), motion


def without_yaw_rates(drive, first_s, last_s):
    """The drive with no odometry strictly between two times."""
    t = drive.tables["odometry"].t_ns - drive.start_ns
    kept = drive.tables["odometry"].take((t <= first_s * 1e9) | (t >= last_s * 1e9))
    return drive.with_tables(odometry=kept)


@pytest.mark.parametrize("name", DRIVES)
def test_the_chain_has_the_optimum_of_gtsam(name):
    drive, motion = of_kind(name, duration_s=20.0)
    # A car that waits may point anywhere, and the cost is flat there.
    assert_same_optimum(drive, motion=motion, solver={"cost_tolerance": 1e-10})


def test_the_chain_has_the_optimum_of_gtsam_where_yaw_rates_are_missing():
    drive = without_yaw_rates(drive_of("odometry", duration_s=20.0), 8.0, 12.0)
    assert_same_optimum(drive)


@pytest.mark.parametrize(("mode", "most_m"), [("batch", 1.2), ("fixed-lag", 2.5)])
@pytest.mark.parametrize("name", DRIVES)
def test_each_kind_of_drive_is_smoothed_and_followed(name, mode, most_m, run, rmse_m):
    """Fixes have 0.7 m, and in the second between two of them a car speeds up by 2 m/s."""
    drive, motion = of_kind(name, duration_s=20.0)
    result = run(drive, mode, motion=motion, lag_s=2.0)
    assert rmse_m(result.trajectory, drive, 10.0) < most_m
    counts = result.summary["counts"]
    for source, table in drive.tables.items():
        assert sum(counts[source].values()) == len(table)
    assert "imu" not in counts


@pytest.mark.parametrize("name", ["odometry", "bicycle"])
def test_yaw_rates_and_wheels_outlast_the_fixes(name, run, against_truth, altered):
    drive, motion = of_kind(name, duration_s=60.0)
    drive = altered.without_fixes(drive, 40.0, 50.0)
    held = against_truth(run(drive, "fixed-lag", motion=motion).trajectory, drive, 40.0)
    inside = held.t_ns <= drive.start_ns + 50_000_000_000
    assert held.horizontal_m[inside].max() < 4.0


def test_an_error_of_acceleration_that_is_white_noise_is_told_as_large_as_it_is():
    """NEES of a constant velocity whose changes are the ones of the model, in both directions of
    time."""
    densities, nees = np.array([1.5, 1.5, 0.3]), {"batch": [], "fixed-lag": []}
    for seed in range(4):
        drive = wandering(seed, densities)
        for mode, found in nees.items():
            config = load_config(mode=mode, vehicle={"non_holonomic": False})
            result = smooth(drive, config).trajectory
            shared = drive.truth.take(np.isin(drive.truth.t_ns, result.t_ns))
            at = np.isin(result.t_ns, shared.t_ns)
            error = result.p_world_m[at] - shared.p_world_m
            cov = result.cov[at][:, :3, :3]
            each = np.einsum("ni,ni->n", error, np.linalg.solve(cov, error[..., None])[..., 0])
            found.append(each[40:].mean())
    assert 2.2 < np.mean(nees["batch"]) < 3.8
    assert 2.2 < np.mean(nees["fixed-lag"]) < 3.8


def test_a_wild_velocity_is_gated_as_it_comes_and_in_a_batch(run):
    drive = drive_of("velocity", duration_s=15.0)
    v = np.array(drive.tables["velocity"].v_world_mps)
    v[140] += [0.0, 30.0, 0.0]
    wild = dataclasses.replace(drive.tables["velocity"], v_world_mps=v)
    drive = drive.with_tables(velocity=wild)
    told = run(drive, "fixed-lag").verdicts["velocity"]
    assert told.verdict[140] == Verdict.GATED
    assert told.nis[140] > told.threshold[140]
    assert run(drive, "batch").verdicts["velocity"].verdict[140] == Verdict.GATED


def test_a_velocity_tells_the_heading_as_soon_as_the_car_moves(run):
    drive = drive_of("velocity", duration_s=15.0)
    v = drive.tables["velocity"].v_world_mps
    moves_ns = drive.tables["velocity"].t_ns[np.argmax(np.linalg.norm(v, axis=1) > 2.0)]
    aligned = [e.t_ns for e in run(drive, "fixed-lag").events if e.kind == "aligned"]
    assert len(aligned) == 1
    assert aligned[0] <= moves_ns + 1e9


def test_velocities_that_come_after_the_lag_are_late(run):
    drive = drive_of("velocity", duration_s=15.0)
    table = drive.tables["velocity"]
    late = dataclasses.replace(table, received_ns=table.t_ns + 4_000_000_000)
    drive = drive.with_tables(velocity=late)
    told = run(drive, "fixed-lag", lag_s=2.0).verdicts["velocity"]
    assert told.is_(Verdict.LATE)[85:100].all()
    assert "its state has left the window" in told.reason[90]


def test_nothing_is_told_before_it_has_arrived(run, apart):
    """A causal run over the first part of a drive gives what the whole run gave there."""
    drive = drive_of("odometry", duration_s=15.0)
    whole = run(drive, "fixed-lag").trajectory
    until = drive.start_ns + 10_000_000_000
    tables = {name: table.take(table.t_ns <= until) for name, table in drive.tables.items()}
    part = run(dataclasses.replace(drive, tables=tables), "fixed-lag").trajectory
    same = apart(part, whole)
    assert same.m.max() < 1e-6 and len(same.m) > 80


def test_the_whole_past_can_be_kept(run, apart):
    drive = drive_of("odometry", duration_s=15.0)
    one, other = (run(drive, mode).trajectory for mode in ("incremental", "fixed-lag"))
    assert apart(one, other, 10.0).m.max() < 0.1


def test_with_an_imu_velocities_and_odometry_wait_to_be_asked(city, run):
    drive = city(1, 30.0)
    more = drive_of("velocity", "odometry").tables
    drive = drive.with_tables(velocity=more["velocity"], odometry=more["odometry"])
    told = run(drive).summary["counts"]
    assert set(told["velocity"]) == set(told["odometry"]) == {"unused"}
    asked = run(drive, motion={"velocities": True}).summary["counts"]["velocity"]
    assert asked["used"] > 250


def test_velocities_that_come_from_odometry_do_not_tell_it_twice(run):
    drive = drive_of("velocity", "odometry", duration_s=15.0)
    assert set(run(drive).summary["counts"]["velocity"]) == {"unused"}
    alone = run(drive, motion={"kind": "constant-velocity"}).summary["counts"]["velocity"]
    assert alone["used"] > 100


def test_an_imu_can_be_left_aside(city, run, rmse_m):
    drive = city(1, 30.0)
    result = run(drive, motion={"kind": "constant-velocity"})
    assert result.summary["counts"]["imu"] == {"unused": len(drive.imu)}
    assert result.summary["motion"] == "constant-velocity"
    assert rmse_m(result.trajectory, drive) < 1.0


def test_a_motion_that_the_drive_cannot_tell_is_refused(run):
    for kind, missing in (("odometry", "odometry"), ("bicycle", "steering"), ("imu", "imu")):
        with pytest.raises(DriveError, match=f"{missing} rows"):
            run(drive_of(), motion={"kind": kind})
    with pytest.raises(DriveError, match=r"--set motion.wheelbase_m=2.7"):
        run(drive_of("wheel", "steering"), motion={"kind": "bicycle"})
    with pytest.raises(DriveError, match=r"vehicle.zero_velocity .* there is none"):
        run(drive_of(), vehicle={"zero_velocity": True})
