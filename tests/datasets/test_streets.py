"""Simulated streets: the same of one seed, the drive's own pass, roads that keep their rules."""

from dataclasses import replace

import numpy as np
import pytest

from fgloc.datasets import lee2021_road
from fgloc.datasets.lee2021 import P_VEH_BOX_M, cases, make_lee2021_mcity
from fgloc.datasets.simulator import instants
from fgloc.datasets.street_recording import record
from fgloc.datasets.streets import (
    CAR_ID,
    FOLLOWER_ID,
    ORIGIN,
    START_NS,
    make_mcity_street,
    make_street,
    mcity_street,
    plain_street,
)
from fgloc.errors import InputError
from fgloc.measurements import PEDESTRIAN, VEHICLE
from fgloc.perception.paper_nodes import khamooshi2023_node, lee2021_node
from fgloc.timing import elapsed_s


def small_node(survey):
    """Lee's, with images of 96 x 60."""
    node = lee2021_node(survey)
    heads = tuple(
        replace(head, cameras=tuple(
            replace(one, size_px=(96, 60), focal_px=one.focal_px / 20,
                    principal_px=(one.principal_px + 0.5) / 20 - 0.5)
            for one in head.cameras))
        for head in node.heads
    )  # fmt: skip
    return replace(node, heads=heads)


def test_frames_are_those_of_the_seed_in_whatever_order_they_are_asked_for():
    first, again = (make_street(4, 2.0, make_node=small_node) for _ in range(2))
    backwards = [again.image(1, frame) for frame in (9, 3)][::-1]
    for frame, image in zip((3, 9), backwards, strict=True):
        np.testing.assert_array_equal(first.image(1, frame), image)
    np.testing.assert_array_equal(first.cloud(0, 5), again.cloud(0, 5))
    other = make_street(5, 2.0, make_node=small_node)
    assert not np.array_equal(first.image(1, 3), other.image(1, 3))
    assert not np.array_equal(first.image(0, 3), first.image(1, 3))


def test_frames_are_at_10_hz_and_late_by_the_stated_latency():
    made = make_street(0, 2.0)
    for frames in (*made.images, *made.clouds):
        np.testing.assert_allclose(elapsed_s(frames.t_ns, START_NS), np.arange(21) / 10)
        assert set((frames.received_ns - frames.t_ns).tolist()) == {100_000_000}
    assert set(made.objects.t_ns.tolist()) == set(made.images[0].t_ns.tolist())


def test_nobody_runs_into_another_and_all_reach_the_nodes_view():
    street = plain_street(1, 10.0)
    kinds = [mover.kind for mover in street.movers]
    assert {VEHICLE, PEDESTRIAN} == set(kinds)
    assert len({mover.object_id for mover in street.movers}) == len(kinds)
    distances = []
    for t_ns in instants(START_NS, 10.0, 2).tolist():
        solids, there = street.solids(t_ns), street.there(t_ns)
        plan_m = solids.centre_m[len(street.fixed) :, :2]
        apart = np.linalg.norm(plan_m[:, None] - plan_m, axis=-1) + 99 * np.eye(len(plan_m))
        cars = np.array([mover.kind == VEHICLE for mover in there])
        assert apart[cars][:, cars].min() > 4.0  # side by side in two lanes
        distances += np.linalg.norm(plan_m[cars], axis=-1).tolist()
    assert min(distances) < 10
    assert max(distances) > 80


def test_a_swaying_node_moves_by_the_stated_amplitude_and_tips_with_it():
    street = plain_street(2, 5.0, sway_m=0.1)
    poses = [street.pose(int(t)) for t in instants(START_NS, 5.0, 50)]
    moved = np.array([p for _, p in poses])
    np.testing.assert_allclose(np.abs(moved).max(0), [0.1, 0.1, 0.0], atol=0.003)
    for R, p in poses[::20]:  # a tip that goes ahead looks down
        assert np.sign(-R[2, 0]) == np.sign(p[0]) or abs(p[0]) < 1e-3


def test_both_nodes_of_the_papers_watch_the_street():
    for make in (lee2021_node, khamooshi2023_node):
        made = make_street(0, 1.0, make_node=make)
        assert len(made.images) == 2
        assert len(made.cloud(0, 0)) > 10_000


def test_the_second_pass_is_the_drives_own():
    street, t_ns = mcity_street()
    drive = make_lee2021_mcity(seed=0, errors="model")
    assert np.isin(t_ns, drive.gnss.t_ns).all()
    begin_s, end_s = cases()[1].covered_s
    span_s = elapsed_s(t_ns[[0, -1]], lee2021_road.START_NS)
    np.testing.assert_allclose(span_s, [begin_s - 4, end_s + 4], atol=0.06)
    truth = street.truth(t_ns)
    car = truth.take(truth.object_id == CAR_ID)
    at = np.searchsorted(drive.truth.t_ns, t_ns)
    box_m = drive.truth.p_world_m[at] + drive.truth.R_world_veh[at] @ np.array(P_VEH_BOX_M)
    np.testing.assert_allclose(car.p_world_m, box_m[:, :2], atol=1e-6)
    follower = truth.take(truth.object_id == FOLLOWER_ID)
    np.testing.assert_allclose(follower.p_world_m[20:], car.p_world_m[:-20], atol=1e-6)


def test_the_lorry_hides_the_car_where_the_scenario_says_so_and_the_tunnel_does_not():
    made = make_mcity_street()
    street, t_ns = mcity_street()
    east_m = made.objects.take(made.objects.object_id == CAR_ID).p_world_m[:, 0]
    east_m = east_m - street.node.node.p_world_m[0]
    for place_m, head in ((10.0, 0), (-17.0, 1)):
        frame = int(np.argmin(np.abs(east_m - place_m)))
        box_m = street.solids(int(t_ns[frame])).corners_m()[len(street.fixed)]
        clouds = [made.cloud(head, frame) for head in (0, 1)]
        low, high = box_m.min(0) - 0.1, box_m.max(0) + 0.1
        inside = [((cloud > low) & (cloud < high) & (cloud[:, 2:] > low[2] + 0.3)).all(-1).sum()
                  for cloud in clouds]  # fmt: skip
        assert (max(inside) > 100) == (place_m < 0), (place_m, inside)


def test_impossible_streets_are_refused():
    with pytest.raises(InputError, match="seed = -1"):
        make_street(-1)
    with pytest.raises(InputError, match="duration_s = 0"):
        plain_street(0, 0)
    with pytest.raises(InputError, match="latency_s = -1"):
        record("s", plain_street(0, 1.0), ORIGIN, instants(START_NS, 1.0, 10), 0, -1)
