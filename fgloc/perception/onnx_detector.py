"""Boxes by a detector of the user's own: a network in ONNX, run by OpenCV.

The image is scaled to fit the network's input, in its middle, with grey bars on the sides that stay
free (letterbox). Of what the network says, boxes of the stated classes above a score are kept, and
of boxes of one kind that overlap the one of the highest score (non-maximum suppression).
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgloc.errors import InputError
from fgloc.measurements import PEDESTRIAN, UNKNOWN, VEHICLE, Array
from fgloc.perception.boxes import ImageBoxes
from fgloc.perception.recording import Image
from fgloc.perception.settings import OnnxConfig

GREY = 114
"""Of the bars, as detectors of the YOLO family are trained with."""


class Found(NamedTuple):
    """Edges (N, 4) in px of the network's input, scores (N,) and numbers of classes (N,)."""

    box_px: Array
    score: Array
    class_: NDArray[np.int64]


class OnnxDetector:
    """A network from a file; InputError where it is none that OpenCV reads."""

    def __init__(self, config: OnnxConfig) -> None:
        import cv2

        if not Path(config.file).is_file():
            raise InputError(f"onnx.file = {config.file!r}: no such file; give a network in ONNX")
        try:
            self._net = cv2.dnn.readNetFromONNX(config.file)
        except (cv2.error, SystemError) as err:
            raise InputError(
                f"{config.file}: OpenCV does not read this network: {_first_line(err)}"
            ) from err
        self.config = config

    def find(self, camera: int, frame: int, image: Image) -> ImageBoxes:
        """The boxes in an image (H, W, 3); InputError where the network does not run on it or its
        output is not laid out as stated."""
        c = self.config
        placed, scale, corner_px = _letterbox(image, c.width_px, c.height_px)
        found = parse(self._run(placed), c)
        kind = _kinds(found.class_, c)
        # Pixel centres are whole numbers here and there: edges are half a pixel off.
        box_px = (found.box_px - np.tile(corner_px, 2)) / scale - 0.5
        limit = np.tile(image.shape[1::-1], 2) - 0.5
        box_px = np.clip(box_px, -0.5, limit)
        fits = (found.score >= c.least_score) & (kind != UNKNOWN)
        fits &= (box_px[:, 2:] > box_px[:, :2]).all(-1)
        best = np.flatnonzero(fits)[_suppressed(box_px[fits], found.score[fits], kind[fits], c)]
        n = len(best)
        score = np.clip(found.score[best], 0, 1)
        return ImageBoxes(np.full(n, frame), np.full(n, camera), box_px[best], kind[best], score)

    def _run(self, placed: Image) -> Array:
        import cv2

        c = self.config
        blob = cv2.dnn.blobFromImage(placed, c.scale, swapRB=c.rgb)
        try:
            self._net.setInput(blob)
            return np.asarray(self._net.forward(), float)
        except cv2.error as err:
            raise InputError(
                f"{c.file}: the network does not run on an image of {c.width_px} x {c.height_px} "
                f"px: {_first_line(err)}; correct onnx.width_px and onnx.height_px"
            ) from err


def parse(output: Array, config: OnnxConfig) -> Found:
    """What a network's output of the configured layout says; InputError where its shape differs."""
    rows = output[0] if output.ndim == 3 and output.shape[0] == 1 else output
    if config.layout == "yolov8" and rows.ndim == 2:
        rows = rows.T
    least = {"yolov5": 6, "yolov8": 5, "boxes": 6}[config.layout]
    exact = config.layout == "boxes"
    if rows.ndim != 2 or rows.shape[1] < least or (exact and rows.shape[1] != least):
        raise InputError(
            f"{config.file}: the output has shape {output.shape}, which is not that of "
            f"onnx.layout = {config.layout!r}; give the layout that the network has"
        )
    if config.layout == "boxes":
        return Found(rows[:, :4], rows[:, 4], rows[:, 5].astype(np.int64))
    middle, half = rows[:, :2], rows[:, 2:4] / 2
    of_class = rows[:, 4:] if config.layout == "yolov8" else rows[:, 5:] * rows[:, 4:5]
    edges = np.concatenate([middle - half, middle + half], -1)
    return Found(edges, of_class.max(-1), of_class.argmax(-1))


def _letterbox(image: Image, width: int, height: int) -> tuple[Image, float, Array]:
    """The image within width x height px, its scale, and where its upper left corner is, px."""
    import cv2

    high, wide = image.shape[:2]
    scale = min(width / wide, height / high)
    size = round(wide * scale), round(high * scale)
    left, upper = (width - size[0]) // 2, (height - size[1]) // 2
    placed = np.full((height, width, 3), GREY, np.uint8)
    small = cv2.resize(image, size, interpolation=cv2.INTER_LINEAR)
    placed[upper : upper + size[1], left : left + size[0]] = small
    return placed, scale, np.array([left, upper], float)


def _kinds(class_: NDArray[np.int64], config: OnnxConfig) -> NDArray[np.int64]:
    kind = np.where(np.isin(class_, config.vehicle_classes), VEHICLE, UNKNOWN)
    return np.where(np.isin(class_, config.pedestrian_classes), PEDESTRIAN, kind)


def _suppressed(
    box_px: Array, score: Array, kind: NDArray[np.int64], config: OnnxConfig
) -> NDArray[np.int64]:
    """Rows that stay, of boxes that overlap others of their kind."""
    import cv2

    if not len(box_px):
        return np.empty(0, np.int64)
    corner_and_size = np.column_stack([box_px[:, :2], box_px[:, 2:] - box_px[:, :2]])
    rows = cv2.dnn.NMSBoxesBatched(
        corner_and_size.tolist(), score.tolist(), kind.tolist(), 0.0, config.nms_iou
    )
    return np.asarray(rows, np.int64).reshape(-1)


def _first_line(err: BaseException) -> str:
    return " ".join(str(err).split())[:200]
