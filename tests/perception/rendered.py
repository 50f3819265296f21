"""Rendered sightings of Smart Codes at random poses, as the tests and the benchmark draw them."""

from dataclasses import dataclass

import numpy as np

from fgloc.datasets.marr2019_smart_code import FOCAL_PX, IMAGE_PX
from fgloc.perception.smart_code_reader import Read, code_bits
from fgloc.perception.smart_code_renderer import Look, render

PRINCIPAL_PX = np.array(IMAGE_PX) / 2
LEAST_WINDOW_PX, WINDOW_SIDES = 200, 1.7
"""Side of the part of the image around the code that is drawn, at least, and for one of the code:
the whole would take a second."""
CODES = tuple(f"{i:04x}" for i in range(256))
ASIDE_RAD, TURN_RAD = np.deg2rad(22), np.deg2rad(45)


@dataclass(frozen=True)
class Scene:
    """One image, its corner in the camera's image, and what is really in it."""

    image: np.ndarray
    offset_px: np.ndarray
    code: str
    corners_px: np.ndarray
    range_m: float


def scene(rng: np.random.Generator, size_m: float, range_m: float, look: Look) -> Scene:
    """A code of `size_m` at a distance, aside of the axis and turned by random angles."""
    aside, up, turn, lean = rng.uniform(-1, 1, 4) * [ASIDE_RAD, 0.08, TURN_RAD, 0.03]
    ray = np.array([np.sin(aside) * np.cos(up), -np.sin(up), np.cos(aside) * np.cos(up)])
    right = np.array([np.cos(turn + aside), 0, -np.sin(turn + aside)])
    right, down = _leaning(right, np.array([0.0, 1, 0]), lean)
    half = size_m / 2
    sides = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    corners = range_m * ray + sides[:, :1] * right + sides[:, 1:] * down
    px = FOCAL_PX * corners[:, :2] / corners[:, 2:] + PRINCIPAL_PX
    window = int(max(LEAST_WINDOW_PX, WINDOW_SIDES * np.ptp(px, axis=0).max()))
    offset = np.rint(px.mean(0) - window / 2 + rng.uniform(-20, 20, 2))
    code = CODES[rng.integers(len(CODES))]
    image = render(code_bits(code), px - offset, range_m, (window, window), look, rng)
    return Scene(image, offset, code, px, range_m)


def right_and_wrong(read: Read, code: str) -> tuple[int, int]:
    """How often the code was read in an image, and how often another one."""
    right = sum(one == code for one in read.codes)
    return right, len(read.codes) - right


def _leaning(right: np.ndarray, down: np.ndarray, lean: float) -> tuple[np.ndarray, np.ndarray]:
    c, s = np.cos(lean), np.sin(lean)
    return c * right + s * down, c * down - s * right
