"""What a camera on a post sees of a car: the box around it in the image."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc.datasets.simulator import Motion
from fgloc.measurements import Array

CAR_X_M, CAR_Y_M, CAR_Z_M = (-0.9, 3.6), (-0.9, 0.9), (0.2, 1.5)
"""The body about the rear axle: what the box in the image is drawn around."""


@dataclass(frozen=True)
class PostCamera:
    """A pinhole camera that looks along `yaw_rad` from East and down by `pitch_rad`."""

    p_world_m: tuple[float, float, float]
    yaw_rad: float
    pitch_rad: float
    focal_px: float
    image_px: tuple[int, int]

    def project(self, p_world_m: Array) -> tuple[Array, Array]:
        """Pixels (..., 2), right and down, of points (..., 3), and their depths (...,) in m."""
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        cp, sp = np.cos(self.pitch_rad), np.sin(self.pitch_rad)
        ahead, right = np.array([c * cp, s * cp, -sp]), np.array([s, -c, 0.0])
        axes = np.stack([right, np.cross(ahead, right), ahead])
        local = (p_world_m - np.asarray(self.p_world_m)) @ axes.T
        depth = local[..., 2]
        middle = np.asarray(self.image_px) / 2
        return self.focal_px * local[..., :2] / depth[..., None] + middle, depth


def box_centres(
    camera: PostCamera, motion: Motion, edge_sigma_px: float, rng: np.random.Generator
) -> tuple[Array, NDArray[np.bool_]]:
    """Centres (N, 2) in px of the boxes around a car, and which (N,) lie in the image.

    Each edge of a box errs by `edge_sigma_px` and is rounded to a whole pixel.
    """
    corners = np.array([(x, y, z) for x in CAR_X_M for y in CAR_Y_M for z in CAR_Z_M])
    p_world = motion.p_world_m[:, None] + corners @ motion.R_world_veh.swapaxes(-1, -2)
    px, depth = camera.project(p_world)
    inside = (depth[..., None] > 0) & (px >= 0) & (px <= camera.image_px)
    seen = np.asarray(inside.all((1, 2)))
    edges = np.stack([px.min(1), px.max(1)], 1)
    edges = np.rint(edges + edge_sigma_px * rng.standard_normal(edges.shape))
    return edges.mean(1), seen
