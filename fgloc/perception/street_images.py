"""Simple images of a street as a camera on the node sees it: sky, textured ground, shaded boxes.

Boxes are drawn whole, the farther before the nearer. Of two boxes the one on the camera's side of a
plane between them is the nearer; for upright boxes apart there is such a plane among their faces
in all cases that matter on a street. No shadows, no reflections, no motion blur.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fgloc.errors import InputError
from fgloc.measurements import Array
from fgloc.perception.heads import Camera
from fgloc.perception.recording import Image
from fgloc.perception.street import Solids, Street

FACES = np.array(
    [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [2, 3, 7, 6], [1, 2, 6, 5], [3, 0, 4, 7]]
)
"""Corners of the lower, upper, right, left, front and rear face."""
_NORMALS = np.array([[0, 0, -1], [0, 0, 1], [0, -1, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0]])
SUN = np.array([0.36, -0.48, 0.8])
AMBIENT, DIRECT = 0.55, 0.5
"""Share of a face's colour in the shade, and more of it straight in the sun."""
SKY, ASPHALT = (235, 220, 200), 105.0
TEXEL_M, TEXELS = 0.1, 2400
"""Of the ground's texture, which ends 120 m from the node."""
GRAIN = 7.0
NEAR_M = 0.1
ROOM = 8
"""The field of noise is larger than an image by this part of it, each way."""
_SUBPIXEL_BITS = 4


@dataclass(frozen=True, eq=False)
class Painter:
    """Paints frames of one camera; `make` prepares what all frames share.

    ground  (TEXELS, TEXELS, 3) the texture, row and column along the node's y and x
    noise   a field of noise larger than an image, of which each frame takes another part
    still   the ground and the sky where the node does not sway, or None
    """

    street: Street
    camera: Camera
    ground: Image
    noise: NDArray[np.int16]
    still: Image | None = None

    @classmethod
    def make(
        cls, street: Street, camera: Camera, rng: np.random.Generator, noise: float = 3.0
    ) -> "Painter":
        """A painter for a pinhole camera.

        noise  standard deviation of a pixel's colours, in grey levels

        Raises InputError where the camera has a distortion.
        """
        if camera.distortion.any():
            raise InputError(f"camera {camera.name!r}: images are rendered without distortion only")
        width, height = camera.size_px
        shape = height + height // ROOM, width + width // ROOM, 3
        field = np.rint(noise * rng.standard_normal(shape, np.float32)).astype(np.int16)
        painter = cls(street, camera, _ground(rng), field)
        if street.sway is not None:
            return painter
        return replace(painter, still=painter._paint_ground(camera.R_node_cam, camera.p_node_cam_m))

    def paint(self, t_ns: int, rng: np.random.Generator) -> Image:
        """The image (H, W, 3) at an instant; `rng` draws its noise alone."""
        import cv2

        R_sway, p_sway_m = self.street.pose(t_ns)
        R = R_sway @ self.camera.R_node_cam
        p_m = R_sway @ self.camera.p_node_cam_m + p_sway_m
        image = self._paint_ground(R, p_m) if self.still is None else self.still.copy()
        _paint_solids(image, self.camera.K, self.street.solids(t_ns), R, p_m)
        height, width = image.shape[:2]
        row, column = (int(rng.integers(n // ROOM + 1)) for n in (height, width))
        part = self.noise[row : row + height, column : column + width]
        painted: Image = cv2.add(image, part, dtype=cv2.CV_8U)
        return painted

    def _paint_ground(self, R: Array, p_m: Array) -> Image:
        """The ground up to the horizon, the sky above it."""
        import cv2

        onto_node = np.array([[TEXEL_M, 0, 0], [0, TEXEL_M, 0], [0, 0, 1.0]])
        onto_node[:2, 2] = -TEXEL_M * TEXELS / 2
        plane = np.column_stack([np.eye(3)[:, :2], [0, 0, self.street.node.ground_m]])
        plane[:, 2] -= p_m
        H = self.camera.K @ R.T @ plane @ onto_node
        image = cv2.warpPerspective(self.ground, H, self.camera.size_px, borderValue=[ASPHALT] * 3)
        cv2.fillPoly(image, [_sky(self.camera, R)], SKY)
        return np.asarray(image)


def _ground(rng: np.random.Generator) -> Image:
    """Asphalt: patches of some metres and grain."""
    import cv2

    coarse = rng.standard_normal((TEXELS // 40, TEXELS // 40), np.float32)
    grey = ASPHALT + GRAIN * cv2.resize(coarse, (TEXELS, TEXELS), interpolation=cv2.INTER_CUBIC)
    tile = rng.standard_normal((TEXELS // 4, TEXELS // 4), np.float32)
    grey += GRAIN * np.tile(tile, (4, 4))
    return np.repeat(np.clip(grey, 0, 255).astype(np.uint8)[..., None], 3, -1)


def _sky(camera: Camera, R: Array) -> NDArray[np.int32]:
    """The part of the image whose rays rise, as a polygon; empty where none does."""
    width, height = camera.size_px
    corners = np.array([[-1, -1], [width, -1], [width, height], [-1, height]], float)
    rise = (np.column_stack([corners, np.ones(4)]) @ np.linalg.inv(camera.K).T) @ R[2]
    return np.asarray(np.rint(_clip(corners, rise)), np.int32).reshape(-1, 1, 2)


def _clip(polygon: Array, inside: Array) -> Array:
    """The part of a convex polygon (N, D) where a linear function, `inside` (N,) at its corners, is
    not below 0."""
    ahead = np.roll(np.arange(len(polygon)), -1)
    kept: list[Array] = []
    for k, n in enumerate(ahead):
        if inside[k] >= 0:
            kept.append(polygon[k])
        if (inside[k] >= 0) != (inside[n] >= 0):
            share = inside[k] / (inside[k] - inside[n])
            kept.append(polygon[k] + share * (polygon[n] - polygon[k]))
    return np.array(kept).reshape(-1, polygon.shape[1])


def _paint_solids(image: Image, K: Array, solids: Solids, R: Array, p_m: Array) -> None:
    import cv2

    corners = solids.corners_m()
    normals, offsets = _planes(solids)
    facing = normals @ p_m > offsets
    shade = AMBIENT + DIRECT * np.clip(normals @ SUN, 0, None)
    for number in draw_order(corners, normals, offsets, p_m):
        for face in np.flatnonzero(facing[number]):
            p_cam = (corners[number, FACES[face]] - p_m) @ R
            seen = _clip(p_cam, p_cam[:, 2] - NEAR_M)
            if len(seen) < 3:
                continue
            pixels = (seen @ K.T)[:, :2] / seen[:, 2:]
            colour = np.clip(shade[number, face] * solids.colour[number], 0, 255).tolist()
            fine = np.rint(np.clip(pixels, -1e5, 1e5) * 2**_SUBPIXEL_BITS).astype(np.int32)
            cv2.fillConvexPoly(image, fine, colour, cv2.LINE_AA, _SUBPIXEL_BITS)


def _planes(solids: Solids) -> tuple[Array, Array]:
    """Outward normals (N, 6, 3) and offsets (N, 6) of the faces: n x = d on them."""
    axes = solids.moved(np.eye(3), np.zeros(3)).axes
    normals = _NORMALS @ axes.swapaxes(1, 2)
    reach_m = (np.abs(_NORMALS) * solids.size_m[:, None] / 2).sum(-1)
    return normals, np.einsum("nfi,ni->nf", normals, solids.centre_m) + reach_m


def draw_order(corners: Array, normals: Array, offsets: Array, p_m: Array) -> list[int]:
    """Numbers of boxes, none before another that it hides a part of; ties by the distance.

    corners  (N, 8, 3), normals (N, 6, 3), offsets (N, 6) of their faces
    p_m      (3,) place of the eye
    """
    beyond = (np.einsum("nfi,mci->nfmc", normals, corners) > offsets[:, :, None, None] - 1e-9).all(
        -1
    )  # (N, 6, N): box m lies wholly outside of face f of box n
    eye_out = (normals @ p_m > offsets)[:, :, None]
    nearer = (beyond & eye_out).any(1)  # m nearer than n
    farther = (beyond & ~eye_out).any(1)
    after = (nearer | farther.T) & ~(nearer.T | farther)
    return _sorted(after, np.linalg.norm(corners.mean(1) - p_m, axis=-1))


def _sorted(after: NDArray[np.bool_], distance_m: Array) -> list[int]:
    """An order in which m comes after n where after[n, m]; the farthest first where that is open,
    also where boxes hide each other in a ring."""
    left = list(np.argsort(-distance_m))
    order: list[int] = []
    while left:
        ready = (one for one in left if not after[left, one].any())
        order.append(int(next(ready, left[0])))
        left.remove(order[-1])
    return order
