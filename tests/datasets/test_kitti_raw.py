"""KITTI raw OXTS folders, made by hand."""

import numpy as np
import pytest

from fgloc.datasets.kitti_raw import FIELDS, import_kitti_raw
from fgloc.errors import DriveError, InputError
from fgloc.timing import iso_utc

STAMPS = (
    "2011-09-26 13:02:25.000000000\n2011-09-26 13:02:25.500000000\n"
    "2011-09-26 13:02:26.100000000\n2011-09-26 13:02:26.600000000\n"
)


def row(**values: float) -> str:
    """A line of data: at rest in Karlsruhe but for what is given."""
    usual = {"lat": 49.0, "lon": 8.4, "alt": 116.0, "az": 9.8, "pos_accuracy": 0.5}
    return " ".join(str((usual | values).get(name, 0)) for name in FIELDS) + "\n"


@pytest.fixture
def recording(tmp_path):
    """Writes a recording: stamps, and a data file for each row that is not None."""

    def write(*rows: str | None, stamps: str = STAMPS):
        data = tmp_path / "oxts" / "data"
        data.mkdir(parents=True)
        (tmp_path / "oxts" / "timestamps.txt").write_text(stamps)
        for i, text in enumerate(rows):
            if text is not None:
                (data / f"{i:010d}.txt").write_text(text)
        return tmp_path

    return write


def test_one_fix_a_second_is_measured_and_every_row_is_truth(recording):
    drive = import_kitti_raw(recording(row(), row(), row(), row()))
    assert ((drive.gnss.t_ns - drive.start_ns) / 1e9).tolist() == [0.0, 1.1]
    assert (len(drive.imu), len(drive.truth)) == (4, 4)
    assert iso_utc(drive.start_ns) == "2011-09-26T13:02:25.000Z"
    assert "truth is the same device's fused pose" in drive.about.source


def test_all_fixes_and_no_truth_where_asked_for(recording):
    drive = import_kitti_raw(recording(row(), row()), fix_every_s=0.0, use_truth=False)
    assert (len(drive.gnss), drive.truth) == (2, None)
    assert "no truth taken" in drive.about.source


def test_columns_go_where_they_belong(recording):
    text = row(lat=49.0 + 1e-5, ax=1, ay=2, az=3, wx=4, wy=5, wz=6, vn=7, ve=8, vu=9,
               af=-1, al=-1, au=-1, wf=-1, wl=-1, wu=-1, vf=-1, vl=-1)  # fmt: skip
    drive = import_kitti_raw(recording(row(), text), fix_every_s=0.0)
    np.testing.assert_array_equal(drive.imu.accel_mps2[1], [1, 2, 3])
    np.testing.assert_array_equal(drive.imu.gyro_radps[1], [4, 5, 6])
    np.testing.assert_array_equal(drive.gnss.v_world_mps[1], [8, 7, 9])
    np.testing.assert_array_equal(drive.truth.v_world_mps[1], [8, 7, 9])
    np.testing.assert_allclose(drive.gnss.p_world_ant_m[1], [0, 1.112, 0], atol=1e-3)
    np.testing.assert_allclose(drive.gnss.cov_world_m2[1], np.eye(3) * 0.25)
    assert drive.origin.datum == "msl"


def test_angles_turn_about_z_then_y_then_x(recording):
    drive = import_kitti_raw(recording(row(yaw=np.pi / 2), row(pitch=0.1), row(roll=0.1)))
    forward, left = drive.truth.R_world_veh[..., 0], drive.truth.R_world_veh[..., 1]
    np.testing.assert_allclose(forward[0], [0, 1, 0], atol=1e-12)  # yaw counts from East
    np.testing.assert_allclose(forward[1], [np.cos(0.1), 0, -np.sin(0.1)])  # positive: front down
    np.testing.assert_allclose(left[2], [0, np.cos(0.1), np.sin(0.1)])  # positive: left side up


def test_the_oxts_folder_itself_will_do(recording):
    folder = recording(row(), row())
    assert import_kitti_raw(folder / "oxts").gnss.same_as(import_kitti_raw(folder).gnss)


def test_what_is_left_out_is_counted(recording):
    stamps = STAMPS.replace("13:02:26.100", "13:02:25.400")
    drive = import_kitti_raw(
        recording(row(), None, row(), row(pos_accuracy=0), stamps=stamps + STAMPS[:30]),
        fix_every_s=0.0,
    )
    assert (len(drive.imu), len(drive.gnss)) == (3, 2)
    assert "stamps without a data file (2)" in drive.about.source
    assert "rows without a positive pos_accuracy, as fixes (1)" in drive.about.source
    assert "not later" not in drive.about.source


def test_rows_that_do_not_come_later_are_left_out(recording):
    stamps = STAMPS.replace("13:02:26.100", "13:02:25.500")
    drive = import_kitti_raw(recording(row(), row(ax=1), row(ax=2), row(ax=3), stamps=stamps))
    assert drive.imu.accel_mps2[:, 0].tolist() == [0, 1, 3]
    assert "rows not later than the one before (1)" in drive.about.source


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2 3\n", r"0000000001.txt:1: 3 numbers, expected 30"),
        (row(ax="x"), r"0000000001.txt:1: ax = 'x' is not a number"),
        (row(wz="inf"), r"0000000001.txt:1: wz = inf is not finite"),
        (row(lat=95), r"data:1: lat_deg = 95.0 is outside \[-90, 90\]"),
        ("\n", r"0000000001.txt: the file is empty"),
    ],
)
def test_faults_of_a_row_name_file_and_field(recording, text, message):
    with pytest.raises(DriveError, match=message):
        import_kitti_raw(recording(row(), text), fix_every_s=0.0)


@pytest.mark.parametrize(
    ("stamps", "message"),
    [
        ("2011-09-26 25:02:25.0\n" * 2, r"timestamps.txt:1: 2011-09-26 25:02:25.0 is not a date"),
        ("2011-09-26 13:02:25.0\nx\n", r"timestamps.txt:2: x  is not a date and time"),
        ("2011-09-26 13:02:25.0\n", r"0000000001.txt: has no stamp, timestamps.txt has 1 lines"),
    ],
)
def test_faults_of_the_stamps_name_the_line(recording, stamps, message):
    with pytest.raises(DriveError, match=message):
        import_kitti_raw(recording(row(), row(), stamps=stamps))


def test_files_that_are_missing_or_named_otherwise_are_told(recording, tmp_path):
    with pytest.raises(DriveError, match=r"timestamps.txt: no such file"):
        import_kitti_raw(tmp_path)
    folder = recording()
    with pytest.raises(DriveError, match=r"holds no .txt files; give the recording's folder"):
        import_kitti_raw(folder)
    (folder / "oxts" / "data" / "dataformat.txt").write_text("lat: latitude\n")
    with pytest.raises(DriveError, match=r"dataformat.txt: is not named by a number"):
        import_kitti_raw(folder)


def test_a_negative_span_between_fixes_is_refused(recording):
    with pytest.raises(InputError, match=r"fix_every_s = -1.0: expected seconds, 0 or more"):
        import_kitti_raw(recording(row()), fix_every_s=-1.0)
