"""Trajectory files: written for other programs, read back without losing a nanosecond."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgloc import frames
from fgloc.datasets.city import make_city
from fgloc.datasets.trajectory_files import (
    read_trajectory,
    read_tum,
    write_geojson,
    write_trajectory_csv,
    write_tum,
)
from fgloc.errors import DriveError, InputError
from fgloc.frames import Origin
from fgloc.trajectory import Trajectory

ORIGIN = Origin(40.0, -105.0, 1600.0)
TUM = "1.000000000 0 0 0 0 0 0 1\n2.000000001 1 0 0 0 0 0.6 0.8\n"


def some_trajectory() -> Trajectory:
    rng = np.random.default_rng(3)
    half = rng.standard_normal((5, 6, 6))
    cov = half @ half.swapaxes(-1, -2)
    return Trajectory(
        1_752_003_244_000_000_001 + np.arange(5) * 10_000_003,
        rng.standard_normal((5, 3)) * 1000,
        frames.exp_so3(rng.standard_normal((5, 3))),
        rng.standard_normal((5, 3)),
        (cov + cov.swapaxes(-1, -2)) / 2,
    )


def fault(path: Path) -> str:
    with pytest.raises(DriveError) as caught:
        read_trajectory(path)
    return str(caught.value).replace(f"{path.parent}/", "")


def test_csv_gives_back_all_but_the_last_bit_of_the_attitude(tmp_path):
    written = some_trajectory()
    write_trajectory_csv(tmp_path / "t.csv", written)
    again = read_trajectory(tmp_path / "t.csv")
    np.testing.assert_array_equal(again.t_ns, written.t_ns)
    np.testing.assert_array_equal(again.p_world_m, written.p_world_m)
    np.testing.assert_array_equal(again.v_world_mps, written.v_world_mps)
    np.testing.assert_array_equal(again.cov, written.cov)
    np.testing.assert_allclose(again.R_world_veh, written.R_world_veh, atol=1e-14)


def test_csv_columns_carry_units_and_derived_sigmas(tmp_path):
    write_trajectory_csv(tmp_path / "t.csv", some_trajectory())
    lines = (tmp_path / "t.csv").read_text().splitlines()
    names = lines[0].split(",")
    assert names[:8] == ["t_ns", "east_m", "north_m", "up_m", "qx", "qy", "qz", "qw"]
    assert names[8:11] == ["v_east_mps", "v_north_mps", "v_up_mps"]
    assert len([name for name in names if name.startswith("cov_")]) == 21
    assert {"cov_e_e_m2", "cov_e_rn_mrad", "cov_rn_ru_rad2"} <= set(names)
    along, across = some_trajectory().sigma_along_across_m()
    row = dict(zip(names, map(float, lines[1].split(",")), strict=True))
    assert (row["sigma_lateral_m"], row["sigma_longitudinal_m"]) == (across[0], along[0])


def test_csv_of_positions_only_has_no_more_columns(tmp_path):
    write_trajectory_csv(tmp_path / "t.csv", Trajectory([1, 2], np.zeros((2, 3))))
    assert (tmp_path / "t.csv").read_text().splitlines()[0] == "t_ns,east_m,north_m,up_m"
    again = read_trajectory(tmp_path / "t.csv")
    assert again.R_world_veh is None and again.v_world_mps is None and again.cov is None


def test_a_drives_truth_table_is_a_trajectory_file(tmp_path):
    from fgloc.datasets.drive_folder import write_drive

    drive = make_city(2, 2.0)
    write_drive(drive, tmp_path / "drive")
    assert read_trajectory(tmp_path / "drive" / "truth.csv").same_as(drive.truth)


@given(st.lists(st.integers(-(2**62), 2**62), min_size=1, max_size=8, unique=True))
@settings(max_examples=100, deadline=None)
def test_tum_keeps_every_nanosecond(tmp_path_factory, stamps):
    path = tmp_path_factory.getbasetemp() / "any.tum"
    written = Trajectory(sorted(stamps), np.zeros((len(stamps), 3)))
    write_tum(path, written)
    np.testing.assert_array_equal(read_tum(path).t_ns, written.t_ns)


def test_tum_gives_back_positions_and_attitudes(tmp_path):
    written = some_trajectory()
    write_tum(tmp_path / "t.tum", written)
    again = read_trajectory(tmp_path / "t.tum")
    np.testing.assert_array_equal(again.p_world_m, written.p_world_m)
    np.testing.assert_allclose(again.R_world_veh, written.R_world_veh, atol=1e-14)
    first = (tmp_path / "t.tum").read_text().split()
    assert first[0] == "1752003244.000000001" and len(first) == 5 * 8


def test_tum_comments_are_passed_over(tmp_path):
    path = tmp_path / "t.txt"
    path.write_text("# timestamp tx ty tz qx qy qz qw\n\n" + TUM)
    assert read_trajectory(path).t_ns.tolist() == [1_000_000_000, 2_000_000_001]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("t.tum", "", "t.tum: the file holds no states; lines of seconds x y z qx qy qz qw"),
        ("t.tum", TUM + "3 1 2\n", "t.tum:3: 3 values, expected 8: seconds x y z qx qy qz qw"),
        (
            "t.tum",
            "1,0,0,0,0,0,0,1\n",
            "t.tum:1: 1 values, expected 8: seconds x y z qx qy qz qw; "
            "is it separated by commas? save it as .csv",
        ),
        ("t.tum", "1 0 a 0 0 0 0 1\n", "t.tum:1: y = 'a' is not a number"),
        (
            "t.tum",
            "1 0 nan 0 0 0 0 1\n",
            "t.tum:1: y = nan is not finite; remove the line or repair it",
        ),
        (
            "t.tum",
            "# c\n1 0 0 0 0 0 0 0\n",
            "t.tum:2: the quaternion qx,qy,qz,qw has norm 0, expected 1; "
            "is a row or an order of columns wrong?",
        ),
        (
            "t.tum",
            TUM + "2.0 0 0 0 0 0 0 1\n",
            "t.tum:3: seconds = 2.000000000 goes back by 1 ns; "
            "rows must be in time order: sort them",
        ),
        (
            "t.tum",
            "# c\n" + TUM + "2.000000001 0 0 0 0 0 0 1\n",
            "t.tum:4: seconds = 2.000000001 occurs twice; remove one of the two rows",
        ),
        (
            "t.tum",
            "1.75e9 0 0 0 0 0 0 1\n",
            "t.tum:1: seconds = '1.75e9' is not a decimal number with at most nine decimals",
        ),
        (
            "t.tum",
            "1752003244000000000 0 0 0 0 0 0 1\n",
            "t.tum:1: seconds = 1752003244000000000 is out of range; is it in nanoseconds?",
        ),
        ("t.xyz", TUM, "t.xyz: a trajectory file ends in .tum, .txt or .csv, not '.xyz'"),
        (
            "t.csv",
            "t_ns,east_m,north_m,up_m\n2,0,0,0\n1,0,0,0\n",
            "t.csv:3: t_ns = 1 goes back by 1 ns; rows must be in time order: sort them",
        ),
        (
            "t.csv",
            "t_ns,east_m,north_m,up_m," + ",".join(f"r{i}{j}" for i in range(3) for j in range(3))
            + "\n2,0,0,0,1,0,0,0,1,0,0,0,2\n",
            "t.csv:2: r00 to r22 are not a rotation matrix; are they transposed?",
        ),
    ],
)  # fmt: skip
def test_each_fault_is_told_with_its_place_and_remedy(tmp_path, name, text, message):
    path = tmp_path / name
    path.write_text(text)
    assert fault(path) == message


@pytest.mark.parametrize("name", ["t.tum", "t.csv"])
def test_a_missing_file_is_told(tmp_path, name):
    assert fault(tmp_path / name) == f"{name}: no such file"


def test_geojson_draws_longitude_latitude_height(tmp_path):
    path = tmp_path / "t.geojson"
    estimate = Trajectory([10**18, 10**18 + 500_000_000], [[0, 0, 0], [0, 111.0, 1.0]])
    write_geojson(path, estimate, ORIGIN, name="graph-batch", truth=estimate)
    collection = json.loads(path.read_text())
    assert collection["type"] == "FeatureCollection"
    line, truth = collection["features"]
    assert line["geometry"]["type"] == "LineString"
    assert line["geometry"]["coordinates"][0] == [-105.0, 40.0, 1600.0]
    lon, lat, height = line["geometry"]["coordinates"][1]
    assert (lon, lat) == pytest.approx((-105.0, 40.001), abs=1e-5)
    assert height == pytest.approx(1601.0, abs=0.01)
    assert line["properties"] == {
        "name": "graph-batch",
        "start": "2001-09-09T01:46:40.000Z",
        "end": "2001-09-09T01:46:40.500Z",
        "height_datum": "ellipsoid",
    }
    assert truth["properties"]["name"] == "truth"


def test_geojson_of_one_state_is_a_point_and_of_none_an_error(tmp_path):
    one = Trajectory([10**18], np.zeros((1, 3)))
    write_geojson(tmp_path / "t.geojson", one, ORIGIN)
    feature = json.loads((tmp_path / "t.geojson").read_text())["features"][0]
    assert feature["geometry"] == {"type": "Point", "coordinates": [-105.0, 40.0, 1600.0]}
    with pytest.raises(InputError, match="has no states"):
        write_geojson(tmp_path / "t.geojson", one.take(slice(0, 0)), ORIGIN)
