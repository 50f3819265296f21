"""Drive folders: exact round trips, and a message for everything that can be wrong with one."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from fgloc.datasets.city import make_city
from fgloc.datasets.drive_folder import read_drive, write_drive
from fgloc.datasets.drive_tables import check_covariances
from fgloc.drive import Camera, Drive, GnssBias, Rig, VelocityErrors
from fgloc.errors import DriveError
from fgloc.frames import Origin
from fgloc.infrastructure import Anchor, Infrastructure, Node, Post, Sign
from fgloc.measurements import (
    EnuVelocities,
    GnssFixes,
    NodeDetections,
    NodePoses,
    Odometry,
    Ranges,
    SmartCodeSightings,
    SteeringAngles,
    UserFixes,
    WheelSpeeds,
)
from fgloc.posts import PostStates

TOML = 'format = 1\nname = "small"\n[origin]\nlat_deg = 50.0\nlon_deg = 8.0\nheight_m = 100.0\n'
GNSS = (
    "t_ns,east_m,north_m,up_m,sigma_east_m,sigma_north_m,sigma_up_m\n"
    "1000,1,2,3,1,1,2\n2000,2,3,4,1,1,2\n3000,3,4,5,1,1,2\n"
)
IMU = (
    "t_ns,accel_x_mps2,accel_y_mps2,accel_z_mps2,gyro_x_radps,gyro_y_radps,gyro_z_radps\n"
    "1000,0,0,9.81,0,0,0\n2000,0,0,9.81,0,0,0\n3000,0,0,9.81,0,0,0\n"
)
WHEEL = "t_ns,speed_mps,sigma_mps\n1000,5,0.1\n2000,5,0.1\n"
FULL_COV = "t_ns,east_m,north_m,up_m,cov_ee_m2,cov_en_m2,cov_eu_m2,cov_nn_m2,cov_nu_m2,cov_uu_m2\n"


@pytest.fixture
def small(tmp_path):
    """Writes a small drive folder by hand, some files replaced; gives its path."""

    def write(**files: str) -> Path:
        folder = tmp_path / "small"
        folder.mkdir()
        contents = {"drive.toml": TOML, "gnss.csv": GNSS, **files}
        for name, text in contents.items():
            (folder / name.replace("__", ".")).write_text(text)
        return folder

    return write


def fault(folder: Path) -> str:
    """The message that reading the folder raises, paths left out."""
    with pytest.raises(DriveError) as caught:
        read_drive(folder)
    return str(caught.value).replace(f"{folder}/", "").replace(str(folder), folder.name)


def assert_same(a: Drive, b: Drive) -> None:
    assert (a.name, a.origin, a.about, a.rig.imu_noise) == (
        b.name, b.origin, b.about, b.rig.imu_noise,
    )  # fmt: skip
    for name in ("gnss_bias", "user_bias", "velocity_errors"):
        assert getattr(a.rig, name) == getattr(b.rig, name)
    assert a.rig.p_veh_ant_m.tobytes() == b.rig.p_veh_ant_m.tobytes()
    assert a.rig.T_veh_imu.tobytes() == b.rig.T_veh_imu.tobytes()
    assert a.rig.p_veh_box_m.tobytes() == b.rig.p_veh_box_m.tobytes()
    assert a.rig.p_veh_tag_m.tobytes() == b.rig.p_veh_tag_m.tobytes()
    assert_same_fields(a.rig.camera, b.rig.camera)
    assert a.infrastructure.posts == b.infrastructure.posts
    for kind in ("nodes", "signs", "anchors"):
        pairs = zip(getattr(a.infrastructure, kind), getattr(b.infrastructure, kind), strict=True)
        for one, other in pairs:
            assert_same_fields(one, other)
    assert list(a.tables) == list(b.tables)
    assert all(a.tables[name].same_as(b.tables[name]) for name in a.tables)
    assert (a.truth is None and b.truth is None) or a.truth.same_as(b.truth)
    sway = (a.post_truth, b.post_truth)
    assert sway == (None, None) or sway[0].same_as(sway[1])


def assert_same_fields(one: object, other: object) -> None:
    assert type(one) is type(other)
    if one is not None:
        for name, value in vars(one).items():
            np.testing.assert_array_equal(value, getattr(other, name), name)


def full_drive() -> Drive:
    """A drive in which everything that a folder can hold is there and odd."""
    drive = make_city(5, 3.0)
    rng = np.random.default_rng(1)
    n = len(drive.gnss)
    half = rng.standard_normal((n, 3, 3))
    cov = half @ half.swapaxes(-1, -2) + np.eye(3)
    velocity = rng.standard_normal((n, 3))
    velocity[4] = np.nan
    fixes = dataclasses.replace(
        drive.gnss,
        received_ns=drive.gnss.t_ns + 120_000_001,
        cov_world_m2=(cov + cov.swapaxes(-1, -2)) / 2,
        v_world_mps=velocity,
    )
    half = rng.standard_normal((len(drive.truth), 6, 6))
    cov6 = half @ half.swapaxes(-1, -2)
    truth = dataclasses.replace(
        drive.truth, cov=(cov6 + cov6.swapaxes(-1, -2)) / 2, p_veh_point_m=np.array([0.1, -0.0, 2])
    )
    steering = SteeringAngles(
        drive.imu.t_ns, drive.imu.t_ns + 7, rng.standard_normal(len(drive.imu))
    )
    camera = Camera(2400.5, np.array([1224, 1023.5]), np.ones(3), -0.52)
    rig = dataclasses.replace(drive.rig, p_veh_box_m=np.array([1.3, -0.1, 0.8]),
                              gnss_bias=GnssBias(1.3, 60.0), user_bias=GnssBias(0.7, 30.0),
                              p_veh_tag_m=np.array([0, 0.1, 2]),
                              velocity_errors=VelocityErrors(0.01, 0.0087),
                              camera=camera)  # fmt: skip
    drive = dataclasses.replace(drive, rig=rig, truth=truth, infrastructure=roadside_things(),
                                post_truth=swayed(rng))  # fmt: skip
    return drive.with_tables(gnss=fixes, steering=steering, **roadside(rng))


def roadside_things() -> Infrastructure:
    return Infrastructure(
        (Node("north", np.array([7.13, 62.19, 6.0]), 0.3),
         Node("s", np.zeros(3), -2, 0.1, 0.01, sigma_level_rad=0.002)),
        (Post("s", 10.0, 1.97, 0.05, 20.1, 0.138, 250.0, 0.3),),
        (Sign("big", "0c0ffee", np.array([9.1, 2, 3]), -1.57, 0.5588, "left"),
         Sign("small", "1", np.zeros(3), 0, 0.127)),
        (Anchor("a1", np.array([0.1, -0.87, 1.97])),),
    )  # fmt: skip


def swayed(rng: np.random.Generator) -> PostStates:
    t_ns = 50_000_000 * np.arange(7)
    return PostStates.truth(t_ns, 1, *rng.standard_normal((3, 7, 2)))


def roadside(rng: np.random.Generator, n: int = 5) -> dict:
    t_ns = np.arange(n) * 100_000_000
    cov = np.tile(np.array([[0.3, 0.1], [0.1, 0.2]]), (n, 1, 1))
    cov[2] = np.nan
    up, sigma_up = -rng.uniform(1, 9, (2, n)), rng.uniform(0.1, 1, (2, n))
    up[:, 3], sigma_up[:, 3] = np.nan, np.nan
    seen = NodeDetections(
        t_ns, t_ns + 90_000_000, np.arange(n) % 2, np.arange(n) - 1, np.ones(n),
        rng.standard_normal((n, 2)), cov, up[0], sigma_up[0],
    )  # fmt: skip
    users = UserFixes(t_ns, t_ns, np.arange(n) % 2, rng.standard_normal((n, 2)),
                      np.tile([[0.3, 0.1], [0.1, 0.2]], (n, 1, 1)), up[1], sigma_up[1])  # fmt: skip
    odometry = Odometry(t_ns, t_ns, *rng.standard_normal((2, n)), *rng.uniform(0.1, 1, (2, n)))
    velocity = EnuVelocities(t_ns, t_ns, rng.standard_normal((n, 3)), rng.uniform(0.1, 1, n))
    tilt, sigma_tilt = rng.standard_normal((n, 2)), rng.uniform(0.1, 1, (n, 2))
    tilt[1], sigma_tilt[1] = np.nan, np.nan
    poses = NodePoses(t_ns, t_ns + 5, np.arange(n) % 2, rng.standard_normal((n, 2)), tilt,
                      rng.uniform(0.1, 1, (n, 2)), sigma_tilt)  # fmt: skip
    corners = [[0, 0], [50, 0], [50, 50], [0, 50]] + rng.uniform(0, 20, (n, 4, 2))
    corners[3] = np.nan
    codes = SmartCodeSightings(
        t_ns, t_ns + 5, np.arange(n) % 2, rng.uniform(9, 99, n), rng.uniform(9, 99, n),
        rng.uniform(0, 2000, (n, 2)), corners,
    )  # fmt: skip
    ranges = Ranges(t_ns, t_ns, np.zeros(n), rng.uniform(1, 50, n), rng.uniform(0.1, 1, n))
    return {
        "odometry": odometry, "velocity": velocity, "detections": seen, "node_poses": poses,
        "users": users, "smart_codes": codes, "ranges": ranges,
    }  # fmt: skip


@pytest.mark.parametrize("parquet", [False, True])
def test_a_drive_is_read_back_bit_for_bit(tmp_path, parquet):
    drive = full_drive()
    write_drive(drive, tmp_path / "drive", parquet=parquet)
    assert_same(drive, read_drive(tmp_path / "drive"))


def test_a_drive_without_truth_or_imu_is_read_back(tmp_path):
    full = full_drive()
    drive = Drive("bare", full.origin, Rig(), {"gnss": full.gnss})
    write_drive(drive, tmp_path / "drive")
    assert_same(drive, read_drive(tmp_path / "drive"))


@pytest.mark.parametrize("parquet", [False, True])
def test_writing_what_was_read_gives_the_same_bytes(tmp_path, parquet):
    write_drive(full_drive(), tmp_path / "a", parquet=parquet)
    write_drive(read_drive(tmp_path / "a"), tmp_path / "b", parquet=parquet)
    names = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert names == sorted(path.name for path in (tmp_path / "b").iterdir())
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_geodetic_positions_are_turned_into_metres_about_the_origin(small):
    header = GNSS.splitlines()[0].replace("east_m,north_m,up_m", "lat_deg,lon_deg,height_m", 1)
    drive = read_drive(small(gnss__csv=f"{header}\n1000,50.001,8.0,100.5,1,1,2\n"))
    east, north, up = drive.gnss.p_world_ant_m[0]
    assert abs(east) < 1e-9
    # A thousandth of a degree of the meridian's radius of curvature, here 6373.05 km with height.
    assert north == pytest.approx(6_373_056 * np.deg2rad(0.001), abs=1e-4)
    assert up == pytest.approx(0.5 - north**2 / 2 / 6.373e6, abs=1e-5)


def test_without_an_origin_the_first_geodetic_fix_is_it(small):
    header = GNSS.splitlines()[0].replace("east_m,north_m,up_m", "lat_deg,lon_deg,height_m", 1)
    toml = 'format = 1\nname = "small"\n'
    drive = read_drive(small(drive__toml=toml, gnss__csv=f"{header}\n1000,50.001,8,100,1,1,2\n"))
    assert drive.origin == Origin(50.001, 8.0, 100.0)
    np.testing.assert_array_equal(drive.gnss.p_world_ant_m, [[0, 0, 0]])


def test_sigmas_become_a_diagonal_covariance(small):
    np.testing.assert_array_equal(read_drive(small()).gnss.cov_world_m2[1], np.diag([1, 1, 4]))


def test_a_truth_by_hand_may_use_quaternions(small):
    truth = "t_ns,east_m,north_m,up_m,qx,qy,qz,qw\n1000,0,0,0,0,0,1,0\n2000,1,0,0,0,0,0,1\n"
    drive = read_drive(small(truth__csv=truth))
    np.testing.assert_allclose(drive.truth.R_world_veh[0], np.diag([-1, -1, 1]))


def test_fixes_and_wheel_speeds_may_repeat_a_stamp(small):
    folder = small(
        gnss__csv=GNSS.replace("3000,", "2000,"), wheel__csv=WHEEL.replace("2000,", "1000,")
    )
    assert read_drive(folder).gnss.t_ns.tolist() == [1000, 2000, 2000]


@pytest.mark.parametrize(
    ("files", "message"),
    [
        (
            {"gnss.csv": GNSS.replace("3000,", "1500,")},
            "gnss.csv:4: t_ns = 1500 goes back by 500 ns; rows must be in time order: sort them",
        ),
        (
            {"imu.csv": IMU.replace("3000,", "1500,")},
            "imu.csv:4: t_ns = 1500 goes back by 500 ns; rows must be in time order: sort them",
        ),
        (
            {"imu.csv": IMU.replace("3000,", "2000,")},
            "imu.csv:4: t_ns = 2000 occurs twice; remove one of the two rows",
        ),
        (
            {"truth.csv": "t_ns,east_m,north_m,up_m\n5,1,1,1\n5,1,1,1\n"},
            "truth.csv:3: t_ns = 5 occurs twice; remove one of the two rows",
        ),
        (
            {"truth.csv": "t_ns,east_m,north_m,up_m,qx,qy,qz,qw\n5,1,1,1,0,0,0,0\n"},
            "truth.csv:2: the quaternion qx,qy,qz,qw has norm 0, expected 1; "
            "is a row or an order of columns wrong?",
        ),
        (
            {"imu.csv": IMU.replace("accel_x_mps2", "accel_x_g")},
            "imu.csv:1: unknown unit 'g' in column 'accel_x_g'; want 'accel_x_mps2'",
        ),
        (
            {"imu.csv": IMU.replace("2000,0,", "2000,nan,")},
            "imu.csv:3: accel_x_mps2 is nan; a finite number is needed; "
            "remove the row or repair it",
        ),
        (
            {"imu.csv": IMU.splitlines()[0] + "\n"},
            "imu.csv: the table is empty (a header, no rows); delete the file instead",
        ),
        (
            {"imu.csv": IMU[:-14]},
            "imu.csv:4: 2 cells where the header names 7 columns; "
            "the file looks cut off: copy it again",
        ),
        (
            {"gnss.csv": GNSS.replace("2000,2,3,4,1,", "2000,2,3,4,0,")},
            "gnss.csv:3: sigma_east_m = 0.0; a standard deviation must be above 0",
        ),
        (
            {"gnss.csv": GNSS.replace("2000,2,3,4,1,1,2", "2000,2,3,4,1,1,-2")},
            "gnss.csv:3: sigma_up_m = -2.0; a standard deviation must be above 0",
        ),
        (
            {"wheel.csv": WHEEL.replace("2000,5,0.1", "2000,5,-0.1")},
            "wheel.csv:3: sigma_mps = -0.1; a standard deviation must be above 0",
        ),
        (
            {"gnss.csv": FULL_COV + "1,0,0,0,1,0,0,1,0,4\n2,0,0,0,0,0,0,0,0,0\n"},
            "gnss.csv:3: the position covariance has a zero or negative variance: "
            "[[0, 0, 0], [0, 0, 0], [0, 0, 0]] m^2; "
            "give what the receiver states, or remove the row",
        ),
        (
            {"gnss.csv": FULL_COV + "1,0,0,0,1,0,0,-1,0,4\n"},
            "gnss.csv:2: the position covariance has a zero or negative variance: "
            "[[1, 0, 0], [0, -1, 0], [0, 0, 4]] m^2; "
            "give what the receiver states, or remove the row",
        ),
        (
            {"gnss.csv": FULL_COV + "1,0,0,0,1,1.5,0,1,0,4\n"},
            "gnss.csv:2: the position covariance is not positive definite: "
            "[[1, 1.5, 0], [1.5, 1, 0], [0, 0, 4]] m^2; "
            "give what the receiver states, or remove the row",
        ),
        (
            {"gnss.csv": FULL_COV + "1,0,0,0,inf,0,0,1,0,4\n"},
            "gnss.csv:2: cov_ee_m2 is inf; a finite number is needed; remove the row or repair it",
        ),
        (
            {"gnss.csv": GNSS.replace("east_m,north_m,up_m", "lat_deg,lon_deg,height_m", 1)
             .replace("2000,2,", "2000,91,")},
            "gnss.csv:3: lat_deg = 91.0 is outside [-90, 90]; is it swapped with the longitude?",
        ),
        (
            {"gnss.csv": GNSS.replace("east_m,north_m,up_m", "lat_deg,lon_deg,height_m", 1)
             .replace("2000,2,3,", "2000,2,361,")},
            "gnss.csv:3: lon_deg = 361.0 is outside [-180, 360]",
        ),
        (
            {"gnss.csv": "t_ns,east_m,north_m,up_m,sigma_east_m,sigma_north_m,sigma_up_m,"
             "v_east_mps,v_north_mps,v_up_mps\n1,0,0,0,1,1,1,1,,1\n"},
            "gnss.csv:2: v_north_mps is empty but other parts of the velocity are not; "
            "give all three or none",
        ),
        (
            {"gps.csv": GNSS},
            "gps.csv: is not a table that a drive has; the nearest valid name is 'gnss.csv'; "
            "rename it or move it out of the folder",
        ),
        ({"gnss.parquet": ""}, "small: has both gnss.csv and gnss.parquet; keep one"),
        (
            {"drive.toml": TOML + "[truth]\np_veh_point_m = [0, 0, 0]\n"},
            "drive.toml: has [truth], but there is no truth.csv or truth.parquet",
        ),
        (
            {"drive.toml": 'format = 1\nname = "small"\n'},
            "drive.toml: [origin] is missing; positions in gnss.csv are east, north, up of it, "
            "so lat_deg, lon_deg and height_m of that point are needed",
        ),
        (
            {"drive.toml": TOML.replace("lat_deg", "lat").replace('"small"', "7")},
            "drive.toml: name = 7: Input should be a valid string; origin.lat_deg is missing; "
            "unknown key 'origin.lat'; the nearest valid key is 'origin.lat_deg'",
        ),
        (
            {"drive.toml": TOML + "[rig.imu_noise]\naccel_noise = 1.0\n"},
            "unknown key 'rig.imu_noise.accel_noise'; the nearest valid key is "
            "'rig.imu_noise.accel_noise_mps2_per_sqrt_hz'",
        ),
        (
            {"drive.toml": TOML.replace("format = 1", "format = 2")},
            "drive.toml: format = 2: Input should be 1",
        ),
        ({"drive.toml": "format 1"}, "drive.toml: not valid TOML"),
        (
            {"drive.toml": TOML + "[rig]\nT_veh_imu = [[2.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0],"
             " [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]\n"},
            "drive.toml: rig.T_veh_imu: the upper left 3x3 block is not a rotation matrix",
        ),
    ],
)  # fmt: skip
def test_each_fault_is_told_with_its_place_and_remedy(small, files, message):
    assert message in fault(small(**files))


def test_a_missing_folder_is_told(tmp_path):
    assert fault(tmp_path / "nowhere") == "nowhere: no such folder"


def test_a_folder_without_drive_toml_is_told(tmp_path):
    assert "is not a drive folder: it has no drive.toml" in fault(tmp_path)


def test_a_folder_without_tables_is_told(small):
    folder = small()
    (folder / "gnss.csv").unlink()
    tables = (
        "gnss.csv, imu.csv, wheel.csv, steering.csv, odometry.csv, velocity.csv, detections.csv, "
        "relative.csv, node_poses.csv, users.csv, smart_codes.csv, ranges.csv"
    )
    assert fault(folder) == f"small: has none of the tables {tables}"


def test_a_drive_is_not_written_over_another_unless_told(tmp_path):
    write_drive(full_drive(), tmp_path / "drive", parquet=True)
    with pytest.raises(DriveError, match="holds a drive already"):
        write_drive(full_drive(), tmp_path / "drive")
    write_drive(make_city(1, 1.0), tmp_path / "drive", overwrite=True)
    assert_same(make_city(1, 1.0), read_drive(tmp_path / "drive"))


def test_a_drive_is_never_written_among_foreign_files(tmp_path):
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(DriveError, match="holds other files and no drive"):
        write_drive(make_city(1, 1.0), tmp_path, overwrite=True)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_nothing_is_written_of_a_drive_that_could_not_be_read(tmp_path):
    drive = make_city(1, 1.0)
    cov = np.zeros((len(drive.gnss), 3, 3))
    broken = drive.with_tables(gnss=dataclasses.replace(drive.gnss, cov_world_m2=cov))
    with pytest.raises(DriveError, match="gnss row 0: the position covariance has a zero"):
        write_drive(broken, tmp_path / "drive")
    assert not (tmp_path / "drive").exists()


def test_a_table_under_a_foreign_name_is_not_written(tmp_path):
    drive = make_city(1, 1.0)
    says = "no file for source 'gnss2'; known: gnss, imu, wheel, steering, odometry"
    with pytest.raises(DriveError, match=says):
        write_drive(drive.with_tables(gnss2=drive.gnss), tmp_path / "drive")


def test_a_table_without_rows_is_not_written(tmp_path):
    drive = make_city(1, 1.0)
    with pytest.raises(DriveError, match="table wheel has no rows"):
        none = WheelSpeeds(*(np.zeros(0) for _ in range(4)))
        write_drive(drive.with_tables(wheel=none), tmp_path / "drive")


def cov_fault(cov) -> str:
    with pytest.raises(DriveError) as caught:
        check_covariances(np.stack([np.eye(3), cov]), lambda row: f"row {row}")
    return str(caught.value)


@pytest.mark.parametrize(
    ("cov", "words"),
    [
        (np.array([[1, 0.2, 0], [0.1, 1, 0], [0, 0, 1]]), "row 1: the position covariance is not"),
        (np.diag([1, np.inf, 1]), "is not finite"),
        (np.full((3, 3), np.nan), "is not finite"),
        (np.ones((3, 3)), "is not positive definite"),
        (np.diag([1e-12, 0.0, 1.0]), "zero or negative variance"),
        (np.array([[1, 0.9, -0.9], [0.9, 1, 0.9], [-0.9, 0.9, 1.0]]), "is not positive definite"),
    ],
)  # fmt: skip
def test_an_impossible_covariance_is_told(cov, words):
    assert words in cov_fault(cov)


def test_covariances_of_any_scale_pass():
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    for scale in (1e-12, 1.0, 1e12):
        check_covariances((turn @ np.diag([1, 4, 9]) @ turn.T * scale)[None], str)


def test_fixes_without_rows_pass_the_check():
    check_covariances(np.zeros((0, 3, 3)), str)
    assert len(GnssFixes([], [], np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)))) == 0
