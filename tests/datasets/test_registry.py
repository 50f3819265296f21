"""Opening drives by name or path."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fgloc import api
from fgloc.datasets import available, import_recording, make, open_drive
from fgloc.datasets.city import make_city
from fgloc.datasets.drive_folder import write_drive
from fgloc.errors import DriveError, InputError


def same(a, b) -> bool:
    return all(a.tables[name].same_as(b.tables[name]) for name in a.tables)


def test_every_real_sample_and_scenario_opens_as_it_is_listed():
    for info in available():
        if info.kind == "importer":
            continue
        drive = open_drive(info.name)
        assert drive.name == info.name
        assert tuple(drive.tables) == info.sensors
        assert drive.about.licence == info.licence
        assert (drive.end_ns - drive.start_ns) / 1e9 == pytest.approx(info.duration_s, abs=0.5)
        assert drive.about.simulated == (info.kind == "scenario")


def test_a_scenario_takes_seed_and_options():
    drive = open_drive("city", seed=3, duration_s=5)
    assert same(drive, make_city(3, 5.0))
    assert same(drive, make("city", 3, duration_s=5))


def test_a_scenario_without_a_seed_has_the_default_one():
    assert same(open_drive("city", duration_s=5), make_city(0, 5.0))


def test_a_folder_opens_by_its_path(tmp_path):
    write_drive(make_city(7, 2.0), tmp_path / "mine")
    assert same(open_drive(tmp_path / "mine"), make_city(7, 2.0))
    assert same(open_drive(str(tmp_path / "mine")), make_city(7, 2.0))


def test_a_drive_folder_here_comes_before_a_scenario_of_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_drive(make_city(7, 2.0), "city")
    assert same(open_drive("city"), make_city(7, 2.0))
    assert same(open_drive("city", seed=1, duration_s=2.0), make_city(1, 2.0))


def test_a_recorded_drive_takes_no_seed(tmp_path):
    with pytest.raises(InputError, match="'mems-rtk' is a recorded drive; a seed and options"):
        open_drive("mems-rtk", seed=1)
    write_drive(make_city(7, 2.0), tmp_path / "mine")
    with pytest.raises(InputError, match="is a recorded drive"):
        open_drive(tmp_path / "mine", seed=1)


def test_unknown_names_bring_the_nearest_one():
    with pytest.raises(InputError, match=r"no drive named 'cty' .* the nearest is 'city'"):
        open_drive("cty")
    with pytest.raises(InputError, match="no scenario named 'City'; the nearest is 'city'"):
        make("City", 1)
    with pytest.raises(
        InputError, match="no import format named 'mems'; the nearest is 'mems-rtk'"
    ):
        import_recording("mems", ".")
    with pytest.raises(InputError, match=r"no option 'duration'; .* 'duration_s'"):
        make("city", 1, duration=5)
    with pytest.raises(InputError, match="option duration_s = 'long' is not a number"):
        make("city", 1, duration_s="long")


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"sigma_up_m": "high"}, "option sigma_up_m = 'high' is not a number"),
        ({"sigma_up_m": True}, "option sigma_up_m = True is not a number"),
    ],
)
def test_an_option_that_is_a_number_takes_no_other_type(options, says):
    with pytest.raises(InputError, match=says):
        import_recording("comma2k19", ".", **options)


@pytest.mark.parametrize(
    ("format", "options", "says"),
    [
        ("kitti-raw", {"use_truth": 1}, "option use_truth = 1 is not true or false"),
        ("nmea", {"date": 20250708}, "option date = 20250708 is not text"),
        ("nmea", {"imu": 5}, "option imu = 5 is not a path"),
        ("mems-rtk", {"gps_week": 2374.5}, "option gps_week = 2374.5 is not a whole number"),
        ("rtklib-pos", {"worst_quality": "fix"}, "worst_quality = 'fix' is not a whole number"),
    ],
)
def test_options_have_the_types_that_their_function_names(format, options, says):
    with pytest.raises(InputError, match=says):
        import_recording(format, ".", **options)


def test_a_format_wants_its_source_or_none():
    with pytest.raises(InputError, match="format 'nmea' needs a source"):
        import_recording("nmea")
    with pytest.raises(InputError, match="format 'kitti' takes no source; leave 'here' out"):
        import_recording("kitti", "here")
    with pytest.raises(InputError, match="format 'kitti' has no option 'x'; it takes none"):
        import_recording("kitti", x=1)


def test_every_importer_is_listed_and_can_be_called():
    listed = {info.name for info in available() if info.kind == "importer"}
    assert listed == {
        "mems-rtk", "comma2k19", "kitti", "kitti-raw", "euroc", "rtklib-pos", "nmea",
        "mcity-roadside",
        "outdoor-uwb", "plaza",
    }  # fmt: skip
    faults = r"no such file|name a TUM|has neither|holds no|names neither|there are 1"
    for name in listed - {"kitti"}:
        with pytest.raises(InputError, match=faults):
            import_recording(name, "/nowhere")


@pytest.mark.parametrize("name", ["name", "scenario", "name_or_path", "drive", "function"])
def test_names_of_parameters_are_no_options_of_a_scenario(name):
    says = rf"scenario 'city' has no option '{name}'; .* \(there are: duration_s\)"
    for call in (make, open_drive, api.make, api.load):
        with pytest.raises(InputError, match=says):
            call("city", **{name: 1})


@pytest.mark.parametrize("name", ["format", "source"])
def test_names_of_parameters_are_no_options_of_a_format(name):
    with pytest.raises(InputError, match=rf"no option '{name}'; .* \(there are: gps_week, start_s"):
        import_recording("mems-rtk", ".", **{name: 1})


def test_a_path_that_is_not_there_is_told_as_a_path():
    with pytest.raises(InputError, match="no drive named 'out/mine' and no folder of that path"):
        open_drive("out/mine")
    with pytest.raises(DriveError, match="out/mine: no such folder"):
        open_drive(Path("out/mine"))


def test_importing_the_package_stays_cheap():
    code = (
        "import sys, fgloc.datasets; "
        "print([m for m in ('scipy', 'pydantic', 'gtsam', 'pyarrow') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_real_sample_is_in_the_vehicle_frame_and_on_posix_time():
    drive = open_drive("mems-rtk")
    np.testing.assert_array_equal(drive.rig.p_veh_ant_m, [0, 0.05, 0])
    assert np.median(drive.imu.accel_mps2[:, 2]) == pytest.approx(9.8, abs=0.2)
    assert drive.gnss.t_ns[0] == 1_752_003_244 * 1_000_000_000
