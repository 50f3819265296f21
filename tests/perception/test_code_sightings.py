"""From images to a table: rendered codes become sightings, by which a drive is then found."""

import numpy as np
import pytest

from fgloc.datasets.marr2019_smart_code import FRAME_HZ, SIGNS, corners_in_camera, smart_code_motion
from fgloc.datasets.registry import make
from fgloc.errors import InputError
from fgloc.factors.corners import code_size_px
from fgloc.perception.code_sightings import sightings_of
from fgloc.perception.smart_code_reader import MarkerReader, Read, code_bits
from fgloc.perception.smart_code_renderer import Look, render
from fgloc.smoother.codes import smooth_codes

SQUARE = np.array([[60.0, 50], [160, 50], [160, 150], [60, 150]])
LARGE = SIGNS[0]


def read_of(*codes: str) -> Read:
    return Read(codes, np.array([SQUARE + i for i in range(len(codes))]).reshape(-1, 4, 2))


def test_rows_come_in_the_order_of_time_each_with_its_sign_size_and_middle():
    table = sightings_of([read_of("05b2"), read_of(), read_of("22a1", "05c3")], [30, 20, 10], SIGNS,
                         [31, 21, 11])  # fmt: skip
    assert (table.t_ns.tolist(), table.received_ns.tolist()) == ([10, 10, 30], [11, 11, 31])
    assert table.sign.tolist() == [0, 2, 1]
    assert table.has_corners.all()
    np.testing.assert_array_equal(table.corners_px[1], SQUARE + 1)
    np.testing.assert_array_equal(table.centre_px[0], [110, 100])
    np.testing.assert_array_equal(np.c_[table.height_px, table.width_px], np.full((3, 2), 100))


def test_images_without_codes_make_an_empty_table():
    assert len(sightings_of([read_of(), read_of()], [1, 2], SIGNS)) == 0


@pytest.mark.parametrize(
    ("reads", "t_ns", "signs", "says"),
    [
        ([read_of("22a7")], [1], SIGNS, "image 0: Smart Code '22a7' is on none of the signs; the "
         "nearest is '22a1'"),
        ([read_of("22a7")], [1], (), "there are no signs"),
        ([read_of("22a1")], [1, 2], SIGNS, r"t_ns has shape \(2,\); give one for each of the 1"),
        ([read_of("22a1")], [1.5], SIGNS, "t_ns is of type float64"),
        ([read_of("22a1")], [1], (LARGE, LARGE), "'22a1' is on two signs"),
        ([read_of(), Read(("22a1",), np.roll(SQUARE, 2, axis=0)[None])], [1, 2], SIGNS,
         "image 1: a Smart Code with corners .* is not upright"),
    ],
)  # fmt: skip
def test_what_cannot_be_a_sighting_is_refused_by_name(reads, t_ns, signs, says):
    with pytest.raises(InputError, match=says):
        sightings_of(reads, t_ns, signs)


def images_of(drive, every: int):
    """Reads of what the camera sees of the large sign on every so many frames, and their stamps."""
    frames, camera = smart_code_motion("left", FRAME_HZ).every(every), drive.rig.camera
    local, rng = corners_in_camera(frames, camera, LARGE), np.random.default_rng(8)
    px = camera.focal_px * local[..., :2] / local[..., 2:] + camera.principal_px
    range_m = np.linalg.norm(local.mean(1), axis=-1)
    reader, told, taken = MarkerReader.smart_codes([sign.code for sign in SIGNS]), [], []
    for t_ns, corners, away_m in zip(frames.t_ns, px, range_m, strict=True):
        if (corners < 60).any() or (corners > 1980).any() or away_m > 30:
            continue
        low = np.floor(corners.min(0)) - 60
        shape = tuple(np.ceil(np.ptp(corners, axis=0) + 120).astype(int)[::-1])
        image = render(code_bits(LARGE.code), corners - low, away_m, shape, Look(), rng)
        read = reader.read(image)
        told.append(Read(read.codes, read.corners_px + low))
        taken.append(t_ns)
    return told, taken, px[np.isin(frames.t_ns, taken)]


def test_a_drive_is_found_by_its_rendered_images():
    drive = make("marr2019/smart-code", 5)
    reads, taken, true_px = images_of(drive, 4)
    seen = sightings_of(reads, taken, SIGNS)
    assert len(seen) == len(reads) > 25
    assert np.sqrt(np.mean((seen.corners_px - true_px) ** 2)) < 0.35
    np.testing.assert_allclose(seen.height_px, code_size_px(true_px)[0], atol=1.5)
    trajectory = smooth_codes(drive.with_tables(smart_codes=seen)).trajectory
    t_ns = trajectory.t_ns[trajectory.t_ns <= drive.truth.t_ns[-1]]
    true = drive.truth.at_point(trajectory.p_veh_point_m).at(t_ns).p_world_m
    assert np.linalg.norm((trajectory.at(t_ns).p_world_m - true)[:, :2], axis=1).mean() < 0.1
