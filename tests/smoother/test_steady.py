"""Cars beside swaying posts: the sway is taken back from what their nodes report."""

import dataclasses

import numpy as np
import pytest

import fgloc
from fgloc.config import SmoothConfig
from fgloc.factors.post import post_spread, post_step
from fgloc.infrastructure import Infrastructure, Post
from fgloc.smoother.steady import at_rest, state_at, steadied
from fgloc.sway import watches

SCENARIO = "khamooshi2023/sway-drive"
POST = Post("isn-1", 10.0, 1.97, 0.05, 20.0, 0.1377, 90.0, 0.7)


@pytest.fixture(scope="module")
def drive():
    return fgloc.make(SCENARIO, seed=5, duration_s=42.0)


def rmse_m(drive: fgloc.Drive, *settings: str) -> float:
    result = fgloc.smooth(drive, settings=settings)
    return fgloc.score(result.trajectory, drive.truth)["horizontal_rmse_m"].value


def test_the_graph_removes_four_fifths_of_what_sway_does_to_the_car(drive):
    still = fgloc.make(SCENARIO, seed=5, duration_s=42.0, sways=False)
    ignored, without = (rmse_m(one, "posts.compensate=false") for one in (drive, still))
    assert ignored > 2 * without
    assert (ignored - rmse_m(drive)) / (ignored - without) > 0.8


def test_a_result_with_posts_tells_of_both(drive):
    result = fgloc.smooth(drive)
    assert len(result.trajectory) and len(result.posts) == len(drive.tables["node_poses"])
    assert result.summary["counts"]["node_poses"] == {"used": 421}
    assert result.summary["posts"]["isn-1"]["rms_m"] > 0.02
    off = result.posts.p_node_m - drive.post_truth.p_node_m[::20]
    assert np.mean((off / result.posts.sigma_p_m) ** 2) == pytest.approx(1.0, abs=0.25)


def test_detections_between_poses_take_the_state_on(drive):
    watch = watches(drive, "test")[0][0]
    states, covs = np.random.default_rng(0).standard_normal((2, 421, 6))
    covs = np.eye(6) * covs[:, :1, None] ** 2
    t_ns = watch.t_ns[7] + np.array([-(10**12), 0, 30_000_000])
    x, P = state_at(watch, (states, covs), t_ns)
    np.testing.assert_array_equal(P[0], post_spread(watch.post))
    np.testing.assert_array_equal(x[:2], [np.zeros(6), states[7]])
    step = post_step(watch.post, 0.03)
    np.testing.assert_allclose(x[2], step.transition @ states[7])
    np.testing.assert_allclose(P[2], step.transition @ covs[7] @ step.transition.T + step.noise)


def test_what_is_unsure_of_the_sway_is_added_to_the_covariance():
    P = np.zeros((1, 6, 6))
    P[0, 0, 0] = 0.01**2  # a centimetre of displacement, which tilts by 1.377 mrad
    p_m, cov = at_rest(np.array([[20.0, 0]]), np.zeros((1, 2, 2)), (np.zeros((1, 6)), P), POST,
                       "camera")  # fmt: skip
    # At 20 m: 50 m a radian of tilt less the displacement itself.
    np.testing.assert_allclose(cov[0], np.diag([(0.01 * (50 * 0.1377 - 1)) ** 2, 0]), atol=1e-12)
    np.testing.assert_allclose(p_m, [[20, 0]])


def test_without_posts_or_poses_or_will_nothing_is_changed(drive):
    config = SmoothConfig()
    bare = Infrastructure(drive.infrastructure.nodes)
    assert steadied(dataclasses.replace(drive, infrastructure=bare), config) is None
    alone = {name: table for name, table in drive.tables.items() if name != "node_poses"}
    assert steadied(dataclasses.replace(drive, tables=alone), config) is None
    off = config.model_copy(update={"posts": config.posts.model_copy(update={"compensate": False})})
    assert steadied(drive, off) is None
