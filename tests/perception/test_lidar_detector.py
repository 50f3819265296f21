"""Objects in clouds: what is background, what belongs together, how well its centre is known."""

from dataclasses import replace

import numpy as np
import pytest

from fgloc.datasets.streets import START_NS
from fgloc.errors import InputError
from fgloc.frames import exp_so3, wrap_pi
from fgloc.measurements import PEDESTRIAN
from fgloc.perception.cuboid_fit import CAR_M, PERSON_M, fit_cuboid
from fgloc.perception.ground_plane import levelled
from fgloc.perception.lidar_background import VoxelBackground
from fgloc.perception.lidar_clusters import cluster
from fgloc.perception.lidar_detector import CUT, FEW, HIDDEN, LidarDetector
from fgloc.perception.lidar_settings import LidarConfig
from fgloc.perception.ray_cast import scan
from fgloc.perception.street import PERSON_SIZE_M, Sway

from .standing_street import driving, lidar, node, standing, street

GROUND_M = -10.0
SENSOR_M = np.array([0.0, 0, 0])
WALLS = ((20, 70, 8, 9, 0, 9), (45, 46, -6, -5, 0, 6))
WALL = np.column_stack([np.full(300, 20.1), np.linspace(-3, 3, 300), np.tile([-9.0, -8, -7], 100)])
CAR = np.column_stack([np.linspace(10, 14, 50), np.full((50, 2), [0.1, -9.3])])


def frames(made, count, every_s=0.5):
    """Clouds of a street in the node's axes."""
    one, rng = made.node.heads[0].lidar, np.random.default_rng(0)
    instants = START_NS + (np.arange(count) * every_s * 1e9).astype(np.int64)
    return [one.to_node(scan(made, one, int(t), rng).points_m) for t in instants]


@pytest.fixture(scope="module")
def detector():
    """Learnt from an empty street with two walls."""
    return LidarDetector.learn(node(), 0, frames(street(walls=WALLS), 4))


def found(detector, *movers, sway=None):
    return detector.look(frames(street(*movers, walls=WALLS, sway=sway), 1)[0], 0)


def test_what_stands_is_background_and_what_passes_is_not():
    clouds = [np.vstack([WALL, CAR + [3.0 * k, 0, 0]]) for k in range(10)]
    background = VoxelBackground.learn(clouds, GROUND_M)
    assert background.holds(WALL).all()
    assert background.holds(WALL + [0.3, 0, 0]).all()  # grown by a voxel
    assert not background.holds(CAR + [1.0, 0, 0]).any()
    assert not background.holds(WALL + [2.0, 0, 0]).any()


def test_a_car_that_stands_for_long_becomes_background():
    clouds = [np.vstack([WALL, CAR + [10.0 * max(0, k - 6), 0, 0]]) for k in range(10)]
    assert VoxelBackground.learn(clouds, GROUND_M).holds(CAR).all()
    wary = LidarConfig(least_share=0.8)
    assert not VoxelBackground.learn(clouds, GROUND_M, wary).holds(CAR).any()


def test_gaps_between_beams_are_filled_up_to_a_height():
    column = np.array([[20.0, 0, z] for z in (-9.0, -7.4, -4.0)])
    background = VoxelBackground.learn([column] * 3, GROUND_M)
    heights_m = np.array([-8.2, -7.8, -6.0, -5.2])
    points = np.column_stack([np.full((4, 2), [20.0, 0]), heights_m])
    assert background.holds(points).tolist() == [True, True, False, False]


def test_ground_does_not_grow_upwards():
    ground = np.column_stack([np.linspace(5, 50, 400), np.zeros(400), np.full(400, GROUND_M)])
    background = VoxelBackground.learn([ground] * 3, GROUND_M)
    assert background.holds(ground + [0, 0.3, 0.1]).all()
    assert not background.holds(ground + [0, 0, 0.3]).any()


def test_a_background_needs_two_clouds_with_points():
    with pytest.raises(InputError, match="needs 2 clouds with points, there are 1"):
        VoxelBackground.learn([WALL, np.empty((0, 3))], GROUND_M)
    with pytest.raises(InputError, match="head 'head' has no LiDAR"):
        bare = replace(node().heads[0], lidar=None)
        LidarDetector.learn(replace(node(), heads=(bare,)), 0, [WALL, WALL])


@pytest.mark.parametrize("turn_rad", [[np.pi / 2, 0, 0], [0, 0.35, 0]])
def test_a_mount_that_puts_the_ground_elsewhere_is_refused(turn_rad):
    right = node().heads[0].lidar
    wrong = replace(right, R_node_lidar=exp_so3(turn_rad) @ right.R_node_lidar)
    mounted = replace(node(), heads=(replace(node().heads[0], lidar=wrong),))
    clouds = [wrong.to_node(right.to_lidar(cloud)) for cloud in frames(street(walls=WALLS), 2)]
    with pytest.raises(InputError, match=r"LiDAR 'lidar': \d.*% of its points .* check the node's"):
        LidarDetector.learn(mounted, 0, clouds)


def test_a_tilted_cloud_is_levelled_and_one_without_ground_stays():
    rng = np.random.default_rng(0)
    level = np.column_stack([rng.uniform(-20, 80, (1000, 2)), np.full(1000, GROUND_M)])
    tilted = level @ exp_so3([0.006, -0.004, 0]).T + [0, 0, 0.1]
    np.testing.assert_allclose(levelled(tilted, GROUND_M)[:, 2], GROUND_M, atol=1e-4)
    np.testing.assert_array_equal(levelled(WALL, GROUND_M), WALL)


def test_far_points_belong_together_where_near_ones_do_not():
    apart_m = np.array([[0.0, 0], [2.4, 0]])
    pairs = [np.repeat(apart_m + [x, 0], 3, axis=0) for x in (15.0, 60.0)]
    labels = [cluster(pair, 8.5, np.deg2rad(1.0), 0.0) for pair in pairs]
    assert [len(set(one.tolist())) for one in labels] == [2, 1]
    beside = np.repeat([[60.0, 0], [60.0, 2.4]], 3, axis=0)
    assert set(cluster(beside, 8.5, np.deg2rad(1.0), 0.0).tolist()) == {0, 1}
    assert len(cluster(np.empty((0, 2)), 8.5, 0.02, 0.0)) == 0


def l_shape(yaw_rad, place_m, size_m=(4.0, 1.8), faces=((1, 0), (0, 1))):
    """Points on the rear and on the right face of a car, its rear right corner at a place."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    share = np.linspace(0, 1, 40)[:, None]
    plan = np.vstack([share * np.multiply(face, size_m) for face in faces])
    turned = plan @ np.array([[c, s], [-s, c]]) + place_m
    return np.column_stack([turned, np.tile([-9.5, -8.6], len(turned) // 2)])


@pytest.mark.parametrize("yaw_rad", [0.2, 0.5, 1.0])
def test_a_car_shorter_than_usual_is_lengthened_away_from_the_sensor(yaw_rad):
    place_m = np.array([20.0, 3.0])
    fit = fit_cuboid(l_shape(yaw_rad, place_m, (3.0, 1.8)), SENSOR_M, GROUND_M, 1.0)
    assert abs(wrap_pi(2 * (fit.yaw_rad - yaw_rad))) / 2 < np.deg2rad(1)
    np.testing.assert_allclose(fit.size_m, CAR_M, atol=0.06)
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    near = fit.centre_m[:2] - np.array([[c, -s], [s, c]]) @ fit.size_m[:2] / 2
    np.testing.assert_allclose(near, place_m, atol=0.1)
    assert fit.centre_m[2] == pytest.approx(GROUND_M + CAR_M[2] / 2)


def test_a_front_alone_is_a_car_along_the_line_of_sight_and_a_bus_stays_long():
    rear = l_shape(0.0, np.array([40.0, -0.9]), faces=((0, 1),))
    fit = fit_cuboid(rear, SENSOR_M, GROUND_M, 1.0)
    np.testing.assert_allclose(fit.centre_m[:2], [40 + CAR_M[0] / 2, 0], atol=0.05)
    bus = fit_cuboid(l_shape(0.3, np.array([20.0, 3]), (12.0, 2.5)), SENSOR_M, GROUND_M, 1.0)
    np.testing.assert_allclose(bus.size_m[:2], [12.0, 2.5], atol=0.05)


def test_what_is_small_is_a_person():
    points = np.array([[20.0, 0, -9.5], [20.1, 0.3, -9], [20, 0.3, -8.4], [20.1, 0, -8.4]])
    fit = fit_cuboid(points, SENSOR_M, GROUND_M, 1.0)
    assert fit.person
    assert sorted(fit.size_m) == sorted(PERSON_M)


def test_cars_and_a_person_are_found_where_they_stand(detector):
    places = {(20.0, 3.0, 0.1), (35.0, -4.0, np.pi / 2), (60.0, 2.0, -0.2)}
    cars = [standing(*place, number=k) for k, place in enumerate(places)]
    person = standing(25.0, -8.0, number=9, size_m=PERSON_SIZE_M, kind=PEDESTRIAN)
    cuboids = found(detector, *cars, person).cuboids
    assert len(cuboids) == 4
    for x, y, yaw_rad in places:
        row = np.argmin(np.hypot(*(cuboids.centre_m[:, :2] - [x, y]).T))
        np.testing.assert_allclose(cuboids.centre_m[row, :2], [x, y], atol=0.3)
        assert abs(wrap_pi(2 * (cuboids.yaw_rad[row] - yaw_rad))) / 2 < 0.1
    row = np.argmin(cuboids.size_m[:, 0])
    np.testing.assert_allclose(cuboids.centre_m[row, :2], [25.0, -8.0], atol=0.15)
    assert (cuboids.points >= 4).all()


def test_an_empty_cloud_and_an_empty_street_hold_nothing(detector):
    assert len(detector.detect(np.empty((0, 3)), 5)) == 0
    nothing = found(detector)
    assert len(nothing.cuboids) == 0
    assert nothing.left_out.total() == 0


def test_what_the_edge_of_the_view_cuts_is_left_out_and_counted(detector):
    assert found(detector, standing(13.0, 0.0)).left_out[CUT] == 1
    person = standing(75.0, 0.0, size_m=PERSON_SIZE_M)
    far = found(detector, person)
    assert (len(far.cuboids), far.left_out[FEW]) in {(0, 1), (0, 0)}


def test_what_something_nearer_hides_a_side_of_is_left_out_and_counted(detector):
    lorry = standing(20.0, 4.0, size_m=(6.0, 2.5, 4.4), number=2)
    behind, beside = standing(32.0, 3.8), standing(32.0, -2.0)
    hidden = found(detector, lorry, behind)
    assert hidden.left_out == {HIDDEN: 1}
    assert len(hidden.cuboids) == 1  # the lorry
    assert len(found(detector, lorry, beside).cuboids) == 2


def test_a_learnt_street_in_use_shows_the_car_and_nothing_else():
    made = street(driving((75.0, 15.0), -2.0, 12.0), walls=WALLS)
    clouds = frames(made, 24)
    detector = LidarDetector.learn(made.node, 0, clouds[::2])
    counts = [len(detector.detect(cloud, k)) for k, cloud in enumerate(clouds[1::4])]
    assert counts == [1] * len(counts)


def test_sway_brings_no_ghosts(detector):
    sway = Sway(START_NS + np.array([0, 10**10]), np.tile([0.05, 0.05, 0], (2, 1)),
                np.tile([-0.007, 0.007, 0], (2, 1)))  # fmt: skip
    swayed = frames(street(walls=WALLS, sway=sway), 1)[0]
    assert len(detector.detect(swayed, 0)) == 0
    seen = found(detector, standing(40.0, 2.0), sway=sway).cuboids
    assert len(seen) == 1
    # Where it is told from the points as they came: the node's own motion is in them.
    np.testing.assert_allclose(seen.centre_m[0, :2], [40.0, 2.0], atol=0.4)


@pytest.mark.parametrize(("kind", "size_m"), [("car", CAR_M), ("person", PERSON_M)])
def test_scans_confirm_the_covariance(kind, size_m):
    rng, one = np.random.default_rng(11), lidar()
    squares = []
    for _ in range(200):
        range_m, azimuth = rng.uniform(18, 75), rng.uniform(-0.4, 0.4)
        place = range_m * np.array([np.cos(azimuth), np.sin(azimuth)])
        spread = np.array(size_m) * (1 + 0.05 * np.clip(rng.standard_normal(3), -2, 2))
        made = street(standing(*place, rng.uniform(-np.pi, np.pi), size_m=tuple(spread)))
        detector = LidarDetector(
            0, one, VoxelBackground(np.empty(0, np.int64), 0.3, -10.0), LidarConfig()
        )
        hits = scan(made, one, START_NS, rng)
        points = one.to_node(hits.points_m[hits.hit == 0])
        points = points[points[:, 2] > GROUND_M + 0.25]
        cuboids = detector.fit(points, np.zeros(len(points), np.int64), points, 0).cuboids
        if len(cuboids):
            error = cuboids.centre_m[0, :2] - place
            squares.append(error @ np.linalg.solve(cuboids.cov_m2[0], error) / 2)
    assert len(squares) > 100
    # The law holds for the mean of all ranges and yaws; errors are not Gaussian.
    assert 0.4 < np.mean(squares) < 1.3
    assert np.mean(np.array(squares) < 4.6 / 2 * 2) > 0.95
