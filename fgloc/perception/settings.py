"""What `fgloc perceive` can be told, by a TOML file or `key=value`, with default and reason."""

from typing import Literal

from pydantic import Field

from fgloc.config import Section
from fgloc.perception.lidar_settings import LidarConfig


class BackgroundConfig(Section):
    """The embedded detector: what differs from the fixed view of a camera."""

    shrink: int = Field(default=2, ge=1, le=8)
    """Images are made so many times smaller: at 2 a core does more than 20 frames of 1920 x 1200 a
    second, and a car at 80 m still has 10 x 30 px."""
    learn_frames: int = Field(default=40, ge=2, le=1000)
    """Frames over the whole recording that the background is learnt from beforehand."""
    learning_rate: float = Field(default=2e-4, ge=0, lt=1)
    """Share of each later frame in the background: a car that stands becomes part of it after
    minutes, and so does a change of light."""
    threshold: float = Field(default=30.0, gt=0)
    """Squared distance in sigmas of a pixel's colour from its background."""
    least_ratio: float = Field(default=0.6, gt=0, lt=1)
    """Share of the time in which a pixel shows its background; where traffic is dense, cars of one
    colour are seen for a fifth of it."""
    shadows: bool = False
    """Leave out what is only darker than the background; dark cars on asphalt go with it."""
    close_px: int = Field(default=9, ge=1, le=99)
    """Parts of an object nearer to each other, px of the small image, are one."""
    least_area_px: int = Field(default=20, ge=1)
    """Of a box, px of the small image that differ."""
    least_width_m: float = Field(default=0.3, gt=0)
    least_height_m: float = Field(default=0.8, gt=0)
    most_width_m: float = Field(default=20.0, gt=0)
    most_height_m: float = Field(default=8.0, gt=0)
    """Size of an upright object at the box's place on the ground; others are left out."""
    pedestrian_width_m: float = Field(default=1.4, gt=0)
    """A box narrower than this and higher than wide by a fifth is a pedestrian's, any other a
    vehicle's: towards the corners of an image people lean and look as wide as 1.2 m."""


class OnnxConfig(Section):
    """A detector of your own in ONNX, run by OpenCV."""

    file: str = ""
    """The network with its weights; also `--onnx FILE`."""
    width_px: int = Field(default=640, ge=8, le=8192)
    height_px: int = Field(default=640, ge=8, le=8192)
    """Size of the network's input; an image is scaled to fit, with grey bars beside it."""
    layout: Literal["yolov5", "yolov8", "boxes"] = "yolov8"
    """Of the output. yolov8: (1, 4 + classes, N), centre, width and height, a score of each class;
    yolov5: (1, N, 5 + classes), the same with a score of the box before those of the classes;
    boxes: (1, N, 6), left, upper, right, lower, score, class. Boxes are in px of the input."""
    scale: float = Field(default=1 / 255, gt=0)
    """Factor on the colours, 0 to 255."""
    rgb: bool = True
    """Red comes first."""
    vehicle_classes: tuple[int, ...] = (2, 3, 5, 7)
    """Numbers of the classes that are vehicles; those of COCO: car, motorcycle, bus, truck."""
    pedestrian_classes: tuple[int, ...] = (0,)
    """Likewise; what belongs to neither is left out."""
    least_score: float = Field(default=0.4, ge=0, le=1)
    nms_iou: float = Field(default=0.5, gt=0, le=1)
    """Of two boxes of one kind that overlap by more, the one of lower score is left out."""


class PlaceConfig(Section):
    """From a box in the image to a place on the ground."""

    point: Literal["edges", "bottom", "centre", "idw"] = "edges"
    """edges: a track begins as with bottom, then all edges of a box are held against its cuboid;
    bottom: where the middle of the lower edge meets the ground; centre: where the middle of the box
    meets the plane at half the height of its kind; idw: by a map (Marr 2019)."""
    sigma_px: float = Field(default=2.0, gt=0)
    """Of each edge of a box ..."""
    sigma_share: float = Field(default=0.03, ge=0)
    """... and more of it in proportion to the box."""
    shape_sigma_m: float = Field(default=0.3, ge=0)
    """bottom and centre: how far that point of an object is from where the model has it, as boxes
    around objects that are turned are not about their middle."""
    idw_file: str = ""
    """Calibration set of the map, `u_px,v_px,east_m,north_m[,run]`; for a node of one camera."""


class TrackConfig(Section):
    """Tracks of one head: motion, measurements, birth and death."""

    gate_probability: float = Field(default=0.999, gt=0, lt=1)
    """A measurement belongs to no track whose quantile of chi-square it exceeds."""
    least_iou: float = Field(default=0.1, gt=0, lt=1)
    """A track's cuboid in the image and a box that overlap by less are not one object."""
    vehicle_accel_mps2_per_sqrt_hz: float = Field(default=1.5, gt=0)
    pedestrian_accel_mps2_per_sqrt_hz: float = Field(default=0.7, gt=0)
    """White noise that changes the velocity."""
    size_walk_m_per_sqrt_s: float = Field(default=0.01, gt=0)
    yaw_walk_rad_per_sqrt_s: float = Field(default=0.2, gt=0)
    birth_speed_mps: float = Field(default=10.0, gt=0)
    """Sigma of each axis of the velocity that a track is born with."""
    extent_sigma_m: float = Field(default=0.15, gt=0)
    """Of a cuboid's length, width and height where its whole extent was seen."""
    yaw_sigma_rad: float = Field(default=0.1, gt=0)
    """Of a cuboid's yaw where the cuboid is long."""
    course_from_mps: float = Field(default=2.0, gt=0)
    """A vehicle that is faster drives along its length."""
    course_sigma_rad: float = Field(default=0.05, gt=0)
    confirm_hits: int = Field(default=3, ge=1)
    """A track is told of once it was seen in so many frames ..."""
    confirm_frames: int = Field(default=5, ge=1)
    """... of its first so many, or it dies."""
    coast_s: float = Field(default=1.0, gt=0)
    """A track that was not seen for longer dies; meanwhile it is kept, and not told of."""
    camera_only: bool = True
    """Follow objects that no LiDAR sees, by their place on the ground."""


class HeadsConfig(Section):
    """Tracks of several heads become one list."""

    least_iou: float = Field(default=0.1, gt=0, lt=1)
    """3-D IoU from which on tracks of two heads are one object ..."""
    gate_probability: float = Field(default=0.999, gt=0, lt=1)
    """... and so they are where their places differ by less than this quantile of chi-square ..."""
    slack_m: float = Field(default=0.3, ge=0)
    """... with so much more sigma, as heads see different sides of an object."""


class PerceiveConfig(Section):
    """Everything that `fgloc perceive` can be told."""

    method: Literal["fused", "lidar", "camera"] = "fused"
    """Which sensors are used."""
    detector: Literal["background", "table", "onnx"] = "background"
    """Where the boxes in the images come from."""
    report: Literal["measured", "tracked"] = "measured"
    """measured: what a frame's measurements alone say, with the track's shape, so that errors are
    new in each frame, as the graph takes them to be; tracked: what the filter believes, which is
    smoother but errs alike for a second, so that the graph trusts it too much."""
    together_s: float = Field(default=0.04, gt=0, le=10)
    """Frames of several sensors within so much time are one frame of the node."""
    background: BackgroundConfig = BackgroundConfig()
    lidar: LidarConfig = LidarConfig()
    onnx: OnnxConfig = OnnxConfig()
    place: PlaceConfig = PlaceConfig()
    track: TrackConfig = TrackConfig()
    heads: HeadsConfig = HeadsConfig()
