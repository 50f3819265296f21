"""Boxes in the images of a node: from a table, or as different from a fixed camera's background.

The background of each pixel is a mixture of Gaussians (Zivkovic, Improved adaptive Gaussian mixture
model for background subtraction, ICPR 2004; OpenCV's MOG2), learnt from frames over the whole
recording. What differs is cleaned of single pixels, parts that are close are joined, and each part
becomes a box if an object of its size could stand on the ground there. It knows no classes: narrow
and tall is a pedestrian, all else a vehicle. A camera that moves has no background.
"""

from collections.abc import Iterable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fgloc.measurements import PEDESTRIAN, VEHICLE, Array
from fgloc.perception.boxes import ImageBoxes
from fgloc.perception.ground import on_border, upright_size_m
from fgloc.perception.heads import Camera
from fgloc.perception.recording import Image
from fgloc.perception.settings import BackgroundConfig

_DIFFERS = 255
"""MOG2's mark; shadows have 127."""
UPRIGHT = 1.2
"""A pedestrian is so many times higher than wide, at least."""
_SPECK = np.ones((3, 3), np.uint8)


class Detector(Protocol):
    """Finds the boxes in an image."""

    def find(self, camera: int, frame: int, image: Image) -> ImageBoxes:
        """The boxes in a frame of a camera, given by its number."""
        ...


class TableDetector:
    """Boxes of any detector that ran elsewhere; images are not looked at."""

    def __init__(self, boxes: ImageBoxes) -> None:
        self.boxes = boxes

    def find(self, camera: int, frame: int, image: Image | None = None) -> ImageBoxes:
        """The table's rows of the frame, in their order."""
        return self.boxes.take((self.boxes.camera == camera) & (self.boxes.frame == frame))


class BackgroundDetector:
    """What is new before the background of one fixed camera; frames are to come in their order.

    ground_m  z of the ground in the node's axes
    learn     images of the camera, spread over the recording
    dropped   how many boxes were left out, as too small or large for an object at their place
    """

    def __init__(
        self, camera: Camera, ground_m: float, learn: Iterable[Image], config: BackgroundConfig
    ) -> None:
        import cv2

        self.camera, self.ground_m, self.config = camera, ground_m, config
        self.dropped = 0
        self._model: Any = cv2.createBackgroundSubtractorMOG2(
            varThreshold=config.threshold, detectShadows=config.shadows
        )
        self._model.setBackgroundRatio(config.least_ratio)
        for count, image in enumerate(learn, 1):
            self._model.apply(self._small(image), learningRate=1 / count)

    def find(self, camera: int, frame: int, image: Image) -> ImageBoxes:
        """The boxes in a frame; its score is the share of the box that differs."""
        mask = self._model.apply(self._small(image), learningRate=self.config.learning_rate)
        box_px, score = _parts(mask == _DIFFERS, self.config)
        scale = np.array(self.camera.size_px) / np.array(mask.shape[::-1])
        box_px = box_px * np.tile(scale, 2) - 0.5  # edges of pixels, whose centres are whole
        width_m, height_m = upright_size_m(self.camera, self.ground_m, box_px)
        fits = self._fits(box_px, width_m, height_m)
        self.dropped += int((~fits).sum())
        narrow = width_m < np.minimum(self.config.pedestrian_width_m, height_m / UPRIGHT)
        kind = np.where(narrow, PEDESTRIAN, VEHICLE)[fits]
        n = int(fits.sum())
        return ImageBoxes(
            np.full(n, frame), np.full(n, camera), box_px[fits], kind, np.asarray(score[fits])
        )

    def _small(self, image: Image) -> Image:
        import cv2

        if self.config.shrink == 1:
            return image
        size = tuple(side // self.config.shrink for side in image.shape[1::-1])
        return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)

    def _fits(self, box_px: Array, width_m: Array, height_m: Array) -> NDArray[np.bool_]:
        """Which boxes could be of an object; one that the image cuts off may seem too small."""
        c = self.config
        small = (width_m < c.least_width_m) | (height_m < c.least_height_m)
        large = (width_m > c.most_width_m) | (height_m > c.most_height_m)
        known = np.isfinite(width_m)
        return np.asarray(known & ~large & (~small | on_border(self.camera, box_px)))


def _parts(differs: NDArray[np.bool_], config: BackgroundConfig) -> tuple[Array, Array]:
    """Edges (N, 4) of the parts of a mask in px of it, and the share (N,) of each that differs."""
    import cv2

    clean = cv2.morphologyEx(differs.astype(np.uint8), cv2.MORPH_OPEN, _SPECK)
    near = np.ones((config.close_px, config.close_px), np.uint8)
    whole = cv2.morphologyEx(clean, cv2.MORPH_CLOSE, near)
    _, _, stats, _ = cv2.connectedComponentsWithStats(whole)
    left, upper, width, height, area = stats[1:].T.astype(float)  # the first is the background
    box = np.column_stack([left, upper, left + width, upper + height])
    large = area >= config.least_area_px
    return box[large], (area / (width * height))[large]
