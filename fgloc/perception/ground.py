"""From a box in an image to a place on the ground, and how far to trust it.

Khamooshi (2023), section 3.2: the box is projected onto the top-down view, its centre is where the
vehicle is. Two ways for a calibrated camera, over a level ground:

- bottom  the ray through the middle of the lower edge meets the ground where the object begins;
          the track knows how far it reaches behind
- centre  the ray through the middle of the box meets the level plane at half the object's height

and a third without calibration, the map of `idw.py`. A covariance is what `sigma_px` of the
edges does to the place, with what is not known of the height; along the ray it grows with the
distance to the fourth, so its sigma with the square.

# Differs from the paper: a box has no centre in the top-down view where its upper edge is above the
# horizon, so its centre in the image is projected, to the height that it has.
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from fgloc.infrastructure import Node
from fgloc.measurements import PEDESTRIAN, Array
from fgloc.perception.cuboid_fit import CAR_M, PERSON_M
from fgloc.perception.heads import Camera
from fgloc.perception.idw import IdwMap
from fgloc.perception.map_error import ErrorMap
from fgloc.perception.settings import PlaceConfig

CAR_SIGMA_M, PERSON_SIGMA_M = (0.5, 0.15, 0.2), (0.15, 0.15, 0.15)
"""How much lengths, widths and heights differ from the usual ones."""
HALF = 0.5**0.5
_BORDER_PX = 2.0
_STEP_PX = 0.5


class Sightings(NamedTuple):
    """What boxes say of places on the ground, along the node's level axes; NaN where nothing.

    p_node_m  (N, 2) of a point of the object, m
    cov_m2    (N, 2, 2) its covariance
    share     (N,) 1 where the point is that end of the object which faces the camera, 0 where it is
              its centre
    width_m   (N,) of the object as seen, across the ray
    """

    p_node_m: Array
    cov_m2: Array
    share: Array
    width_m: Array

    def take(self, rows: NDArray[np.int64]) -> "Sightings":
        """Some of the rows."""
        return Sightings(*(column[rows] for column in self))

    @property
    def known(self) -> NDArray[np.bool_]:
        """(N,) bool: which boxes have a place."""
        return np.asarray(np.isfinite(self.p_node_m).all(-1))


class Placing(Protocol):
    """A way from boxes to the ground."""

    def sight(self, box_px: Array, kind: NDArray[np.int64]) -> Sightings:
        """What boxes (N, 4) of kinds (N,) say."""
        ...


def kind_size_m(kind: NDArray[np.int64]) -> tuple[Array, Array]:
    """Length, width, height (N, 3) in m to expect of kinds (N,), and their sigmas (N, 3)."""
    walks = (kind == PEDESTRIAN)[:, None]
    size = np.where(walks, PERSON_M, CAR_M)
    return size, np.where(walks, PERSON_SIGMA_M, CAR_SIGMA_M)


def on_plane(camera: Camera, pixels: Array, z_m: Array | float) -> Array:
    """Where rays through pixels (N, 2) meet level planes (N,) or one: (N, 2) along the node's axes,
    m; NaN where they do not, ahead of the camera."""
    ray = camera.rays(pixels)
    with np.errstate(divide="ignore"):
        far = (z_m - camera.p_node_cam_m[2]) / ray[:, 2]
    far = np.where((far > 0) & np.isfinite(far), far, np.nan)
    return np.asarray(camera.p_node_cam_m[:2] + far[:, None] * ray[:, :2])


def on_border(camera: Camera, box_px: Array) -> NDArray[np.bool_]:
    """(N,) bool: which boxes (N, 4) touch the edge of the image, where objects are cut off."""
    size = np.array(camera.size_px)
    low, high = box_px[:, :2] < _BORDER_PX, box_px[:, 2:] > size - 1 - _BORDER_PX
    return np.asarray((low | high).any(-1))


def upright_size_m(camera: Camera, ground_m: float, box_px: Array) -> tuple[Array, Array]:
    """Width (N,) and height (N,) in m that an upright board has whose image a box is and that
    stands on the ground; NaN above the horizon."""
    foot = on_plane(camera, bottom_px(box_px), ground_m)
    base = np.column_stack([foot, np.full(len(foot), ground_m)]) - camera.p_node_cam_m
    ahead_m = base @ camera.R_node_cam[:, 2]
    span_m = (box_px[:, 2:] - box_px[:, :2]) * ahead_m[:, None] / camera.focal_px
    return span_m[:, 0], span_m[:, 1]


def depth_m(width_m: Array, size_m: Array) -> tuple[Array, Array]:
    """What a rectangle measures along the line of sight (N,), and how far its length is turned from
    that line (N,) in rad, to either side, by what it measures across (N,).

    Seen at an angle t from its length L, its width being W, it is L sin t + W cos t wide, which
    gives t, and L cos t + W sin t deep. Broadside and aslant may be equally wide: the mean of both.
    """
    length, width = size_m[:, 0], size_m[:, 1]
    diagonal, lean = np.hypot(length, width), np.arctan2(width, length)
    wide = np.where(np.isfinite(width_m), width_m, diagonal)
    first = np.arcsin(np.clip(wide / diagonal, np.sin(lean), 1.0))
    t = np.stack([first - lean, np.minimum(np.pi - first - lean, np.pi / 2)])
    t[1] = np.where(wide < length, t[0], t[1])
    deep = length * np.cos(t) + width * np.sin(t)
    return np.asarray(deep.mean(0)), np.asarray(t.mean(0))


@dataclass(frozen=True)
class ByBottom:
    """The near end of the object, where the middle of the lower edge meets the ground.

    ground_m  z of the ground in the node's axes
    """

    camera: Camera
    ground_m: float
    config: PlaceConfig

    def sight(self, box_px: Array, kind: NDArray[np.int64]) -> Sightings:
        """What boxes (N, 4) say; their kinds do not matter."""
        foot = bottom_px(box_px)
        sigma_px = _edge_sigma_px(box_px, self.config) * [HALF, 1]  # a middle is of two edges
        cov = _spread(_by_pixel(self.camera, foot, self.ground_m), sigma_px, self.config)
        width_m, _ = upright_size_m(self.camera, self.ground_m, box_px)
        place = on_plane(self.camera, foot, self.ground_m)
        return Sightings(place, cov, np.ones(len(box_px)), width_m)


@dataclass(frozen=True)
class ByCentre:
    """The centre of the object, where the middle of the box meets the plane at half its height."""

    camera: Camera
    ground_m: float
    config: PlaceConfig

    def sight(self, box_px: Array, kind: NDArray[np.int64]) -> Sightings:
        """What boxes (N, 4) of kinds (N,) say."""
        size, sigma = kind_size_m(kind)
        middle = (box_px[:, :2] + box_px[:, 2:]) / 2
        z_m = self.ground_m + size[:, 2] / 2
        place = on_plane(self.camera, middle, z_m)
        down_m = self.camera.p_node_cam_m[2] - z_m
        by_height = (place - self.camera.p_node_cam_m[:2]) / down_m[:, None] * sigma[:, 2:] / 2
        sigma_px = _edge_sigma_px(box_px, self.config) * HALF
        cov = _spread(_by_pixel(self.camera, middle, z_m), sigma_px, self.config)
        width_m, _ = upright_size_m(self.camera, self.ground_m, box_px)
        cov = cov + by_height[:, :, None] * by_height[:, None, :]
        return Sightings(place, cov, np.zeros(len(box_px)), width_m)


@dataclass(frozen=True)
class ByMap:
    """The surveyed point of the object by a map of box centres; no model of a camera."""

    node: Node
    map: IdwMap
    error: ErrorMap

    def sight(self, box_px: Array, kind: NDArray[np.int64]) -> Sightings:
        """What boxes (N, 4) say, NaN beyond the calibrated part of the image."""
        middle = (box_px[:, :2] + box_px[:, 2:]) / 2
        inside = self.map.inside(middle)[:, None]
        place = np.where(inside, self.node.from_world(self.map.place(middle)), np.nan)
        R = self.node.R_world_node
        cov = R.T @ self.error.covariance_m2(middle) @ R
        n = len(box_px)
        return Sightings(place, cov, np.zeros(n), np.full(n, np.nan))


def bottom_px(box_px: Array) -> Array:
    """(N, 2) the middle of the lower edges."""
    return np.column_stack([(box_px[:, 0] + box_px[:, 2]) / 2, box_px[:, 3]])


def _by_pixel(camera: Camera, pixels: Array, z_m: Array | float) -> Array:
    """(N, 2, 2) of the place by the pixel, by central differences: rays may be distorted."""
    return np.stack([
        (on_plane(camera, pixels + step, z_m) - on_plane(camera, pixels - step, z_m))
        / (2 * _STEP_PX)
        for step in _STEP_PX * np.eye(2)
    ], -1)  # fmt: skip


def _edge_sigma_px(box_px: Array, config: PlaceConfig) -> Array:
    """(N, 2) of an edge across and upright."""
    size_px = box_px[:, 2:] - box_px[:, :2]
    return np.hypot(config.sigma_px, config.sigma_share * size_px)


def _spread(J: Array, sigma_px: Array, config: PlaceConfig) -> Array:
    """(N, 2, 2) what sigmas (N, 2) of a pixel do, and what is not known of the shape."""
    scaled = J * sigma_px[:, None, :]
    return np.asarray(scaled @ scaled.swapaxes(-1, -2) + config.shape_sigma_m**2 * np.eye(2))
