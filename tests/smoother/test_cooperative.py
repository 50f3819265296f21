"""The cooperative graph: against the filter that is exact, surveys, latency, births and deaths."""

import dataclasses

import numpy as np
import pytest

import fgloc
from fgloc import baselines
from fgloc.api import doctor
from fgloc.baselines.joint import Belief, of_node
from fgloc.correspondence.epochs import Epoch
from fgloc.correspondence.tracks import track_objects
from fgloc.datasets import make
from fgloc.datasets.city import make_city
from fgloc.errors import DriveError, InputError
from fgloc.evaluation.objects import errors_by_object
from fgloc.infrastructure import Infrastructure, Node, Post
from fgloc.smoother import is_cooperative
from fgloc.smoother.cooperative_graph import Grown
from fgloc.smoother.cooperative_lag import Window
from fgloc.smoother.cooperative_model import DEATH_S, Roster, motion
from fgloc.verdicts import Verdict

NAMES = ("one-node", "two-nodes", "acceleration", "correspondence", "intersection")


def scenario(name, seed=0, **options):
    return make(f"khamooshi2023/{name}", seed, **options)


def errors_m(result, drive):
    e = result.trajectory.p_world_m - drive.truth.at(result.trajectory.t_ns).p_world_m
    return e[:, :2]


def rmse_m(result, drive):
    return float(np.sqrt((errors_m(result, drive) ** 2).sum(-1).mean()))


def surveyed(drive, **more):
    """The same drive with nodes whose survey is uncertain."""
    nodes = tuple(dataclasses.replace(node, **more) for node in drive.infrastructure.nodes)
    return dataclasses.replace(drive, infrastructure=Infrastructure(nodes))


def test_drives_of_several_road_users_are_told_from_drives_of_one_car():
    assert all(is_cooperative(scenario(name)) for name in NAMES)
    assert is_cooperative(scenario("one-node", onboard=False))
    assert not is_cooperative(make_city(0, 2.0))
    assert not is_cooperative(make("khamooshi2023/constant-velocity"))


def test_of_nodes_alone_the_filtered_graph_is_the_kalman_filter():
    drive = scenario("two-nodes", 1, onboard=False)
    found = track_objects(drive, "test")
    belief, last_ns, means, covs = Belief.unborn(found.tracks), found.epochs[0].t_ns, [], []
    at = slice(4 * found.ego, 4 * found.ego + 2)
    for epoch in found.epochs:
        belief = belief.predicted((epoch.t_ns - last_ns) / 1e9)
        belief = belief.updated(of_node(epoch, 0, 2) + of_node(epoch, 1, 2))
        last_ns = epoch.t_ns
        means.append(belief.x[at])
        covs.append(belief.P[at, at])
    result = fgloc.smooth(drive, mode="incremental")
    assert result.trajectory.p_world_m[:, :2] == pytest.approx(np.array(means), abs=1e-3)
    assert result.trajectory.cov[:, :2, :2] == pytest.approx(np.array(covs), abs=1e-4)


def test_the_last_state_is_the_same_filtered_and_smoothed():
    drive = scenario("two-nodes", 2, onboard=False)
    whole, grown = (fgloc.smooth(drive, mode=mode) for mode in ("batch", "incremental"))
    assert whole.trajectory.p_world_m[-1] == pytest.approx(grown.trajectory.p_world_m[-1], abs=1e-5)
    assert whole.trajectory.cov[-1, :2, :2] == pytest.approx(
        grown.trajectory.cov[-1, :2, :2], abs=1e-6
    )


@pytest.mark.parametrize("name", NAMES)
def test_the_filtered_graph_is_as_good_as_consensus_and_the_smoothed_one_better(name):
    squares = []
    for seed in range(4):
        drive = scenario(name, seed)
        results = [baselines.run(drive, "khamooshi2023-kcf"), fgloc.smooth(drive, "fixed-lag"),
                   fgloc.smooth(drive, "batch")]  # fmt: skip
        squares.append([rmse_m(result, drive) ** 2 for result in results])
    kcf, lag, batch = np.sqrt(np.mean(squares, 0))
    assert lag < 1.05 * kcf
    assert batch < 0.7 * kcf


def test_claimed_covariances_hold_where_the_model_does():
    z, yaw = [], []
    for seed in range(6):
        drive = scenario("intersection", seed)
        result = fgloc.smooth(drive, mode="batch")
        e, cov = errors_m(result, drive), result.trajectory.cov
        z.append(np.einsum("ni,nij,nj->n", e, np.linalg.inv(cov[:, :2, :2]), e).mean() / 2)
        off = np.angle(np.exp(1j * (result.trajectory.yaw_rad - drive.truth.yaw_rad)))
        yaw.append((off**2 / cov[:, 5, 5]).mean())
    assert 0.3 < np.mean(z) < 1.2  # the noise on acceleration is wide: they stop, not more
    assert 0.2 < np.mean(yaw) < 1.6


def test_the_hidden_car_is_followed_and_its_covariance_stays_small():
    drive = scenario("intersection", 1)
    own = drive.tables["relative"]
    hidden = np.setdiff1d(drive.truth.t_ns, own.t_ns[own.kind == 1])
    t_ns, e, cov = errors_by_object(fgloc.smooth(drive, "fixed-lag").objects, drive.objects)[1]
    rows = np.isin(t_ns, hidden)
    assert rows.sum() == len(hidden) > 3
    assert np.linalg.norm(e[rows], axis=-1).max() < 0.5
    assert cov[rows, 0, 0].max() < 0.15


def test_an_error_of_the_survey_is_found_by_its_variable():
    drive = scenario("two-nodes", 3)
    off = np.array([1.5, -1.0, 0.0])
    first, second = drive.infrastructure.nodes
    wrong = dataclasses.replace(first, p_world_m=first.p_world_m + off, sigma_position_m=2.0)
    moved = dataclasses.replace(drive, infrastructure=Infrastructure((wrong, second)))
    blind = dataclasses.replace(wrong, sigma_position_m=0.0)
    trusting = dataclasses.replace(drive, infrastructure=Infrastructure((blind, second)))
    result = fgloc.smooth(moved, mode="batch")
    assert result.summary["survey"]["node-1"][:2] == pytest.approx(off[:2], abs=0.4)
    assert rmse_m(result, drive) < 0.6 * rmse_m(fgloc.smooth(trusting, mode="batch"), drive)


def test_a_survey_turned_by_a_degree_is_found_by_its_variable():
    drive = scenario("two-nodes", 4)
    first, second = drive.infrastructure.nodes
    wrong = dataclasses.replace(first, yaw_rad=0.03, sigma_yaw_rad=0.05)
    moved = dataclasses.replace(drive, infrastructure=Infrastructure((wrong, second)))
    found = fgloc.smooth(moved, mode="batch").summary["survey"]["node-1"]
    assert found[2] == pytest.approx(0.03, abs=0.015)


def test_certain_surveys_have_no_variables():
    assert fgloc.smooth(scenario("one-node"), "batch").summary["survey"] == {}


def test_late_sightings_enter_at_their_own_instant_and_too_late_ones_are_told():
    punctual, late = scenario("two-nodes", 0), scenario("two-nodes", 0, latency_s=0.3)
    a, b = (fgloc.smooth(drive, "fixed-lag") for drive in (punctual, late))
    assert rmse_m(a, punctual) < rmse_m(b, late)
    assert b.verdicts["detections"].counts()[Verdict.LATE] == 2 * 2 * 3  # the last three instants
    tight = fgloc.smooth(late, "fixed-lag", lag_s=0.2)
    assert tight.verdicts["detections"].is_(Verdict.LATE).all()


@pytest.mark.parametrize("mode", ["batch", "fixed-lag"])
def test_all_measurements_are_judged_and_all_road_users_told(mode):
    drive = scenario("correspondence", 1)
    result = fgloc.smooth(drive, mode=mode)
    for name, table in drive.tables.items():
        assert sum(result.verdicts[name].counts().values()) == len(table)
    assert len(np.unique(result.objects.track_id)) == 4
    assert result.causal == (mode != "batch")
    assert result.method == ("graph-batch" if mode == "batch" else "graph-lag")


def test_numbers_that_a_node_mixes_up_for_a_moment_are_put_right_by_the_batch():
    drive = scenario("intersection", 2)
    seen = drive.tables["detections"]
    mixed = (seen.t_ns == drive.start_ns + 3_000_000_000) & (seen.kind == 1)
    number = seen.object_id.copy()
    number[mixed] = number[mixed][::-1]
    wrong = drive.with_tables(detections=dataclasses.replace(seen, object_id=number))
    right, put_right = (fgloc.smooth(d, mode="batch") for d in (drive, wrong))
    assert put_right.trajectory.p_world_m == pytest.approx(right.trajectory.p_world_m, abs=0.02)
    filtered = fgloc.smooth(wrong, mode="fixed-lag")
    assert np.abs(errors_m(filtered, drive)).max() > 1


def epoch(t_ns, *places):
    n = len(places)
    return Epoch(
        t_ns, np.zeros(n, np.int64), np.arange(n), np.array(places).reshape(-1, 2),
        np.tile(0.04 * np.eye(2), (n, 1, 1)), np.arange(n), np.full(n, t_ns),
    )  # fmt: skip


GROWING = {"whole": Grown, "lag": lambda roster: Window(roster, 5.0)}


@pytest.mark.parametrize("kind", GROWING)
def test_a_track_ends_where_nobody_sees_it_and_another_begins(kind):
    graph = GROWING[kind](Roster(0, (Node("n", np.zeros(3)),)))
    seen = [epoch(0, (0, 0), (5, 5)), *(epoch(int(1e9 * t), (0, 0)) for t in (1, 2, 3, 4, 5, 6)),
            epoch(int(7e9), (0, 0), (90, 90))]  # fmt: skip
    alive = []
    for k, one in enumerate(seen):
        graph.update(one, np.nan, {k: np.arange(len(one.track))})
        alive.append(1 in graph.tracks)
    assert alive == [True, *(t <= DEATH_S for t in (1, 2, 3, 4, 5, 6)), True]
    assert graph.states([1])[0][0, :2] == pytest.approx([90, 90], abs=1e-2)


def test_the_noise_of_the_motion_adds_up_over_half_steps():
    F, Q = motion(0.1)
    half_F, half = motion(0.05)
    assert half_F @ half @ half_F.T + half == pytest.approx(Q)
    assert half_F @ half_F == pytest.approx(F)
    assert F[0, 2] == 0.1


def test_smoothed_is_refused_rather_than_left_out():
    with pytest.raises(InputError, match="use the mode batch"):
        fgloc.smooth(scenario("one-node"), "fixed-lag", smoothed=True)


@pytest.mark.parametrize("name", NAMES)
def test_doctor_has_no_complaint_of_several_objects_at_an_instant(name):
    findings = doctor(scenario(name))
    assert [f.check for f in findings if f.severity == "fault" or f.check == "duplicate"] == []


def test_a_car_that_is_never_found_is_told():
    drive = scenario("one-node")
    tables = {name: table for name, table in drive.tables.items() if name != "gnss"}
    with pytest.raises(DriveError, match="the car is never found among what the nodes see"):
        fgloc.smooth(dataclasses.replace(drive, tables=tables), "batch")


def test_a_post_that_this_graph_does_not_follow_is_told():
    drive = scenario("two-nodes")
    name = drive.infrastructure.nodes[0].name
    post = Post(name, 10.0, 1.97, 0.05, 20.1, 0.138, 90.0, 0.7)
    stood = dataclasses.replace(
        drive, infrastructure=dataclasses.replace(drive.infrastructure, posts=(post,))
    )
    told = [event.text for event in fgloc.smooth(stood, "fixed-lag").events]
    assert any("posts to stand still" in text and name in text for text in told)
    assert not any("posts" in e.text for e in fgloc.smooth(drive, "fixed-lag").events)
