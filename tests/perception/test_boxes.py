"""Tables of what detectors find: shapes, corners by hand, and what is refused."""

import numpy as np
import pytest

from fgloc.errors import InputError
from fgloc.measurements import PEDESTRIAN, VEHICLE
from fgloc.perception.boxes import Cuboids, ImageBoxes


def boxes(**changed) -> ImageBoxes:
    columns = {
        "frame": [0, 1], "camera": [0, 1], "box_px": [[1.0, 2, 3, 4], [5, 6, 9, 8]],
        "kind": [VEHICLE, PEDESTRIAN], "score": [0.5, 1.0],
    }  # fmt: skip
    return ImageBoxes(**{name: np.array(column) for name, column in {**columns, **changed}.items()})


def cuboids(**changed) -> Cuboids:
    columns = {
        "frame": [3], "head": [0], "centre_m": [[10.0, 5, -9]], "size_m": [[4.0, 2, 1.5]],
        "yaw_rad": [np.pi / 2], "points": [12], "cov_m2": [[[1.0, 0.2], [0.2, 2]]],
    }  # fmt: skip
    return Cuboids(**{name: np.array(column) for name, column in {**columns, **changed}.items()})


def test_rows_are_taken_and_put_together():
    both = ImageBoxes.concat([boxes(), boxes().take([1])])
    assert both.frame.tolist() == [0, 1, 1]
    assert both.box_px[2].tolist() == [5, 6, 9, 8]
    assert len(ImageBoxes.none()) == len(Cuboids.none()) == len(ImageBoxes.concat([])) == 0
    assert ImageBoxes.none().kind.dtype == np.int64
    with pytest.raises(ValueError, match="read-only"):
        both.box_px[0, 0] = 1.0


def test_corners_turn_with_the_yaw():
    corners = cuboids().corners_m()[0]
    # Its length lies along y; from the rear right, so from x + 1, y - 2.
    lower = [[11, 3, -9.75], [11, 7, -9.75], [9, 7, -9.75], [9, 3, -9.75]]
    np.testing.assert_allclose(corners[:4], lower)
    np.testing.assert_allclose(corners[4:], np.add(lower, [0, 0, 1.5]))


@pytest.mark.parametrize(("changed", "message"), [
    ({"box_px": [[1, 2, 3, 4], [5, 6, 5, 8]]}, r"image boxes row 1: box_px = \[5.0, 6.0, 5.0, 8.0"),
    ({"score": [0.5, 1.5]}, "row 1: score = 1.5: expected 0 to 1"),
    ({"score": [np.nan, 1]}, "row 0: score = nan: expected finite"),
    ({"kind": [1, 7]}, "row 1: kind = 7: expected one of"),
    ({"frame": [-1, 0]}, "row 0: frame = -1: frames count from 0"),
    ({"camera": [0, -2]}, "row 1: camera = -2: cameras count from 0"),
    ({"box_px": [[1, 2, 3, 4]]}, r"box_px has shape \(1, 4\), expected \(2, 4\)"),
])  # fmt: skip
def test_impossible_boxes_are_told_with_their_row(changed, message):
    with pytest.raises(InputError, match=message):
        boxes(**changed)


def test_impossible_cuboids_are_told_with_their_row():
    with pytest.raises(InputError, match=r"cuboids row 0: size_m = \[4.0, 0.0, 1.5\]"):
        cuboids(size_m=[[4.0, 0, 1.5]])
    with pytest.raises(InputError, match="not symmetric"):
        cuboids(cov_m2=[[[1.0, 0.2], [0.3, 2]]])
