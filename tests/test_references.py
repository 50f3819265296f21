"""Road users who say where they are: which detection is theirs, and what that tells of a node."""

from dataclasses import replace

import numpy as np
import pytest

import fgloc
from fgloc.config import load_config
from fgloc.datasets.drive_folder import read_drive, write_drive
from fgloc.errors import DriveError
from fgloc.factors.sway import reported
from fgloc.measurements import UserFixes
from fgloc.node_health import node_rows
from fgloc.references import find_references
from fgloc.verdicts import SourceVerdicts, Verdict


@pytest.fixture(scope="module")
def drive():
    return fgloc.make("khamooshi2023/sway-drive", seed=2, duration_s=12.0, poses=False, users=2)


def found_in(drive, **settings):
    verdicts = {name: SourceVerdicts.of(name, table) for name, table in drive.tables.items()}
    span_ns = drive.start_ns, drive.end_ns
    return find_references(drive, load_config(**settings), span_ns, verdicts), verdicts["users"]


def changed(drive, **columns):
    return drive.with_tables(users=replace(drive.tables["users"], **columns))


def test_each_user_is_found_among_what_the_node_sees(drive):
    found, judged = found_in(drive)
    seen = drive.tables["detections"]
    # The scenario numbers its cars 1 and 2, as users they are 101 and 102.
    np.testing.assert_array_equal(seen.object_id[found.row] + 100, found.user)
    assert len(found) == 2 * 121
    assert set(judged.reason) == {
        "tells of nodes alone, which this method takes as they were surveyed"
    }


def test_a_user_between_two_fixes_is_on_the_line_between_them(drive):
    users = drive.tables["users"]
    every_other = drive.with_tables(users=users.take(np.arange(len(users)) // 2 % 2 == 0))
    found, whole = found_in(every_other)[0], found_in(drive)[0]
    at = np.isin(whole.row, found.row)
    between = ~np.isin(found.t_ns, every_other.tables["users"].t_ns)
    assert between.sum() > 100
    assert np.abs(found.told_m - whole.told_m[at]).max() < 0.12  # four sigmas of two fixes
    latest = found.received_ns[between] - found.t_ns[between]
    assert (latest == 100_000_000).all()  # known with the fix that came after


def test_a_user_whose_fixes_are_far_apart_tells_nothing_between(drive):
    users = drive.tables["users"]
    rare = drive.with_tables(users=users.take(users.t_ns % (2 * 10**9) == 0))
    found, _ = found_in(rare)
    assert np.isin(found.t_ns, rare.tables["users"].t_ns).all()


def test_a_detection_that_two_users_fit_is_nobodys(drive):
    users = drive.tables["users"]
    twin = np.where((users.user_id == 102)[:, None], _of(users, 101), users.p_world_m)
    found, _ = found_in(changed(drive, p_world_m=twin))
    assert len(found) == 0


@pytest.fixture(scope="module")
def high():
    """Past a LiDAR that tells heights, with users who do."""
    return fgloc.make("khamooshi2023/sway-drive", seed=2, duration_s=12.0, poses=False, users=2,
                      sensor="lidar")  # fmt: skip


def test_heights_are_compared_where_node_and_user_tell_them(high):
    users = high.tables["users"]
    told = users.user_id == 101
    up, sigma = (np.where(told, column, np.nan) for column in (users.up_m, users.sigma_up_m))
    found, _ = found_in(changed(high, up_m=up, sigma_up_m=sigma))
    np.testing.assert_array_equal(found.dof, np.where(found.user == 101, 3, 2))
    seen, own = high.tables["detections"], found.dof == 3
    up_m = seen.up_node_m[found.row] + 10.0
    np.testing.assert_allclose(found.z_world_m[own, 2], up_m[own])
    at = np.isin(users.t_ns, found.t_ns[own]) & told
    np.testing.assert_allclose(found.told_m[own, 2], users.up_m[at])
    np.testing.assert_allclose(found.cov_world_m2[own, 2, 2],
                               seen.sigma_up_m[found.row[own]] ** 2 + 0.03**2)  # fmt: skip
    np.testing.assert_array_equal(found.told_m[~own, 2], found.z_world_m[~own, 2])


def test_a_height_between_two_fixes_lies_between_theirs(high):
    users = high.tables["users"]
    climb_m = (users.t_ns - users.t_ns[0]) / 1e10
    sparse = users.t_ns // 10**8 % 2 == 0
    some = replace(users, up_m=climb_m).take(sparse)
    found, _ = found_in(high.with_tables(users=some))
    between = ~np.isin(found.t_ns, some.t_ns)
    assert between.sum() > 50
    np.testing.assert_allclose(
        found.told_m[between, 2], (found.t_ns[between] - users.t_ns[0]) / 1e10
    )


def test_a_user_at_another_height_is_not_what_the_node_sees(high):
    """A bridge: 5 m are beyond what sway and noise do."""
    found, _ = found_in(changed(high, up_m=high.tables["users"].up_m + 5.0))
    assert len(found) == 0


def _of(users, user):
    """The places of one user in the rows of all, which come in turn."""
    return np.repeat(users.p_world_m[users.user_id == user], 2, axis=0)


def test_rows_that_are_not_finite_are_left_out_and_said_so(drive):
    p = drive.tables["users"].p_world_m.copy()
    p[4] = np.nan
    _, judged = found_in(changed(drive, p_world_m=p))
    assert judged.verdict[4] == Verdict.INVALID


def test_a_node_without_errors_has_no_use_for_them(drive):
    found, judged = found_in(drive, posts={"compensate": False})
    assert len(found) == 0
    assert set(judged.reason) == {"no node that sees it has errors to be found"}


def test_what_a_survey_is_off_is_found_from_users_alone(drive):
    (node,) = drive.infrastructure.nodes
    off = np.array([0.4, -0.3, 0.0])
    said = replace(node, p_world_m=node.p_world_m + off, sigma_position_m=0.5, sigma_yaw_rad=0.02)
    moved = replace(drive, infrastructure=replace(drive.infrastructure, nodes=(said,)))
    for mode in ("batch", "fixed-lag"):
        told = fgloc.smooth(moved, mode).summary["nodes"]["isn-1"]["survey_off_m"]
        value, sigma = np.array(told["value"]), np.array(told["sigma"])
        assert (sigma < 0.1).all()
        assert (np.abs(value + off[:2]) < 4 * sigma).all()


@pytest.mark.parametrize("mode", ["batch", "fixed-lag"])
def test_what_a_survey_is_off_in_height_is_found_too(high, mode):
    (node,) = high.infrastructure.nodes
    off = np.array([0.3, 0.2, 0.4])
    said = replace(node, p_world_m=node.p_world_m + off, sigma_position_m=0.5)
    moved = replace(high, infrastructure=replace(high.infrastructure, nodes=(said,)))
    result = fgloc.smooth(moved, mode)
    told = result.summary["nodes"]["isn-1"]
    (up,), (sigma,) = told["survey_off_up_m"]["value"], told["survey_off_up_m"]["sigma"]
    assert sigma < 0.05
    assert abs(up + 0.4) < 4 * sigma
    (row,) = node_rows(moved, result.summary)
    assert (row["survey_up_m"], row["sigma_survey_up_m"]) == (up, sigma)
    plain = fgloc.smooth(high, mode).posts
    np.testing.assert_allclose(result.posts.p_node_m, plain.p_node_m, atol=0.02)


def test_a_node_that_is_not_level_is_found_out_by_its_heights(high):
    """Built in with 5 mrad of pitch, about which it sways: 0.3 m of height at 60 m."""
    (node,), seen = high.infrastructure.nodes, high.tables["detections"]
    askew = np.tile([0, 0, 0, 0.005], (len(seen), 1))
    place_m, _, _ = reported(seen.place_node_m, askew, "lidar")
    leans = replace(seen, p_node_m=place_m[:, :2], up_node_m=place_m[:, 2])
    said = replace(node, sigma_level_rad=0.01)
    beside = replace(high.infrastructure, nodes=(said,))
    drive = replace(high, infrastructure=beside).with_tables(detections=leans)
    told = fgloc.smooth(drive).summary["nodes"]["isn-1"]["survey_off_level_rad"]
    value, sigma = np.array(told["value"]), np.array(told["sigma"])
    assert (sigma < 1e-3).all()
    # Taken back by a turn about North, along the node's y axis.
    assert (np.abs(value - [0, 0.005]) < 4 * sigma).all()
    plain = fgloc.smooth(high).posts
    np.testing.assert_allclose(fgloc.smooth(drive).posts.p_node_m, plain.p_node_m, atol=0.02)


def test_users_survive_a_folder(drive, tmp_path):
    write_drive(drive, tmp_path / "drive")
    assert read_drive(tmp_path / "drive").tables["users"].same_as(drive.tables["users"])


def test_sigmas_may_stand_for_a_covariance(drive, tmp_path):
    write_drive(drive, tmp_path / "drive")
    path = tmp_path / "drive" / "users.csv"
    head = "t_ns,user_id,east_m,north_m,sigma_east_m,sigma_north_m\n"
    path.write_text(head + "1,7,2.0,3.0,0.1,0.2\n")
    users = read_drive(tmp_path / "drive").tables["users"]
    assert isinstance(users, UserFixes)
    np.testing.assert_allclose(users.cov_m2, [np.diag([0.01, 0.04])])
    path.write_text(head + "1,7,2.0,3.0,0.1,-0.2\n")
    with pytest.raises(
        DriveError, match=r"users.csv:2: sigma_north_m = -0.2; a standard deviation"
    ):
        read_drive(tmp_path / "drive")
    path.write_text("t_ns,user_id,east_m,north_m,cov_ee_m2,cov_en_m2,cov_nn_m2\n1,7,2,3,1,2,1\n")
    with pytest.raises(
        DriveError, match=r"users.csv:2: the covariance .* is not positive definite"
    ):
        read_drive(tmp_path / "drive")
