"""The filter behind a track: Jacobians, what a near side says of a centre, what names change."""

import numpy as np
import pytest

from fgloc.measurements import PEDESTRIAN, VEHICLE
from fgloc.perception.boxes import Cuboids
from fgloc.perception.cuboid_fit import CAR_M
from fgloc.perception.ground import ByBottom, Sightings
from fgloc.perception.paper_nodes import pinhole
from fgloc.perception.settings import PlaceConfig, TrackConfig
from fgloc.perception.track_filter import (
    YAW,
    Belief,
    along_course,
    born_of_cuboids,
    born_of_sightings,
    by_box,
    by_cuboid,
    by_kind,
    by_sighting,
    forget_place,
    outline,
    predict,
    update,
)

CONFIG = TrackConfig()
GROUND_M = -10.0
SENSOR_M = np.zeros(3)


def states(n: int = 6, seed: int = 0) -> Belief:
    """Cars all around the node, turned every way."""
    rng = np.random.default_rng(seed)
    x = np.column_stack([
        rng.uniform(-40, 40, (n, 2)), np.full(n, GROUND_M + 0.75), rng.normal(0, 5, (n, 2)),
        rng.uniform([4, 1.7, 1.4], [5, 2, 1.6], (n, 3)), rng.uniform(-1.5, 1.5, n),
    ])  # fmt: skip
    x[:, 2] = GROUND_M + x[:, 7] / 2
    A = rng.normal(0, 0.3, (n, 9, 9))
    return Belief(x, A @ A.swapaxes(1, 2) + 0.01 * np.eye(9))


def cuboids(belief: Belief, size=None, yaw=None) -> Cuboids:
    n = len(belief.x)
    size = belief.x[:, 5:8] if size is None else np.broadcast_to(size, (n, 3))
    yaw = belief.x[:, YAW] if yaw is None else yaw
    zero = np.zeros(n, int)
    return Cuboids(
        zero, zero, belief.x[:, :3], size, (yaw + np.pi / 2) % np.pi - np.pi / 2, zero + 50,
        np.broadcast_to(0.01 * np.eye(2), (n, 2, 2)),
    )  # fmt: skip


def sightings(p_m, share, sigma_m=0.3) -> Sightings:
    n = len(p_m)
    return Sightings(np.asarray(p_m), np.tile(sigma_m**2 * np.eye(2), (n, 1, 1)),
                     np.full(n, share), np.full(n, 4.0))  # fmt: skip


def check_jacobian(measure, belief: Belief):
    """H is minus what the innovation changes by, entry by entry."""
    H = measure(belief).H
    for k in range(9):
        step = np.zeros(9)
        step[k] = 1e-6
        ahead, back = (measure(Belief(belief.x + sign * step, belief.P)).error for sign in (1, -1))
        numeric = -(ahead - back) / 2e-6
        np.testing.assert_allclose(H[:, :, k], numeric, atol=1e-5, err_msg=f"state {k}")


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_jacobian_of_a_sighting(share):
    belief = states()
    seen = sightings(belief.x[:, :2] + 0.5, share)
    check_jacobian(lambda b: by_sighting(b, seen, SENSOR_M), belief)


@pytest.mark.parametrize("long", [True, False])
def test_jacobian_of_a_cuboid_whose_near_sides_stay_the_same(long):
    # Both sides are seen under 40 deg and more, so that the corner is the nearest for all steps.
    belief = states()
    bearing = np.arctan2(belief.x[:, 1], belief.x[:, 0])
    belief.x[:, YAW] = bearing + np.pi / 4
    size = (4.4, 1.7, 1.5) if long else (1.9, 1.7, 1.5)
    seen = cuboids(belief, size, belief.x[:, YAW] + 0.05)
    if long:
        check_jacobian(lambda b: by_cuboid(b, seen, SENSOR_M, GROUND_M, CONFIG), belief)
        return
    H = by_cuboid(belief, seen, SENSOR_M, GROUND_M, CONFIG).H
    assert (H[:, 6, YAW] == 1).all()
    np.testing.assert_allclose(H[:, :2, :2], np.tile(np.eye(2), (6, 1, 1)))


def test_a_cuboid_that_is_where_the_track_is_says_nothing_new():
    belief = states()
    seen = cuboids(belief)
    assert np.abs(by_cuboid(belief, seen, SENSOR_M, GROUND_M, CONFIG).error).max() < 1e-9


def test_a_cuboid_may_call_the_width_a_length():
    belief = states()
    seen = cuboids(belief, belief.x[:, [6, 5, 7]], belief.x[:, YAW] + np.pi / 2)
    assert np.abs(by_cuboid(belief, seen, SENSOR_M, GROUND_M, CONFIG).error).max() < 1e-9


def test_from_the_near_end_alone_a_known_car_is_placed_right():
    # A car of 4.5 m heads away at 40 m; the LiDAR sees its rear only: 0.4 m deep, at 37.95 m.
    x = np.array([[40.5, 0.2, -9.25, 0, 0, 4.5, 1.8, 1.5, 0.0]])
    P = np.diag([1.0, 1, 0.01, 1, 1, 0.01, 0.01, 0.01, 1e-4])[None]
    seen = Cuboids([0], [0], [[37.95, 0, -9.25]], [[0.4, 1.8, 1.5]], [0.0], [9],
                   [0.0025 * np.eye(2)])  # fmt: skip
    after = update(Belief(x, P), by_cuboid(Belief(x, P), seen, SENSOR_M, GROUND_M, CONFIG))
    np.testing.assert_allclose(after.x[0, :2], [40.0, 0.0], atol=0.05)
    assert after.x[0, 5] > 4.3  # what is missing of the length is taken for hidden
    assert after.P[0, 0, 0] < 0.02


def test_a_class_gives_its_size_and_with_it_the_centre():
    seen = Cuboids([0], [0], [[40.0, 0, -9.25]], [[0.4, 1.8, 1.5]], [0.0], [9], [0.01 * np.eye(2)])
    born = born_of_cuboids(seen, GROUND_M, CONFIG)
    told = update(born, by_kind(born, np.array([VEHICLE])))
    assert told.x[0, 5] == pytest.approx(4.1, abs=0.2)
    assert told.x[0, 7] == pytest.approx(1.5, abs=0.05)


def test_measurements_alone_are_what_is_left_when_the_place_is_forgotten():
    belief = states()
    seen = sightings(belief.x[:, :2] + 0.7, 0.0)
    alone = update(forget_place(belief), by_sighting(belief, seen, SENSOR_M))
    np.testing.assert_allclose(alone.x[:, :2], seen.p_node_m, atol=1e-5)
    np.testing.assert_allclose(alone.P[:, :2, :2], seen.cov_m2, rtol=1e-5, atol=1e-8)
    assert forget_place(belief).x is not belief.x  # both are written into


def test_a_car_that_drives_sideways_has_its_sides_exchanged():
    x = np.array([[30.0, 0, -9.25, 0, 9, 1.8, 4.5, 1.5, 0.1]])
    after = along_course(Belief(x, np.eye(9)[None] * 0.01), np.array([VEHICLE]), CONFIG)
    np.testing.assert_allclose(after.x[0, 5:8], [4.5, 1.8, 1.5], atol=0.05)
    assert after.x[0, YAW] == pytest.approx(np.pi / 2, abs=0.03)
    walking = along_course(Belief(x, np.eye(9)[None]), np.array([PEDESTRIAN]), CONFIG)
    assert walking.x is x  # pedestrians turn as they like


def test_prediction_moves_by_the_velocity_and_is_less_sure():
    belief = states()
    kind = np.full(6, VEHICLE)
    after = predict(belief, 0.5, kind, CONFIG)
    np.testing.assert_allclose(after.x[:, :2], belief.x[:, :2] + 0.5 * belief.x[:, 3:5])
    two = predict(predict(belief, 0.2, kind, CONFIG), 0.3, kind, CONFIG)
    np.testing.assert_allclose(two.P, after.P, atol=1e-12)


def test_jacobian_of_a_box_is_that_of_its_outermost_corners():
    camera = pinhole("camera", 0.0)
    belief = Belief(np.array([[40.0, 3, -9.25, 5, 0, 4.5, 1.8, 1.5, 0.3]]), np.eye(9)[None])
    box_px = outline(camera, belief.x) + [[2.0, -1.0, 3.0, 1.0]]
    place = PlaceConfig()
    found = by_box(belief, box_px, camera, GROUND_M, place)
    np.testing.assert_allclose(found.error, [[2, -1, 3, 1, 0]], atol=1e-9)
    check_jacobian(lambda b: by_box(b, box_px, camera, GROUND_M, place), belief)


def test_boxes_alone_find_place_and_size_of_a_car_that_drives_by():
    camera = pinhole("camera", 0.0)
    true = np.array([[30.0, -6, -9.2, 8, 4, 4.9, 2.0, 1.6, np.arctan2(4, 8)]])
    kind = np.array([VEHICLE])
    seen = ByBottom(camera, GROUND_M, PlaceConfig()).sight(outline(camera, true), kind)
    belief = born_of_sightings(seen, kind, camera.p_node_cam_m, GROUND_M, CONFIG)
    for _ in range(30):
        box = by_box(belief, outline(camera, true), camera, GROUND_M, PlaceConfig())
        belief = along_course(update(belief, box), kind, CONFIG)
        belief = predict(belief, 0.1, kind, CONFIG)
        true[:, :2] += 0.1 * true[:, 3:5]
    off = belief.x[0, :2] - true[0, :2]
    assert np.abs(off).max() < 0.5
    assert off @ np.linalg.solve(belief.P[0, :2, :2], off) < 9
    assert belief.x[0, 6] == pytest.approx(2.0, abs=0.15)


def test_a_box_as_wide_as_a_car_begins_one_that_drives_along_the_ray():
    seen = Sightings(
        np.array([[30.0, 0.0]]), np.eye(2)[None] * 0.1, np.ones(1), np.array([CAR_M[1]])
    )
    born = born_of_sightings(seen, np.array([VEHICLE]), SENSOR_M, GROUND_M, CONFIG)
    assert born.x[0, 0] == pytest.approx(30 + CAR_M[0] / 2)
    assert born.x[0, YAW] == pytest.approx(0)
    assert born.P[0, 0, 0] > born.P[0, 1, 1]
