"""Recordings of a node's sensors: round trips, clocks, and a message for all that can be wrong."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fgloc.datasets.perception_recording import (
    is_recording_folder,
    read_recording,
    write_recording,
)
from fgloc.drive import About
from fgloc.errors import DriveError
from fgloc.frames import Origin
from fgloc.infrastructure import Node
from fgloc.measurements import ObjectTruth
from fgloc.perception.boxes import ImageBoxes
from fgloc.perception.paper_nodes import khamooshi2023_node, lee2021_node
from fgloc.perception.recording import Frames, Recording
from fgloc.timing import utc_to_gps_ns, utc_to_tai_ns

T_NS = 1_600_000_000_000_000_000 + np.arange(3) * 100_000_001
SURVEY = Node("n", np.array([1.0, -2, 10]), 0.3, sigma_position_m=0.02, sensor="camera")


def small(make=lee2021_node) -> Recording:
    """Three frames of each sensor: images of 1920 x 1200 are not needed to be right."""
    node = make(SURVEY)
    heads = tuple(
        replace(head, cameras=tuple(replace(c, size_px=(12, 8)) for c in head.cameras))
        for head in node.heads
    )
    node, rng = replace(node, heads=heads), np.random.default_rng(0)
    pictures = rng.integers(0, 255, (3, 8, 12, 3), dtype=np.uint8)
    points = rng.normal(0, 30, (3, 50, 3)).astype(np.float32).astype(float)

    def frames(sensor, load):
        return Frames(sensor, T_NS, T_NS + 5_000_000, load)

    return Recording(
        "small", Origin(42.3, -83.7, 240.0), node,
        tuple(frames(camera.name, pictures.__getitem__) for camera in node.cameras),
        tuple(frames(head.lidar.name, points.__getitem__) for head in node.heads),
        ImageBoxes(*map(np.array, ([0, 2], [0, 1], [[1.5, 2, 3, 4], [5, 6, 9, 8]], [1, 2],
                                   [0.5, 1.0]))),
        ObjectTruth(T_NS, T_NS, np.arange(3), np.ones((3, 2)), np.zeros((3, 2))),
        About("Small", "MIT", "a test", True),
    )  # fmt: skip


@pytest.fixture
def folder(tmp_path) -> Path:
    write_recording(small(), tmp_path / "r", ".png")
    return tmp_path / "r"


@pytest.mark.parametrize("make", [lee2021_node, khamooshi2023_node])
def test_a_recording_is_read_as_it_was_written(tmp_path, make):
    told: list[tuple[int, int]] = []
    wrote = small(make)
    write_recording(wrote, tmp_path / "r", ".png", lambda done, of: told.append((done, of)))
    read = read_recording(tmp_path / "r")
    assert (read.name, read.origin, read.about) == (wrote.name, wrote.origin, wrote.about)
    assert read.objects.same_as(wrote.objects)
    np.testing.assert_equal(vars(read.boxes), vars(wrote.boxes))
    np.testing.assert_equal(vars(read.node.node), vars(wrote.node.node))
    for mine, theirs in zip(read.node.heads, wrote.node.heads, strict=True):
        np.testing.assert_equal(vars(mine.lidar), vars(theirs.lidar))
        for one, other in zip(mine.cameras, theirs.cameras, strict=True):
            np.testing.assert_equal(vars(one), vars(other))
    for camera in range(2):
        np.testing.assert_array_equal(read.images[camera].received_ns, T_NS + 5_000_000)
        for frame in range(3):
            expected = wrote.image(camera, frame)
            np.testing.assert_array_equal(read.image(camera, frame), expected)
    for head in range(len(read.clouds)):
        np.testing.assert_array_equal(read.cloud(head, 1), wrote.cloud(head, 1))
    assert told[-1] == (3 * (2 + len(read.clouds)),) * 2


def test_points_that_are_not_finite_are_left_out_and_turned_into_the_nodes_axes():
    one = small()
    points = np.array([[1.0, 0, 0], [np.nan] * 3])
    frames = replace(one.clouds[0], load=lambda frame: points)
    lidar = one.node.heads[0].lidar
    cloud = replace(one, clouds=(frames, one.clouds[1])).cloud(0, 0)
    np.testing.assert_allclose(cloud, [lidar.R_node_lidar[:, 0] + lidar.p_node_lidar_m])


@pytest.mark.parametrize(("clock", "from_utc"), [("gps", utc_to_gps_ns), ("tai", utc_to_tai_ns)])
def test_stamps_of_other_clocks_become_posix(folder, clock, from_utc):
    text = (folder / "recording.toml").read_text()
    (folder / "recording.toml").write_text(f'clock = "{clock}"\n{text}')
    for name in ("left-camera", "right-camera", "left-lidar", "right-lidar"):
        rows = "\n".join(f"{t},{k:06d}.{'png' if 'camera' in name else 'npz'}"
                         for k, t in enumerate(from_utc(T_NS)))  # fmt: skip
        (folder / name / "frames.csv").write_text(f"t_ns,file\n{rows}\n")
    read = read_recording(folder)
    assert all(frames.t_ns.tolist() == T_NS.tolist() for frames in (*read.images, *read.clouds))
    assert read.images[0].received_ns.tolist() == T_NS.tolist()


def test_a_sensor_whose_clock_is_known_to_be_ahead_is_set_right(folder):
    text = (folder / "recording.toml").read_text()
    text = text.replace('name = "left-lidar"', 'name = "left-lidar"\nclock_ahead_s = 0.25')
    (folder / "recording.toml").write_text(text)
    read = read_recording(folder)
    assert (read.clouds[0].t_ns - T_NS).tolist() == [-250_000_000] * 3
    assert read.clouds[1].t_ns.tolist() == T_NS.tolist()


@pytest.mark.parametrize(("file", "old", "new", "message"), [
    ("recording.toml", "height_m = 10.0", "height_m = -1.0", r"node\.height_m"),
    ("recording.toml", "[origin]", "[orign]", "orign"),
    ("recording.toml", "sigma_m = 0.03", "sigma_m = 0.0", "LiDAR 'left-lidar': sigma_m = 0.0"),
    ("recording.toml", 'name = "right-camera"', 'name = "left-camera"', "occurs twice"),
    ("recording.toml", 'name = "left-camera"', 'name = "../cam"', r"camera\.0\.name"),
    ("recording.toml", "format = 1", "format = ", "not valid TOML"),
    ("left-camera/frames.csv", "t_ns,", "t_s,", r":1: unknown column 't_s'; the nearest .* 't_ns'"),
    ("left-camera/frames.csv", ",file", ",t_ns", ":1: column 't_ns' is needed once"),
    ("left-camera/frames.csv", ",000001.png", "", r":3: 2 cells where the header names 3"),
    ("left-camera/frames.csv", "000001.png", "000001.npz", r":3: file = '000001.npz': expected"),
    ("left-camera/frames.csv", "000001.png", "../a.png", r":3: file = '../a.png': expected the"),
    ("left-camera/frames.csv", str(T_NS[1]), "1.6e18", r":3: t_ns = '1.6e18' is not a whole"),
    ("left-camera/frames.csv", str(T_NS[1]), str(T_NS[0]), "frame 1: t_ns = .* is not later"),
    ("boxes.csv", "score", "scores", "unknown column 'scores'"),
    ("boxes.csv", "1.5,2.0,3.0", "3.5,2.0,3.0", r"boxes.csv: image boxes row 0: box_px"),
    ("boxes.csv", "2,1,", "2,7,", "row 1: camera = 7, but the node has 2 cameras"),
    ("boxes.csv", "2,1,", "9,1,", "row 1: frame = 9, but camera 1 has 3 frames"),
])  # fmt: skip
def test_each_fault_is_told_with_its_place(folder, file, old, new, message):
    path = folder / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(DriveError, match=message) as told:
        read_recording(folder)
    assert file in str(told.value)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)
@given(text=st.text(st.sampled_from("t_ns,file\n\r\"0129.pngé\0\ufeff/-"), max_size=60),
       header=st.booleans())  # fmt: skip
def test_whatever_a_list_of_frames_holds_it_is_read_or_told(folder, text, header):
    path = folder / "left-camera/frames.csv"
    path.write_text(("t_ns,file\n" if header else "") + text, encoding="utf-8", newline="")
    try:
        assert len(read_recording(folder).images[0])
    except DriveError as err:
        assert "frames.csv" in str(err) or "boxes" in str(err)


def test_a_frame_that_is_missing_or_damaged_is_told_when_it_is_asked_for(folder):
    (folder / "left-camera/000001.png").unlink()
    (folder / "left-lidar/000002.npz").write_bytes(b"no")
    read = read_recording(folder)
    assert read.image(0, 0).shape == (8, 12, 3)
    with pytest.raises(DriveError, match=r"left-camera/000001\.png: no such file"):
        read.image(0, 1)
    with pytest.raises(DriveError, match=r"left-lidar/000002\.npz: is no NPZ file"):
        read.cloud(0, 2)


def test_an_image_of_another_size_than_its_camera_is_refused(folder):
    text = (folder / "recording.toml").read_text()
    (folder / "recording.toml").write_text(text.replace("    12,\n    8,\n", "    8,\n    8,\n", 1))
    with pytest.raises(DriveError, match="frame 0 is 12 x 8 px, the camera 8 x 8; correct"):
        read_recording(folder).image(0, 0)


def test_missing_parts_and_full_folders_are_told(folder, tmp_path):
    assert is_recording_folder(folder)
    with pytest.raises(DriveError, match=r"is not a recording: it has no recording\.toml"):
        read_recording(tmp_path)
    with pytest.raises(DriveError, match="is not an empty folder; choose another"):
        write_recording(small(), folder)
    (folder / "left-camera/frames.csv").write_text("t_ns,file\n")
    with pytest.raises(DriveError, match="lists no frames"):
        read_recording(folder)
    (folder / "left-camera/frames.csv").unlink()
    with pytest.raises(DriveError, match=r"left-camera/frames\.csv: no such file"):
        read_recording(folder)


def test_the_recording_that_the_readme_shows_is_one(tmp_path):
    readme = (Path(__file__).parents[2] / "datasets/README.md").read_text(encoding="utf-8")
    shown = next(part for part in readme.split("```toml")[1:] if "[[head]]" in part)
    (tmp_path / "recording.toml").write_text(shown.split("```")[0])
    for sensor, file in (("north-camera", "a.png"), ("north-lidar", "a.npz")):
        (tmp_path / sensor).mkdir()
        (tmp_path / sensor / "frames.csv").write_text(f"t_ns,file\n1000,{file}\n")
    read = read_recording(tmp_path)
    assert [head.name for head in read.node.heads] == ["north"]
    assert read.clouds[0].t_ns.tolist() == [1000]


def test_frames_and_sensors_must_be_the_same():
    one = small()
    with pytest.raises(DriveError, match="frames and sensors are not the same"):
        replace(one, images=one.images[::-1], boxes=None)
    with pytest.raises(DriveError, match="differ in length"):
        replace(one.images[0], received_ns=T_NS[:2])
