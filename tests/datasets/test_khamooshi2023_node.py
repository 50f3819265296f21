"""The node's scenarios: where the car drives, and how the noise grows."""

import numpy as np
import pytest

from fgloc.datasets import make
from fgloc.datasets.drive_folder import read_drive, write_drive
from fgloc.datasets.khamooshi2023_node import CAMERA_A, FROM_M, LIDAR_A, NODES_M


def errors(drive):
    """Detections minus truth, in the world."""
    seen = drive.tables["detections"]
    nodes = [drive.infrastructure.nodes[i] for i in seen.node]
    world = np.array([n.to_world(p) for n, p in zip(nodes, seen.p_node_m, strict=True)])
    return (
        world - drive.truth.at(np.unique(seen.t_ns)).p_world_m.repeat(len(set(seen.node)), 0)[:, :2]
    )


def test_the_car_leaves_node_1_at_10_mps_towards_node_2():
    truth = make("khamooshi2023/constant-velocity", 0).truth
    assert truth.p_world_m[0, :2] == pytest.approx(FROM_M)
    assert np.linalg.norm(truth.v_world_mps, axis=1) == pytest.approx(10.0)
    nearest = np.linalg.norm(truth.p_world_m[:, :2] - np.array(NODES_M[1][:2]), axis=1).min()
    assert nearest < 1.0


def test_the_right_turn_turns_right_by_90_degrees_at_10_mps():
    truth = make("khamooshi2023/right-turn", 0).truth
    step_m = np.linalg.norm(np.diff(truth.p_world_m, axis=0), axis=1)
    assert step_m == pytest.approx(1.0, abs=1e-3)
    assert truth.yaw_rad[-1] - truth.yaw_rad[0] == pytest.approx(-np.pi / 2)


def test_noise_grows_with_the_slant_range_of_each_sensor():
    e = np.array([errors(make("khamooshi2023/constant-velocity", seed)) for seed in range(200)])
    cov = make("khamooshi2023/constant-velocity", 0).tables["detections"].cov_node_m2
    assert e.var(0).mean(0) == pytest.approx(np.diagonal(cov, axis1=1, axis2=2).mean(0), rel=0.05)
    first = cov[0, 0, 0] / (0.2**2 + 0.4**2 + 10**2)  # node 1 stands 0.45 m beside the start
    assert first == pytest.approx(CAMERA_A[0])
    assert cov[1, 1, 1] / cov[0, 1, 1] == pytest.approx(LIDAR_A[1] / CAMERA_A[1])


def test_a_node_drive_comes_back_from_its_folder(tmp_path):
    drive = make("khamooshi2023/right-turn", 3)
    write_drive(drive, tmp_path / "turn")
    back = read_drive(tmp_path / "turn")
    assert set(back.tables) == set(drive.tables)
    assert back.tables["detections"].p_node_m == pytest.approx(drive.tables["detections"].p_node_m)
    assert [n.name for n in back.infrastructure.nodes] == ["node-1/camera", "node-1/lidar"]
