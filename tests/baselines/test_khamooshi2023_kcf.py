"""Consensus filter and covariance intersection: their algebra, packets, stability, scenarios."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fgloc import baselines
from fgloc.baselines import consensus, joint
from fgloc.baselines.covariance_intersection import intersection
from fgloc.baselines.khamooshi2023_kcf import Sources, run_sources
from fgloc.baselines.packets import Network, Packet
from fgloc.correspondence.tracks import track_objects
from fgloc.datasets import make
from fgloc.errors import DriveError, InputError
from fgloc.evaluation.objects import errors_by_object
from fgloc.verdicts import Verdict

NAMES = ("one-node", "two-nodes", "acceleration", "correspondence", "intersection")
METHODS = ("khamooshi2023-kcf", "khamooshi2023-kcf:nodes", "khamooshi2023-kcf:onboard",
           "covariance-intersection")  # fmt: skip


def scenario(name, seed=0, **options):
    return make(f"khamooshi2023/{name}", seed, **options)


def ego_rmse_m(result, drive):
    e = result.trajectory.p_world_m - drive.truth.at(result.trajectory.t_ns).p_world_m
    return float(np.sqrt((e[:, :2] ** 2).sum(-1).mean()))


def packet():
    return Packet(3, 12, np.array([7, 9]), np.ones((2, 4)), np.tile(np.eye(4), (2, 1, 1)),
                  np.arange(8.0).reshape(2, 4))  # fmt: skip


def test_a_packet_comes_back_from_its_bytes():
    data = packet().encode()
    back = Packet.decode(data)
    assert len(data) == 16 + 2 * 200
    assert (back.node, back.t_ns, list(back.name)) == (3, 12, [7, 9])
    assert all(np.array_equal(getattr(back, f), getattr(packet(), f)) for f in ("u", "U", "x_bar"))


@given(st.binary(max_size=500))
def test_bytes_that_are_no_packet_are_refused(data):
    with pytest.raises(InputError, match="packet"):
        Packet.decode(data)


def test_a_packet_that_is_cut_short_is_refused():
    with pytest.raises(InputError, match="has 416 bytes, not 415"):
        Packet.decode(packet().encode()[:-1])


def test_the_network_gives_what_has_arrived_in_the_order_of_arrival():
    network = Network()
    network.send(b"late", 30)
    network.send(b"soon", 10)
    assert network.receive(5) == []
    assert network.receive(30) == [b"soon", b"late"]
    assert network.receive(99) == []


def test_the_information_form_is_the_kalman_update():
    rng = np.random.default_rng(0)
    A = rng.normal(size=(4, 4))
    P, H, R = A @ A.T + np.eye(4), rng.normal(size=(2, 4)), np.diag([0.5, 2.0])
    x, z, born = rng.normal(size=4), rng.normal(size=2), np.ones(1, bool)
    W = np.linalg.inv(R)
    got = joint.Belief(x, P, born).updated(joint.Information(H.T @ W @ z, H.T @ W @ H, born))
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    assert got.x == pytest.approx(x + K @ (z - H @ x))
    assert np.allclose(got.P, (np.eye(4) - K @ H) @ P)


def test_the_process_noise_is_exact_over_a_step():
    F, Q = joint.model(0.1, 2)
    half_F, half_Q = joint.model(0.05, 2)
    assert half_F @ half_F == pytest.approx(F)
    assert half_F @ half_Q @ half_F.T + half_Q == pytest.approx(Q)
    assert np.diag(Q)[2] == pytest.approx(joint.ACCEL_DENSITY**2 * 0.1)


def test_gamma_takes_the_frobenius_norm():
    assert consensus.gamma(np.diag([3.0, 4.0]), 0.1) == pytest.approx(0.1 / 6)


def test_positions_observe_velocities_and_nothing_observes_nothing():
    F, _ = joint.model(0.1, 1)
    assert consensus.rank_of(np.diag([1.0, 1, 0, 0]), F) == 4
    assert consensus.rank_of(np.diag([1.0, 0, 0, 0]), F) == 2
    assert consensus.rank_of(np.zeros((4, 4)), F) == 0


def test_the_laplacian_of_a_star_sums_to_nothing():
    L = consensus.star(3)
    assert L.sum(0) == pytest.approx(0)
    assert np.linalg.eigvalsh(L) == pytest.approx([0, 1, 3], abs=1e-12)


def test_the_bound_shrinks_as_one_over_the_covariance():
    born = np.ones(1, bool)
    seen = joint.Information(np.zeros(4), np.diag([4.0, 4, 0, 0]), born)
    agents = [(joint.Belief(np.zeros(4), np.eye(4), born), seen)] * 2
    bound = consensus.gamma_star(agents, 0.1, consensus.star(2))
    assert 0 < bound < 1
    wide = [(joint.Belief(np.zeros(4), 100 * np.eye(4), born), seen)] * 2
    assert consensus.gamma_star(wide, 0.1, consensus.star(2)) < bound / 10
    strangers = [agents[0], (joint.Belief.unborn(1), seen)]
    assert np.isnan(consensus.gamma_star(strangers, 0.1, consensus.star(2)))


@pytest.mark.parametrize("correlation", [-0.99, 0.0, 0.5, 0.99])
def test_the_intersection_never_claims_too_much(correlation):
    P1, P2 = np.diag([1.0, 9.0]), np.diag([9.0, 1.0])
    x, P = intersection(np.zeros(2), P1, np.ones(2), P2)
    I1, I2 = np.linalg.inv(P1), np.linalg.inv(P2)
    w = np.linalg.solve(I1 - I2, np.linalg.inv(P) - I2)[0, 0]
    gain = [P @ I1 * w, P @ I2 * (1 - w)]
    cross = correlation * np.sqrt(P1) @ np.sqrt(P2)
    truth = (gain[0] @ P1 @ gain[0].T + gain[1] @ P2 @ gain[1].T
             + gain[0] @ cross @ gain[1].T + gain[1] @ cross.T @ gain[0].T)  # fmt: skip
    assert np.linalg.eigvalsh(P - truth).min() > -1e-9
    assert x == pytest.approx([0.1, 0.9])


@pytest.mark.parametrize("name", NAMES)
def test_numbers_of_nodes_and_car_become_one_track_for_each_object(name):
    drive = scenario(name, 1)
    found = track_objects(drive, "test")
    assert found.tracks == 1 + len(np.unique(drive.objects.object_id))
    for epoch, truth in zip(found.epochs, drive.truth.p_world_m[:, :2], strict=True):
        own = epoch.z_m[epoch.track == found.ego]
        assert (np.linalg.norm(own - truth, axis=-1) < 5).all()
    yaw = np.array([epoch.yaw_rad for epoch in found.epochs]) - drive.truth.yaw_rad
    z = np.angle(np.exp(1j * yaw)) / np.sqrt([epoch.yaw_var for epoch in found.epochs])
    assert np.nanmean(z**2) == pytest.approx(1.0, abs=0.7)


def test_an_object_keeps_its_track_when_the_node_gives_it_another_number():
    drive = scenario("intersection", 1)
    seen = drive.tables["detections"]
    half = seen.t_ns > drive.start_ns + 5_000_000_000
    other = dataclasses.replace(seen, object_id=np.where(half, seen.object_id + 40, seen.object_id))
    found = track_objects(drive.with_tables(detections=other), "test")
    assert found.tracks == 3


def test_two_objects_of_one_node_are_never_one_track():
    drive = scenario("two-nodes", 0)
    for epoch in track_objects(drive, "test").epochs:
        for node in (0, 1):
            mine = epoch.track[epoch.node == node]
            assert len(np.unique(mine)) == len(mine)


def test_fusing_is_better_than_either_alone():
    better = []
    for seed in range(6):
        drive = scenario("two-nodes", seed)
        rmse = [ego_rmse_m(baselines.run(drive, method), drive) for method in METHODS[:3]]
        better.append(rmse[0] < min(rmse[1:]))
    assert sum(better) >= 5


@pytest.mark.parametrize("method", METHODS)
def test_each_method_judges_all_and_follows_the_others(method):
    drive = scenario("intersection", 2)
    result = baselines.run(drive, method) if "onboard" not in method else run_sources(
        scenario("one-node", 2), Sources(nodes=()), method)  # fmt: skip
    drive = drive if "onboard" not in method else scenario("one-node", 2)
    for name, table in drive.tables.items():
        assert sum(result.verdicts[name].counts().values()) == len(table)
    by_object = errors_by_object(result.objects, drive.objects)
    rmse = [np.sqrt((e**2).sum(-1).mean()) for _, e, _ in by_object.values()]
    assert len(rmse) == len(np.unique(drive.objects.object_id))
    assert max(rmse) < (4.0 if "onboard" in method else 0.5)


def test_a_hidden_object_is_followed_by_what_the_node_sees():
    drive = scenario("intersection", 0)
    own = drive.tables["relative"]
    car_seen = np.unique(own.t_ns[own.kind == 1])
    hidden = np.setdiff1d(drive.truth.t_ns, car_seen)
    t_ns, e, _ = errors_by_object(
        baselines.run(drive, "khamooshi2023-kcf").objects, drive.objects
    )[1]  # fmt: skip
    step = (hidden - drive.start_ns) // 100_000_000
    assert step.min() == pytest.approx(60, abs=3) and len(hidden) > 3
    assert np.linalg.norm(e[np.isin(t_ns, hidden)], axis=-1).max() < 0.5


def test_a_drive_from_nodes_alone_runs():
    drive = scenario("two-nodes", 0, onboard=False)
    assert set(drive.tables) == {"detections"}
    assert ego_rmse_m(baselines.run(drive, "khamooshi2023-kcf"), drive) < 0.6


def test_late_packets_are_put_where_they_belong_and_lost_ones_are_missed():
    punctual, late = scenario("two-nodes", 0), scenario("two-nodes", 0, latency_s=0.25)
    a, b = (run_sources(drive, Sources()) for drive in (punctual, late))
    assert np.array_equal(
        late.tables["detections"].p_node_m, punctual.tables["detections"].p_node_m
    )
    assert ego_rmse_m(a, punctual) < ego_rmse_m(b, late)
    too_late = run_sources(scenario("two-nodes", 0, latency_s=1.5), Sources())
    counts = too_late.verdicts["detections"].counts()
    assert counts[Verdict.LATE] > 0 and too_late.summary["packets_late"] > 0
    lossy = scenario("two-nodes", 0, loss=0.5)
    assert run_sources(lossy, Sources()).summary["packets"] < 0.7 * a.summary["packets"]


def test_an_estimate_that_comes_late_is_moved_on_and_intersected_then():
    punctual, late = (scenario("one-node", 0, onboard=False, latency_s=s) for s in (0.0, 0.3))
    now, then = (baselines.run(d, "covariance-intersection") for d in (punctual, late))
    assert now.verdicts["detections"].is_(Verdict.USED).all()
    assert then.verdicts["detections"].counts()[Verdict.LATE] == 3  # the last three instants
    old, new = now.trajectory, then.trajectory
    n = len(new.t_ns)
    assert np.array_equal(new.t_ns, old.t_ns[:n] + 300_000_000)
    step = np.diff(new.p_world_m[:, :2], axis=0)
    assert np.linalg.norm(new.p_world_m[1:, :2] - old.p_world_m[1:n, :2], axis=1).mean() == (
        pytest.approx(3 * np.linalg.norm(step, axis=1).mean(), rel=0.3)  # three steps further on
    )
    assert (new.cov[:, 0, 0] > old.cov[:n, 0, 0]).all()


def test_the_summary_tells_of_stability_and_of_what_is_observable():
    summary = baselines.run(scenario("two-nodes", 0), "khamooshi2023-kcf").summary["consensus"]
    assert summary["gamma_star_min"] > 0 and 0 < summary["gamma_max"] < 0.1
    assert 0 <= summary["stable_share"] <= 1 and summary["observable_share"] == 1


def test_a_car_that_cannot_be_found_is_an_error():
    drive = scenario("one-node", 0)
    tables = {name: table for name, table in drive.tables.items() if name != "gnss"}
    with pytest.raises(DriveError, match="never found"):
        baselines.run(dataclasses.replace(drive, tables=tables), "khamooshi2023-kcf")
    with pytest.raises(DriveError, match="nothing that takes part places the car"):
        run_sources(scenario("correspondence", 0), Sources(car=False, nodes=()))


def test_without_fixes_the_car_alone_does_not_claim_to_know_where_anything_is():
    drive = scenario("correspondence", 5)
    alone = baselines.run(drive, "khamooshi2023-kcf:onboard")
    assert alone.trajectory.cov[:, 0, 0].min() > 100**2
    assert alone.objects.cov[:, 0, 0].min() > 100**2
    joined = baselines.run(drive, "covariance-intersection")
    rmse = [np.sqrt((e**2).sum(-1).mean()) for _, e, _ in
            errors_by_object(joined.objects, drive.objects).values()]  # fmt: skip
    assert max(rmse) < 0.8
