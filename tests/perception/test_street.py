"""The simulated street: rays and pictures by hand, noise as stated, and both of one world."""

import numpy as np
import pytest

from fgloc.datasets.streets import START_NS
from fgloc.errors import InputError
from fgloc.frames import exp_so3
from fgloc.perception.heads import Lidar
from fgloc.perception.ray_cast import GROUND, NOTHING, nearest, scan
from fgloc.perception.street import Mover, Solids, Sway
from fgloc.perception.street_images import Painter

from .standing_street import driving, lidar, standing, street

UP = np.array([0.0, 0, 1])
AHEAD, DOWN, SKYWARD = [1.0, 0, 0], [0.0, 0, -1], [0.6, 0, 0.8]


def box(centre_m, size_m, yaw_rad=0.0):
    one = Solids(np.array([centre_m]), np.array([size_m]), np.array([yaw_rad]), np.zeros((1, 3)))
    return one.moved(np.eye(3), np.zeros(3))


def test_rays_meet_ground_boxes_and_nothing_where_they_should():
    rays = np.array([AHEAD, DOWN, SKYWARD, [-1.0, 0, 0], [np.sqrt(0.5), np.sqrt(0.5), 0]])
    range_m, hit = nearest(rays, box([10.0, 0, 0], [4.0, 2, 2]), UP, 5.0)
    assert hit.tolist() == [0, GROUND, NOTHING, NOTHING, NOTHING]
    np.testing.assert_allclose(range_m[:2], [8, 5])
    assert np.isinf(range_m[2:]).all()


def test_a_turned_box_shows_its_corner():
    range_m, _ = nearest(np.array([AHEAD]), box([10.0, 0, 0], [2.0, 2, 2], np.pi / 4), UP, 5.0)
    np.testing.assert_allclose(range_m, 10 - np.sqrt(2))


def test_of_two_boxes_the_nearer_is_met_whatever_their_order():
    near, far = [6.0, 0, 0], [12.0, 0, 0]
    for centres in ([near, far], [far, near]):
        both = Solids(np.array(centres), np.full((2, 3), 2.0), np.zeros(2), np.zeros((2, 3)))
        range_m, hit = nearest(np.array([AHEAD]), both.moved(np.eye(3), np.zeros(3)), UP, 5.0)
        assert range_m[0] == pytest.approx(5.0)
        assert centres[hit[0]] == near


def test_ranges_carry_the_stated_noise_and_reach():
    one = lidar()
    seen = scan(street(), one, START_NS, np.random.default_rng(0))
    true_m = np.full(len(seen.points_m), 10.0) / -(seen.points_m @ one.R_node_lidar[2])
    error_m = np.linalg.norm(seen.points_m, axis=-1) * (1 - true_m)
    # 9600 ranges: the mean of so many is known to 0.0003 m, their spread to 1 %.
    assert abs(error_m.mean()) < 0.001
    assert error_m.std() == pytest.approx(0.03, rel=0.03)
    blind = Lidar(**{**vars(one), "max_range_m": 30.0})
    assert len(scan(street(), blind, START_NS, np.random.default_rng(0)).points_m) < len(true_m)


def test_a_car_is_met_where_it_stands():
    one = lidar()
    seen = scan(street(standing(30.0, 2.0)), one, START_NS, np.random.default_rng(0))
    on_car = one.to_node(seen.points_m[seen.hit == 0])
    low, high = on_car.min(0), on_car.max(0)
    np.testing.assert_allclose(low[:2], [27.7, 1.075], atol=0.15)
    assert high[0] < 32.4
    np.testing.assert_allclose(high[2], -8.5, atol=0.1)


def test_a_node_that_tips_forward_sees_the_ground_nearer():
    tipped = Sway(START_NS + np.array([0, 10**9]), np.zeros((2, 3)), np.array([[0, 0.02, 0]] * 2))
    one, rng = lidar(), np.random.default_rng(0)
    level = scan(street(), one, START_NS, rng).points_m
    down = scan(street(sway=tipped), one, START_NS, rng).points_m
    # What it measured lies on its tipped ground: turned back, on the level one.
    np.testing.assert_allclose((one.to_node(down) @ exp_so3([0, 0.02, 0]).T)[:, 2], -10, atol=0.15)
    assert np.linalg.norm(down, axis=-1).mean() < np.linalg.norm(level, axis=-1).mean() - 1


def painted(*movers, walls=(), sway=None, noise=0.0):
    made = street(*movers, walls=walls, sway=sway)
    painter = Painter.make(made, made.node.cameras[0], np.random.default_rng(0), noise)
    return made, painter.paint(START_NS, np.random.default_rng(1))


def red(image):
    blue, _, colour = image.astype(int).transpose(2, 0, 1)
    return colour - blue > 60


def test_a_car_is_painted_within_its_projected_corners():
    made, image = painted(standing(20.0, 1.0, 0.3))
    rows, columns = np.nonzero(red(image))
    corners = made.node.cameras[0].project(made.solids(START_NS).corners_m()[0])
    seen_px = [columns.min(), rows.min(), columns.max(), rows.max()]
    np.testing.assert_allclose(seen_px, [*corners.min(0), *corners.max(0)], atol=1.5)


def test_the_picture_and_the_cloud_show_one_world():
    made, image = painted(standing(25.0, -3.0, 0.5), walls=[[14, 15, -9, -1.9, 0, 6.5]])
    one, eye = made.node.heads[0].lidar, made.node.cameras[0]
    seen = scan(made, one, START_NS, np.random.default_rng(2))
    pixels = eye.project(one.to_node(seen.points_m))
    inside = eye.sees(pixels)
    column, row = np.rint(pixels[inside]).astype(int).T
    painted_red, on_car = red(image)[row, column], seen.hit[inside] == 1  # box 0 is the wall
    # But for pixels on an edge:
    assert painted_red[on_car].mean() > 0.85
    assert painted_red[~on_car].mean() < 0.01
    assert 0 < red(image).sum() < red(painted(standing(25.0, -3.0, 0.5))[1]).sum()


def test_the_sky_begins_at_the_horizon():
    made, image = painted()
    eye = made.node.cameras[0]
    horizon = eye.project([[1e6, 0.0, 0.0]])[0, 1]
    sky = (image == (235, 220, 200)).all(-1)
    assert sky[: int(horizon)].all()
    assert not sky[int(np.ceil(horizon)) + 1 :].any()


def test_a_swaying_node_paints_what_it_sees_then():
    sway = Sway(START_NS + np.array([0, 10**9]), np.zeros((2, 3)), np.array([[0, 0.05, 0]] * 2))
    lower = np.nonzero(red(painted(standing(30.0, 0.0), sway=sway)[1]))[0].mean()
    level = np.nonzero(red(painted(standing(30.0, 0.0))[1]))[0].mean()
    assert lower < level - 5  # tipped forward, the same car is higher in the picture


def test_noise_is_as_stated():
    plain, noisy = (painted(noise=level)[1].astype(float) for level in (0.0, 4.0))
    assert (noisy - plain)[40:].std() == pytest.approx(4.0, rel=0.05)


def test_a_distorted_camera_is_not_painted():
    made = street()
    bent = type(made.node.cameras[0])(
        **{**vars(made.node.cameras[0]), "distortion": [0.1, 0, 0, 0, 0]}
    )
    with pytest.raises(InputError, match="without distortion only"):
        Painter.make(made, bent, np.random.default_rng(0))


def test_the_truth_tells_who_is_there_and_how_fast():
    made = street(driving((60.0, 40.0), 2.0, 2.0), standing(20, -3, number=7))
    truth = made.truth(START_NS + np.array([0, 1, 3]) * 10**9)
    assert truth.object_id.tolist() == [1, 7, 1, 7, 7]
    # The node looks North from (100, 50): 50 m ahead and 2 m to the left of it.
    np.testing.assert_allclose(truth.p_world_m[2], [98.0, 100.0], atol=1e-9)
    np.testing.assert_allclose(truth.v_world_mps[2], [0.0, -10.0], atol=1e-9)
    assert len(street().truth(np.array([START_NS]))) == 0


def test_movers_and_solids_of_no_shape_are_refused():
    with pytest.raises(InputError, match="mover 3: expected 2 or more instants"):
        Mover(3, 1, np.array([0]), np.zeros((1, 2)), np.zeros(1))
    with pytest.raises(InputError, match="mover 3: instants must rise"):
        Mover(3, 1, np.array([5, 5]), np.zeros((2, 2)), np.zeros(2))
    with pytest.raises(InputError, match=r"solids\.centre_m: expected finite"):
        Solids(np.zeros((2, 2)), np.zeros((2, 3)), np.zeros(2), np.zeros((2, 3)))
