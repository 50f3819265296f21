"""The fixed lag of the cooperative graph: the same as the graph of everything, solved by QR."""

import dataclasses

import numpy as np
import pytest

from fgloc.correspondence.epochs import Epoch
from fgloc.correspondence.tracks import track_objects
from fgloc.datasets import make
from fgloc.drive import GnssBias
from fgloc.infrastructure import Infrastructure, Node
from fgloc.smoother.cooperative import run_online
from fgloc.smoother.cooperative_graph import Grown
from fgloc.smoother.cooperative_lag import Window
from fgloc.smoother.cooperative_model import Roster

STEP_NS, STEPS, USERS = 100_000_000, 60, 12
NODES = (
    Node("plain", np.array([0.0, 0, 8])),
    Node("uncertain", np.array([30.0, 0, 8]), sigma_position_m=0.3, sigma_yaw_rad=0.02),
    Node("slow", np.array([0.0, 30, 8]), sigma_position_m=0.1, bias_sigma_m=0.4, bias_tau_s=20.0),
)


def both(run):
    """What the graph of everything and that of a lag of 2 s find."""
    return run(Grown), run(lambda roster: Window(roster, 2.0))


@pytest.mark.parametrize("name", ["two-nodes", "correspondence", "intersection"])
@pytest.mark.parametrize("latency_s", [0.0, 0.3])
def test_the_newest_states_are_those_of_the_whole_graph(name, latency_s):
    drive = make(f"khamooshi2023/{name}", 1, latency_s=latency_s)
    nodes = tuple(
        dataclasses.replace(node, sigma_position_m=0.1, sigma_yaw_rad=0.01)
        for node in drive.infrastructure.nodes
    )
    unsure = dataclasses.replace(drive, infrastructure=Infrastructure(nodes))

    def run(graph):
        found = track_objects(unsure, "test")
        roster = Roster(found.ego, nodes, found.slow)
        states, _, survey = run_online(found, roster, graph(roster), 2.0)
        return states, [epoch.yaw_rad for epoch in found.epochs], survey

    (whole, yaws, survey), (lag, lag_yaws, lag_survey) = both(run)
    assert len(whole.track) >= 50
    assert np.array_equal(whole.track, lag.track)
    assert lag.state == pytest.approx(whole.state, abs=1e-6)
    assert lag.cov == pytest.approx(whole.cov, abs=1e-5, rel=1e-6)
    assert lag_yaws == pytest.approx(yaws, abs=1e-7, nan_ok=True)
    assert survey.keys() == lag_survey.keys()
    assert all(lag_survey[i] == pytest.approx(survey[i], abs=1e-6) for i in survey)


def crossing(seed):
    """Users on straight lines, seen by every node in turn, late by up to 0.5 s; 1 and 2 also by the
    car; 3 and 4 say where they are, and 5 is hidden for 4 s."""
    rng = np.random.default_rng(seed)
    start, v = rng.uniform(-40, 40, (USERS, 2)), rng.uniform(-9, 9, (USERS, 2))
    for k in range(STEPS):
        t_ns = k * STEP_NS
        place = start + v * t_ns / 1e9
        track = np.setdiff1d(np.arange(USERS), [5] if 10 <= k < 50 else [])
        node = (track + k // 7) % len(NODES)
        seen = np.array([1, 2] if k > 20 else [], np.int64)
        yield Epoch(
            t_ns, node, track, place[track] + 0.3 * rng.standard_normal((len(track), 2)),
            np.tile(0.09 * np.eye(2), (len(track), 1, 1)), track,
            t_ns + rng.integers(0, 5 * STEP_NS, len(track)),
            place[0] + rng.standard_normal(2) if k % 3 == 0 else None, np.eye(2), seen,
            place[seen] - place[0] + 0.2 * rng.standard_normal((len(seen), 2)),
            np.tile(0.04 * np.eye(2), (len(seen), 1, 1)), 0.05, 0.01,
            np.array([3, 4]), place[[3, 4]] + rng.standard_normal((2, 2)),
            np.tile(np.eye(2), (2, 1, 1)),
        )  # fmt: skip


def grown(graph, slow, seed=0):
    """States, covariances of all at each instant, with the heading and the surveys."""
    growing, found, epochs = graph(Roster(0, NODES, slow)), [], []
    for k, epoch in enumerate(crossing(seed)):
        epochs.append(epoch)
        due = {
            of: np.flatnonzero(-(-one.received_ns // STEP_NS) == k) for of, one in enumerate(epochs)
        }
        growing.update(epoch, 0.02, {of: rows for of, rows in due.items() if len(rows)})
        found.append((*growing.states(sorted(growing.tracks)), np.array(growing.heading())))
    return found, growing.survey()


@pytest.mark.parametrize("slow", [{}, {0: GnssBias(1.0, 30.0), 3: GnssBias(2.0, 10.0)}])
def test_late_sightings_slow_errors_births_and_deaths_are_all_in_it(slow):
    (whole, survey), (lag, lag_survey) = both(lambda graph: grown(graph, slow))
    for (x, P, yaw), (lag_x, lag_P, lag_yaw) in zip(whole[5:], lag[5:], strict=True):
        assert lag_x == pytest.approx(x, abs=1e-6)
        assert lag_P == pytest.approx(P, abs=1e-5)
        assert lag_yaw == pytest.approx(yaw, abs=1e-7)
    assert survey.keys() == lag_survey.keys() == {1, 2}
    assert all(lag_survey[i] == pytest.approx(survey[i], abs=1e-6) for i in survey)


def test_only_who_depends_on_more_than_surveys_is_in_the_dense_core():
    graph = Window(Roster(0, NODES[:2]), 2.0)
    for k, epoch in enumerate(crossing(0)):
        node = epoch.node % 2
        graph.update(dataclasses.replace(epoch, node=node), 0.0, {k: np.arange(len(node))})
    assert graph.core_tracks == {0, 1, 2}


def test_covariances_stay_sound_over_a_long_drive():
    graph = Window(Roster(0, NODES), 1.0)
    epochs = [dataclasses.replace(one, received_ns=np.full(len(one.node), one.t_ns))
              for one in crossing(3)]  # fmt: skip
    for k in range(600):
        one = dataclasses.replace(epochs[k % STEPS], t_ns=k * STEP_NS)
        graph.update(one, 0.0, {k: np.arange(len(one.node))})
    P = graph.states(sorted(graph.tracks))[1]
    assert np.array_equal(P, P.swapaxes(1, 2))
    assert np.linalg.eigvalsh(P).min() > 1e-4
