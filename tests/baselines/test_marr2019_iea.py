"""The filter of Marr (2019) for roadside cameras: printed weights, and why not as printed."""

import numpy as np
import pytest

from fgloc.baselines import run as run_method
from fgloc.baselines.dead_reckoning import DeadReckoning
from fgloc.baselines.marr2019_iea import MARR2019_IEA, Marr2019Iea, blend, run, track
from fgloc.baselines.marr2019_sources import Positions
from fgloc.datasets.registry import make
from fgloc.drive import Drive, Rig
from fgloc.errors import DriveError
from fgloc.frames import Origin
from fgloc.infrastructure import Infrastructure, Node
from fgloc.measurements import PEDESTRIAN, VEHICLE, EnuVelocities, GnssFixes, NodeDetections
from fgloc.timing import NS_PER_S

VELOCITY = np.array([3.0, -10.0, 0.0])


def drive(gnss_s=(0.0, 1, 2, 3), seen_s=(1.55, 1.65), late_s=0.0, seen_m=(0.0, 0.0)) -> Drive:
    """A car that goes straight from (0, 0), with exact fixes, and detections off by `seen_m`."""
    t_ns = np.arange(0, 4 * NS_PER_S, NS_PER_S // 50)
    velocity = EnuVelocities(t_ns, t_ns, np.tile(VELOCITY, (len(t_ns), 1)), np.full(len(t_ns), 0.1))
    at_ns, seen_ns = (np.rint(np.array(s) * 1e9).astype(np.int64) for s in (gnss_s, seen_s))
    fixes = GnssFixes(
        at_ns, at_ns, np.outer(gnss_s, VELOCITY) + [0, 0, 7],
        np.tile(np.eye(3), (len(at_ns), 1, 1)), np.full((len(at_ns), 3), np.nan),
    )  # fmt: skip
    node = Node("post", np.array([5.0, -20, 10]), 0.4)
    n = len(seen_ns)
    seen = NodeDetections(
        seen_ns, seen_ns + int(late_s * 1e9), np.zeros_like(seen_ns), np.ones_like(seen_ns),
        np.full(n, VEHICLE), node.from_world(np.outer(seen_s, VELOCITY[:2]) + seen_m),
        np.full((n, 2, 2), np.nan),
    )  # fmt: skip
    tables = {"gnss": fixes, "velocity": velocity, "detections": seen}
    return Drive("straight", Origin(30, -96, 0), Rig(), tables,
                 infrastructure=Infrastructure((node,)))  # fmt: skip


def at(t_s, p_m) -> Positions:
    ns = np.array([int(t_s * 1e9)])
    return Positions("gnss", np.array([0]), ns, ns, np.array([p_m], float))


def test_blend_and_gain_are_the_printed_ones_of_ages_by_hand():
    now_ns = np.array([2 * NS_PER_S])
    still = DeadReckoning(np.array([0]), np.zeros((1, 2)), np.zeros((1, 2)), np.array([0]))
    measured, gain = blend(now_ns, at(1.5, [1, 0]), at(1.9, [0, 1]), still, MARR2019_IEA)
    beta = np.exp(-0.5) / (np.exp(-0.5) + 20 * np.exp(-0.1))
    assert beta == pytest.approx(0.03243, abs=1e-5)
    np.testing.assert_allclose(measured, [[beta, 1 - beta]])
    assert gain[0] == pytest.approx(0.005 * np.exp(-0.1))


def test_each_source_is_carried_forward_by_its_own_age():
    now_ns = np.array([2 * NS_PER_S])
    moving = DeadReckoning(np.array([0]), np.array([[10.0, 0]]), np.zeros((1, 2)), np.array([0]))
    measured, _ = blend(now_ns, at(1.5, [15, 0]), at(1.9, [19, 0]), moving, MARR2019_IEA)
    np.testing.assert_allclose(measured, [[20, 0]])


def test_as_printed_4_3_diverges_and_as_read_it_settles():
    travel, measured = np.zeros((31, 2)), np.zeros((31, 2))
    gain = np.full(31, 0.005)
    literal = 0.5
    for k in range(30):
        literal = literal - (1 - gain[k]) * (0.0 - literal)  # x - lambda_1 (x_m - x), x_m = 0
    assert literal > 1e8
    measured[0] = 0.5
    as_read = track(travel, measured, gain)
    assert as_read[-1, 0] == pytest.approx(0.5 * 0.995**30)


def test_a_straight_drive_without_errors_is_followed_exactly():
    result = run(drive())
    true = (result.trajectory.t_ns / 1e9)[:, None] * VELOCITY[:2]
    np.testing.assert_allclose(result.trajectory.p_world_m[:, :2], true, atol=1e-9)
    np.testing.assert_allclose(result.trajectory.p_world_m[:, 2], 7)


def test_late_detections_are_carried_from_when_they_were_true():
    result = run(drive(late_s=0.4))
    true = (result.trajectory.t_ns / 1e9)[:, None] * VELOCITY[:2]
    np.testing.assert_allclose(result.trajectory.p_world_m[:, :2], true, atol=1e-9)


def test_nothing_is_known_of_a_detection_before_it_comes_in():
    early = run(drive(late_s=0.4, seen_m=(5.0, 0.0)))
    t_s = early.trajectory.t_ns / 1e9
    off = np.linalg.norm(early.trajectory.p_world_m[:, :2] - t_s[:, None] * VELOCITY[:2], axis=1)
    assert off[t_s < 1.94].max() < 1e-9
    assert off[t_s > 2.0].min() > 0.01


def test_at_100_steps_a_second_a_start_is_forgotten_over_two_seconds():
    rates = [
        run(drive(gnss_s=(0.0,), seen_s=np.arange(0.005, 3.9, 0.01), seen_m=(1.0, 0.0)),
            Marr2019Iea(step_hz=hz)).trajectory
        for hz in (100.0, 10.0)
    ]  # fmt: skip
    left = [1 - (p.p_world_m[:, 0] - p.t_ns / 1e9 * 3)[p.t_ns <= 2 * NS_PER_S][-1] for p in rates]
    assert left[0] == pytest.approx(np.exp(-1), abs=0.02)
    assert left[1] == pytest.approx(np.exp(-0.1), abs=0.02)


def test_every_row_has_a_verdict():
    one = drive(gnss_s=(0.0, 1.001, 1.002, 2), seen_s=(0.5, 1.5))
    seen = one.tables["detections"]
    on_foot = NodeDetections(
        seen.t_ns, seen.received_ns, seen.node, seen.object_id, [PEDESTRIAN, VEHICLE],
        seen.p_node_m, seen.cov_node_m2,
    )  # fmt: skip
    counts = run(one.with_tables(detections=on_foot)).summary["counts"]
    assert counts["gnss"] == {"used": 3, "unused": 1}
    assert counts["detections"] == {"used": 1, "unused": 1}
    assert counts["velocity"] == {"used": 200}


@pytest.mark.parametrize(
    ("without", "says"),
    [(("velocity",), "no velocity table; marr2019-iea needs"),
     (("gnss", "detections"), "neither fixes nor detections")],
)  # fmt: skip
def test_what_a_drive_lacks_is_named(without, says):
    whole = drive()
    tables = {name: table for name, table in whole.tables.items() if name not in without}
    with pytest.raises(DriveError, match=says):
        run(Drive("bare", whole.origin, Rig(), tables, infrastructure=whole.infrastructure))


@pytest.mark.parametrize("without", ["gnss", "detections"])
def test_one_source_is_enough(without):
    whole = drive()
    tables = {name: table for name, table in whole.tables.items() if name != without}
    result = run(Drive("bare", whole.origin, Rig(), tables, infrastructure=whole.infrastructure))
    true = (result.trajectory.t_ns / 1e9)[:, None] * VELOCITY[:2]
    np.testing.assert_allclose(result.trajectory.p_world_m[:, :2], true, atol=1e-9)


def test_on_the_scenario_it_is_better_than_gps_and_settles_within_metres():
    drives = [make("marr2019/iea", seed) for seed in range(4)]
    gps, slow, quick = (
        np.mean([mean_error_m(d, run_method(d, method)) for d in drives])
        for method in ("raw:gnss", "marr2019-iea:10hz", "marr2019-iea")
    )
    assert quick < 0.6 * gps
    assert quick < 0.6 * slow


def mean_error_m(drive, result) -> float:
    told = result.trajectory
    true = drive.truth.at_point(drive.rig.p_veh_ant_m).at(told.t_ns).p_world_m
    return float(np.linalg.norm((told.p_world_m - true)[:, :2], axis=1).mean())
