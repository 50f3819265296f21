"""Heights that detections and road users may tell: written, read, refused where they cannot be."""

from dataclasses import replace

import numpy as np
import pytest

import fgloc
from fgloc.datasets.drive_folder import read_drive, write_drive
from fgloc.drive import Drive, Rig
from fgloc.errors import DriveError
from fgloc.infrastructure import Infrastructure, Node
from fgloc.measurements import NodeDetections, UserFixes

TOML = """format = 1
name = "small"
[origin]
lat_deg = 50.0
lon_deg = 8.0
height_m = 100.0
[[node]]
name = "lidar"
p_world_m = [100.0, 0.0, 12.0]
[[node]]
name = "camera"
p_world_m = [0.0, 0.0, 9.0]
sensor = "camera"
"""
SEEN = "t_ns,node,object_id,kind,x_m,y_m"
USERS = "t_ns,user_id,east_m,north_m,sigma_east_m,sigma_north_m,up_m,sigma_up_m"


@pytest.fixture
def written(tmp_path):
    """Writes a drive folder with one table; gives its path."""

    def write(name: str, text: str):
        (tmp_path / "drive.toml").write_text(TOML)
        (tmp_path / f"{name}.csv").write_text(text)
        return tmp_path

    return write


def seen_by(node: str, up_m: float = -9.0, sigma_m: float = 0.1) -> NodeDetections:
    """One detection of the LiDAR or the camera."""
    none = np.full((1, 2, 2), np.nan)
    return NodeDetections([1], [1], [node == "camera"], [0], [1], [[3, 4]], none, [up_m], [sigma_m])


def drive_of(seen: NodeDetections) -> Drive:
    """Both nodes and what they see."""
    nodes = Node("lidar", np.zeros(3)), Node("camera", np.zeros(3), sensor="camera")
    return Drive("small", fgloc.Origin(50, 8, 0), Rig(), {"detections": seen},
                 infrastructure=Infrastructure(nodes))  # fmt: skip


def test_a_height_is_over_the_node_or_in_the_world(written):
    over = read_drive(written("detections", f"{SEEN},z_m,sigma_z_m\n1,0,0,1,3,4,-11.25,0.1\n"))
    world = read_drive(written("detections", f"{SEEN},up_m,sigma_up_m\n1,0,0,1,3,4,0.75,0.1\n"))
    for drive in (over, world):
        seen = drive.tables["detections"]
        assert (seen.up_node_m.tolist(), seen.sigma_up_m.tolist()) == ([-11.25], [0.1])
        assert seen.place_node_m.tolist() == [[3, 4, -11.25]]


def test_a_row_may_leave_its_height_empty_and_a_table_all_of_them(written):
    rows = "1,0,0,1,3,4,-11,0.1\n2,1,0,1,3,4,,\n"
    seen = read_drive(written("detections", f"{SEEN},z_m,sigma_z_m\n{rows}")).tables["detections"]
    assert seen.has_height.tolist() == [True, False]
    bare = read_drive(written("detections", f"{SEEN}\n1,0,0,1,3,4\n")).tables["detections"]
    assert not bare.has_height.any() and np.isnan(bare.sigma_up_m).all()


def test_a_user_may_tell_a_height(written):
    users = read_drive(written("users", f"{USERS}\n1,7,2,3,1,1,0.5,0.03\n2,7,2,3,1,1,,\n"))
    np.testing.assert_array_equal(users.tables["users"].up_m, [0.5, np.nan])
    np.testing.assert_array_equal(users.tables["users"].sigma_up_m, [0.03, np.nan])


def test_a_table_that_tells_no_height_is_written_without_the_columns(tmp_path):
    seen = replace(seen_by("lidar"), up_node_m=[np.nan], sigma_up_m=[np.nan])
    write_drive(drive_of(seen), tmp_path / "drive")
    assert "z_m" not in (tmp_path / "drive" / "detections.csv").read_text()
    assert read_drive(tmp_path / "drive").tables["detections"].same_as(seen)


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("detections", f"{SEEN},z_m,sigma_z_m\n1,0,0,1,3,4,-9,0\n",
         r"detections.csv:2: sigma_z_m = 0.0; a standard deviation must be above 0"),
        ("detections", f"{SEEN},z_m,sigma_z_m\n1,0,0,1,3,4,-9,0.1\n2,0,0,1,3,4,-9,\n",
         r"detections.csv:3: of z_m and sigma_z_m one is empty; give both or neither"),
        ("detections", f"{SEEN},z_m\n1,0,0,1,3,4,-9\n", "missing column sigma_z_m"),
        ("detections", f"{SEEN},z_m,sigma_z_m,up_m,sigma_up_m\n1,0,0,1,3,4,-9,1,0,1\n",
         "has columns of both z_m,sigma_z_m and up_m,sigma_up_m; keep one"),
        ("detections", f"{SEEN},up_m,sigma_up_m\n1,0,0,1,3,4,,\n2,1,0,1,3,4,0.5,0.1\n",
         r"detections.csv:3: up_m = 0.5 of node 'camera': a camera sees the ground along a ray"),
        ("users", f"{USERS}\n1,7,2,3,1,1,0.5,-1\n", r"users.csv:2: sigma_up_m = -1.0; a standard"),
        ("users", f"{USERS}\n1,7,2,3,1,1,,1\n", "users.csv:2: of up_m and sigma_up_m one is"),
    ],
)  # fmt: skip
def test_a_height_that_cannot_be_names_its_row_and_the_remedy(written, name, text, says):
    with pytest.raises(DriveError, match=says):
        read_drive(written(name, text))


@pytest.mark.parametrize(
    ("up_m", "sigma_m"), [(1.0, np.nan), (np.nan, 1.0), (1.0, 0.0), (1.0, -1.0), (np.inf, 1.0)]
)
def test_a_height_in_memory_has_a_sigma_or_is_nan(up_m, sigma_m):
    with pytest.raises(DriveError, match=r"detections row 0: height .* NaN for both"):
        seen_by("lidar", up_m, sigma_m)
    with pytest.raises(DriveError, match="users row 0: height"):
        UserFixes([1], [1], [7], [[2, 3]], np.eye(2)[None], [up_m], [sigma_m])


def test_a_drive_in_memory_takes_no_height_from_a_camera():
    assert drive_of(seen_by("lidar")).tables["detections"].has_height.all()
    says = "detections row 0: up_node_m = -9.0 of node 'camera': a camera sees"
    with pytest.raises(DriveError, match=says):
        drive_of(seen_by("camera"))
