"""What boxes and cuboids of the same objects say of clocks and calibration.

A camera whose mount is wrong sees all objects shifted alike; one whose clock is off sees them where
they are at another time, shifted along their motion. So of each camera
    box - cuboid = shift + lateness * (speed of the cuboid in the image)
over all pairs, by least squares under Huber's loss, far objects first.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fgloc.measurements import Array
from fgloc.perception.tracker import Match

LEAST_PAIRS = 30
SHIFT_PX, LATE_S = 8.0, 0.03
"""Less is what detectors do: 8 px are 0.4 deg at f = 1144 px."""
SIGMAS = 4.0
LASTING = 10.0
"""Errors of one object last: no more than one pair in so many is new."""
LEAST_SCALE = 0.2
"""Pairs are never better than this share of what a match states."""
_HUBER = 2.0
_ROUNDS = 20


class Alignment(NamedTuple):
    """Of one camera against the LiDAR: shift (2,) in px, how late its stamps are in s, the sigmas
    (3,) of these, the rms of what is left in px, and of how many pairs."""

    shift_px: Array
    late_s: float
    sigma: Array
    rms_px: float
    pairs: int


def align(matches: Sequence[Match]) -> Alignment | None:
    """The alignment of one camera by its matches, None where they are too few."""
    if len(matches) < LEAST_PAIRS:
        return None
    sigma = np.array([[m.sigma_px] * 2 for m in matches]).reshape(-1)
    off = np.array([m.seen_px - m.expected_px for m in matches]).reshape(-1) / sigma
    by = np.zeros((len(matches), 2, 3))
    by[:, [0, 1], [0, 1]] = 1
    # Stamped late, a box is of an earlier moment than the cuboid beside it.
    by[:, :, 2] = -np.array([m.speed_pxps for m in matches])
    A = by.reshape(-1, 3) / sigma[:, None]
    weight = np.ones(len(off))
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)
        found = np.linalg.lstsq(root[:, None] * A, root * off, rcond=None)[0]
        left = off - A @ found
        weight = _HUBER / np.maximum(np.abs(left), _HUBER)
    scale = max(float(np.sqrt((weight * left**2).sum() / weight.sum())), LEAST_SCALE)
    cov = np.linalg.pinv((A * weight[:, None]).T @ A) * scale**2 * LASTING
    rms_px = float(np.sqrt(np.average((left * sigma) ** 2, weights=weight)))
    return Alignment(found[:2], float(found[2]), np.sqrt(np.diag(cov)), rms_px, len(matches))


def remarks(camera: str, found: Alignment) -> list[str]:
    """What is wrong with a camera, with the remedy."""
    told = []
    if abs(found.late_s) > max(LATE_S, SIGMAS * found.sigma[2]):
        told.append(
            f"{camera}: its stamps are {found.late_s:+.3f} s late against the LiDAR's (sigma "
            f"{found.sigma[2]:.3f} s, {found.pairs} pairs); add this to its clock_ahead_s"
        )
    if (np.abs(found.shift_px) > np.maximum(SHIFT_PX, SIGMAS * found.sigma[:2])).any():
        told.append(
            f"{camera}: boxes are {found.shift_px[0]:+.0f} px right of and "
            f"{found.shift_px[1]:+.0f} px below where the LiDAR has the objects "
            f"({found.pairs} pairs); is its mount or its focal length wrong?"
        )
    return told


def unmatched(camera: str, boxes: int, matched: int) -> str:
    """What to say where hardly any box has an object of the LiDAR; '' where enough have."""
    if boxes < LEAST_PAIRS or matched > boxes / 4:
        return ""
    return (
        f"{camera}: {matched} of {boxes} boxes lie on an object that the LiDAR sees; is a mount "
        "wrong, or a clock off by a second?"
    )
