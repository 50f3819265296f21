"""A recording of a node's sensors: when each took its frames, and a way to load them one by one.

It may be a folder (`fgloc.datasets.perception_recording`) or a simulation that makes each frame as
it is asked for. Sensors have frames of their own; nothing says that they were taken together.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgloc.arrays import Array, freeze_ns
from fgloc.drive import About
from fgloc.errors import DriveError
from fgloc.frames import Origin
from fgloc.measurements import ObjectTruth
from fgloc.perception.boxes import ImageBoxes
from fgloc.perception.heads import PerceptionNode
from fgloc.timing import Instants

Image = NDArray[np.uint8]
"""(H, W, 3) blue, green, red."""


@dataclass(frozen=True, eq=False)
class Frames:
    """The frames of one sensor, in the order of time.

    Raises DriveError where stamps are no integers, do not match or do not rise.

    t_ns         (N,) when each was taken
    received_ns  (N,) when it arrived
    load         gives frame k: an `Image`, or the points (M, 3) of a cloud in the LiDAR's axes, m;
                 it raises DriveError, with the file's name, where the frame cannot be read
    """

    sensor: str
    t_ns: Instants
    received_ns: Instants
    load: Callable[[int], NDArray[Any]]

    def __post_init__(self) -> None:
        for name in ("t_ns", "received_ns"):
            stamps = freeze_ns(f"{self.sensor}.{name}", getattr(self, name), DriveError)
            object.__setattr__(self, name, stamps)
        if self.t_ns.shape != self.received_ns.shape:
            raise DriveError(f"sensor {self.sensor!r}: t_ns and received_ns differ in length")
        still = np.flatnonzero(self.t_ns[1:] <= self.t_ns[:-1])
        if len(still):
            row = int(still[0]) + 1
            raise DriveError(
                f"sensor {self.sensor!r}: frame {row}: t_ns = {self.t_ns[row]} is not later than "
                "that of the frame before; frames must be in time order"
            )

    def __len__(self) -> int:
        return len(self.t_ns)


@dataclass(frozen=True, eq=False)
class Recording:
    """What a node's sensors recorded.

    Raises DriveError where frames and sensors do not match, or a box is of a frame that is not.

    images   frames of each camera of the node, in their order
    clouds   frames of the LiDAR of each head, None where a head has none
    boxes    of an external detector, or None
    objects  where the road users really were, or None
    """

    name: str
    origin: Origin
    node: PerceptionNode
    images: tuple[Frames, ...]
    clouds: tuple[Frames | None, ...]
    boxes: ImageBoxes | None = None
    objects: ObjectTruth | None = None
    about: About = field(default_factory=About)

    def __post_init__(self) -> None:
        named = [camera.name for camera in self.node.cameras]
        lidars = [head.lidar.name if head.lidar else None for head in self.node.heads]
        if [frames.sensor for frames in self.images] != named or [
            frames.sensor if frames else None for frames in self.clouds
        ] != lidars:
            raise DriveError(f"recording {self.name!r}: frames and sensors are not the same")
        if self.boxes is not None:
            self._check_boxes(self.boxes)

    def _check_boxes(self, boxes: ImageBoxes) -> None:
        counts = np.array([len(frames) for frames in self.images], np.int64)
        known = boxes.camera < len(counts)
        if not known.all():
            row = int(np.argmin(known))
            raise DriveError(
                f"recording {self.name!r}: boxes row {row}: camera = {boxes.camera[row]}, but the "
                f"node has {len(counts)} cameras, counted from 0"
            )
        late = boxes.frame >= counts[boxes.camera]
        if late.any():
            row = int(np.argmax(late))
            camera = boxes.camera[row]
            raise DriveError(
                f"recording {self.name!r}: boxes row {row}: frame = {boxes.frame[row]}, but camera "
                f"{camera} has {counts[camera]} frames, counted from 0"
            )

    def image(self, camera: int, frame: int) -> Image:
        """Frame (H, W, 3) of a camera; DriveError where it cannot be read or has another size than
        the camera."""
        image = self.images[camera].load(frame)
        width, height = self.node.cameras[camera].size_px
        if image.shape != (height, width, 3):
            raise DriveError(
                f"camera {self.images[camera].sensor!r}: frame {frame} is {image.shape[1]} x "
                f"{image.shape[0]} px, the camera {width} x {height}; correct its size_px"
            )
        return image

    def cloud(self, head: int, frame: int) -> Array:
        """Points (M, 3) of a head's LiDAR in the node's axes, m; those that are not finite, as some
        drivers write for no return, are left out."""
        frames, lidar = self.clouds[head], self.node.heads[head].lidar
        if frames is None or lidar is None:
            raise DriveError(f"head {self.node.heads[head].name!r} has no LiDAR")
        points = frames.load(frame)
        return lidar.to_node(points[np.isfinite(points).all(-1)])
