"""Tables: what does not fit is refused, and nobody can change what is in one."""

import dataclasses

import numpy as np
import pytest

from fgloc.errors import DriveError
from fgloc.measurements import (
    TABLES,
    EnuVelocities,
    GnssFixes,
    ImuSamples,
    NodeDetections,
    NodePoses,
    Odometry,
    Ranges,
    RelativeSightings,
    SmartCodeSightings,
    SteeringAngles,
    UserFixes,
    WheelSpeeds,
)

INT64 = np.iinfo(np.int64)


def wheel(t_ns=(1, 2, 3), **columns) -> WheelSpeeds:
    n = len(t_ns)
    return WheelSpeeds(
        **{"t_ns": t_ns, "received_ns": t_ns, "speed_mps": np.arange(n) + 0.5,
           "sigma_mps": np.full(n, 0.1)} | columns
    )  # fmt: skip


def gnss(n: int = 2) -> GnssFixes:
    t_ns = np.arange(n)
    return GnssFixes(
        t_ns, t_ns + 5, np.ones((n, 3)), np.tile(np.eye(3), (n, 1, 1)), np.full((n, 3), np.nan)
    )


def test_every_kind_of_table_is_known_by_its_name():
    assert {
        "gnss": GnssFixes, "imu": ImuSamples, "wheel": WheelSpeeds, "steering": SteeringAngles,
        "odometry": Odometry, "velocity": EnuVelocities, "detections": NodeDetections,
        "relative": RelativeSightings,
        "node_poses": NodePoses, "users": UserFixes,
        "smart_codes": SmartCodeSightings, "ranges": Ranges,
    } == TABLES  # fmt: skip


def test_lists_become_arrays_of_the_right_type():
    table = wheel(t_ns=[1, 2], speed_mps=[3, 4])
    assert (table.t_ns.dtype, table.speed_mps.dtype) == (np.int64, np.float64)
    assert len(table) == 2


def test_a_code_has_all_four_corners_or_none():
    corners = np.full((3, 4, 2), np.nan)
    corners[1] = [[0, 0], [9, 0], [9, 9], [0, 9]]
    t_ns, size = np.arange(3), np.full(3, 9.0)
    codes = SmartCodeSightings(t_ns, t_ns, [0, 0, 0], size, size, np.ones((3, 2)), corners)
    assert codes.take([1, 2]).has_corners.tolist() == [True, False]
    corners[2, 3, 1] = 4.0
    with pytest.raises(DriveError, match=r"smart_codes row 2: corners_px .*or NaN for all"):
        dataclasses.replace(codes, corners_px=corners)


def test_time_that_goes_back_is_refused_with_row_and_step():
    with pytest.raises(DriveError, match="wheel row 2: t_ns goes back by 4 ns; rows must be in"):
        wheel(t_ns=(1, 5, 1))


def test_time_that_goes_back_by_more_than_64_bits_hold_is_refused_too():
    with pytest.raises(DriveError, match=f"goes back by {2**64 - 1} ns"):
        wheel(t_ns=(INT64.max, INT64.min))


def test_time_may_go_forth_by_more_than_64_bits_hold():
    assert len(wheel(t_ns=(INT64.min, INT64.max))) == 2


def test_stamps_may_repeat_and_arrivals_come_in_any_order():
    assert len(wheel(t_ns=(1, 1, 1), received_ns=(9, 3, 5))) == 3


@pytest.mark.parametrize(
    ("column", "value", "shapes"),
    [
        ("speed_mps", np.zeros(2), r"wheel.speed_mps has shape \(2,\), expected \(3,\)"),
        ("sigma_mps", np.zeros((3, 1)), r"wheel.sigma_mps has shape \(3, 1\), expected \(3,\)"),
        ("received_ns", [1], r"wheel.received_ns has shape \(1,\), expected \(3,\)"),
    ],
)
def test_columns_of_another_shape_are_refused(column, value, shapes):
    with pytest.raises(DriveError, match=shapes):
        wheel(**{column: value})


@pytest.mark.parametrize("column", ["t_ns", "received_ns"])
@pytest.mark.parametrize("stamps", [[1.0, 2.0, 3.0], [True] * 3, ["1", "2", "3"]])
def test_stamps_that_are_no_integers_are_refused(column, stamps):
    says = rf"wheel.{column} is of type .*; give whole nanoseconds as int64"
    with pytest.raises(DriveError, match=says):
        wheel(**{column: stamps})


def test_stamps_may_be_integers_of_any_width():
    assert wheel(t_ns=np.array([1, 2, 3], np.uint32)).t_ns.dtype == np.int64


def test_the_shape_of_each_row_is_checked_too():
    with pytest.raises(DriveError, match=r"imu.gyro_radps has shape \(1, 2\), expected \(1, 3\)"):
        ImuSamples([1], [1], np.zeros((1, 3)), np.zeros((1, 2)))


def test_a_table_without_rows_is_a_table():
    assert len(gnss(0)) == 0


def test_columns_cannot_be_written_to():
    with pytest.raises(ValueError, match="read-only"):
        wheel().speed_mps[0] = 1.0


def test_a_table_does_not_follow_the_array_it_was_made_of():
    speed_mps = np.array([1.0, 2.0, 3.0])
    table = wheel(speed_mps=speed_mps)
    speed_mps[0] = 99.0
    assert table.speed_mps[0] == 1.0


def test_a_table_does_not_follow_the_array_behind_a_read_only_view():
    speed_mps = np.array([1.0, 2.0, 3.0])
    view = speed_mps[:]
    view.flags.writeable = False
    table = wheel(speed_mps=view)
    speed_mps[0] = 99.0
    assert table.speed_mps[0] == 1.0


@pytest.mark.parametrize("index", [slice(1, None), [False, True], np.array([1])])
def test_take_selects_rows_of_all_columns(index):
    fixes = gnss()
    taken = fixes.take(index)
    assert type(taken) is GnssFixes
    assert (taken.t_ns.tolist(), taken.received_ns.tolist()) == ([1], [6])
    assert taken.cov_world_m2.shape == (1, 3, 3)


def test_tables_are_the_same_where_every_bit_is_and_nan_equals_nan():
    assert gnss().same_as(gnss())
    assert not gnss().same_as(gnss(3))
    assert not wheel().same_as(wheel(speed_mps=[0.5, 1.5, np.nextafter(2.5, 3)]))
    assert not wheel().same_as(gnss())


def test_a_covariance_that_is_not_symmetric_is_refused_by_its_row():
    t_ns, p = np.arange(3), np.zeros((3, 3))
    cov = np.tile(np.eye(3), (3, 1, 1))
    cov[1, 0, 1] = 0.5
    with pytest.raises(DriveError, match=r"gnss row 1: the covariance .* is not symmetric; write"):
        GnssFixes(t_ns, t_ns, p, cov, p)
    cov[1, 1, 0] = 0.5 + 1e-9
    assert len(GnssFixes(t_ns, t_ns, p, cov, p)) == 3
    cov[2] = np.nan
    assert len(GnssFixes(t_ns, t_ns, p, cov, p)) == 3
