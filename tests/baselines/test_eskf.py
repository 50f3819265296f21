"""The error-state filter on whole drives: consistency, late data, gates, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

import fgloc
from fgloc.drive import GnssBias
from fgloc.errors import DriveError, SolverError
from fgloc.evaluation import chi2_quantile, errors
from fgloc.measurements import EnuVelocities

from .roadside import CAR_ID, roadside_drive

SLOW = {"gnss_bias": GnssBias(1.3, 60.0), "node_bias_m": 0.5}
DRIVES = 16


@pytest.fixture(scope="module")
def drive():
    return roadside_drive(0, duration_s=45.0, **SLOW)


def without(drive, *names):
    return replace(drive, tables={n: t for n, t in drive.tables.items() if n not in names})


def mean_nees(drive) -> tuple[float, float]:
    """Of position and pose, at the instants that estimate and truth share."""
    found = fgloc.baseline(drive, "eskf").trajectory
    scored = errors(found, drive.truth.take(np.isin(drive.truth.t_ns, found.t_ns)))
    return float(scored.nees_position.mean()), float(scored.nees_pose.mean())


def test_nees_of_simulated_drives_lies_within_its_band():
    nees = [mean_nees(fgloc.make("city", seed=s, duration_s=30.0)) for s in range(DRIVES)]
    for dof, mean in zip((3, 6), np.mean(nees, axis=0), strict=True):
        low, high = chi2_quantile([0.0125, 0.9875], dof * DRIVES) / DRIVES
        assert low < mean < high, f"{dof} dimensions: {mean:.2f} outside {low:.2f} to {high:.2f}"


def test_with_slow_errors_and_a_node_it_is_as_good_as_it_claims():
    drives = [roadside_drive(s, duration_s=45.0, **SLOW) for s in range(4)]
    position, pose = np.mean([mean_nees(one) for one in drives], axis=0)
    low, high = chi2_quantile([0.0125, 0.9875], 12) / 4
    assert low < position < high and pose < 2 * 6


def test_every_row_has_one_verdict_and_the_car_is_told_from_the_others(drive):
    result = fgloc.baseline(drive, "eskf")
    for name, table in drive.tables.items():
        assert sum(result.summary["counts"][name].values()) == len(table)
    own, table = result.verdicts["detections"], drive.tables["detections"]
    assert np.isin(table.object_id[own.is_("used")], [CAR_ID, CAR_ID + 10]).mean() > 0.98
    assert result.events[0].kind == "aligned" and result.summary["start_s"] > 0
    assert result.trajectory.t_ns[0] > drive.start_ns
    assert "before a course" in result.verdicts["gnss"].reason[0]


def test_late_detections_end_where_prompt_ones_do():
    late = roadside_drive(0, duration_s=45.0, latency_s=0.4, **SLOW)
    prompt = roadside_drive(0, duration_s=45.0, **SLOW)
    ends = [fgloc.baseline(one, "eskf") for one in (prompt, late)]
    assert ends[0].summary["counts"] == ends[1].summary["counts"]
    np.testing.assert_allclose(
        ends[0].trajectory.p_world_m[-1], ends[1].trajectory.p_world_m[-1], atol=0.01
    )
    assert not ends[0].trajectory.same_as(ends[1].trajectory)  # meanwhile it had to wait for them


def test_what_comes_later_than_the_buffer_is_late():
    result = fgloc.baseline(roadside_drive(0, duration_s=45.0, latency_s=3.0), "eskf")
    counts = result.summary["counts"]["detections"]
    assert "used" not in counts and counts["late"] > 100


def test_nothing_that_has_not_arrived_is_used(drive):
    cut_ns = drive.start_ns + 30_000_000_000
    tables = {name: t.take(t.received_ns <= cut_ns) for name, t in drive.tables.items()}
    short = fgloc.baseline(replace(drive, tables=tables), "eskf").trajectory
    whole = fgloc.baseline(drive, "eskf").trajectory
    same = np.isin(whole.t_ns, short.t_ns)
    np.testing.assert_allclose(whole.p_world_m[same], short.p_world_m, atol=1e-9)


def test_a_jump_is_gated_and_after_a_while_believed(drive):
    jumped = drive.gnss.p_world_ant_m.copy()
    jumped[300:] += [60.0, 0, 0]
    apart = without(drive.with_tables(gnss=replace(drive.gnss, p_world_ant_m=jumped)), "detections")
    result = fgloc.baseline(apart, "eskf")
    assert 45 < result.summary["counts"]["gnss"]["gated"] < 60
    assert "gate reset" in {event.kind for event in result.events}
    end = result.trajectory.p_world_m[-1] - drive.truth.p_world_m[-1]
    assert np.hypot(end[0] - 60, end[1]) < 6.0


def test_without_an_imu_it_moves_by_the_velocities(drive):
    result = fgloc.baseline(without(drive, "imu"), "eskf")
    scores = fgloc.score(result.trajectory, drive.truth)
    raw = fgloc.score(fgloc.baseline(drive, "raw:gnss").trajectory, drive.truth)
    assert result.summary["moves_by"] == "velocity"
    assert scores["horizontal_rmse_m"].value < 0.8 * raw["horizontal_rmse_m"].value
    assert sum(result.summary["counts"]["velocity"].values()) == len(drive.tables["velocity"])


def test_by_velocities_alone_the_height_is_that_of_the_fixes(drive):
    scores = fgloc.score(fgloc.baseline(drive, "eskf:velocity").trajectory, drive.truth)
    raw = fgloc.score(fgloc.baseline(drive, "raw:gnss").trajectory, drive.truth)
    assert scores["up_rmse_m"].value < raw["up_rmse_m"].value
    assert scores["anees_position"].value < 2.5


def test_a_start_in_reverse_is_told_from_the_accelerations():
    ahead = fgloc.make("city", seed=2, duration_s=30.0)
    # The same drive with vehicle and IMU turned about: it sets off backwards.
    turn = np.diag([-1.0, -1.0, 1.0])
    T = ahead.rig.T_veh_imu.copy()
    T[:3] = turn @ T[:3]
    rig = replace(ahead.rig, T_veh_imu=T, p_veh_ant_m=turn @ ahead.rig.p_veh_ant_m)
    truth = replace(ahead.truth, R_world_veh=ahead.truth.R_world_veh @ turn)
    result = fgloc.baseline(replace(ahead, rig=rig, truth=truth), "eskf")
    scores = fgloc.score(result.trajectory, truth, score_from_s=10.0)
    assert scores["yaw_rmse_rad"].value < 0.2


def test_a_vehicle_that_only_stands_has_no_heading_and_that_is_said(drive):
    still = drive.gnss.p_world_ant_m[:30]
    stands = drive.with_tables(gnss=replace(drive.gnss.take(slice(0, 30)), p_world_ant_m=still))
    with pytest.raises(SolverError, match="eskf starts where the fixes show a course"):
        fgloc.baseline(stands, "eskf")


def test_without_imu_and_velocities_the_message_says_what_is_needed(drive):
    with pytest.raises(DriveError, match="eskf needs an IMU or the table velocity"):
        fgloc.baseline(without(drive, "imu", "velocity"), "eskf")


def test_broken_and_doubled_velocities_are_counted(drive):
    v = drive.tables["velocity"]
    broken = v.v_world_mps.copy()
    broken[20] = np.nan
    t_ns = v.t_ns.copy()
    t_ns[31] = t_ns[30]
    table = EnuVelocities(t_ns, t_ns, broken, v.sigma_mps)
    result = fgloc.baseline(without(drive.with_tables(velocity=table), "imu"), "eskf")
    counts = result.summary["counts"]["velocity"]
    assert counts["invalid"] == 1 and counts["duplicate"] == 1
