"""What a roadside node carries: heads of cameras and a LiDAR, where they sit and what they resolve.

Three kinds of axes. The node's are level, turned by the surveyed yaw, with their origin at
`node.p_world_m`: x_world = Rz(yaw) x_node + p_world. A LiDAR's are x ahead, y left, z up; a
camera's are those of its optics, x right, y down, z ahead. A mount maps a sensor's axes to the
node's: x_node = R_node_cam x_cam + p_node_cam.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgloc.arrays import Array, freeze
from fgloc.errors import InputError
from fgloc.frames import is_rotation
from fgloc.infrastructure import Node

UNDISTORTED = (0.0, 0.0, 0.0, 0.0, 0.0)
_ROTATION_TOLERANCE = 1e-5  # a matrix written with six decimals is one
_LEAST_AHEAD_M = 1e-6


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera at its place on the node. Pixel centres are whole numbers, (0, 0) the upper left.

    Raises InputError where a shape does not fit, a number is not finite, the mount is no rotation,
    or size or focal lengths are not above 0.

    size_px       width and height of its images
    focal_px      (2,) focal lengths along the rows and the columns
    principal_px  (2,) where the optical axis meets the image, right and down
    R_node_cam    (3, 3) from the camera's axes to the node's
    p_node_cam_m  (3,) its place in the node's axes
    distortion    (5,) k1, k2, p1, p2, k3 of Brown's model in OpenCV's order
    """

    name: str
    size_px: tuple[int, int]
    focal_px: Array
    principal_px: Array
    R_node_cam: Array
    p_node_cam_m: Array
    distortion: Array = field(default_factory=lambda: np.array(UNDISTORTED))

    def __post_init__(self) -> None:
        shapes = {"focal_px": (2,), "principal_px": (2,), "p_node_cam_m": (3,), "distortion": (5,)}
        _freeze(self, f"camera {self.name!r}", {**shapes, "R_node_cam": (3, 3)}, "R_node_cam")
        if min(self.size_px) < 1 or self.focal_px.min() <= 0:
            raise InputError(
                f"camera {self.name!r}: size_px = {self.size_px}, focal_px = "
                f"{self.focal_px.tolist()}: expected numbers above 0"
            )

    @property
    def K(self) -> Array:
        """(3, 3) the camera matrix."""
        (fu, fv), (u, v) = self.focal_px, self.principal_px
        return np.array([[fu, 0, u], [0, fv, v], [0, 0, 1.0]])

    def project(self, p_node_m: ArrayLike) -> Array:
        """Pixels (N, 2) of points (N, 3) in the node's axes; NaN behind the camera. They may lie
        outside of the image: see `sees`."""
        import cv2

        p_cam = (np.asarray(p_node_m, float) - self.p_node_cam_m) @ self.R_node_cam
        ahead = p_cam[:, 2] > _LEAST_AHEAD_M
        pixels = np.full((len(p_cam), 2), np.nan)
        if self.distortion.any() and ahead.any():
            zero = np.zeros(3)
            found, _ = cv2.projectPoints(p_cam[ahead], zero, zero, self.K, self.distortion)
            pixels[ahead] = found[:, 0]
        else:
            p = p_cam[ahead]
            pixels[ahead] = self.focal_px * p[:, :2] / p[:, 2:] + self.principal_px
        return pixels

    def rays(self, pixels: ArrayLike) -> Array:
        """Unit directions (N, 3) in the node's axes of the lines of sight through pixels (N, 2)."""
        import cv2

        at = np.asarray(pixels, float).reshape(-1, 2)
        flat = (at - self.principal_px) / self.focal_px
        if self.distortion.any() and len(at):
            flat = cv2.undistortPoints(at[:, None], self.K, self.distortion)[:, 0]
        ray = np.column_stack([flat, np.ones(len(at))]) @ self.R_node_cam.T
        return np.asarray(ray / np.linalg.norm(ray, axis=-1, keepdims=True))

    def sees(self, pixels: ArrayLike) -> NDArray[np.bool_]:
        """(N,) bool: which pixels (N, 2) lie in the image; NaN does not."""
        at = np.asarray(pixels, float)
        return np.asarray(((at >= -0.5) & (at < np.array(self.size_px) - 0.5)).all(-1))


@dataclass(frozen=True, eq=False)
class Lidar:
    """A LiDAR at its place on the node: beams above each other, swept about its z axis.

    Raises InputError where a shape does not fit, a number is not finite, the mount is no rotation,
    or ranges, angles, steps or sigma are none.

    R_node_lidar    (3, 3) from its axes to the node's
    p_node_lidar_m  (3,) its place in the node's axes
    min_range_m     what is nearer or farther gives no return
    azimuth_rad     (2,) first and last azimuth, counter-clockwise from its x axis
    elevation_rad   (2,) of the lowest and the highest beam
    step_rad        (2,) between directions of one beam, and between beams
    sigma_m         of a range
    """

    name: str
    R_node_lidar: Array
    p_node_lidar_m: Array
    min_range_m: float
    max_range_m: float
    azimuth_rad: Array
    elevation_rad: Array
    step_rad: Array
    sigma_m: float

    def __post_init__(self) -> None:
        what = f"LiDAR {self.name!r}"
        pairs = dict.fromkeys(("azimuth_rad", "elevation_rad", "step_rad"), (2,))
        shapes = {"R_node_lidar": (3, 3), "p_node_lidar_m": (3,), **pairs}
        _freeze(self, what, shapes, "R_node_lidar")
        if not 0 <= self.min_range_m < self.max_range_m < np.inf:
            raise InputError(
                f"{what}: ranges from {self.min_range_m} to {self.max_range_m} m: expected 0 or "
                "more, and more"
            )
        spans = self.azimuth_rad, self.elevation_rad
        if any(low > high for low, high in spans) or self.step_rad.min() <= 0:
            raise InputError(f"{what}: angles must rise from first to last by steps above 0")
        if not 0 < self.sigma_m < np.inf:
            raise InputError(f"{what}: sigma_m = {self.sigma_m}: expected a number above 0")

    def to_node(self, p_lidar_m: ArrayLike) -> Array:
        """Points (N, 3) of its cloud in the node's axes."""
        return np.asarray(p_lidar_m, float) @ self.R_node_lidar.T + self.p_node_lidar_m

    def to_lidar(self, p_node_m: ArrayLike) -> Array:
        """Points (N, 3) in the node's axes in its own."""
        return (np.asarray(p_node_m, float) - self.p_node_lidar_m) @ self.R_node_lidar

    def angles(self, p_node_m: ArrayLike) -> tuple[Array, Array, Array]:
        """Azimuth and elevation in rad and range in m, (N,) each, of points (N, 3) in the node's
        axes as it sees them."""
        x, y, z = self.to_lidar(p_node_m).T
        plan_m = np.hypot(x, y)
        return np.arctan2(y, x), np.arctan2(z, plan_m), np.hypot(plan_m, z)

    def at_edge(self, p_node_m: ArrayLike) -> NDArray[np.bool_]:
        """(N,) bool: which points (N, 3) in the node's axes are seen by the lowest beam or by the
        first or last direction of a sector: what they are on may go on out of view."""
        azimuth, elevation, _ = self.angles(p_node_m)
        first, last = self.azimuth_rad
        sideways = (azimuth < first + self.step_rad[0]) | (azimuth > last - self.step_rad[0])
        lowest = elevation < self.elevation_rad[0] + self.step_rad[1] / 2
        return np.asarray(lowest | (sideways & (last - first < 2 * np.pi - 1e-9)))

    def directions(self) -> Array:
        """(N, 3) unit directions of all rays in its own axes, beam by beam from the lowest."""
        elevation = _angles(self.elevation_rad, self.step_rad[1])[:, None]
        azimuth = _angles(self.azimuth_rad, self.step_rad[0])
        rays = np.broadcast_arrays(
            np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        )  # fmt: skip
        return np.stack(rays, -1).reshape(-1, 3)


@dataclass(frozen=True)
class Head:
    """One housing: cameras whose boxes are merged into one view, and the LiDAR that fits it."""

    name: str
    cameras: tuple[Camera, ...] = ()
    lidar: Lidar | None = None

    def __post_init__(self) -> None:
        if not self.cameras and self.lidar is None:
            raise InputError(f"head {self.name!r} has neither a camera nor a LiDAR; leave it out")


@dataclass(frozen=True)
class PerceptionNode:
    """A surveyed node and what it carries; the ground is taken for a level plane.

    Raises InputError where there is no head, two sensors share a name, or the height is not
    above 0.

    height_m  of the origin of the node's axes above the ground
    """

    node: Node
    heads: tuple[Head, ...]
    height_m: float

    def __post_init__(self) -> None:
        names = [camera.name for camera in self.cameras]
        names += [head.lidar.name for head in self.heads if head.lidar]
        double = next((name for name in names if names.count(name) > 1), None)
        if double is not None:
            raise InputError(f"the sensor's name {double!r} occurs twice; names are unique")
        if not self.heads:
            raise InputError(f"node {self.node.name!r} has no head")
        if not 0 < self.height_m < np.inf:
            raise InputError(
                f"node {self.node.name!r}: height_m = {self.height_m}: expected m above 0"
            )

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """All cameras in the order of the heads; their place here is their number."""
        return tuple(camera for head in self.heads for camera in head.cameras)

    @property
    def head_of_camera(self) -> NDArray[np.int64]:
        """(C,) the number of the head that carries each camera."""
        return np.repeat(np.arange(len(self.heads)), [len(head.cameras) for head in self.heads])

    @property
    def ground_m(self) -> float:
        """z of the ground in the node's axes."""
        return -self.height_m


def _freeze(one: object, what: str, shapes: dict[str, tuple[int, ...]], turn: str) -> None:
    """Arrays of the fields, read-only; InputError where one does not fit or `turn` is none."""
    for name, shape in shapes.items():
        array = freeze(getattr(one, name))
        if array.shape != shape or not np.isfinite(array).all():
            raise InputError(f"{what}: {name}: expected finite numbers of shape {shape}")
        object.__setattr__(one, name, array)
    if not is_rotation(getattr(one, turn), _ROTATION_TOLERANCE):
        raise InputError(f"{what}: {turn} is not a rotation matrix")


def _angles(span: Array, step: float) -> Array:
    """From the first to the last; a full turn does not repeat its first direction."""
    first, last = span
    count = round((last - first) / step) + 1
    if (count - 1) * step > 2 * np.pi - step / 2:
        count -= 1
    return np.asarray(first + step * np.arange(count))
