"""From a recording of a node's sensors to what the node tells of the road users: detections.

Lee et al. (2021), Fig. 4, frame by frame: boxes in the images, cuboids in the clouds, the tracks of
each head, the objects of the node. What cannot be used is counted, nothing is left out in silence.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from fgloc.errors import InputError
from fgloc.measurements import NodeDetections
from fgloc.perception.attempts import Account
from fgloc.perception.boxes import Cuboids, ImageBoxes
from fgloc.perception.checks import align, remarks, unmatched
from fgloc.perception.detectors import BackgroundDetector, Detector, TableDetector
from fgloc.perception.ground import ByBottom, ByCentre, ByMap, Placing
from fgloc.perception.head_fusion import HeadFusion, Objects
from fgloc.perception.lidar_detector import LidarDetector
from fgloc.perception.onnx_detector import OnnxDetector
from fgloc.perception.recording import Image, Recording
from fgloc.perception.schedule import Take, missing, node_frames, spread
from fgloc.perception.settings import PerceiveConfig
from fgloc.perception.tracker import Tracker


@dataclass(frozen=True, eq=False)
class Seen:
    """One frame of the node: what it tells of, at the instant of its last measurement.

    boxes, images  by the number of the camera
    """

    t_ns: int
    received_ns: int
    objects: Objects
    boxes: dict[int, ImageBoxes]
    images: dict[int, Image]


@dataclass(frozen=True, eq=False)
class Perceived:
    """What came of a recording.

    detections  of the drive's node 0
    frames      of the node
    dropped     how much was not used, by the reason
    remarks     what seems wrong with the recording
    seconds     of the processor, by the stage
    """

    detections: NodeDetections
    frames: int
    dropped: dict[str, int]
    remarks: tuple[str, ...]
    seconds: dict[str, float]


def perceive(
    recording: Recording, config: PerceiveConfig, map_places: ByMap | None = None,
    show: Callable[[int, int, Seen], None] = lambda done, of, seen: None,
) -> Perceived:  # fmt: skip
    """The detections of a recording.

    map_places  the map from boxes to the ground, for `place.point` 'idw'
    show        is told, after each frame of the node, how many of how many are done, and the frame

    Raises InputError where nothing can be learnt or no object was seen, or a setting needs what the
    recording does not have.
    """
    pipeline = Pipeline(recording, config, map_places)
    groups = node_frames(recording, config.together_s, *pipeline.uses)
    seen = []
    for done, takes in enumerate(groups, 1):
        frame = pipeline.step(takes)
        seen.append(frame)
        show(done, len(groups), frame)
        frame.images.clear()  # a recording's images do not fit in memory
    pipeline.conclude()
    account = pipeline.account
    dropped = {reason: n for reason, n in account.dropped.items() if n}
    if not sum(len(frame.objects) for frame in seen):
        lost = ", ".join(f"{reason} ({n})" for reason, n in dropped.items()) or "none"
        raise InputError(
            f"recording {recording.name!r}: no object was seen in {len(seen)} frames; what was "
            f"dropped: {lost}; look at its frames and at the detectors' settings"
        )
    return Perceived(
        _table(seen), len(seen), dropped, tuple(account.remarks), dict(account.seconds)
    )  # fmt: skip


class Pipeline:
    """The stages of one recording, with what they have learnt of it.

    uses  whether cameras, and LiDARs, are used
    """

    def __init__(
        self, recording: Recording, config: PerceiveConfig, map_places: ByMap | None = None
    ) -> None:
        self.recording, self.config, self.account = recording, config, Account()
        self.uses = config.method != "lidar", config.method != "camera"
        for sensors, used in zip((recording.images, recording.clouds), self.uses, strict=True):
            for frames in sensors if used else ():
                if frames is not None and (remark := missing(frames)):
                    self.account.remarks.append(remark)
        self.trackers = self._trackers(map_places)
        with self.account.stage("learning"):
            self.detectors = self._detectors() if self.uses[0] else {}
            self.lidars = self._lidars() if self.uses[1] else {}
        self.fusion = HeadFusion(config.heads)
        self._boxes_of: dict[int, int] = dict.fromkeys(self.detectors, 0)

    def step(self, takes: Sequence[Take]) -> Seen:
        """One frame of the node."""
        images: dict[int, Image] = {}
        found: list[tuple[Take, Cuboids | ImageBoxes]] = []
        for take in takes:
            what = self._boxes(take, images) if take.is_camera else self._cuboids(take)
            if what is not None:
                found.append((take, what))
        with self.account.stage("tracks"):
            objects = self._objects(takes, found)
        boxes = {take.number: what for take, what in found if isinstance(what, ImageBoxes)}
        received_ns = max(take.received_ns for take in takes)
        return Seen(takes[-1].t_ns, received_ns, objects, boxes, images)

    def conclude(self) -> None:
        """What all frames together tell of the recording."""
        cameras = self.recording.node.cameras
        pairs = [match for tracker in self.trackers for match in tracker.matches]
        for number, boxes in self._boxes_of.items():
            own = [match for match in pairs if match.camera == number]
            if found := align(own):
                self.account.remarks += remarks(cameras[number].name, found)
            if self.lidars and (told := unmatched(cameras[number].name, boxes, len(own))):
                self.account.remarks.append(told)
            detector = self.detectors[number]
            if isinstance(detector, BackgroundDetector):
                reason = f"{cameras[number].name}: boxes too small or too large for their place"
                self.account.dropped[reason] += detector.dropped
        for tracker in self.trackers:
            self.account.dropped["tracks that were not confirmed"] += tracker.doubtful

    def _boxes(self, take: Take, images: dict[int, Image]) -> ImageBoxes | None:
        name = self.recording.images[take.number].sensor
        image = self.account.tried(name, partial(self.recording.image, take.number, take.frame))
        if image is None:
            return None
        images[take.number] = image
        with self.account.stage("boxes in images"):
            boxes = self.detectors[take.number].find(take.number, take.frame, image)
        self._boxes_of[take.number] += len(boxes)
        return boxes

    def _cuboids(self, take: Take) -> Cuboids | None:
        name = self.recording.node.heads[take.number].name
        cloud = self.account.tried(name, partial(self.recording.cloud, take.number, take.frame))
        if cloud is None:
            return None
        self.account.dropped[f"{name}: empty clouds"] += not len(cloud)
        with self.account.stage("cuboids in clouds"):
            found = self.lidars[take.number].look(cloud, take.frame)
        for reason, clusters in found.left_out.items():
            self.account.dropped[f"{name}: clusters left out: {reason}"] += clusters
        return found.cuboids

    def _objects(
        self, takes: Sequence[Take], found: Sequence[tuple[Take, Cuboids | ImageBoxes]]
    ) -> Objects:
        head_of = self.recording.node.head_of_camera
        for tracker in self.trackers:
            tracker.begin(takes[0].t_ns)
        for take, what in found:
            if isinstance(what, Cuboids):
                self.trackers[take.number].see_cuboids(take.t_ns, what)
            else:
                self.trackers[head_of[take.number]].see_boxes(take.t_ns, take.number, what)
        told = []
        for tracker in self.trackers:
            tracker.advance(takes[-1].t_ns)
            tracks = tracker.end()
            measured = self.config.report == "measured"
            told.append((tracks, tracks.alone if measured else tracks.belief))
        return self.fusion.join(told)

    def _detectors(self) -> dict[int, Detector]:
        """A detector of each camera by its number."""
        recording, config = self.recording, self.config
        cameras = dict(enumerate(recording.node.cameras))
        if config.detector == "table":
            if recording.boxes is None:
                raise InputError(
                    f"recording {recording.name!r} has no boxes.csv; give another detector"
                )
            return dict.fromkeys(cameras, TableDetector(recording.boxes))
        if config.detector == "onnx":
            return dict.fromkeys(cameras, OnnxDetector(config.onnx))
        ground_m = recording.node.ground_m
        return {
            number: BackgroundDetector(camera, ground_m, self._images(number), config.background)
            for number, camera in cameras.items()
        }

    def _images(self, number: int) -> Iterator[Image]:
        """Images of a camera over the whole recording; those that cannot be read count later."""
        quiet = Account()
        frames = self.recording.images[number]
        for frame in spread(len(frames), self.config.background.learn_frames):
            image = quiet.tried("", partial(self.recording.image, number, frame))
            if image is not None:
                yield image

    def _lidars(self) -> dict[int, LidarDetector]:
        """The detector of each head that has a LiDAR."""
        return {
            head: LidarDetector.learn(
                self.recording.node, head, self._clouds(head), self.config.lidar
            )
            for head, frames in enumerate(self.recording.clouds)
            if frames is not None
        }  # fmt: skip

    def _clouds(self, head: int) -> Iterator[np.ndarray]:
        quiet = Account()
        frames = self.recording.clouds[head]
        for frame in spread(len(frames or ()), self.config.lidar.learn_frames):
            cloud = quiet.tried("", partial(self.recording.cloud, head, frame))
            if cloud is not None:
                yield cloud

    def _trackers(self, map_places: ByMap | None) -> list[Tracker]:
        node = self.recording.node
        places = {number: self._placing(number, map_places) for number in range(len(node.cameras))}
        trackers = []
        for number, head in enumerate(node.heads):
            own = np.flatnonzero(node.head_of_camera == number).tolist()
            cameras = {camera: node.cameras[camera] for camera in own}
            of_head = {camera: places[camera] for camera in own}
            trackers.append(Tracker(cameras, of_head, head.lidar, node.ground_m, self.config))
        return trackers

    def _placing(self, number: int, map_places: ByMap | None) -> Placing:
        node, place = self.recording.node, self.config.place
        if place.point != "idw":
            way = ByCentre if place.point == "centre" else ByBottom
            return way(node.cameras[number], node.ground_m, place)
        if map_places is None or len(node.cameras) != 1:
            raise InputError(
                "place.point = 'idw' needs place.idw_file, the calibration set of a map, and a "
                f"node of one camera; this one has {len(node.cameras)}"
            )
        return map_places


def _table(seen: Sequence[Seen]) -> NodeDetections:
    """The frames' objects as detections of node 0, without heights: cuboids are put on the ground
    of the survey, so that theirs would tell of that and of no tilt."""
    counts = [len(frame.objects) for frame in seen]
    t_ns, received_ns = (
        np.repeat(np.array(stamps, np.int64), counts)
        for stamps in ([frame.t_ns for frame in seen], [frame.received_ns for frame in seen])
    )
    columns = [
        np.concatenate([getattr(frame.objects, name) for frame in seen])
        for name in ("object_id", "kind", "p_node_m", "cov_m2")
    ]
    return NodeDetections(t_ns, received_ns, np.zeros(len(t_ns), np.int64), *columns)
