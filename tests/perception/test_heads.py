"""Mounts and intrinsics: pixels and rays by hand, and the nodes of the papers as printed."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fgloc.errors import InputError
from fgloc.infrastructure import Node
from fgloc.perception.heads import Camera, Head, PerceptionNode
from fgloc.perception.paper_nodes import khamooshi2023_node, lee2021_node, mount, pinhole

from .standing_street import camera, lidar, node

LEVEL = Camera("level", (200, 100), np.array([100.0, 50.0]), np.array([99.5, 49.5]),
               np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.array([0.0, 0, 2]))  # fmt: skip
"""Along the node's x axis, 2 m above its origin."""
BENT = replace(camera(size_px=(1920, 1200)), distortion=np.array([-0.12, 0.05, 1e-3, -1e-3, 0.0]))
SURVEY = Node("n", np.array([0.0, 0, 10]))


def test_a_point_is_seen_where_it_lies_by_hand():
    # 10 m ahead, 1 m left, 3 m up from the node, so 1 m up from the camera.
    pixels = LEVEL.project([[10.0, 1, 3], [10, -1, 1], [-10, 0, 2]])
    np.testing.assert_allclose(pixels[:2], [[99.5 - 10, 49.5 - 5], [99.5 + 10, 49.5 + 5]])
    assert np.isnan(pixels[2]).all()
    assert LEVEL.sees(pixels).tolist() == [True, True, False]
    edges = [[-0.4, 99.4], [-0.6, 50], [199.4, 0], [199.6, 0], [5, 99.6]]
    assert LEVEL.sees(edges).tolist() == [True, False, True, False, False]


@pytest.mark.parametrize("one", [LEVEL, BENT], ids=["pinhole", "distorted"])
@given(share=st.tuples(st.floats(0, 1), st.floats(0, 1)))
def test_the_ray_through_a_pixel_leads_back_to_it(one, share):
    pixel = np.array([share]) * one.size_px
    ray = one.rays(pixel)
    assert np.linalg.norm(ray) == pytest.approx(1.0)
    np.testing.assert_allclose(one.project(one.p_node_cam_m + 30 * ray), pixel, atol=1e-3)


def test_a_mount_turned_down_looks_down():
    ahead = mount(np.pi / 2, np.pi / 6)[:, 0]  # to the left, then 30 deg down
    np.testing.assert_allclose(ahead, [0, np.cos(np.pi / 6), -0.5], atol=1e-12)


def test_the_lidars_rays_are_as_far_apart_as_printed():
    rays = lidar(np.deg2rad(2.0)).directions().reshape(32, -1, 3)
    azimuth, elevation = np.arctan2(rays[..., 1], rays[..., 0]), np.arcsin(rays[..., 2])
    np.testing.assert_allclose(np.rad2deg(azimuth[0]), np.arange(-1, 1.01, 0.2), atol=1e-9)
    np.testing.assert_allclose(np.rad2deg(elevation[:, 0]), np.arange(-15.5, 15.6), atol=1e-9)


def test_points_on_the_lowest_beam_and_at_the_ends_of_the_sector_are_at_the_edge():
    one = lidar(np.deg2rad(60))
    rays = one.to_node(20 * one.directions())
    at_edge = one.at_edge(rays).reshape(32, -1)
    assert at_edge[0].all()
    assert at_edge[:, [0, -1]].all()
    assert not at_edge[1:, 2:-2].any()
    whole = replace(one, azimuth_rad=np.array([-np.pi, np.pi]))
    assert not whole.at_edge(whole.to_node(20 * whole.directions()))[1800:].any()


def test_the_node_of_lee_has_two_heads_of_one_camera_and_one_lidar_each():
    made = lee2021_node(SURVEY)
    assert [(len(head.cameras), head.lidar is not None) for head in made.heads] == [(1, True)] * 2
    assert made.head_of_camera.tolist() == [0, 1]
    across = [made.cameras[0].rays([[u, 599.5]])[0] for u in (-0.5, 1919.5)]
    assert np.rad2deg(np.arccos(across[0] @ across[1])) == pytest.approx(80.0, abs=0.05)


def test_the_node_of_chapter_5_has_two_cameras_on_one_head_and_one_lidar_all_around():
    made = khamooshi2023_node(SURVEY)
    assert made.head_of_camera.tolist() == [0, 0]
    assert made.height_m == 10.0
    assert made.ground_m == -10.0
    across = [made.cameras[0].rays([[u, 599.5]])[0] for u in (-0.5, 1919.5)]
    assert np.rad2deg(np.arccos(across[0] @ across[1])) == pytest.approx(90.0, abs=0.05)
    assert len(made.heads[0].lidar.directions()) == 32 * 1800
    # Side by side: what the middle shows, both see.
    middle = np.array([[30.0, 0.0, -10.0]])
    assert all(one.sees(one.project(middle)).all() for one in made.cameras)


def test_impossible_sensors_are_refused():
    with pytest.raises(InputError, match="R_node_cam is not a rotation matrix"):
        replace(camera(), R_node_cam=2 * np.eye(3))
    with pytest.raises(InputError, match=r"focal_px: expected finite numbers of shape \(2,\)"):
        replace(camera(), focal_px=np.array([100.0]))
    with pytest.raises(InputError, match=r"focal_px = \[100.0, 0.0\]: expected numbers above 0"):
        replace(camera(), focal_px=np.array([100.0, 0.0]))
    with pytest.raises(InputError, match="ranges from 5 to 1 m"):
        replace(lidar(), min_range_m=5, max_range_m=1)
    with pytest.raises(InputError, match="angles must rise"):
        replace(lidar(), azimuth_rad=np.array([1.0, -1.0]))
    with pytest.raises(InputError, match="sigma_m = 0: expected a number above 0"):
        replace(lidar(), sigma_m=0)
    with pytest.raises(InputError, match="neither a camera nor a LiDAR"):
        Head("bare")
    with pytest.raises(InputError, match="name 'camera' occurs twice"):
        PerceptionNode(SURVEY, (Head("a", (camera(),)), Head("b", (camera(),))), 10.0)
    with pytest.raises(InputError, match="height_m = 0: expected m above 0"):
        replace(node(), height_m=0)
    with pytest.raises(InputError, match="has no head"):
        PerceptionNode(SURVEY, (), 10.0)


def test_a_pinhole_looks_along_its_yaw():
    np.testing.assert_allclose(
        pinhole("c", np.pi / 2, 0.0).rays([[959.5, 599.5]]), [[0, 1, 0]], atol=1e-12
    )
