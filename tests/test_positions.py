"""Measured positions of a drive: what a node tells of heights, and who takes it."""

from dataclasses import replace

import numpy as np
import pytest

import fgloc
from fgloc.config import load_config
from fgloc.infrastructure import Infrastructure
from fgloc.measurements import LEFT_OUT
from fgloc.positions import FREE_UP_M, measured_positions
from fgloc.verdicts import SourceVerdicts

SCENARIO = "khamooshi2023/sway-drive"


@pytest.fixture(scope="module")
def drive():
    """Past a LiDAR that tells heights, 10 m above the car, and a camera that sees the same."""
    made = fgloc.make(SCENARIO, seed=4, duration_s=10.0, sensor="lidar", poses=False)
    (node,), seen = made.infrastructure.nodes, made.tables["detections"]
    nodes = node, replace(node, name="camera", sensor="camera")
    which = np.arange(len(seen)) % 2
    up, sigma = (np.where(which, np.nan, one) for one in (seen.up_node_m, seen.sigma_up_m))
    both = replace(made, infrastructure=Infrastructure(nodes, made.infrastructure.posts))
    return both.with_tables(detections=replace(seen, node=which, up_node_m=up, sigma_up_m=sigma))


def test_a_height_that_is_told_is_measured_and_no_other(drive):
    verdicts = {name: SourceVerdicts.of(name, table) for name, table in drive.tables.items()}
    found = measured_positions(drive, load_config(), (drive.start_ns, drive.end_ns), verdicts)
    seen = drive.tables["detections"]
    told, free = (found.take(found.source == s) for s in (1, 2))
    np.testing.assert_allclose(told.z_world_m[:, 2], 10.0 + seen.up_node_m[told.row])
    np.testing.assert_allclose(told.cov_world_m2[:, 2, 2], seen.sigma_up_m[told.row] ** 2)
    np.testing.assert_array_equal(free.cov_world_m2[:, 2, 2], FREE_UP_M**2)
    for rows, dof in ((told, 3), (free, 2), (found.take(found.source == 0), 3)):
        assert set(rows.dof) == {dof}
    assert not found.cov_world_m2[found.candidates, 2, :2].any()


def test_a_run_takes_a_lidar_and_a_camera_together(drive):
    result = fgloc.smooth(drive)
    judged, node = result.verdicts["detections"], drive.tables["detections"].node
    np.testing.assert_array_equal(judged.dof, 3 - node)
    assert result.summary["counts"]["detections"].get("used", 0) > 95
    told = result.summary["nodes"]
    assert told["isn-1"]["nis_mean"] == pytest.approx(3, abs=1)
    up_m = result.trajectory.p_world_m[:, 2]
    assert np.sqrt(np.mean(up_m**2)) < 0.3  # of 2 m of each fix


@pytest.mark.parametrize("method", ["eskf", "raw:detections"])
def test_methods_in_the_plane_leave_heights_alone(drive, method):
    seen = drive.tables["detections"]
    flat = drive.with_tables(detections=replace(seen, up_node_m=LEFT_OUT, sigma_up_m=LEFT_OUT))
    one, other = (fgloc.baseline(each, method).trajectory for each in (drive, flat))
    np.testing.assert_array_equal(one.p_world_m[:, :2], other.p_world_m[:, :2])
