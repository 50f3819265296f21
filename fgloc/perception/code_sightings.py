"""From codes read in images to the table of a drive: which sign each is, its size and corners."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgloc.arrays import Array, freeze_ns
from fgloc.errors import InputError, nearest
from fgloc.factors.corners import code_size_px
from fgloc.infrastructure import Sign
from fgloc.measurements import SmartCodeSightings
from fgloc.perception.smart_code_reader import Read


def sightings_of(
    reads: Sequence[Read], t_ns: ArrayLike, signs: Sequence[Sign],
    received_ns: ArrayLike | None = None,
) -> SmartCodeSightings:  # fmt: skip
    """All codes in images (M,) taken at `t_ns` (M,), in the order of time.

    Height, width and middle are those of the corners, in parts of a pixel. `received_ns` (M,) left
    out means: received when taken. Raises InputError where images and stamps do not fit, two signs
    bear one code, a code is on no sign, or is not upright in its image, as a sign's is.
    """
    taken = freeze_ns("t_ns", t_ns)
    received = taken if received_ns is None else freeze_ns("received_ns", received_ns)
    for name, stamps in (("t_ns", taken), ("received_ns", received)):
        if stamps.shape != (len(reads),):
            raise InputError(f"{name} has shape {stamps.shape}; give one for each of the "
                             f"{len(reads)} images")  # fmt: skip
    numbers = _numbers(signs)
    order = np.argsort(taken, kind="stable")
    image = np.repeat(order, [len(reads[i].codes) for i in order])
    sign = [_number(code, numbers, int(i)) for i in order for code in reads[i].codes]
    corners = np.concatenate([np.zeros((0, 4, 2)), *(reads[i].corners_px for i in order)])
    height_px, width_px = code_size_px(corners)
    _check_upright(corners, np.minimum(height_px, width_px), image)
    return SmartCodeSightings(
        taken[image], received[image], np.array(sign, np.int64), height_px, width_px,
        corners.mean(1), corners,
    )  # fmt: skip


def _numbers(signs: Sequence[Sign]) -> dict[str, int]:
    """The number of each sign by its code."""
    codes = [sign.code for sign in signs]
    double = next((code for code in codes if codes.count(code) > 1), None)
    if double is not None:
        raise InputError(f"Smart Code {double!r} is on two signs, and does not tell which is seen")
    return {code: i for i, code in enumerate(codes)}


def _number(code: str, numbers: dict[str, int], image: int) -> int:
    if code not in numbers:
        known = f"the nearest is {nearest(code, numbers)!r}" if numbers else "there are no signs"
        raise InputError(f"image {image}: Smart Code {code!r} is on none of the signs; {known}: "
                         "add the sign, or leave the code out of the reader's")  # fmt: skip
    return numbers[code]


def _check_upright(corners_px: Array, least_px: Array, image: NDArray[np.int64]) -> None:
    if (least_px <= 0).any():
        row = int(np.argmax(least_px <= 0))
        raise InputError(
            f"image {image[row]}: a Smart Code with corners {corners_px[row].tolist()} px is not "
            "upright; turn the image so that down in it is down"
        )
