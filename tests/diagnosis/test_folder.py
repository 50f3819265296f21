"""The doctor on drive folders and at the command line, also where a folder cannot be read."""

import json

import pytest

import fgloc
from fgloc.cli import main
from fgloc.datasets.drive_folder import salvage_drive, write_drive
from fgloc.errors import DriveError


@pytest.fixture
def folder(tmp_path):
    write_drive(fgloc.make("city", seed=3, duration_s=30.0), tmp_path / "city")
    return tmp_path / "city"


def edit(path, change):
    path.write_text(change(path.read_text()))


def swap_rows(text):
    lines = text.splitlines(keepends=True)
    lines[5], lines[6] = lines[6], lines[5]
    return "".join(lines)


def test_a_sound_folder_loses_nothing_in_salvage(folder):
    drive, faults = salvage_drive(folder)
    assert not faults
    assert drive.gnss.same_as(fgloc.load(folder).gnss)
    assert drive.truth.same_as(fgloc.load(folder).truth)


def test_several_faults_are_told_of_at_once(folder):
    edit(folder / "imu.csv", swap_rows)
    edit(folder / "truth.csv", lambda text: text.replace("east_m", "east_ft", 1))
    edit(folder / "gnss.csv", lambda text: text.rstrip("\n") + ",1\n")
    findings = {one.source: one for one in fgloc.doctor(folder)}
    assert "imu.csv:7" in findings["imu"].what and "time order" in findings["imu"].what
    assert "east_ft" in findings["truth"].what
    assert "gnss.csv:302" in findings["gnss"].what
    assert all(one.severity == "fault" for one in findings.values())


def test_tables_that_can_be_read_are_checked(folder):
    edit(folder / "wheel.csv", swap_rows)
    edit(folder / "drive.toml", lambda text: text.replace("1.2,", "1200.0,"))
    checks = {(one.source, one.check) for one in fgloc.doctor(folder) if one.severity == "fault"}
    assert checks == {("wheel", "unreadable"), ("rig", "lever-arm")}


def test_a_table_that_cannot_be_read_is_not_called_missing(folder):
    edit(folder / "gnss.csv", lambda text: text.replace("t_ns", "t_s", 1))
    findings = fgloc.doctor(folder)
    assert [one.check for one in findings if one.source == "gnss"] == ["unreadable"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text.replace("lat_deg = ", "lat_deg = 1"), "lat_deg"),
        (lambda text: text.replace("format = 1", "format = 2"), "format"),
        (lambda text: text.replace("0.999", "0.9", 1), "not a rotation"),
    ],
)
def test_a_faulty_toml_is_a_fault_beside_those_of_the_tables(folder, change, words):
    edit(folder / "imu.csv", swap_rows)
    edit(folder / "drive.toml", change)
    findings = {one.source: one.what for one in fgloc.doctor(folder)}
    assert words in findings["drive"]


def test_a_folder_without_a_drive_is_refused(tmp_path):
    with pytest.raises(DriveError, match="no such folder"):
        salvage_drive(tmp_path / "nothing")


def test_an_origin_that_the_first_fix_gives_needs_readable_fixes(folder):
    text = (folder / "drive.toml").read_text()
    start, end = text.index("[origin]"), text.index("[rig]")
    (folder / "drive.toml").write_text(text[:start] + text[end:])
    edit(folder / "gnss.csv", lambda text: text.replace("t_ns", "t_s", 1))
    drive, faults = salvage_drive(folder)
    assert drive is None
    assert list(faults) == ["gnss"]


def test_the_command_ends_with_0_for_a_clean_drive_and_says_what_it_saw(folder, capsys):
    assert main(["doctor", str(folder)]) == 0
    out = capsys.readouterr().out
    assert out.splitlines()[-1].startswith(f"{folder}: 0 faults, 0 warnings, ")


def test_the_command_ends_with_2_for_a_fault_and_gives_the_remedy(folder, capsys):
    edit(folder / "imu.csv", swap_rows)
    assert main(["doctor", str(folder)]) == 2
    out, err = capsys.readouterr()
    assert err == ""
    assert out.startswith("imu\n  fault    unreadable: ")
    assert "remedy: repair it as said" in out
    assert "1 fault, " in out.splitlines()[-1]


def test_a_warning_alone_ends_with_0(folder, capsys):
    edit(folder / "drive.toml", lambda text: text.replace("1.5,\n]", "-1.5,\n]"))
    (folder / "truth.csv").unlink()
    edit(folder / "drive.toml", lambda text: text[: text.index("[truth]")])
    assert main(["doctor", str(folder), "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["counts"] == {"fault": 0, "warning": 1, "remark": len(shown["findings"]) - 1}
    assert shown["findings"][0]["check"] == "lever-arm-sign"


def test_scenarios_take_a_seed(capsys):
    assert main(["doctor", "city", "--seed", "4", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["drive"] == "city"
    assert main(["doctor", "mems-rtk", "--seed", "4"]) == 2
    assert "leave them out" in capsys.readouterr().err
