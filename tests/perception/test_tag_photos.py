"""Real photos of AprilTags, where they are at hand: read, and as far apart as the tape says.

Photos of PhotonVision's test resources (GPL-3.0, not part of this project), 1280 x 720; the file
names tell taped distances, to the element on which the tag is. The camera is OpenCV's calibration
from the photos of a board beside them.
"""

import os
from pathlib import Path

import numpy as np
import pytest

from fgloc.perception.smart_code_reader import MarkerReader
from fgloc.perception.square_pose import square_poses

FOLDER = Path(os.environ.get("FGLOC_SHARED_DATA", Path(__file__).parents[3] / "shared/data"))
PHOTOS = FOLDER / "apriltag_photos/field2024"
TAG_M, FOCAL_PX, PRINCIPAL_PX = 0.1651, 1127.0, (625.6, 332.3)
INCH_M, ABOVE_IN = 0.0254, 27.4
pytestmark = pytest.mark.skipif(not PHOTOS.is_dir(), reason="data not here: apriltag_photos")


def tags_in(name: str) -> dict[str, float]:
    """The tags of a photo, and the level distance of the camera to each, in inches."""
    import cv2

    read = MarkerReader.april_tags().read(cv2.imread(str(PHOTOS / name), cv2.IMREAD_GRAYSCALE))
    return {code: level_distance_in(corners) for code, corners in
            zip(read.codes, read.corners_px, strict=True)}  # fmt: skip


def level_distance_in(corners_px: np.ndarray) -> float:
    """From the range and the tag's height over the camera, which far photos do not tell."""
    range_m = square_poses(corners_px, TAG_M, FOCAL_PX, PRINCIPAL_PX).range_m[0]
    return float(np.sqrt((range_m / INCH_M) ** 2 - ABOVE_IN**2))


@pytest.mark.parametrize(
    "name",
    ["Amp_42in.jpg", "Amp_85in.jpg", "BackAmpZone_117in.jpg", "Loading_83in.jpg",
     "Podium_103in.jpg", "SpeakerCenter_143in.jpg", "SpeakerCenter_63in.jpg",
     "StageLeft_51in.jpg", "StageRight_51in.jpg"],
)  # fmt: skip
def test_there_is_a_tag_in_every_photo_of_an_element(name):
    assert tags_in(name)


@pytest.mark.parametrize(
    ("far", "near", "inches"),
    [("Amp_85in.jpg", "Amp_42in.jpg", 43),
     ("SpeakerCenter_143in.jpg", "SpeakerCenter_63in.jpg", 80),
     ("SpeakerCenter_63in.jpg", "SpeakerCenter_19in.jpg", 44)],
)  # fmt: skip
def test_the_differences_of_ranges_are_those_of_the_tape(far, near, inches):
    there, here = tags_in(far), tags_in(near)
    common = set(there) & set(here)
    assert common
    for code in common:
        assert there[code] - here[code] == pytest.approx(inches, abs=3)
