"""Boxes in images: those of a table, and what is new before a fixed background."""

import numpy as np
import pytest

from fgloc.measurements import PEDESTRIAN, VEHICLE
from fgloc.perception.boxes import ImageBoxes
from fgloc.perception.detectors import BackgroundDetector, TableDetector
from fgloc.perception.paper_nodes import pinhole
from fgloc.perception.settings import BackgroundConfig

CAMERA = pinhole("camera", 0.0, size_px=(480, 300), focal_px=286.0)
GROUND_M = -10.0
CAR_PX, PERSON_PX = (300, 150, 360, 190), (100, 140, 110, 166)
CONFIG = BackgroundConfig(shrink=1)


def image(*objects, seed=0):
    """Grey noise with rectangles; a person's is red, any other white."""
    rng = np.random.default_rng(seed)
    made = 110 + 4 * rng.standard_normal((300, 480, 3))
    for left, upper, right, lower in objects:
        made[upper:lower, left:right] = (30, 30, 200) if right - left < 20 else 240
    return made.clip(0, 255).astype(np.uint8)


def detector(config=CONFIG, learn=None):
    learn = [image(seed=k) for k in range(20)] if learn is None else learn
    return BackgroundDetector(CAMERA, GROUND_M, learn, config)


@pytest.mark.parametrize(("shrink", "within_px"), [(1, 1.0), (2, 2.0)])
def test_what_is_new_is_boxed_with_its_kind(shrink, within_px):
    found = detector(BackgroundConfig(shrink=shrink)).find(2, 5, image(CAR_PX, PERSON_PX, seed=99))
    order = np.argsort(-found.box_px[:, 0])
    expected = np.array([CAR_PX, PERSON_PX]) - 0.5
    np.testing.assert_allclose(found.box_px[order], expected, atol=within_px)
    assert found.kind[order].tolist() == [VEHICLE, PEDESTRIAN]
    assert found.camera.tolist() == [2, 2]
    assert found.frame.tolist() == [5, 5]
    assert (found.score > 0.9).all()


def test_the_background_alone_has_no_boxes():
    assert len(detector().find(0, 0, image(seed=99))) == 0


def test_traffic_while_it_learns_is_no_background():
    # The same car stands in a third of the frames at the same place.
    learn = [image(CAR_PX, seed=k) if k % 3 == 0 else image(seed=k) for k in range(21)]
    assert len(detector(learn=learn).find(0, 0, image(CAR_PX, seed=99))) == 1


def test_equal_images_give_equal_boxes():
    first, second = (detector().find(0, 0, image(CAR_PX, seed=7)) for _ in range(2))
    np.testing.assert_array_equal(first.box_px, second.box_px)


def test_parts_that_are_close_are_one():
    left, right = (300, 150, 327, 190), (333, 150, 360, 190)
    assert len(detector().find(0, 0, image(left, right, seed=9))) == 1


def test_what_cannot_stand_there_is_left_out_and_counted():
    low_wall = (50, 250, 130, 254)  # near, and 0.2 m high
    sky = (200, 5, 240, 20)
    made = detector()
    assert len(made.find(0, 0, image(low_wall, sky, CAR_PX, seed=9))) == 1
    assert made.dropped == 2


def test_a_table_gives_the_rows_of_the_frame():
    boxes = ImageBoxes([0, 1, 1, 1], [0, 0, 1, 0], np.tile([0.0, 0, 9, 9], (4, 1)),
                       [1, 1, 2, 2], [1, 0.5, 1, 1])  # fmt: skip
    found = TableDetector(boxes).find(0, 1)
    assert found.score.tolist() == [0.5, 1]
    assert len(TableDetector(boxes).find(1, 0)) == 0
