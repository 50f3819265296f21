"""Recordings of ranges: a miniature of the UWB-dataset, and the plazas of the gtsam wheel."""

from pathlib import Path

import numpy as np
import pytest

from fgloc.datasets.drive_folder import read_drive, write_drive
from fgloc.datasets.registry import import_recording
from fgloc.errors import DriveError, InputError

HEADER = "%time,field.stamp,field.id,field.x,field.y,field.z,field.distanceFromTag,field.rssi\n"
FIX = "field.latitude,field.longitude,field.altitude\n37.5,127.0,49.8\n"
START = 1_734_501_485_000_000_000


@pytest.fixture
def run_folder(tmp_path):
    """Writes a run's folder, some files replaced; gives its path."""

    def write(name="Trajectory_B", **files: str) -> Path:
        folder = tmp_path / "LOS" / name / "Case_1"
        folder.mkdir(parents=True)
        contents = {"A3.csv": ranges(3, "2,1,1.5", 5), "A12.csv": ranges(12, "0,-1,0.5", 3),
                    "gnss.csv": FIX, "trajectory.csv": trajectory()}  # fmt: skip
        for file, text in (contents | {k.replace("__", "."): v for k, v in files.items()}).items():
            (folder / file).write_text(text)
        return folder

    return write


def ranges(number: int, place: str, offset_ms: int, range_m: str = "7.25") -> str:
    rows = []
    for i in range(3):
        stamp = START + i * 100_000_000 + offset_ms * 1_000_000
        rows.append(f"{stamp + 400_000},{stamp},{number},{place},{range_m},-79")
    return HEADER + "\n".join(rows) + "\n"


def trajectory() -> str:
    """Rows before, in and after the window of Trajectory_B, one of them off the ground."""
    rows = [(0, 0), (8, -8), (8, -9), (8.5, -10), (9, -8), (20, 0)]
    heights = [0, 0, 0.7, 0.1, 0, 0]
    lines = [
        f"{START + i * 125_000_000:.10e},{x},{y},{z},0.0"
        for i, ((x, y), z) in enumerate(zip(rows, heights, strict=True))
    ]
    return "timestamp,x,y,z,heading_degrees\n" + "\n".join(lines) + "\n"


def test_ranges_of_all_anchors_are_merged_in_time(run_folder):
    drive = import_recording("outdoor-uwb", run_folder())
    told = drive.tables["ranges"]
    assert told.anchor.tolist() == [1, 0, 1, 0, 1, 0]
    assert told.t_ns[0] == START + 3_000_000
    assert (told.received_ns - told.t_ns == 400_000).all()
    assert (told.range_m == 7.25).all()
    assert [a.name for a in drive.infrastructure.anchors] == ["A3", "A12"]
    np.testing.assert_array_equal(drive.infrastructure.anchors[0].p_world_m, [2, 1, 1.5])


def test_truth_is_what_the_authors_score(run_folder):
    drive = import_recording("outdoor-uwb", run_folder())
    np.testing.assert_array_equal(drive.truth.p_world_m[:, :2], [[8, -8], [8.5, -10], [9, -8]])
    assert "truth outside of the authors' window (2)" in drive.about.source
    assert "off the ground (1)" in drive.about.source


def test_a_drive_of_ranges_goes_through_a_folder(run_folder, tmp_path):
    drive = import_recording("outdoor-uwb", run_folder())
    write_drive(drive, tmp_path / "drive")
    assert read_drive(tmp_path / "drive").tables["ranges"].same_as(drive.tables["ranges"])


def test_ranges_that_are_none_are_counted(run_folder):
    drive = import_recording("outdoor-uwb", run_folder(A3__csv=ranges(3, "2,1,1.5", 5, "0.0")))
    assert len(drive.tables["ranges"]) == 3
    assert "ranges that are not above 0 (3)" in drive.about.source


@pytest.mark.parametrize(
    ("files", "says"),
    [
        ({"A3__csv": ranges(3, "2,1,1.5", 5, "x")}, "A3.csv:2: field.distanceFromTag = 'x'"),
        ({"A3__csv": "a,b\n1,2\n"}, "A3.csv:1: missing column field.x"),
        ({"A3__csv": ranges(3, "2,1,1.5", 5) + "1,2\n"}, "A3.csv:5: 2 cells, expected 8"),
        ({"A3__csv": ranges(3, "2,1,1", 5) + ranges(3, "2,1,2", 9).split("\n")[3] + "\n"},
         "the anchor's place changes"),
        ({"trajectory__csv": "timestamp,x,y,z\n1,0,0,0\n"}, "never enters or leaves the window"),
        ({"A3__csv": HEADER}, "has a header and no rows"),
    ],
)  # fmt: skip
def test_a_faulty_file_is_refused_by_place(run_folder, files, says):
    with pytest.raises(DriveError, match=says):
        import_recording("outdoor-uwb", run_folder(**files))


def test_a_folder_must_name_its_trajectory_and_hold_ranges(run_folder, tmp_path):
    with pytest.raises(DriveError, match="names neither Trajectory_A nor"):
        import_recording("outdoor-uwb", run_folder("Trajectory_C"))
    (tmp_path / "Trajectory_A").mkdir()
    with pytest.raises(DriveError, match=r"has no A\*.csv"):
        import_recording("outdoor-uwb", tmp_path / "Trajectory_A")


@pytest.mark.parametrize(("run", "rows", "anchors"), [("1", 3529, 4), ("2", 1816, 4)])
def test_the_plazas_of_the_wheel(run, rows, anchors):
    drive = import_recording("plaza", run)
    assert len(drive.tables["ranges"]) == rows
    assert len(drive.infrastructure.anchors) == anchors
    told, odometry = drive.truth, drive.tables["odometry"]
    length_m = np.linalg.norm(np.diff(told.p_world_m, axis=0), axis=1).sum()
    by_wheels_m = (odometry.speed_mps * np.gradient(odometry.t_ns) / 1e9).sum()
    assert by_wheels_m == pytest.approx(length_m, rel=0.05)


def test_the_ranges_of_plaza_1_are_long_by_some_percent():
    drive = import_recording("plaza", "1")
    ranges = drive.tables["ranges"]
    inside = drive.truth.covers(ranges.t_ns)
    place = np.array([a.p_world_m for a in drive.infrastructure.anchors])[ranges.anchor[inside]]
    stamps, row = np.unique(ranges.t_ns[inside], return_inverse=True)
    true_m = np.linalg.norm(drive.truth.at(stamps).p_world_m[row] - place, axis=1)
    slope, _ = np.polyfit(true_m, ranges.range_m[inside], 1)
    assert 1.01 < slope < 1.1


def test_there_is_no_third_plaza():
    with pytest.raises(InputError, match="there are 1 and 2"):
        import_recording("plaza", "3")
