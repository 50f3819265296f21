"""Recorded motion of a gantry camera replayed on a node: a synthetic combination.

The motion is that of an image on a windy day (A9 test field, 25 frames a second); its scale in
metres, the post and the noise of the poses are ours.
"""

from pathlib import Path

import numpy as np
import pytest

import fgloc
from fgloc.infrastructure import Infrastructure, Node, Post
from fgloc.measurements import NodePoses
from fgloc.posts import PostStates

TRACK = Path(__file__).parents[1] / (
    "../shared/data/a9_gantry_camera_sway/track_s50_s_far__silver_car.csv"
)
METRES_PER_PX, SIGMA_M, RATE_HZ = 0.01, 0.02, 25
POST = Post("gantry", 10.0, 1.97, 0.05, 20.0, 0.138, 100.0, 0.5)


@pytest.fixture(scope="module")
def drive():
    if not TRACK.exists():
        pytest.skip("data not here")
    columns = np.genfromtxt(TRACK, delimiter=",", names=True)
    px = np.column_stack([columns[f"Original_{k}_px"] - columns[f"SURF_{k}_px"] for k in "xy"])
    p_m = METRES_PER_PX * (px - px.mean(0))
    t_ns = (columns["frame_in_track"] * 1e9 / RATE_HZ).astype(np.int64)
    nothing, sigma = np.full(p_m.shape, np.nan), np.full(p_m.shape, SIGMA_M)
    told = p_m + SIGMA_M * np.random.default_rng(0).standard_normal(p_m.shape)
    poses = NodePoses(t_ns, t_ns, np.zeros(len(t_ns)), told, nothing, sigma, nothing)
    truth = PostStates.truth(t_ns, 0, p_m, np.gradient(p_m, axis=0) * RATE_HZ, 0 * p_m)
    beside = Infrastructure((Node("gantry", np.zeros(3)),), (POST,))
    about = fgloc.About("Recorded gantry motion on a made-up node: synthetic combination")
    return fgloc.Drive("gantry", fgloc.Origin(48.2, 11.6, 480), fgloc.Rig(),
                       {"node_poses": poses}, None, about, beside, post_truth=truth)  # fmt: skip


def rmse_m(result, drive) -> float:
    return float(np.sqrt(np.mean((result.posts.p_node_m - drive.post_truth.p_node_m) ** 2)))


def test_the_graph_follows_recorded_sway_better_than_the_poses(drive):
    raw, smoothed = fgloc.baseline(drive, "raw:node_poses"), fgloc.smooth(drive)
    assert rmse_m(smoothed, drive) < 0.85 * rmse_m(raw, drive)


def test_the_frequency_of_recorded_sway_is_found(drive):
    sought = fgloc.smooth(drive, settings=["posts.estimate_mode=true"])
    told = sought.summary["posts_sought"]["gantry"]["frequency_hz"]
    # The recorded image swings at 1.59 Hz; the drive states 1.97.
    assert told["value"] == pytest.approx(1.59, abs=0.1)
    assert rmse_m(sought, drive) < rmse_m(fgloc.smooth(drive), drive)
