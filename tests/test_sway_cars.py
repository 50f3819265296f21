"""A car placed by a camera on a swaying post: the graph takes out what the sway puts in."""

import numpy as np
import pytest
from sway_cars import ego, estimate, five_ways, removed_share

import fgloc


@pytest.fixture(scope="module")
def ways():
    return five_ways(11, "camera", duration_s=45.0)


def test_ignored_sway_is_felt_far_away(ways):
    share = ways["sway ignored"] / ways["no sway"]
    assert share[0] > 3
    assert ways["sway ignored"][3] > 3 * ways["sway ignored"][1]


def test_with_poses_the_graph_removes_four_fifths_at_every_range(ways):
    assert np.all(removed_share(ways, "graph with poses") > 0.8)
    assert np.all(ways["graph with poses"] <= 1.02 * ways["taken back by the observer"])


def test_two_cars_with_rtk_remove_half_without_any_pose(ways):
    assert np.all(removed_share(ways, "graph, two RTK cars, no poses") > 0.5)


def test_where_nothing_sways_the_posts_states_cost_little():
    still = fgloc.make("khamooshi2023/sway-drive", seed=3, duration_s=20.0, sways=False)
    car = ego(still)
    found = [estimate(still, [car], None, joint=joint) for joint in (False, True)]
    errors = [np.sqrt(((found_m - car.true_m) ** 2).sum(-1).mean()) for found_m in found]
    assert errors[1] < 1.25 * errors[0]
