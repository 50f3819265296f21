"""Drives and rigs: what they hold, and what they refuse."""

import numpy as np
import pytest

from fgloc import frames
from fgloc.drive import Drive, Rig
from fgloc.errors import DriveError
from fgloc.frames import Origin
from fgloc.measurements import GnssFixes, ImuSamples, WheelSpeeds


def wheel(*t_ns: int) -> WheelSpeeds:
    n = len(t_ns)
    return WheelSpeeds(t_ns, t_ns, np.zeros(n), np.ones(n))


def imu(*t_ns: int) -> ImuSamples:
    n = len(t_ns)
    return ImuSamples(t_ns, t_ns, np.zeros((n, 3)), np.zeros((n, 3)))


def drive(**tables) -> Drive:
    return Drive("test", Origin(52.0, 9.0, 100.0), Rig(), tables)


def mount(R: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = R
    return T


def test_a_rig_left_to_itself_has_everything_at_the_vehicle_origin():
    rig = Rig()
    np.testing.assert_array_equal(rig.p_veh_ant_m, np.zeros(3))
    np.testing.assert_array_equal(rig.T_veh_imu, np.eye(4))


def test_a_rig_takes_any_rotation_and_cannot_be_written_to():
    rig = Rig(T_veh_imu=mount(frames.exp_so3([0.1, 2.0, -0.4])))
    with pytest.raises(ValueError, match="read-only"):
        rig.T_veh_imu[0, 3] = 1.0


def test_a_mount_may_be_written_with_six_decimals():
    R = frames.exp_so3([0.1, 2.0, -0.4]).round(6)
    np.testing.assert_array_equal(Rig(T_veh_imu=mount(R)).T_veh_imu[:3, :3], R)


@pytest.mark.parametrize(
    "R",
    [np.diag([1, 1, -1]), 2 * np.eye(3), np.zeros((3, 3)), np.eye(3) + 1e-3],
    ids=["mirror", "scaled", "zero", "sheared"],
)
def test_a_mount_that_is_no_rotation_is_refused(R):
    with pytest.raises(DriveError, match="upper left 3x3 block is not a rotation matrix"):
        Rig(T_veh_imu=mount(R))


@pytest.mark.parametrize(
    ("part", "message"),
    [
        ({"T_veh_imu": np.eye(3)}, r"rig.T_veh_imu: expected finite numbers of shape \(4, 4\)"),
        ({"p_veh_ant_m": [1.0, 2.0]}, r"rig.p_veh_ant_m: expected finite numbers of shape \(3,\)"),
        ({"p_veh_ant_m": [1.0, 2.0, np.nan]}, r"rig.p_veh_ant_m: expected finite numbers"),
    ],
)
def test_parts_of_a_rig_that_do_not_fit_are_refused(part, message):
    with pytest.raises(DriveError, match=message):
        Rig(**part)


def test_a_drive_spans_all_of_its_tables():
    some = drive(wheel=wheel(5, 20), imu=imu(3, 18))
    assert (some.start_ns, some.end_ns) == (3, 20)


def test_a_table_without_rows_takes_no_part_in_the_span():
    some = drive(wheel=wheel(5, 20), imu=imu())
    assert (some.start_ns, some.end_ns) == (5, 20)


@pytest.mark.parametrize("tables", [{}, {"imu": imu()}])
def test_a_drive_without_rows_has_no_span(tables):
    with pytest.raises(DriveError, match="drive 'test' has no rows in any table"):
        _ = drive(**tables).start_ns
    with pytest.raises(DriveError, match="has no rows in any table"):
        _ = drive(**tables).end_ns


def test_a_sensor_that_is_missing_is_named_beside_those_that_are_not():
    with pytest.raises(DriveError, match=r"drive 'test' has no gnss rows \(it has wheel, imu\)"):
        _ = drive(wheel=wheel(1), imu=imu()).gnss
    with pytest.raises(DriveError, match=r"no imu rows \(it has nothing\)"):
        _ = drive().imu


def test_sensors_are_at_hand_by_name():
    samples = imu(1, 2)
    assert drive(imu=samples).imu is samples


def test_with_tables_replaces_and_adds_and_leaves_the_drive_as_it_was():
    before = drive(wheel=wheel(1))
    fixes = GnssFixes([1], [1], np.zeros((1, 3)), np.eye(3)[None], np.zeros((1, 3)))
    after = before.with_tables(wheel=wheel(7, 8), gnss=fixes)
    assert (len(after.tables["wheel"]), after.gnss) == (2, fixes)
    assert list(before.tables) == ["wheel"]


def test_tables_cannot_be_exchanged_in_place():
    tables = {"wheel": wheel(1)}
    some = drive(**tables)
    with pytest.raises(TypeError):
        some.tables["wheel"] = wheel(2)
