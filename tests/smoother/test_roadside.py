"""What roadside nodes see helps the car: which of it is the car, late or not, and what is told."""

from dataclasses import replace

import numpy as np
import pytest
from baselines.roadside import CAR_ID, GHOST_ID, roadside_drive

from fgloc.config import load_config
from fgloc.drive import GnssBias
from fgloc.evaluation import errors
from fgloc.measurements import NodeDetections
from fgloc.smoother import smooth
from fgloc.smoother.chain import Chain
from fgloc.verdicts import Verdict

MODES = ("batch", "fixed-lag")
SLOW = GnssBias(1.5, 60.0)


@pytest.fixture(scope="module")
def drive():
    return roadside_drive(3, duration_s=40.0, gnss_bias=SLOW, node_bias_m=0.2)


@pytest.fixture(scope="module")
def smoothed(drive):
    """The drive through every mode, each solved once."""
    return {mode: smooth(drive, load_config(mode=mode)) for mode in MODES}


def near_the_node(result, drive) -> float:
    """Horizontal RMSE in m where the node sees the car, from a second after it first told so."""
    seen = drive.tables["detections"]
    found = errors(result.trajectory, drive.truth)
    inside = (found.t_ns >= seen.received_ns[0] + 10**9) & (found.t_ns <= seen.t_ns[-1])
    return float(np.sqrt((found.horizontal_m[inside] ** 2).mean()))


def verdicts_of(result, drive, ids) -> set[str]:
    rows = np.isin(drive.tables["detections"].object_id, ids)
    return set(result.verdicts["detections"].verdict[rows].tolist())


@pytest.mark.parametrize("mode", MODES)
def test_a_node_makes_up_for_what_slow_errors_of_the_fixes_do(run, drive, smoothed, mode):
    with_node = near_the_node(smoothed[mode], drive)
    without = near_the_node(run(drive, mode, detections={"use": False}), drive)
    assert with_node < 0.5 * without


@pytest.mark.parametrize("mode", MODES)
def test_the_car_is_told_from_its_neighbour_and_from_ghosts(drive, smoothed, mode):
    result = smoothed[mode]
    car = verdicts_of(result, drive, [CAR_ID, CAR_ID + 10])
    assert Verdict.USED in car
    rows = np.isin(drive.tables["detections"].object_id, [CAR_ID, CAR_ID + 10])
    used = result.verdicts["detections"].verdict[rows] == Verdict.USED
    assert used.mean() > 0.9
    others = [*range(GHOST_ID, GHOST_ID + 1000)]
    assert verdicts_of(result, drive, others) <= {Verdict.OTHER, Verdict.GATED, Verdict.UNUSED}
    total = sum(result.summary["counts"]["detections"].values())
    assert total == len(drive.tables["detections"])


def test_what_was_not_the_car_is_explained(smoothed):
    verdicts = smoothed["batch"].verdicts["detections"]
    assert all(verdicts.reason[verdicts.is_(Verdict.OTHER)])
    assert any("another road user" in reason for reason in verdicts.reason)


def test_late_detections_land_where_they_belong(run, smoothed):
    """Half a second late, a detection moves the past; the present follows."""
    prompt = smoothed["fixed-lag"]
    late = roadside_drive(3, duration_s=40.0, gnss_bias=SLOW, node_bias_m=0.2, latency_s=0.5)
    result = run(late, "fixed-lag")
    assert near_the_node(result, late) < 1.5 * near_the_node(prompt, late) + 0.05
    assert result.summary["counts"]["detections"] == prompt.summary["counts"]["detections"]


def test_the_newest_state_knows_nothing_of_what_has_not_arrived(run, drive, smoothed):
    """Whatever is received after an instant, what was written by then is the same, bit for bit."""
    seen = drive.tables["detections"]
    middle = int(seen.t_ns[len(seen) // 2])
    moved = seen.p_node_m + np.where(seen.t_ns > middle, 3.0, 0.0)[:, None]
    other = drive.with_tables(detections=replace(seen, p_node_m=moved))
    one, two = smoothed["fixed-lag"].trajectory, run(other, "fixed-lag").trajectory
    before = one.t_ns <= middle
    np.testing.assert_array_equal(one.p_world_m[before], two.p_world_m[before])
    assert not np.array_equal(one.p_world_m[~before], two.p_world_m[~before])


def test_plain_candidates_that_join_with_the_sketch_are_those_that_gtsam_takes(run, monkeypatch):
    """A node without slow errors, a second car and ghosts; GTSAM first solves without them all."""
    told, ask = [], Chain.rough_predictions
    monkeypatch.setattr(Chain, "rough_predictions", lambda *of: told.append(ask(*of)) or told[-1])
    drive = roadside_drive(3, duration_s=30.0)
    ours, theirs = (
        run(drive, solver={"batch": batch, "cost_tolerance": 1e-7}) for batch in ("banded", "gtsam")
    )
    assert len(told[0]) > len(drive.gnss)
    for table in ("gnss", "detections"):
        mine, its = (result.verdicts[table].verdict for result in (ours, theirs))
        np.testing.assert_array_equal(mine, its)
    apart = ours.trajectory.p_world_m - theirs.trajectory.p_world_m
    assert np.abs(apart).max() < 1e-4


def test_what_the_survey_is_off_is_found_to_within_its_sigma(run):
    """Good fixes, and a node half a metre from where it is said to be."""
    drive = roadside_drive(5, duration_s=40.0, ghosts=False)
    (node,) = drive.infrastructure.nodes
    off = np.array([0.5, -0.3, 0.0])
    said = replace(node, p_world_m=node.p_world_m + off, sigma_position_m=0.5, sigma_yaw_rad=0.02)
    drive = replace(drive, infrastructure=replace(drive.infrastructure, nodes=(said,)))
    told = run(drive).summary["nodes"]["pole"]["survey_off_m"]
    value, sigma = np.array(told["value"]), np.array(told["sigma"])
    assert (sigma < 0.3).all()
    assert (np.abs(value + off[:2]) < 3 * sigma).all()


def test_where_the_box_is_centred_is_found_to_within_its_sigma(run):
    drive = roadside_drive(5, duration_s=40.0, ghosts=False)
    true = drive.rig.p_veh_box_m
    drive = replace(drive, rig=replace(drive.rig, p_veh_box_m=true - [0.6, 0.0, 0.0]))
    told = run(drive, detections={"offset_sigma_m": 1.0}).summary["box_offset_m"]
    assert abs(told["value"][0] - 0.6) < 3 * told["sigma"][0] < 0.6


@pytest.mark.parametrize("late_s", [0.12, -0.2])
def test_how_late_a_nodes_stamps_are_is_estimated(run, late_s):
    drive = roadside_drive(5, duration_s=40.0, ghosts=False)
    seen = drive.tables["detections"]
    shifted = seen.t_ns + round(late_s * 1e9)
    drive = drive.with_tables(detections=replace(seen, t_ns=shifted, received_ns=shifted))
    clock = run(drive, clock={"estimate": "nodes"}).summary["clock"]["nodes"]
    assert clock["observable"]
    assert abs(clock["late_s"] - late_s) < 3 * clock["sigma_s"] + 0.005


def test_rows_that_cannot_be_the_car_cost_no_state(run, drive):
    seen = drive.tables["detections"]
    walking = replace(seen, kind=np.full(len(seen), 2))
    result = run(drive.with_tables(detections=walking))
    assert result.summary["counts"]["detections"] == {"other object": len(seen)}
    assert result.summary["states"] == run(drive, detections={"use": False}).summary["states"]


def test_frames_without_candidates_are_no_fault(run, drive):
    seen = drive.tables["detections"]
    none = np.full((1, 2, 2), np.nan)
    far = NodeDetections(seen.t_ns[:1], seen.t_ns[:1], [0], [1], [1], [[1e4, 0]], none)
    result = run(drive.with_tables(detections=far))
    assert result.summary["counts"]["detections"] == {"outside": 1}
    assert result.summary["nodes"]["pole"]["car_seen"] == 0
