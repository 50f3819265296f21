"""Nodes beside the road: where what they see lies in the world, and what is refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fgloc.datasets.drive_folder import read_drive
from fgloc.drive import Drive, Rig
from fgloc.errors import DriveError
from fgloc.frames import Origin
from fgloc.infrastructure import Anchor, Infrastructure, Node, Post, Sign
from fgloc.measurements import NodeDetections

TOML = """format = 1
name = "roadside"
[origin]
lat_deg = 42.3
lon_deg = -83.7
height_m = 270
[[node]]
name = "pole"
p_world_m = [10, 20, 6]
yaw_rad = 1.5707963267948966
"""


SEEN = "t_ns,node,object_id,kind,x_m,y_m\n1,0,7,1,10,25\n"


def write(folder, detections: str, toml: str = TOML):
    (folder / "drive.toml").write_text(toml)
    (folder / "detections.csv").write_text(detections)
    return folder


def test_a_node_that_looks_north_sees_what_lies_ahead_to_its_north():
    node = Node("pole", np.array([10.0, 20, 6]), np.pi / 2)
    np.testing.assert_allclose(node.to_world(np.array([[5.0, 0], [0, 3]])), [[10, 25], [7, 20]])


@given(st.floats(-10, 10), st.floats(-500, 500), st.floats(-500, 500))
def test_to_the_world_and_back_is_where_it_was(yaw_rad, x_m, y_m):
    node = Node("pole", np.array([1.0, -2, 3]), yaw_rad)
    seen = np.array([[x_m, y_m]])
    np.testing.assert_allclose(node.from_world(node.to_world(seen)), seen, atol=1e-9)


def test_detections_in_east_and_north_are_brought_to_the_nodes_axes(tmp_path):
    table = "t_ns,node,object_id,kind,east_m,north_m\n1,0,7,1,10,25\n"
    drive = read_drive(write(tmp_path, table))
    np.testing.assert_allclose(drive.tables["detections"].p_node_m, [[5, 0]], atol=1e-12)
    assert np.isnan(drive.tables["detections"].cov_node_m2).all()


def test_a_detection_of_a_node_that_is_not_there_names_row_and_remedy(tmp_path):
    table = "t_ns,node,object_id,kind,x_m,y_m\n1,0,7,1,10,25\n2,1,7,1,10,25\n"
    with pytest.raises(DriveError, match=r"detections.csv:3: node = 1, but drive.toml has 1 "):
        read_drive(write(tmp_path, table))


def test_a_covariance_that_is_none_names_its_row(tmp_path):
    header = "t_ns,node,object_id,kind,x_m,y_m,cov_xx_m2,cov_xy_m2,cov_yy_m2\n"
    with pytest.raises(DriveError, match=r"detections.csv:2: the covariance .* not positive"):
        read_drive(write(tmp_path, header + "1,0,7,1,10,25,1,2,1\n"))


def test_two_nodes_of_one_name_are_refused(tmp_path):
    with pytest.raises(DriveError, match="'pole' occurs twice"):
        read_drive(write(tmp_path, SEEN, TOML + '[[node]]\nname = "pole"\np_world_m = [0, 0, 0]\n'))


@pytest.mark.parametrize(
    ("part", "says"),
    [({"p_world_m": [0, 0]}, "three finite"), ({"range_m": -1.0}, "from 0"),
     ({"yaw_rad": np.nan}, "yaw_rad")],
)  # fmt: skip
def test_a_node_of_impossible_numbers_is_refused(part, says):
    with pytest.raises(DriveError, match=says):
        Node(**{"name": "pole", "p_world_m": np.zeros(3)} | part)


POST = """[[post]]
node = "pole"
height_m = 10
frequency_hz = 1.97
damping = 0.05
modal_mass_kg = 20
tip_slope_per_m = 0.138
load_sigma_n = 250
load_tau_s = 0.3
"""


def test_a_post_is_found_by_the_number_of_its_node(tmp_path):
    other = '[[node]]\nname = "wall"\np_world_m = [0, 0, 4]\n'
    posts = read_drive(write(tmp_path, SEEN, TOML + other + POST)).infrastructure
    assert posts.post_of(0).frequency_hz == 1.97
    assert posts.post_of(1) is None


@pytest.mark.parametrize(
    ("line", "by", "says"),
    [('node = "pole"', 'node = "pile"', "no node named 'pile'; add it as"),
     ("damping = 0.05", "damping = 5", "damping"),
     ("height_m = 10", "height_m = 0", "height_m")],
)  # fmt: skip
def test_a_post_that_cannot_be_is_refused(tmp_path, line, by, says):
    with pytest.raises(DriveError, match=says):
        read_drive(write(tmp_path, SEEN, TOML + POST.replace(line, by)))


def test_a_post_damped_in_per_cent_is_asked_about():
    with pytest.raises(DriveError, match="damping = 5: expected a ratio below 1; is it in per"):
        Post("pole", 10, 1.97, 5, 20, 0.138, 250, 0.3)


def test_a_drive_in_memory_knows_the_nodes_of_its_detections():
    seen = NodeDetections([1], [1], [2], [0], [1], [[0, 0]], np.full((1, 2, 2), np.nan))
    with pytest.raises(DriveError, match="node = 2, but the drive has 1 nodes"):
        Drive("d", Origin(42, -83, 0), Rig(), {"detections": seen}, None,
              infrastructure=Infrastructure((Node("pole", np.zeros(3)),)))  # fmt: skip


POSES = "t_ns,node,x_m,y_m,sigma_x_m,sigma_y_m"
TILTS = ",roll_rad,pitch_rad,sigma_roll_rad,sigma_pitch_rad"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (f"{POSES}\n1,3,0,0,1,1\n", r"node_poses.csv:2: node = 3, but drive.toml has 1 \[\[node"),
        (f"{POSES}\n1,0,0,0,1,1\n2,0,0,0,1,0\n", r"node_poses.csv:3: sigma_y_m = 0.0; a standard"),
        (f"{POSES}{TILTS}\n1,0,0,0,1,1,0,0,,1\n", "of roll_rad and sigma_roll_rad one is empty"),
        (f"{POSES}{TILTS}\n1,0,0,0,1,1,0,0,1,-1\n", "sigma_pitch_rad = -1.0; a standard"),
    ],
)
def test_a_pose_of_a_node_that_cannot_be_names_its_row(tmp_path, text, says):
    (tmp_path / "node_poses.csv").write_text(text)
    with pytest.raises(DriveError, match=says):
        read_drive(write(tmp_path, SEEN))


def test_a_pose_need_not_tell_angles(tmp_path):
    (tmp_path / "node_poses.csv").write_text(f"{POSES}\n1,0,0.1,0.2,1,1\n")
    poses = read_drive(write(tmp_path, SEEN)).tables["node_poses"]
    np.testing.assert_array_equal(poses.p_node_m, [[0.1, 0.2]])
    assert np.isnan(poses.tilt_rad).all()


def test_the_truth_of_a_post_is_of_a_node_that_is_there(tmp_path):
    header = "t_ns,node,x_m,y_m,vx_mps,vy_mps,roll_rad,pitch_rad\n"
    (tmp_path / "post_truth.csv").write_text(header + "1,0,0,0,0,0,0,0\n2,1,0,0,0,0,0,0\n")
    with pytest.raises(DriveError, match=r"post_truth.csv:3: node = 1, but drive.toml has 1"):
        read_drive(write(tmp_path, SEEN))


SIGN = (
    '[[sign]]\nname = "stop"\ncode = "c0de"\np_world_m = [1, 2, 3]\n'
    "normal_yaw_rad = 0\nsize_m = 0.5588\n"
)
CODES = "t_ns,sign,height_px,width_px,u0_px,v0_px,u1_px,v1_px,u2_px,v2_px,u3_px,v3_px\n"
MIDDLES = CODES.replace("u0_px", "u_px,v_px,u0_px")
ANCHOR = '[[anchor]]\nname = "a1"\np_world_m = [1, 2, 3]\n'
RANGES = "t_ns,anchor,range_m,sigma_m\n"


@pytest.mark.parametrize(
    ("part", "says"),
    [({"code": "0xFF"}, "expected hexadecimal"), ({"size_m": 0.0}, "size_m = 0.0"),
     ({"side": "middle"}, "'left' or 'right'"), ({"normal_yaw_rad": np.inf}, "normal_yaw_rad"),
     ({"p_world_m": np.full(3, np.nan)}, "sign 'stop': p_world_m: expected three finite")],
)  # fmt: skip
def test_a_sign_of_impossible_values_is_refused(part, says):
    with pytest.raises(DriveError, match=says):
        Sign(**{"name": "stop", "code": "c0de", "p_world_m": np.zeros(3),
                "normal_yaw_rad": 0.0, "size_m": 0.5} | part)  # fmt: skip


def test_a_sign_whose_face_looks_south_has_its_left_in_the_east():
    sign = Sign("stop", "1", np.zeros(3), -np.pi / 2, 0.5)
    np.testing.assert_allclose(sign.R_world_sign @ [10, 3], [3, -10], atol=1e-12)


def test_an_anchor_has_a_place():
    with pytest.raises(DriveError, match="anchor 'a1': p_world_m"):
        Anchor("a1", np.zeros(2))


def test_corners_alone_tell_the_middle_and_a_middle_does_without_corners(tmp_path):
    (tmp_path / "drive.toml").write_text(TOML + SIGN)
    path = tmp_path / "smart_codes.csv"
    path.write_text(CODES + "1,0,9,9,0,0,9,0,9,9,0,9\n")
    np.testing.assert_array_equal(
        read_drive(tmp_path).tables["smart_codes"].centre_px, [[4.5, 4.5]]
    )
    path.write_text(MIDDLES + "1,0,9,9,5,6,0,0,9,0,9,9,0,9\n2,0,9,9,7,8,,,,,,,,\n")
    both = read_drive(tmp_path).tables["smart_codes"]
    np.testing.assert_array_equal(both.centre_px, [[5, 6], [7, 8]])
    assert both.has_corners.tolist() == [True, False]
    path.write_text("t_ns,sign,height_px,width_px,u_px,v_px\n1,0,9,9,5,6\n")
    assert not read_drive(tmp_path).tables["smart_codes"].has_corners.any()


@pytest.mark.parametrize(
    ("name", "rows", "says"),
    [
        ("smart_codes", CODES + "1,0,9,9,0,0,9,0,9,9,0,9\n2,1,9,9,0,0,9,0,9,9,0,9\n",
         r"smart_codes.csv:3: sign = 1, but drive.toml has 1 \[\[sign\]\]"),
        ("smart_codes", CODES + "1,0,0,9,0,0,9,0,9,9,0,9\n", "height_px = 0.0; a size must be"),
        ("smart_codes", CODES + "1,0,9,9,0,0,9,0,9,9,0,\n",
         "smart_codes.csv:2: v3_px is empty but other corners are not; give all four"),
        ("smart_codes", CODES + "1,0,9,9,,,,,,,,\n",
         "smart_codes.csv:2: neither the code's middle nor its corners; give u_px,v_px in every"),
        ("smart_codes", MIDDLES + "1,0,9,9,,5,,,,,,,,\n",
         "smart_codes.csv:2: u_px = '' is not a number"),
        ("smart_codes", CODES + "1,0,9,9,0,9,9,9,9,0,0,0\n",
         "smart_codes.csv:2: the corners .* give them clockwise from the upper left one"),
        ("ranges", RANGES + "1,3,2.0,0.1\n", "ranges.csv:2: anchor = 3, but drive.toml has 1"),
        ("ranges", RANGES + "1,0,-2.0,0.1\n", "range_m = -2.0; a distance must be above 0"),
        ("ranges", RANGES + "1,0,2.0,0\n", "sigma_m = 0.0; a standard deviation must be above 0"),
    ],
)  # fmt: skip
def test_a_row_that_cannot_be_names_itself_and_the_remedy(tmp_path, name, rows, says):
    (tmp_path / "drive.toml").write_text(TOML + SIGN + ANCHOR)
    (tmp_path / f"{name}.csv").write_text(rows)
    with pytest.raises(DriveError, match=says):
        read_drive(tmp_path)
