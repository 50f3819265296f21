"""Images as files: read whole or not at all."""

from pathlib import Path

import numpy as np

from fgloc.errors import DriveError
from fgloc.files import read_bytes
from fgloc.perception.recording import Image

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")
_ENDS = {b"\x89PNG": b"IEND", b"\xff\xd8": b"\xff\xd9"}
"""First bytes of PNG and JPEG, and what stands near the end of a whole file: OpenCV reads half a
file too, and fills the rest with grey."""
_TAIL_BYTES = 1024


def read_image(path: Path) -> Image:
    """An image (H, W, 3) of 8 bits, blue, green, red; grey ones get three equal channels.

    Raises DriveError with the file where it is missing, of another kind, damaged or cut off.
    """
    import cv2

    if path.suffix.lower() not in IMAGE_SUFFIXES:
        raise DriveError(f"{path}: an image is one of {', '.join(IMAGE_SUFFIXES)}; convert it")
    raw = read_bytes(path)
    end = next((end for start, end in _ENDS.items() if raw.startswith(start)), None)
    if end is None:
        raise DriveError(f"{path}: is neither PNG nor JPEG inside; write it again")
    if end not in raw[-_TAIL_BYTES:]:
        raise DriveError(f"{path}: the image is cut off after {len(raw)} bytes; copy it again")
    image = cv2.imdecode(np.frombuffer(raw, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise DriveError(f"{path}: the image is damaged; copy it again")
    return image


def write_image(path: Path, image: Image) -> None:
    """Write an image (H, W, 3) as what its suffix says, JPEG at OpenCV's quality of 95."""
    import cv2

    done, raw = cv2.imencode(path.suffix, image)
    if not done:
        raise DriveError(f"{path}: cannot be written as {path.suffix}")
    path.write_bytes(raw.tobytes())
