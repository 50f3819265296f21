"""Infrared images of a Smart Code, made up: what the reader is tried on.

The code lies on a retroreflective panel that shines in the camera's strobe, less with the square
of the distance; the rest of the scene is dark, with things in it that shine too. The image is
drawn in three times its pixels and averaged, blurred, made noisy and rounded.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgloc.measurements import Array

FINER = 3
"""Drawn pixels for one of the image, each way."""
CELL_TEXELS = 8
QUIET_CELLS = 1
"""Bright cells around the border: the panel is larger than the code."""
DARK, BRIGHT_AT_M, MOST = 12.0, 18.0, 235.0
"""Grey of what does not shine; distance up to which the strobe saturates; that grey."""


@dataclass(frozen=True)
class Look:
    """How an image comes out: standard deviations of blur in px and of noise in grey levels, and
    how many bright things stand about."""

    blur_px: float = 0.6
    noise: float = 4.0
    clutter: int = 12


def strobe_grey(range_m: ArrayLike) -> Array:
    """Grey (...) of the panel at distances (...): saturated when near, then falling by d^-2."""
    share = np.minimum(1.0, (BRIGHT_AT_M / np.asarray(range_m, float)) ** 2)
    return DARK + (MOST - DARK) * share


def render(
    bits: NDArray[np.uint8], corners_px: Array, range_m: float, shape: tuple[int, int],
    look: Look, rng: np.random.Generator,
) -> NDArray[np.uint8]:  # fmt: skip
    """A grey image (H, W) with the code of cells (n, n) at corners (4, 2), clockwise from its
    upper left; pixel centres are whole numbers."""
    import cv2

    fine = _clutter(shape, look.clutter, rng)
    texture = _texture(bits) * (strobe_grey(range_m) - DARK) + DARK
    panel = QUIET_CELLS * CELL_TEXELS
    side = texture.shape[0]
    low, high = panel - 0.5, side - panel - 0.5
    source = np.array([[low, low], [high, low], [high, high], [low, high]], np.float32)
    target = ((np.asarray(corners_px) + 0.5) * FINER - 0.5).astype(np.float32)
    onto = cv2.getPerspectiveTransform(source, target)
    size = (shape[1] * FINER, shape[0] * FINER)
    drawn = cv2.warpPerspective(
        texture.astype(np.float32), onto, size, flags=cv2.INTER_LINEAR, borderValue=-1.0
    )
    fine = np.where(drawn >= 0, drawn, fine)
    image = cv2.resize(fine, shape[::-1], interpolation=cv2.INTER_AREA)
    if look.blur_px > 0:
        image = cv2.GaussianBlur(image, (0, 0), look.blur_px)
    image = image + look.noise * rng.standard_normal(shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _texture(bits: NDArray[np.uint8]) -> Array:
    """Cells with their dark border and the bright panel, 0 to 1, some texels each."""
    bordered = np.pad(bits.astype(float), 1)
    panel = np.pad(bordered, QUIET_CELLS, constant_values=1.0)
    return np.kron(panel, np.ones((CELL_TEXELS, CELL_TEXELS)))


def _clutter(shape: tuple[int, int], count: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """A dark scene with bright bars, plates and lamps, in fine pixels."""
    import cv2

    scene = np.full((shape[0] * FINER, shape[1] * FINER), DARK, np.float32)
    limit = np.array(scene.shape[::-1])
    for kind in rng.integers(3, size=count):
        p = rng.uniform(0, 1, 2) * limit
        q = p + rng.uniform(-0.2, 0.2, 2) * limit
        grey = float(rng.uniform(30, 255))
        first, second = (tuple(int(v) for v in point) for point in (p, q))
        if kind == 0:
            cv2.rectangle(scene, first, second, grey, -1)
        elif kind == 1:
            cv2.line(scene, first, second, grey, int(rng.integers(1, 5 * FINER)))
        else:
            cv2.circle(scene, first, int(rng.integers(2, 12 * FINER)), grey, -1)
    return scene
