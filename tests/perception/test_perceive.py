"""From a recording to a drive, through the functions and through the command line."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from fgloc import api
from fgloc.cli import main
from fgloc.datasets.calibration_set import write_calibration
from fgloc.datasets.drive_folder import read_drive
from fgloc.datasets.perception_recording import read_recording, write_recording
from fgloc.errors import ConfigError, InputError
from fgloc.frames import exp_so3
from fgloc.measurements import PEDESTRIAN, VEHICLE
from fgloc.perception.boxes import ImageBoxes, upright_corners
from fgloc.perception.heads import Head, PerceptionNode
from fgloc.perception.idw import Calibration
from fgloc.perception.image_files import read_image
from fgloc.perception.lidar_detector import LidarDetector

from .small_street import CAR_SIZE_M, CARS, NODE, PERSON, small_recording

FINE = {"background": {"shrink": 1}}
"""The images are small already."""


@pytest.fixture(scope="module", autouse=True)
def _each_cloud_is_looked_at_once():
    """Detectors of clouds take half of the time, and are tested elsewhere."""
    looks, look = {}, LidarDetector.look

    def remembered(self, cloud_m, frame):
        key = hash(cloud_m.tobytes())
        if key not in looks:
            looks[key] = look(self, cloud_m, frame)
        return looks[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(LidarDetector, "look", remembered)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The small street as a folder of files, from which all are read."""
    path = tmp_path_factory.mktemp("street") / "recording"
    write_recording(small_recording(), path)
    return path


@pytest.fixture(scope="module")
def recording(folder):
    return read_recording(folder)


def held_against_truth(drive, within_m=1.5):
    """Of each road user: errors (N, 2), NEES (N,), numbers and kinds that were told."""
    seen, truth = drive.tables["detections"], drive.objects
    told = {}
    p_world_m = NODE.to_world(seen.p_node_m)
    R = NODE.R_world_node
    for number in np.unique(truth.object_id).tolist():
        rows = truth.object_id == number
        place = dict(zip(truth.t_ns[rows].tolist(), truth.p_world_m[rows], strict=True))
        error = np.array([p - place[t] for p, t in zip(p_world_m, seen.t_ns.tolist(), strict=True)])
        near = np.hypot(*error.T) < within_m
        cov = R @ seen.cov_node_m2[near] @ R.T
        nees = np.einsum("ni,nij,nj->n", error[near], np.linalg.inv(cov), error[near])
        told[number] = error[near], nees, seen.object_id[near], seen.kind[near]
    return told


@pytest.mark.parametrize("method", ["fused", "lidar", "camera"])
def test_all_road_users_are_found_where_they_are(recording, method):
    drive, found = api.perceive(recording, method=method, **FINE)
    told = held_against_truth(drive, within_m=2.5 if method == "camera" else 1.5)
    frames = len(recording.images[0])
    for number in (*CARS, PERSON):
        error, nees, ids, kind = told[number]
        assert len(error) > 0.6 * frames
        # A pixel of these images is 0.4 m of the ground at 50 m, along the ray.
        assert np.sqrt((error**2).mean()) < (1.0 if method == "camera" else 0.25)
        assert np.mean(nees) / 2 < 4
        assert len(set(ids.tolist())) == 1
        if method != "lidar":
            assert np.mean(kind == (PEDESTRIAN if number == PERSON else VEHICLE)) > 0.9
    ghosts = len(drive.tables["detections"]) - sum(len(one[0]) for one in told.values())
    assert ghosts <= (8 if method == "camera" else 2)
    assert found.frames == frames
    assert found.remarks == ()


def test_what_is_tracked_is_smoother_than_what_is_measured(recording):
    jumps = {}
    for report in ("measured", "tracked"):
        drive, _ = api.perceive(recording, method="lidar", report=report)
        seen = drive.tables["detections"]
        numbers, counts = np.unique(seen.object_id, return_counts=True)
        rows = seen.object_id == numbers[counts.argmax()]
        jumps[report] = np.abs(np.diff(seen.p_node_m[rows][5:], 3, axis=0)).mean()
    assert jumps["tracked"] < jumps["measured"]


def test_boxes_of_another_detector_do_as_well(recording):
    boxes = []
    drive, _ = api.perceive(
        recording, method="camera", show=lambda done, of, seen: boxes.append(seen.boxes[0])
    )
    with pytest.raises(InputError, match=r"has no boxes\.csv"):
        api.perceive(recording, detector="table")
    table = replace(recording, boxes=ImageBoxes.concat(boxes))
    of_table, _ = api.perceive(table, method="camera", detector="table")
    assert drive.tables["detections"].same_as(of_table.tables["detections"])


@pytest.mark.parametrize("point", ["bottom", "centre", "idw"])
def test_places_of_boxes_do_in_every_way(recording, tmp_path, point):
    config = {"point": point, "idw_file": str(tmp_path / "calibration.csv")}
    if point == "idw":
        write_calibration(calibration(recording.node.cameras[0]), config["idw_file"])
    drive, _ = api.perceive(recording, method="camera", place=config, **FINE)
    error, nees, _, _ = held_against_truth(drive, within_m=3.0)[CARS[0]]
    assert len(error) > 0.6 * len(recording.images[0])
    assert np.median(np.hypot(*error.T)) < 1.5
    assert np.median(nees) < 6


def calibration(camera):
    """Middles of the boxes of cars all over the street, and where the cars are."""
    x_m, y_m = (axis.ravel() for axis in np.meshgrid(np.arange(18.0, 60), np.arange(-4.0, 4.1)))
    places = np.column_stack([x_m, y_m])
    centre_m = np.column_stack([places, np.full(len(places), -NODE.p_world_m[2] + 0.725)])
    corners_m = upright_corners(centre_m, np.tile(CAR_SIZE_M, (len(places), 1)), 0 * x_m)
    pixels = camera.project(corners_m.reshape(-1, 3)).reshape(-1, 8, 2)
    return Calibration((pixels.min(1) + pixels.max(1)) / 2, NODE.to_world(places))


@pytest.mark.parametrize(
    ("turn_deg", "says"), [(1.2, "px right of"), (20, "boxes lie on an object that the LiDAR")]
)
def test_a_camera_that_is_turned_is_told(recording, turn_deg, says):
    (head,), camera = recording.node.heads, recording.node.cameras[0]
    turned = replace(camera, R_node_cam=exp_so3([0, 0, np.deg2rad(turn_deg)]) @ camera.R_node_cam)
    node = PerceptionNode(NODE, (Head("head", (turned,), head.lidar),), 10.0)
    _, found = api.perceive(replace(recording, node=node), **FINE)
    assert any(says in remark and "mount" in remark for remark in found.remarks)


def test_a_clock_that_is_off_is_told(recording):
    images = recording.images[0]
    late = replace(images, t_ns=images.t_ns + 250_000_000)
    _, found = api.perceive(replace(recording, images=(late,)), **FINE)
    told = next(remark for remark in found.remarks if "clock_ahead_s" in remark)
    assert 0.15 < float(told.split("stamps are ")[1].split(" s")[0]) < 0.35


def test_frames_that_are_lost_or_damaged_are_counted(folder, tmp_path, recording):
    broken = tmp_path / "broken"
    shutil.copytree(folder, broken)
    images = sorted((broken / "head-camera").glob("*.jpg"))
    images[3].unlink()
    images[5].write_bytes(images[5].read_bytes()[:500])
    np.savez(sorted((broken / "head-lidar").glob("*.npz"))[7], points_m=np.zeros((0, 3)))
    lines = (broken / "head-lidar" / "frames.csv").read_text().splitlines()
    (broken / "head-lidar" / "frames.csv").write_text("\n".join(lines[:15] + lines[17:]) + "\n")
    drive, found = api.perceive(broken, **FINE)
    assert found.dropped["head-camera: frames that cannot be read"] == 2
    assert found.dropped["head: empty clouds"] == 1
    assert any("000003.jpg" in remark for remark in found.remarks)
    assert any("head-lidar: 2 of 25 frames are missing" in remark for remark in found.remarks)
    assert "empty clouds (1)" in drive.about.source
    assert all(len(held_against_truth(drive)[number][0]) > 12 for number in CARS)


def test_the_command_writes_a_drive_and_pictures(folder, tmp_path, capsys):
    out = tmp_path / "drive"
    fine = ["--set", "background.shrink=1"]
    assert main(["perceive", str(folder), "--out", str(out), "--json", *fine]) == 0
    told = json.loads(capsys.readouterr().out)
    drive = read_drive(out)
    assert told["detections"] == len(drive.tables["detections"])
    assert told["objects"] == 3
    assert drive.infrastructure.nodes[0].name == "small"
    assert len(drive.objects)
    picture = read_image(out / "overlay.png")
    assert picture.shape[1] == 2 * 640  # one camera and the plan
    assert picture.std() > 20
    assert main(["doctor", str(out)]) == 0
    capsys.readouterr()
    assert main(["perceive", str(folder), "--out", str(out)]) == 2
    assert "overwrite" in capsys.readouterr().err
    again = ["perceive", str(folder), "--out", str(out), "--overwrite", "--no-overlay"]
    assert main([*again, "--method", "lidar"]) == 0
    text = capsys.readouterr().out
    assert "Drive written to" in text
    assert not (out / "overlay.png").exists()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--detector", "table"], "has no boxes.csv"),
        (["--detector", "onnx"], "no such file; give a network in ONNX"),
        (["--onnx", "missing.onnx"], "no such file; give a network in ONNX"),
        (["--onnx", "net.onnx", "--detector", "table"], "--onnx goes with --detector onnx"),
        (["--set", "track.coast=2"], "the nearest valid key is 'track.coast_s'"),
        (["--set", "place.point=idw"], "needs place.idw_file"),
        (["--set", "method=lidar", "--method", "camera"], "give one of them"),
    ],
)
def test_wrong_options_end_with_one_line(folder, tmp_path, capsys, arguments, says):
    out = tmp_path / "drive"
    assert main(["perceive", str(folder), "--out", str(out), *arguments]) == 2
    assert says in " ".join(capsys.readouterr().err.split())
    assert not out.exists()


def test_a_folder_that_is_no_recording_is_refused(tmp_path, capsys):
    assert main(["perceive", str(tmp_path), "--out", str(tmp_path / "drive")]) == 2
    assert "recording.toml" in capsys.readouterr().err


def test_where_nothing_moves_nothing_is_claimed(recording):
    image = recording.image(0, 0)
    still = replace(recording.images[0], load=lambda k: image)
    with pytest.raises(InputError, match="no object was seen in 25 frames"):
        api.perceive(replace(recording, images=(still,)), method="camera")


def test_all_faults_of_a_configuration_are_named_at_once():
    with pytest.raises(ConfigError, match=r"place\.sigma_px.*track\.confirm_hits"):
        api.perceive("anywhere", settings=["place.sigma_px=0", "track.confirm_hits=0"])
