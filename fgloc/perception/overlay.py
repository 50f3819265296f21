"""Pictures to look at: what the cameras saw, with boxes and tracked cuboids, and a plan beside it.

A strip has a row for each of some frames over the recording: the images of all cameras, with the
detectors' boxes thin and yellow and the cuboid of each object in the colour of its number, and a
plan with cuboids, paths so far, the node (a cross) and, where it is known, the truth (white rings).
"""

from typing import NamedTuple

import numpy as np

from fgloc.measurements import PEDESTRIAN, VEHICLE, Array
from fgloc.perception.boxes import upright_corners
from fgloc.perception.heads import Camera
from fgloc.perception.pipeline import Seen
from fgloc.perception.recording import Image, Recording
from fgloc.perception.schedule import spread
from fgloc.perception.track_filter import Belief

ROWS = 6
WIDTH_PX, HEIGHT_PX = 640, 400
"""Of an image and of the plan in the strip."""
LETTERS = {VEHICLE: "V", PEDESTRIAN: "P"}
PALETTE = ((66, 133, 244), (52, 168, 83), (234, 67, 53), (171, 71, 188), (0, 172, 193),
           (255, 112, 67), (158, 157, 36), (240, 98, 146))  # fmt: skip
_YELLOW, _WHITE, _GREY, _DARK = (60, 230, 250), (255, 255, 255), (150, 150, 150), (45, 40, 40)
_EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4),
          (0, 4), (1, 5), (2, 6), (3, 7))  # fmt: skip
_MARGIN_M, _GRID_M = 5.0, 20
_BITS = 3


class _Row(NamedTuple):
    time_s: float
    images: list[Image]
    objects: Belief
    ids: list[int]
    truth_m: Array


class Strip:
    """Collects rows while frames go by; `image` draws the strip."""

    def __init__(self, recording: Recording, rows: int = ROWS) -> None:
        self.recording, self.rows = recording, rows
        self._chosen: list[_Row] = []
        self._paths: dict[int, list[Array]] = {}
        self._start_ns: int | None = None

    def see(self, done: int, of: int, seen: Seen) -> None:
        """One frame of the node, number `done` of so many from 1."""
        self._start_ns = seen.t_ns if self._start_ns is None else self._start_ns
        for number, place in zip(
            seen.objects.object_id.tolist(), seen.objects.p_node_m, strict=True
        ):
            self._paths.setdefault(number, []).append(place)
        middles = {k + 1 for k in spread(of, self.rows + 2)[1:-1]} or {1}
        if done in middles:
            self._chosen.append(self._row(seen))

    def image(self) -> Image:
        """The strip (H, W, 3); one line of grey where no frame was seen."""
        if not self._chosen:
            return np.full((1, WIDTH_PX, 3), 128, np.uint8)
        places = [np.concatenate([row.objects.x[:, :2], row.truth_m]) for row in self._chosen]
        paths = [np.array(path) for path in self._paths.values()]
        plan = _Plan.around(np.concatenate([*places, *paths, np.zeros((1, 2))]))
        rows = [np.hstack([*row.images, self._draw_plan(plan, row)]) for row in self._chosen]
        return np.vstack(rows)

    def _row(self, seen: Seen) -> _Row:
        ids = seen.objects.object_id.tolist()
        labels = [f"{i} {LETTERS.get(k, '?')}" for i, k in
                  zip(ids, seen.objects.kind.tolist(), strict=True)]  # fmt: skip
        images = []
        for number, camera in enumerate(self.recording.node.cameras):
            image = seen.images.get(number)
            if image is None:
                images.append(np.zeros((HEIGHT_PX, WIDTH_PX, 3), np.uint8))
                continue
            boxes = seen.boxes[number].box_px
            images.append(_draw_image(camera, image, boxes, seen.objects.belief, ids, labels))
        time_s = (seen.t_ns - (self._start_ns or 0)) / 1e9
        return _Row(time_s, images, seen.objects.belief, ids, self._truth_m(seen.t_ns))

    def _truth_m(self, t_ns: int) -> Array:
        """(N, 2) where the road users were at the last instant of the truth by then."""
        truth = self.recording.objects
        if truth is None or truth.t_ns[0] > t_ns:
            return np.zeros((0, 2))
        last_ns = truth.t_ns[np.searchsorted(truth.t_ns, t_ns, side="right") - 1]
        return self.recording.node.node.from_world(truth.p_world_m[truth.t_ns == last_ns])

    def _draw_plan(self, plan: "_Plan", row: _Row) -> Image:
        import cv2

        image = plan.empty()
        for path in self._paths.values():
            line = plan.px(np.array(path))
            cv2.polylines(image, [line], False, _GREY, 1, cv2.LINE_AA, _BITS)
        corners = upright_corners(*row.objects.cuboids)[:, :4, :2]
        for number, corner in zip(row.ids, corners, strict=True):
            shape = plan.px(corner)
            cv2.polylines(image, [shape], True, _colour(number), 2, cv2.LINE_AA, _BITS)
            _write(image, str(number), shape[0] / 2**_BITS, _colour(number))
        for place in plan.px(row.truth_m).reshape(-1, 2):
            cv2.circle(image, place.tolist(), 3 << _BITS, _WHITE, 1, cv2.LINE_AA, _BITS)
        node = (plan.px(np.zeros((1, 2))) / 2**_BITS).astype(int).reshape(2).tolist()
        cv2.drawMarker(image, node, _WHITE, cv2.MARKER_CROSS, 12, 2)
        _write(image, f"{row.time_s:.1f} s; grid {_GRID_M} m", np.array([8.0, 18.0]), _WHITE)
        return image


class _Plan(NamedTuple):
    """From metres along the node's axes to pixels, x to the right and y upwards."""

    scale_pxpm: float
    low_m: Array
    high_m: Array

    @classmethod
    def around(cls, places_m: Array) -> "_Plan":
        low, high = places_m.min(0) - _MARGIN_M, places_m.max(0) + _MARGIN_M
        scale = float(min(WIDTH_PX / (high - low)[0], HEIGHT_PX / (high - low)[1]))
        spare = np.array([WIDTH_PX, HEIGHT_PX]) / scale - (high - low)
        return cls(scale, low - spare / 2, high + spare / 2)

    def px(self, places_m: Array) -> Array:
        """(N, 1, 2) in fractions of a pixel, as OpenCV draws."""
        x, y = (places_m - self.low_m).T
        pixels = np.column_stack([x * self.scale_pxpm, HEIGHT_PX - y * self.scale_pxpm])
        return np.rint(pixels * 2**_BITS).astype(np.int32)[:, None]

    def empty(self) -> Image:
        """The grid."""
        import cv2

        image = np.full((HEIGHT_PX, WIDTH_PX, 3), _DARK, np.uint8)
        for axis in (0, 1):
            first = np.ceil(self.low_m[axis] / _GRID_M) * _GRID_M
            for at in np.arange(first, self.high_m[axis], _GRID_M):
                ends = np.stack([self.low_m, self.high_m])
                ends[:, axis] = at
                cv2.polylines(image, [self.px(ends)], False, (80, 75, 75), 1, cv2.LINE_8, _BITS)
        return image


def _draw_image(
    camera: Camera, image: Image, boxes_px: Array, objects: Belief, ids: list[int],
    labels: list[str],
) -> Image:  # fmt: skip
    """An image in the size of the strip, with boxes and cuboids."""
    import cv2

    small = cv2.resize(image, (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_AREA)
    scale = np.array([WIDTH_PX, HEIGHT_PX]) / camera.size_px
    for box in np.rint(boxes_px.reshape(-1, 2, 2) * scale).astype(int).tolist():
        cv2.rectangle(small, box[0], box[1], _YELLOW, 1)
    corners_m = upright_corners(*objects.cuboids)
    corners_px = camera.project(corners_m.reshape(-1, 3)).reshape(-1, 8, 2) * scale
    for number, label, corners in zip(ids, labels, corners_px, strict=True):
        if not np.isfinite(corners).all() or np.abs(corners).max() > 10 * WIDTH_PX:
            continue
        points = np.rint(corners).astype(int).tolist()
        for first, last in _EDGES:
            cv2.line(small, points[first], points[last], _colour(number), 1, cv2.LINE_AA)
        _write(small, label, corners.min(0) - [0, 3], _colour(number))
    return np.asarray(small, np.uint8)


def _colour(number: int) -> tuple[int, int, int]:
    red, green, blue = PALETTE[number % len(PALETTE)]
    return blue, green, red


def _write(image: Image, text: str, at_px: Array, colour: tuple[int, int, int]) -> None:
    """Text with a dark rim, so that it shows on everything."""
    import cv2

    place = np.rint(np.ravel(at_px)).astype(int).tolist()
    for tint, width in ((_DARK, 3), (colour, 1)):
        cv2.putText(
            image, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, tint, width, cv2.LINE_AA
        )  # fmt: skip
