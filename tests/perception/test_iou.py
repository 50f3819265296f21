"""Overlap of boxes and cuboids, by hand and against areas found by counting; the best pairs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgloc.perception.iou import best_pairs, cuboid_iou, image_iou

numbers = st.floats(-5, 5)
sides = st.floats(0.5, 5)


def cuboid(x=0.0, y=0.0, z=0.0, size=(4.0, 2.0, 1.5), yaw=0.0):
    return np.array([[x, y, z]]), np.array([size]), np.array([yaw])


def test_boxes_share_what_they_share():
    first = [[0, 0, 10, 10], [0, 0, 2, 2]]
    second = [[5, 0, 15, 10], [0, 0, 10, 10], [20, 20, 30, 30]]
    expected = [[50 / 150, 1, 0], [0, 4 / 100, 0]]
    np.testing.assert_allclose(image_iou(first, second), expected)


def test_a_box_that_is_not_in_the_image_overlaps_none():
    assert image_iou([[np.nan] * 4], [[0, 0, 1, 1]]).item() == 0
    assert image_iou(np.empty((0, 4)), [[0, 0, 1, 1]]).shape == (0, 1)


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (cuboid(), 1.0),
        (cuboid(x=2.0), 4 / 12),
        (cuboid(z=0.75), 6 / 18),
        (cuboid(z=1.6), 0.0),
        (cuboid(yaw=np.pi), 1.0),
        (cuboid(yaw=np.pi / 2), 4 / 12),
        (cuboid(size=(2.0, 1.0, 1.5)), 0.25),
        (cuboid(x=2.0, y=1.0, size=(2.0, 2.0, 1.5)), 1 / 11),
        (cuboid(size=(1.0, 2.00001, 1.5)), 2 / 8.00001),
    ],
)  # fmt: skip
def test_cuboids_share_plan_times_height(other, expected):
    assert cuboid_iou(cuboid(), other).item() == pytest.approx(expected, abs=1e-6)


def test_squares_turned_by_45_degrees_share_a_regular_octagon():
    square = cuboid(size=(2.0, 2.0, 1.0))
    turned = cuboid(size=(2.0, 2.0, 1.0), yaw=np.pi / 4)
    octagon = 8 * (np.sqrt(2) - 1)  # with an incircle of radius 1
    assert cuboid_iou(square, turned).item() == pytest.approx(octagon / (8 - octagon), abs=1e-6)


@settings(max_examples=40)
@given(numbers, numbers, st.floats(-7, 7), sides, sides)
def test_iou_is_that_of_counted_points(x, y, yaw, length, width):
    other = cuboid(x, y, 0.0, (length, width, 1.5), yaw)
    found = cuboid_iou(cuboid(), other).item()
    assert found == pytest.approx(cuboid_iou(other, cuboid()).item(), abs=1e-4)
    grid = np.stack(np.meshgrid(*[np.arange(-2.0, 2.0, 0.02) + 0.01] * 2), -1).reshape(-1, 2)
    own = grid[np.abs(grid[:, 1]) < 1]
    c, s = np.cos(yaw), np.sin(yaw)
    local = (own - [x, y]) @ np.array([[c, -s], [s, c]])
    shared = 8.0 * (np.abs(local) < [length / 2, width / 2]).all(1).mean()
    assert found == pytest.approx(shared / (8 + length * width - shared), abs=0.02)


def test_far_from_the_origin_nothing_is_lost():
    far = cuboid(x=40_000.0), cuboid(x=40_002.0)
    assert cuboid_iou(*far).item() == pytest.approx(4 / 12, abs=1e-6)


def test_pairs_are_worth_most_together_and_not_each_for_itself():
    worth = np.array([[0.9, 0.8], [0.85, 0.1]])
    assert best_pairs(worth, worth > 0).tolist() == [[0, 1], [1, 0]]


def test_what_is_not_allowed_is_not_paired():
    worth = np.array([[0.9, -3.0], [0.8, -2.0]])
    assert best_pairs(worth, np.array([[True, False], [True, False]])).tolist() == [[0, 0]]
    assert best_pairs(worth, np.zeros((2, 2), bool)).shape == (0, 2)
    assert best_pairs(np.empty((0, 3)), np.empty((0, 3), bool)).shape == (0, 2)
    # Two poor pairs are better than one good one.
    assert len(best_pairs(worth, np.array([[True, True], [True, False]]))) == 2
