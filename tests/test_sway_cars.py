"""A car placed by a camera on a swaying post: the graph takes out what the sway puts in."""

import dataclasses

import numpy as np
import pytest
from sway_cars import LEFT, SCENARIO, drives, post_rmse, removed_share, rmse_m, ways

import fgloc


@pytest.fixture(scope="module")
def of():
    return drives(11, "camera", duration_s=45.0)


@pytest.fixture(scope="module")
def found(of):
    return ways(of)


def test_ignored_sway_is_felt_far_away(found):
    assert found["sway ignored"][0] > 3 * found["no sway"][0]
    assert found["sway ignored"][3] > 3 * found["sway ignored"][1]


def test_with_poses_the_graph_removes_four_fifths_of_it(found):
    share = removed_share(found, "graph with poses")
    assert share[0] > 0.8 and share[3] > 0.8
    assert found["graph with poses"][0] < found["taken back by khamooshi2023-uio"][0]


def test_two_cars_with_rtk_remove_half_without_any_pose(found):
    share = removed_share(found, "graph without poses, two RTK cars")
    assert share[0] > 0.5 and share[3] > 0.5
    assert found["graph without poses, two RTK cars"][0] < found["graph without poses"][0]


def test_a_lidar_shows_the_sway_by_its_heights():
    """Without poses, by two cars with RTK: the error that sway adds, and the post itself."""
    found, posts = [], []
    for heights in (True, False):
        of = drives(12, "lidar", duration_s=30.0, heights=heights)
        ignored, still = rmse_m(of["poses"], LEFT)[0], rmse_m(of["still"], LEFT)[0]
        found.append((ignored - rmse_m(of["users"])[0]) / (ignored - still))
        posts.append(post_rmse(of["users"]))
    assert found[0] > 0.5
    assert (posts[0] < posts[1] / 2).all()


def test_where_nothing_sways_the_posts_states_cost_little(of):
    assert rmse_m(of["still"])[0] < 1.4 * rmse_m(of["still"], LEFT)[0]


def test_a_causal_run_follows_the_post_too():
    drive = fgloc.make(SCENARIO, seed=3, duration_s=20.0)
    followed, ignored = (fgloc.smooth(drive, "fixed-lag", settings=s) for s in ((), (LEFT,)))
    errors = [fgloc.score(one.trajectory, drive.truth, score_from_s=8.0)["horizontal_rmse_m"].value
              for one in (followed, ignored)]  # fmt: skip
    assert errors[0] < 0.7 * errors[1]
    off = followed.posts.p_node_m - drive.post_truth.p_node_m[::20]
    assert np.mean((off / followed.posts.sigma_p_m) ** 2) == pytest.approx(1.0, abs=0.35)
    assert followed.summary["counts"]["node_poses"] == {"used": 201}
    assert np.isfinite(followed.verdicts["node_poses"].nis).all()


def test_a_node_whose_clock_is_late_has_its_poses_set_right_as_well(of):
    """Sway turns about within a quarter of a second: poses that stay late would be worse than
    none."""
    drive, late_ns = of["poses"], 250_000_000
    late = {
        name: dataclasses.replace(drive.tables[name], t_ns=drive.tables[name].t_ns + late_ns,
                                  received_ns=drive.tables[name].received_ns + late_ns)
        for name in ("detections", "node_poses")
    }  # fmt: skip
    right = rmse_m(drive.with_tables(**late), "clock.nodes_s=0.25")
    np.testing.assert_allclose(right, rmse_m(drive), rtol=1e-6)
