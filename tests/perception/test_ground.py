"""From boxes to the ground: exact for what was projected, with covariances that noise confirms."""

import numpy as np
import pytest

from fgloc.infrastructure import Node
from fgloc.measurements import PEDESTRIAN, VEHICLE
from fgloc.perception.boxes import upright_corners
from fgloc.perception.cuboid_fit import CAR_M, PERSON_M
from fgloc.perception.ground import (
    ByBottom,
    ByCentre,
    ByMap,
    depth_m,
    kind_size_m,
    on_border,
    on_plane,
    upright_size_m,
)
from fgloc.perception.idw import Calibration, IdwMap
from fgloc.perception.map_error import ErrorMap
from fgloc.perception.paper_nodes import pinhole
from fgloc.perception.settings import PlaceConfig

GROUND_M = -10.0
CAMERA = pinhole("camera", 0.0)
CARS = np.full(3, VEHICLE)
CONFIG = PlaceConfig()


def boxes(places, yaw=0.0, size=CAR_M):
    """Boxes around cuboids on the ground."""
    places = np.asarray(places, float)
    n = len(places)
    centre = np.column_stack([places, np.full(n, GROUND_M + size[2] / 2)])
    corners = upright_corners(centre, np.tile(size, (n, 1)), np.full(n, yaw))
    pixels = CAMERA.project(corners.reshape(-1, 3)).reshape(n, 8, 2)
    return np.concatenate([pixels.min(1), pixels.max(1)], 1)


def test_a_pixel_of_the_ground_is_where_it_was_seen():
    p = np.array([[20.0, 3.0, GROUND_M], [70.0, -8.0, GROUND_M]])
    np.testing.assert_allclose(on_plane(CAMERA, CAMERA.project(p), GROUND_M), p[:, :2], atol=1e-9)


def test_above_the_horizon_there_is_no_ground():
    # The camera looks down by 21 deg; 25 deg above its middle is the sky.
    sky = CAMERA.principal_px - [0, CAMERA.focal_px[1] * np.tan(np.deg2rad(25))]
    assert np.isnan(on_plane(CAMERA, sky[None], GROUND_M)).all()
    seen = ByBottom(CAMERA, GROUND_M, CONFIG).sight(
        np.array([[900.0, 20, 960, 30], [900, 600, 960, 640]]), CARS[:2]
    )
    assert seen.known.tolist() == [False, True]


def test_the_lower_edge_is_the_near_end_of_a_car_that_drives_away():
    places = [[25.0, 0.0], [50.0, 0.0], [75.0, 0.0]]
    seen = ByBottom(CAMERA, GROUND_M, CONFIG).sight(boxes(places), CARS)
    np.testing.assert_allclose(seen.p_node_m[:, 0], np.array(places)[:, 0] - 2.3, atol=0.01)
    np.testing.assert_allclose(seen.p_node_m[:, 1], 0, atol=1e-9)
    assert (seen.share == 1).all()


def test_the_middle_of_the_box_is_near_the_centre():
    places = np.array([[30.0, 0.0], [50.0, 5.0], [70.0, -5.0]])
    seen = ByCentre(CAMERA, GROUND_M, CONFIG).sight(boxes(places), CARS)
    off = seen.p_node_m - places
    nis = np.einsum("ni,nij,nj->n", off, np.linalg.inv(seen.cov_m2), off)
    assert (nis < 9).all()
    assert (np.abs(off) < [2.0, 0.4]).all()
    assert (seen.share == 0).all()


@pytest.mark.parametrize("way", [ByBottom, ByCentre])
def test_noise_of_the_edges_does_to_the_place_what_the_covariance_says(way):
    rng = np.random.default_rng(0)
    config = PlaceConfig(shape_sigma_m=0.0, sigma_share=0.0)
    box = boxes([[40.0, 3.0]], size=PERSON_M)
    kind = np.full(4000, PEDESTRIAN)
    noisy = box + config.sigma_px * rng.standard_normal((4000, 4))
    placing = way(CAMERA, GROUND_M, config)
    found = np.cov(placing.sight(noisy, kind).p_node_m.T)
    stated = placing.sight(box, kind[:1]).cov_m2[0]
    if way is ByCentre:  # it also allows for another height, which is not drawn here
        _, sigma = kind_size_m(kind[:1])
        ray = np.array([40.0, 3.0]) / (10 - PERSON_M[2] / 2) * sigma[0, 2] / 2
        stated = stated - np.outer(ray, ray)
    np.testing.assert_allclose(found, stated, rtol=0.15, atol=1e-3)


def test_a_sigma_along_the_ray_grows_with_the_square_of_the_distance():
    config = PlaceConfig(shape_sigma_m=0.0, sigma_share=0.0)
    seen = ByBottom(CAMERA, GROUND_M, config).sight(boxes([[30.0, 0], [60.0, 0]]), CARS[:2])
    along, across = np.sqrt(np.diagonal(seen.cov_m2, axis1=1, axis2=2)).T
    slant = np.hypot(seen.p_node_m[:, 0], GROUND_M)
    assert along[1] / along[0] == pytest.approx((slant[1] / slant[0]) ** 2, rel=0.1)
    assert across[1] / across[0] == pytest.approx(slant[1] / slant[0], rel=0.05)


def test_a_person_looks_as_large_as_a_person():
    width, height = upright_size_m(CAMERA, GROUND_M, boxes([[30.0, 0.0]], size=PERSON_M))
    assert width[0] == pytest.approx(0.6, abs=0.1)
    assert 1.5 < height[0] < 2.1


@pytest.mark.parametrize(("wide", "deep"), [(1.85, 4.6), (4.0, None), (9.0, None)])
def test_the_width_of_a_car_says_how_deep_it_is(wide, deep):
    found, turned = depth_m(np.array([wide]), np.array([CAR_M]))
    if deep is not None:
        assert found[0] == pytest.approx(deep)
        assert turned[0] == pytest.approx(0)
    else:
        assert CAR_M[1] < found[0] < np.hypot(*CAR_M[:2])
        assert 0 < turned[0] <= np.pi / 2
    if wide == 4.0:  # turned so, it is as wide as it is
        t = turned[0]
        assert CAR_M[0] * np.sin(t) + CAR_M[1] * np.cos(t) == pytest.approx(wide)


def test_boxes_at_the_edge_of_the_image_are_told():
    edges = np.array([[-0.5, 100, 50, 200], [100, 100, 200, 1199.5], [100, 100, 200, 200]])
    assert on_border(CAMERA, edges).tolist() == [True, True, False]


def test_a_map_places_boxes_in_the_node_s_axes():
    node = Node("n", np.array([100.0, 50.0, 10.0]), np.pi / 2)
    rng = np.random.default_rng(1)
    u_px = rng.uniform(0, 500, (400, 2))
    calibration = Calibration(u_px, 0.1 * u_px + [80.0, 60.0])
    by_map = ByMap(node, IdwMap(calibration), ErrorMap.of(IdwMap, calibration))
    seen = by_map.sight(np.array([[240.0, 190, 260, 210], [5000, 5000, 5010, 5010]]), CARS[:2])
    world = node.to_world(seen.p_node_m[:1])
    np.testing.assert_allclose(world, [[105.0, 80.0]], atol=2.0)
    assert seen.known.tolist() == [True, False]
    assert np.linalg.eigvalsh(seen.cov_m2[0]).min() > 0
