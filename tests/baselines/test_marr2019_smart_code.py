"""The filter of Marr (2019) for Smart Codes: its start, its two weights, and which way they lie."""

import dataclasses

import numpy as np
import pytest

from fgloc.baselines.dead_reckoning import DeadReckoning
from fgloc.baselines.marr2019_smart_code import Marr2019SmartCode, Reads, run, track
from fgloc.datasets.registry import make
from fgloc.errors import DriveError
from fgloc.timing import NS_PER_S

STILL = DeadReckoning(np.array([0]), np.zeros((1, 2)), np.zeros((1, 2)), np.array([0]))


def exact(path="left", yaw_deg=30.0):
    return make("marr2019/smart-code", 0, path=path, camera_yaw_deg=yaw_deg,
                corner_sigma_px=0.0, quantised=False)  # fmt: skip


def error_at_start_m(drive, parameters) -> np.ndarray:
    trajectory = run(drive, parameters).trajectory
    true = drive.truth.at_point(drive.rig.camera.p_veh_cam_m).at(trajectory.t_ns[:1])
    return (trajectory.p_world_m[0] - true.p_world_m[0])[:2]


def test_reads_move_the_state_by_4_percent_along_and_1_percent_across_the_normal():
    t_ns = np.arange(1, 3) * NS_PER_S
    for yaw in (0.0, np.pi / 2, 0.7):
        c, s = np.cos(yaw), np.sin(yaw)
        R = np.array([[c, -s], [s, c]])
        reads = Reads(t_ns, t_ns, np.array([[0.0, 0], R @ [1.0, 1.0]]), np.array([R, R]))
        _, p_m = track(reads, STILL, Marr2019SmartCode(start_reads=1), "d")
        np.testing.assert_allclose(R.T @ p_m[-1], [0.04, 0.01])


def test_the_plain_mean_of_ten_reads_lies_0_7_m_behind():
    drive = exact()
    behind = error_at_start_m(drive, Marr2019SmartCode(carry_start=False))
    # Nine of 30 frames a second at 4.5 m/s, of which the mean lies half way back.
    assert behind[1] == pytest.approx(-0.675, abs=0.06)
    assert np.linalg.norm(error_at_start_m(drive, Marr2019SmartCode())) < 0.1


def test_between_reads_it_is_dead_reckoning():
    moving = DeadReckoning(np.arange(0, 5) * NS_PER_S, np.tile([2.0, 1.0], (5, 1)),
                           np.outer(np.arange(5.0), [2, 1]), np.arange(5))  # fmt: skip
    t_ns = np.array([NS_PER_S // 2])
    reads = Reads(t_ns, t_ns, np.array([[7.0, 8.0]]), np.eye(2)[None])
    at_ns, p_m = track(reads, moving, Marr2019SmartCode(start_reads=1), "d")
    np.testing.assert_allclose(p_m, [7, 8] + np.outer((at_ns - t_ns) / 1e9, [2, 1]))


def test_reads_that_come_in_late_are_carried_forward():
    drive = exact()
    seen = drive.tables["smart_codes"]
    late = dataclasses.replace(seen, received_ns=seen.t_ns + NS_PER_S // 2)
    assert np.linalg.norm(error_at_start_m(drive.with_tables(smart_codes=late),
                                           Marr2019SmartCode())) < 0.15  # fmt: skip


def test_small_signs_and_reads_without_a_position_are_left_out_by_reason():
    result = run(make("marr2019/smart-code", 0, path="near", camera_yaw_deg=0.0))
    reasons = set(result.verdicts["smart_codes"].reason)
    assert reasons == {"", "a small sign", "no position, range only", "too near"} - (
        {"too near"} - reasons
    )
    assert sum(result.summary["counts"]["smart_codes"].values()) == len(
        result.verdicts["smart_codes"]
    )
    taking_all = run(make("marr2019/smart-code", 0, path="near", camera_yaw_deg=0.0),
                     Marr2019SmartCode(signs="all"))  # fmt: skip
    assert "a small sign" not in set(taking_all.verdicts["smart_codes"].reason)


def test_the_trajectory_is_the_cameras_and_its_error_is_small():
    drive = exact("middle", 45.0)
    result = run(drive)
    np.testing.assert_array_equal(result.trajectory.p_veh_point_m, drive.rig.camera.p_veh_cam_m)
    true = drive.truth.at_point(drive.rig.camera.p_veh_cam_m).at(result.trajectory.t_ns)
    error = np.linalg.norm((result.trajectory.p_world_m - true.p_world_m)[:, :2], axis=1)
    assert error.max() < 0.5


def test_what_a_drive_lacks_is_named():
    drive = exact()
    blind = dataclasses.replace(drive, rig=dataclasses.replace(drive.rig, camera=None))
    few = drive.with_tables(smart_codes=drive.tables["smart_codes"].take(slice(5)))
    none = dataclasses.replace(
        drive, tables={k: v for k, v in drive.tables.items() if k != "smart_codes"}
    )
    for faulty, says in (
        (blind, r"no \[rig.camera\]"),
        (few, "5 Smart Codes give a position"),
        (none, "no smart_codes rows"),
    ):
        with pytest.raises(DriveError, match=says):
            run(faulty)
