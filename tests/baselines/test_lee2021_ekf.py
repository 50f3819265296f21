"""The documented EKF on whole drives: what is synchronised how, and what becomes of each row."""

from dataclasses import replace

import numpy as np
import pytest

import fgloc
from fgloc.baselines.lee2021_ekf import run, run_on_arrival
from fgloc.baselines.lee2021_filter import LEE2021
from fgloc.baselines.lee2021_sync import candidates
from fgloc.errors import DriveError
from fgloc.infrastructure import Node
from fgloc.measurements import PEDESTRIAN, VEHICLE, NodeDetections

from .roadside import roadside_drive

MS = 1_000_000
NODE = Node("pole", np.array([100.0, 0, 5]), np.pi, range_m=60.0)


@pytest.fixture(scope="module")
def drive():
    return roadside_drive(2)


def seen(rows) -> NodeDetections:
    """Detections of (t in ms, object, kind, x, y) by one node."""
    rows = np.array(rows, float)
    t_ns, n = (rows[:, 0] * MS).astype(int), len(rows)
    return NodeDetections(
        t_ns, t_ns, np.zeros(n, int), rows[:, 1].astype(int), rows[:, 2].astype(int), rows[:, 3:],
        np.full((n, 2, 2), np.nan),
    )  # fmt: skip


def brought(rows, t_ms, v_mps=(10.0, 0.0, 0.0)):
    return candidates(seen(rows), (NODE,), np.array(t_ms) * MS, np.tile(v_mps, (len(t_ms), 1)),
                      "as-stamped")  # fmt: skip


def test_an_object_is_taken_where_it_was_between_two_frames():
    found = brought([(0, 7, VEHICLE, 50, 2), (100, 7, VEHICLE, 48, 4)], [25])
    np.testing.assert_allclose(found.p_world_m, [[100 - 49.5, -2.5]], atol=1e-9)
    np.testing.assert_allclose(found.distance_m, [np.hypot(49.5, 2.5)])
    assert found.rows.tolist() == [[0, 1]] and found.in_range.tolist() == [True]


def test_a_frame_at_the_stamp_is_taken_as_it_is():
    found = brought([(0, 7, VEHICLE, 50, 2), (100, 7, VEHICLE, 48, 4)], [100])
    np.testing.assert_allclose(found.p_world_m, [[52, -4]], atol=1e-9)
    assert found.rows.tolist() == [[1, 1]]


def test_what_has_no_partner_is_carried_by_the_vehicles_own_velocity():
    rows = [(0, 7, VEHICLE, 50, 2), (0, -1, VEHICLE, 30, 0), (100, 8, VEHICLE, 48, 2)]
    found = brought(rows, [40])
    np.testing.assert_allclose(
        found.p_world_m, [[50 + 0.4, -2], [70 + 0.4, 0], [52 - 0.6, -2]], atol=1e-9
    )
    assert found.rows.tolist() == [[0, 0], [1, 1], [2, 2]]


def test_over_a_long_gap_nothing_is_joined_and_nothing_carried_far():
    assert len(brought([(0, 7, VEHICLE, 50, 2), (400, 7, VEHICLE, 48, 4)], [200]).epoch) == 0


def test_pedestrians_and_broken_rows_are_no_candidates():
    rows = [(0, 7, PEDESTRIAN, 50, 2), (0, 8, VEHICLE, np.nan, 2), (0, 9, VEHICLE, 20, 2)]
    assert brought(rows, [0]).rows.tolist() == [[2, 2]]


def test_every_row_has_one_verdict_and_the_totals_add_up(drive):
    result = fgloc.baseline(drive, "lee2021-ekf")
    for name, table in drive.tables.items():
        assert sum(result.summary["counts"][name].values()) == len(table)
    own = result.verdicts["detections"]
    used = own.is_("used")
    assert used.any() and own.is_("gated").any() and own.is_("outside").any()
    assert (own.dof[used] == 2).all() and np.isfinite(own.nis[used]).all()
    assert "another candidate was nearer" in set(own.reason[own.is_("other object")])
    assert result.verdicts["gnss"].reason[0] == "the filter starts from it"


def test_near_the_node_it_is_better_than_the_fixes_alone(drive):
    ours = fgloc.score(fgloc.baseline(drive, "lee2021-ekf").trajectory, drive.truth)
    raw = fgloc.score(fgloc.baseline(drive, "raw:gnss").trajectory, drive.truth)
    assert ours["horizontal_rmse_m"].value < 0.5 * raw["horizontal_rmse_m"].value
    assert ours["anees_horizontal"].value is not None


def test_two_runs_are_equal_in_every_bit(drive):
    one, two = run(drive), run(drive)
    assert one.trajectory.same_as(two.trajectory)
    assert one.summary["counts"] == two.summary["counts"]


def test_as_stamped_latency_costs_nothing_and_on_arrival_it_does():
    prompt, late = roadside_drive(1), roadside_drive(1, latency_s=0.3)
    assert run(prompt).trajectory.same_as(run(late).trajectory)
    assert run(prompt).trajectory.same_as(run_on_arrival(prompt).trajectory)
    rmse = [fgloc.score(one.trajectory, late.truth)["horizontal_rmse_m"].value
            for one in (run(late), run_on_arrival(late))]  # fmt: skip
    assert rmse[1] > 2 * rmse[0]


def test_fixes_that_jump_for_good_make_it_start_anew_and_that_is_told(drive):
    jumped = drive.gnss.p_world_ant_m.copy()
    jumped[300:, 0] += 40.0
    moved = drive.with_tables(gnss=replace(drive.gnss, p_world_ant_m=jumped))
    result = run(moved)
    assert result.summary["restarts"] == 1 and result.events[0].kind == "restart"
    assert result.summary["counts"]["gnss"]["gated"] == pytest.approx(51, abs=1)
    assert "m from the prediction; the threshold is 5 m" in result.verdicts["gnss"].reason[310]


def test_rows_that_are_broken_or_without_velocity_are_told_apart(drive):
    p = drive.gnss.p_world_ant_m.copy()
    p[5] = np.nan
    v = drive.tables["velocity"]
    broken = v.v_world_mps.copy()
    broken[20] = np.nan
    cut = replace(v, v_world_mps=broken).take(slice(10, None))
    result = run(drive.with_tables(gnss=replace(drive.gnss, p_world_ant_m=p), velocity=cut))
    assert result.summary["counts"]["gnss"] == {"invalid": 1, "outside": 9, "used": 591}
    assert result.summary["counts"]["velocity"]["invalid"] == 1


def test_without_velocities_the_message_says_what_is_needed(drive):
    tables = {name: table for name, table in drive.tables.items() if name != "velocity"}
    with pytest.raises(DriveError, match=r"predicts with the table velocity .* add velocity.csv"):
        run(replace(drive, tables=tables))


def test_without_detections_it_is_a_filter_of_fixes_and_velocity(drive):
    tables = {name: table for name, table in drive.tables.items() if name != "detections"}
    assert len(run(replace(drive, tables=tables)).trajectory) == len(drive.gnss)


def test_what_was_in_force_is_kept_with_the_result(drive):
    config = run(drive, replace(LEE2021, process_sigma_m=0.2)).config["lee2021"]
    assert config["process_sigma_m"] == 0.2 and config["gps_sigma_m"] == (0.8, 2.0)
