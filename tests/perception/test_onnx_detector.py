"""A network of one's own: letterbox, layouts of its output, classes, overlapping boxes, faults."""

import numpy as np
import pytest

from fgloc.errors import InputError
from fgloc.measurements import PEDESTRIAN, VEHICLE
from fgloc.perception.onnx_detector import GREY, OnnxDetector, parse
from fgloc.perception.settings import OnnxConfig

from .onnx_bytes import network

WIDTH, HEIGHT = 64, 32
IMAGE = np.full((40, 40, 3), 200, np.uint8)
"""Scaled by 0.8, with bars of 16 px to the left and right."""


@pytest.fixture
def detector(tmp_path):
    """A detector whose network says rows of left, upper, right, lower, score, class."""

    def make(rows, gain=None, **settings):
        file = tmp_path / "net.onnx"
        output = np.array([rows], float)
        gain = np.zeros_like(output) if gain is None else np.array([gain], float)
        file.write_bytes(network(output, gain, WIDTH, HEIGHT))
        given = {"width_px": WIDTH, "height_px": HEIGHT, "layout": "boxes", **settings}
        return OnnxDetector(OnnxConfig(file=str(file), **given))

    return make


def test_boxes_come_back_to_the_image_from_the_letterbox(detector):
    found = detector([[24, 8, 40, 16, 0.9, 2]]).find(3, 7, IMAGE)
    np.testing.assert_allclose(found.box_px, [[9.5, 9.5, 29.5, 19.5]])
    assert (found.camera.item(), found.frame.item(), found.kind.item()) == (3, 7, VEHICLE)
    assert found.score.item() == pytest.approx(0.9)


def test_the_network_is_shown_the_scaled_image_between_grey_bars(detector):
    # Its score is the mean of what it sees.
    found = detector([[24, 8, 40, 16, 0.0, 0]], gain=[[0, 0, 0, 0, 1, 0]]).find(0, 0, IMAGE)
    mean = (200 + GREY) / 2 / 255
    assert found.score.item() == pytest.approx(mean, abs=1e-4)


def test_other_classes_and_poor_scores_are_left_out(detector):
    rows = [[20, 2, 30, 9, 0.9, 0], [30, 20, 40, 30, 0.9, 9], [20, 20, 28, 30, 0.1, 2]]
    assert detector(rows).find(0, 0, IMAGE).kind.tolist() == [PEDESTRIAN]
    assert len(detector([rows[1]]).find(0, 0, IMAGE)) == 0


def test_of_boxes_of_one_kind_that_overlap_the_best_stays(detector):
    rows = [[20, 2, 40, 22, 0.7, 2], [21, 2, 41, 22, 0.8, 7], [20, 2, 40, 22, 0.6, 0]]
    found = detector(rows).find(0, 0, IMAGE)
    assert sorted(zip(found.kind.tolist(), found.score.round(1).tolist(), strict=True)) == [
        (VEHICLE, 0.8), (PEDESTRIAN, 0.6),
    ]  # fmt: skip


def test_layouts_of_the_yolo_family_say_the_same():
    eight = np.array([[[24.0], [12], [16], [8], [0.1], [0.2], [0.9]]])
    five = np.array([[[24.0, 12, 16, 8, 0.9, 0.1, 0.2, 1.0]]])
    for layout, output in (("yolov8", eight), ("yolov5", five)):
        found = parse(output, OnnxConfig(layout=layout))
        np.testing.assert_allclose(found.box_px, [[16, 8, 32, 16]])
        assert found.class_.item() == 2
        assert found.score.item() == pytest.approx(0.9)


@pytest.mark.parametrize("shape", [(1, 4, 10), (3,), (2, 8, 9)])
def test_an_output_of_another_shape_is_refused(shape):
    with pytest.raises(InputError, match=r"not that of onnx\.layout = 'boxes'"):
        parse(np.zeros(shape), OnnxConfig(layout="boxes"))


def test_a_file_that_is_no_network_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        OnnxDetector(OnnxConfig(file=str(tmp_path / "none.onnx")))
    (tmp_path / "text.onnx").write_text("hello")
    with pytest.raises(InputError, match="does not read this network"):
        OnnxDetector(OnnxConfig(file=str(tmp_path / "text.onnx")))
