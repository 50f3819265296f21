"""Square codes read in images: Smart Codes by their hexadecimal text, AprilTags by their number.

OpenCV's marker detector finds dark squares with a pattern of cells inside. A Smart Code is 11 x 11
cells: a dark border of one cell around 9 x 9. Which cells are bright for which text is 3M's and not
published; here they are the first 81 bits of the text's SHA-256 digest, so that any text has its
code, and any two differ in about half of their cells.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fgloc.errors import InputError
from fgloc.measurements import Array

if TYPE_CHECKING:
    import cv2

CELLS = 9
"""Of a Smart Code on a side, without its border."""
WRONG_CELLS = 4
"""Cells that may be misread: codes that differ in 18 or more are then still told apart."""
LEAST_DISTANCE = 2 * WRONG_CELLS + 1
LEAST_SIDE_PX = 12
"""A smaller square has about one pixel a cell and cannot be read."""
SURE, PRECISE = "sure", "precise"
"""OpenCV's corners at the steepest point draw a code together by 0.2 px, which is 2 % of the range
at 30 m; those where the lines of AprilTag's method cross do not, but it finds fewer small codes."""
MARGIN = 0.4
"""Sides of a code that are looked at around it for its precise corners."""
SAME_PX = 3.0
"""Corners of one code by the two methods lie closer together than this."""


@dataclass(frozen=True, eq=False)
class Read:
    """M codes in one image: their texts, and corners (M, 4, 2) in px, right and down, clockwise
    from the upper left corner as the code is printed; pixel centres are whole numbers."""

    codes: tuple[str, ...]
    corners_px: Array


@dataclass(frozen=True, eq=False)
class MarkerReader:
    """A detector with the codes that it knows, in the order of its dictionary."""

    codes: tuple[str, ...]
    dictionary: cv2.aruco.Dictionary
    _detectors: dict[tuple[str, int], Any] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def smart_codes(cls, codes: Sequence[str]) -> MarkerReader:
        """For Smart Codes with these texts.

        Raises InputError where there are none, one is not lower-case hexadecimal, or two look too
        much alike to be told apart.
        """
        import cv2

        if not codes:
            raise InputError("a reader needs at least one code")
        bits = np.stack([code_bits(code) for code in codes])
        _check_apart(codes, bits)
        rows = np.concatenate([cv2.aruco.Dictionary.getByteListFromBits(b) for b in bits])
        return cls(tuple(codes), cv2.aruco.Dictionary(rows, CELLS, WRONG_CELLS))

    @classmethod
    def april_tags(cls) -> MarkerReader:
        """For AprilTags of the family tag36h11, by their numbers."""
        import cv2

        known = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        return cls(tuple(str(i) for i in range(len(known.bytesList))), known)

    def read(self, image: NDArray[np.uint8]) -> Read:
        """The codes in a grey image (H, W), corners refined to parts of a pixel.

        Raises InputError where the image is none.
        """
        if image.ndim != 2 or image.dtype != np.uint8 or not image.size:
            raise InputError(
                f"an image of shape {image.shape} and type {image.dtype}; give grey as uint8 (H, W)"
            )
        found = self._detect(image, SURE)
        refined = [
            self._refined(image, code, corners)
            for code, corners in zip(found.codes, found.corners_px, strict=True)
        ]
        return Read(found.codes, np.array(refined).reshape(-1, 4, 2))

    def _refined(self, image: NDArray[np.uint8], code: str, corners_px: Array) -> Array:
        """The precise corners (4, 2) of a code that was found, or those given if it has none."""
        margin = MARGIN * np.ptp(corners_px, axis=0).max()
        low = np.maximum(corners_px.min(0) - margin, 0).astype(int)
        high = np.ceil(corners_px.max(0) + margin).astype(int)
        part = np.ascontiguousarray(image[low[1] : high[1], low[0] : high[0]])
        again = self._detect(part, PRECISE)
        for other, precise in zip(again.codes, again.corners_px + low, strict=True):
            if other == code and np.abs(precise - corners_px).max() < SAME_PX:
                return np.asarray(precise)
        return corners_px

    def _detect(self, image: NDArray[np.uint8], way: str) -> Read:
        corners, numbers, _ = self._detector(way, max(image.shape)).detectMarkers(image)
        if numbers is None or not len(corners):
            return Read((), np.zeros((0, 4, 2)))
        found = np.concatenate(corners).astype(float).reshape(-1, 4, 2)
        if way == PRECISE:
            found -= 0.5  # it counts from the corner of the first pixel
        return Read(tuple(self.codes[int(i)] for i in np.ravel(numbers)), found)

    def _detector(self, way: str, longest_px: int) -> Any:
        """The detector for images of this size: squares are told by their share of it."""
        import cv2

        if (way, longest_px) not in self._detectors:
            settings = cv2.aruco.DetectorParameters()
            settings.cornerRefinementMethod = (
                cv2.aruco.CORNER_REFINE_SUBPIX if way == SURE else cv2.aruco.CORNER_REFINE_APRILTAG
            )
            settings.minMarkerPerimeterRate = 4 * LEAST_SIDE_PX / longest_px
            # The panel's edge is a square too, a cell further out, and must not hide the code's.
            settings.minMarkerDistanceRate = 0.02
            settings.errorCorrectionRate = 1.0  # of what the dictionary allows
            self._detectors[way, longest_px] = cv2.aruco.ArucoDetector(self.dictionary, settings)
        return self._detectors[way, longest_px]


def code_bits(code: str) -> NDArray[np.uint8]:
    """Cells (9, 9) of a text's code, 1 is bright; InputError where it is not hexadecimal."""
    if not code or set(code) - set("0123456789abcdef"):
        raise InputError(f"code {code!r}: expected hexadecimal, in lower case")
    digest = np.frombuffer(hashlib.sha256(code.encode()).digest(), np.uint8)
    return np.unpackbits(digest)[: CELLS**2].reshape(CELLS, CELLS)


def _check_apart(codes: Sequence[str], bits: NDArray[np.uint8]) -> None:
    """Raise InputError where two codes, turned any way, differ in too few cells."""
    plain = bits.reshape(len(bits), -1).astype(float)
    for turn in range(4):
        turned = np.rot90(bits, turn, (1, 2)).reshape(len(bits), -1).astype(float)
        differ = plain @ (1 - turned.T) + (1 - plain) @ turned.T
        if turn == 0:
            np.fill_diagonal(differ, np.inf)
        if differ.min() < LEAST_DISTANCE:
            i, j = divmod(int(np.argmin(differ)), len(codes))
            raise InputError(
                f"codes {codes[i]!r} and {codes[j]!r} differ in {int(differ[i, j])} of 81 cells; "
                f"{LEAST_DISTANCE} are needed: use another text for one of them"
            )
