"""Tracks of one head: birth, confirmation, coasting, death, classes, who sees what."""

import numpy as np
import pytest

from fgloc.measurements import PEDESTRIAN, UNKNOWN, VEHICLE
from fgloc.perception.boxes import Cuboids, ImageBoxes, upright_corners
from fgloc.perception.cuboid_fit import CAR_M, PERSON_M
from fgloc.perception.ground import ByBottom
from fgloc.perception.paper_nodes import lidar_32, pinhole
from fgloc.perception.settings import PerceiveConfig
from fgloc.perception.tracker import Tracker

GROUND_M = -10.0
STEP_NS = 100_000_000
CAMERAS = {0: pinhole("left", 0.35), 1: pinhole("right", -0.35)}
LIDAR = lidar_32("lidar", 0.0, 2.0)
SEEN_CAR_M = (4.5, 1.8, 1.45)
"""Not the usual size, so that its extents count as seen."""


def tracker(camera_only=True, lidar=LIDAR, **track) -> Tracker:
    config = PerceiveConfig(track={"camera_only": camera_only, **track})
    places = {k: ByBottom(camera, GROUND_M, config.place) for k, camera in CAMERAS.items()}
    return Tracker(CAMERAS, places, lidar, GROUND_M, config)


def cuboids(places, size=SEEN_CAR_M, sigma_m=0.1) -> Cuboids:
    n = len(places)
    centre = np.column_stack([np.reshape(places, (n, 2)), np.full(n, GROUND_M + size[2] / 2)])
    zero = np.zeros(n, int)
    return Cuboids(zero, zero, centre, np.tile(size, (n, 1)), np.zeros(n), zero + 60,
                   np.tile(sigma_m**2 * np.eye(2), (n, 1, 1)))  # fmt: skip


def boxes(camera: int, places, kind=VEHICLE, size=SEEN_CAR_M) -> ImageBoxes:
    """What a camera sees of cuboids, as far as they are wholly in its image."""
    n = len(places)
    centre = np.column_stack([np.reshape(places, (n, 2)), np.full(n, GROUND_M + size[2] / 2)])
    corners = upright_corners(centre, np.tile(size, (n, 1)), np.zeros(n)).reshape(-1, 3)
    pixels = CAMERAS[camera].project(corners).reshape(n, 8, 2)
    whole = CAMERAS[camera].sees(pixels.reshape(-1, 2)).reshape(n, 8).all(1)
    edges = np.concatenate([pixels.min(1), pixels.max(1)], 1)[whole]
    m = len(edges)
    return ImageBoxes(np.zeros(m), np.full(m, camera), edges, np.full(m, kind), np.ones(m))


def frame(tracks: Tracker, k: int, lidar=None, seen=()):
    tracks.begin(k * STEP_NS)
    if lidar is not None:
        tracks.see_cuboids(k * STEP_NS, lidar)
    for one in seen:
        if len(one):
            tracks.see_boxes(k * STEP_NS, int(one.camera[0]), one)
    return tracks.end()


def drive(k: int, from_m=(25.0, 2.0), speed_mps=10.0):
    return [from_m[0] + 0.1 * speed_mps * k, from_m[1]]


def test_a_car_is_told_of_from_the_third_frame_on_with_its_speed():
    tracks = tracker()
    told = [frame(tracks, k, cuboids([drive(k)])) for k in range(20)]
    assert [len(one) for one in told[:4]] == [0, 0, 1, 1]
    last = told[-1]
    np.testing.assert_allclose(last.x[0, :2], drive(19), atol=0.05)
    np.testing.assert_allclose(last.x[0, 3:5], [10, 0], atol=0.3)
    np.testing.assert_allclose(last.x[0, 5:8], SEEN_CAR_M, atol=0.1)
    assert last.id.tolist() == [0]
    assert last.kind.tolist() == [VEHICLE]  # its length leaves no doubt


def test_what_is_told_of_the_place_is_this_frame_s_own():
    tracks = tracker()
    for k in range(10):
        frame(tracks, k, cuboids([drive(k)]))
    aside = np.array(drive(10)) + [0.0, 0.15]
    told = frame(tracks, 10, cuboids([aside]))
    np.testing.assert_allclose(told.alone_x[0, :2], aside, atol=0.02)
    assert told.alone_P[0, 0, 0] > told.P[0, 0, 0]


def test_an_echo_is_never_told_of_and_is_counted():
    tracks = tracker()
    told = [frame(tracks, k, cuboids([[30.0, 0.0]] if k == 0 else [])) for k in range(6)]
    assert not any(len(one) for one in told)
    assert len(tracks.tracks) == 0
    assert tracks.doubtful == 1


@pytest.mark.parametrize(("hidden", "same"), [(9, True), (11, False)])
def test_a_hidden_car_keeps_its_number_for_a_second(hidden, same):
    tracks = tracker(coast_s=1.0)
    for k in range(10):
        frame(tracks, k, cuboids([drive(k)]))
    told = [frame(tracks, k, cuboids([])) for k in range(10, 10 + hidden)]
    assert not any(len(one) for one in told)  # a track that coasts is not told of
    later = [frame(tracks, k, cuboids([drive(k)])) for k in range(10 + hidden, 15 + hidden)]
    assert (later[-1].id.item() == 0) is same


def test_two_cars_that_meet_keep_their_numbers():
    tracks = tracker()
    for k in range(40):
        places = [drive(k, (20.0, 2.0)), drive(k, (60.0, -1.2), -10.0)]
        told = frame(tracks, k, cuboids(places if k % 2 else places[::-1]))
    order = np.argsort(told.x[:, 1])
    np.testing.assert_allclose(told.x[order, 3], [-10, 10], atol=0.3)
    assert sorted(told.id.tolist()) == [0, 1]


def test_a_part_of_a_car_is_no_second_one():
    tracks = tracker()
    for k in range(8):
        frame(tracks, k, cuboids([drive(k)]))
    told = frame(tracks, 8, cuboids([drive(8), [drive(8)[0] + 1.5, 2.5]]))
    assert len(told) == len(tracks.tracks) == 1


def test_the_class_comes_from_the_camera():
    tracks = tracker()
    for k in range(5):
        place = [[28.0, 4.0 + 0.1 * k]]
        small = cuboids(place, (0.5, 0.5, 1.1))
        told = frame(tracks, k, small, [boxes(0, place, PEDESTRIAN, (0.5, 0.5, 1.7))])
    assert told.kind.tolist() == [PEDESTRIAN]
    assert told.x[0, 7] == pytest.approx(PERSON_M[2], abs=0.15)  # with the size of its kind
    alone = tracker()
    for k in range(5):
        told = frame(alone, k, cuboids([[28.0, 4.0]], (0.5, 0.5, 1.1)))
    assert told.kind.tolist() == [UNKNOWN]


def test_most_boxes_name_the_class():
    tracks = tracker()
    for k in range(7):
        kind = PEDESTRIAN if k in (1, 4) else VEHICLE
        told = frame(tracks, k, cuboids([drive(k)]), [boxes(0, [drive(k)], kind)])
    assert told.kind.tolist() == [VEHICLE]


def test_a_car_that_only_the_camera_sees_is_placed_with_a_longer_sigma_along_the_ray():
    tracks = tracker(lidar=None)
    for k in range(15):
        told = frame(tracks, k, seen=[boxes(0, [drive(k, (25.0, 6.0))])])
    np.testing.assert_allclose(told.x[0, :2], drive(14, (25.0, 6.0)), atol=0.5)
    assert told.P[0, 0, 0] > 4 * told.P[0, 1, 1]
    silent = tracker(camera_only=False, lidar=None)
    for k in range(15):
        assert not len(frame(silent, k, seen=[boxes(0, [drive(k, (25.0, 6.0))])]))


def test_boxes_of_two_cameras_are_one_car():
    tracks = tracker(lidar=None)
    for k in range(10):
        places = [drive(k, (40.0, 0.0))]
        seen = [boxes(0, places), boxes(1, places)]
        assert all(len(one) == 1 for one in seen)
        told = frame(tracks, k, seen=seen)
    assert len(told) == len(tracks.tracks) == 1
    assert told.votes[0, VEHICLE] == 20


def test_camera_and_lidar_together_are_surer_than_either():
    both, lidar = tracker(), tracker()
    for k in range(8):
        place = [drive(k, (45.0, 6.0))]
        one = frame(both, k, cuboids(place, sigma_m=0.3), [boxes(0, place)])
        other = frame(lidar, k, cuboids(place, sigma_m=0.3))
    assert one.alone_P[0, 1, 1] < 0.5 * other.alone_P[0, 1, 1]


def test_a_box_that_the_image_cuts_off_says_neither_class_nor_place():
    tracks = tracker()
    place = [[28.0, 8.0]]
    cut = boxes(0, place)
    cut = ImageBoxes(cut.frame, cut.camera, np.array([[-0.5, *cut.box_px[0, 1:]]]), cut.kind,
                     cut.score)  # fmt: skip
    for k in range(5):
        told = frame(tracks, k, cuboids(place, CAR_M), [cut])
    assert told.kind.tolist() == [UNKNOWN]
    assert not tracks.matches


def test_matches_tell_how_far_box_and_cuboid_are_apart():
    tracks = tracker()
    for k in range(10):
        place = [drive(k)]
        seen = boxes(0, place)
        off = ImageBoxes(seen.frame, seen.camera, seen.box_px + [5.0, -3, 5, -3], seen.kind,
                         seen.score)  # fmt: skip
        frame(tracks, k, cuboids(place), [off])
    last = tracks.matches[-1]
    np.testing.assert_allclose(last.seen_px - last.expected_px, [5, -3], atol=3)
    assert last.speed_pxps[1] < -20  # it drives away, up the image
