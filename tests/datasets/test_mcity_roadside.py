"""The importer of the Mcity roadside data, and the sample that was made with it."""

import json
from pathlib import Path

import numpy as np
import pytest

from fgloc.cli import main
from fgloc.correspondence.tracks import track_objects
from fgloc.datasets import import_recording, open_drive
from fgloc.datasets.mcity_roadside import (
    LATENCY_S,
    NODE_EN_M,
    ORIGIN,
    import_mcity_roadside,
    mcity_node,
)
from fgloc.errors import DriveError, InputError
from fgloc.measurements import PEDESTRIAN, UNKNOWN, VEHICLE

SOURCE = Path(__file__).parents[3] / "shared" / "data" / "mcity_roadside"
START_S = 1_688_687_478.5
SPEED_MPS = 5.0
SECONDS = 20


def place(east_m, north_m):
    """Latitude and longitude as the files name them, of one place or of arrays of places."""
    at = np.stack([np.asarray(east_m, float), np.asarray(north_m, float)], -1)
    lat_deg, lon_deg, _ = ORIGIN.to_geodetic(np.concatenate([at, 0 * at[..., :1]], -1)).T
    return lat_deg, lon_deg


def thing(lat_deg, lon_deg, object_id, kind) -> dict[str, object]:
    return {"lat": float(lat_deg), "lon": float(lon_deg), "id": object_id, "classType": kind}


def car_places(t_s):
    return place(SPEED_MPS * t_s - 40.0, np.full(np.shape(t_s), -20.0))


def rtk_frames() -> list[dict]:
    """East at 5 m/s for 20 s; after 10 s the lap is cut. Another car stands still."""
    t_s = np.arange(0, SECONDS, 0.02)
    other = thing(*place(0, 0), 1, "2")
    return [
        {"timestamp": START_S + t, "objs": [thing(*at, 0 if t < 10 else "0-cut", "2"), other]}
        for t, *at in zip(t_s, *car_places(t_s), strict=True)
    ]


def seen_frames() -> list[dict]:
    """A frame a second, late as the real ones are, with a pedestrian and something else."""
    t_s = np.arange(1.0, SECONDS)
    frames = []
    for t, *at in zip(t_s, *car_places(t_s), strict=True):
        car = thing(*at, str(331373741 + int(t)), "2")
        walker, other = thing(*place(3, 4), "7", "10"), thing(*place(5, 6), "8", "0")
        frames.append({"timestamp": START_S + t + LATENCY_S, "objs": [car, walker, other]})
    return frames


RTK = json.dumps(rtk_frames())
CAR = thing(*car_places(0.0), "1", "2")


def write(folder: Path, seen: object, rtk: object, rtk_name: str = "gps_data_4.json") -> Path:
    for name, content in (("dets/detection_4.json", seen), (f"gts/{rtk_name}", rtk)):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content if isinstance(content, str) else json.dumps(content))
    return folder


@pytest.fixture
def recording(tmp_path):
    return write(tmp_path / "mcity", seen_frames(), RTK)


@pytest.fixture
def source():
    if not SOURCE.is_dir():
        pytest.skip("data not here")
    return SOURCE


def truth_at(drive, t_ns):
    truth = drive.truth
    return np.stack([np.interp(t_ns, truth.t_ns, axis) for axis in truth.p_world_m.T], -1)


def test_positions_come_back_to_the_millimetre_in_node_and_world(recording):
    drive = import_mcity_roadside(recording, trial=4)
    table = drive.tables["detections"]
    p_world_m = drive.infrastructure.nodes[0].to_world(table.p_node_m)
    np.testing.assert_allclose(p_world_m[:3], [[-35, -20], [3, 4], [5, 6]], atol=1e-3)
    np.testing.assert_allclose(drive.truth.p_world_m[0], [-39.9, -20, 0], atol=1e-3)
    np.testing.assert_allclose(drive.truth.v_world_mps, [[5.0, 0, 0]] * len(drive.truth), atol=1e-3)
    np.testing.assert_allclose(drive.truth.yaw_rad, 0.0, atol=1e-3)


def test_the_nodes_axes_are_right_handed_and_start_where_the_files_are_zero():
    node = mcity_node()
    np.testing.assert_allclose(node.to_world(np.zeros((1, 2)))[0], NODE_EN_M)
    ahead, left = node.to_world(np.eye(2)) - NODE_EN_M
    np.testing.assert_allclose(ahead, [1.0, -0.0139], atol=1e-3)
    np.testing.assert_allclose(left, [0.0139, 1.0], atol=1e-3)


def test_detections_are_true_before_their_stamp_and_received_at_it(recording):
    table = import_mcity_roadside(recording, trial=4).tables["detections"]
    assert np.abs(table.received_ns - (START_S + 1 + LATENCY_S) * 1e9)[0] < 1000
    assert set(table.received_ns - table.t_ns) == {round(LATENCY_S * 1e9)}


def test_detections_match_the_truth_once_the_latency_is_off(recording):
    drive = import_mcity_roadside(recording, trial=4)
    table = drive.tables["detections"]
    own = table.take(table.kind == VEHICLE)
    seen_m = drive.infrastructure.nodes[0].to_world(own.p_node_m)
    np.testing.assert_allclose(seen_m, truth_at(drive, own.t_ns)[:, :2], atol=0.01)


def test_kinds_and_numbers_are_kept(recording):
    table = import_mcity_roadside(recording, trial=4).tables["detections"]
    assert table.kind[:3].tolist() == [VEHICLE, PEDESTRIAN, UNKNOWN]
    assert table.object_id[:3].tolist() == [331373742, 7, 8]


def test_a_cut_lap_goes_on_as_the_same_vehicle(recording):
    drive = import_mcity_roadside(recording, trial=4)
    assert (drive.truth.t_ns[-1] - drive.truth.t_ns[0]) / 1e9 == pytest.approx(SECONDS, abs=0.1)
    assert "rows of other vehicles in the RTK (1000)" in drive.about.source


def test_every_fifth_row_becomes_a_fix_and_the_others_stay_truth(recording):
    drive = import_mcity_roadside(recording, trial=4)
    assert len(drive.gnss) == 10 * SECONDS
    assert len(drive.truth) == 40 * SECONDS
    assert not np.isin(drive.truth.t_ns, drive.gnss.t_ns).any()
    np.testing.assert_allclose(drive.gnss.cov_world_m2[0], 0.25 * np.eye(3))
    assert len(import_mcity_roadside(recording, trial=4, gps_rate_hz=5).gnss) == 5 * SECONDS


def test_fixes_have_the_noise_that_was_asked_for(recording):
    def errors(**options):
        drive = import_mcity_roadside(recording, trial=4, gps_rate_hz=25, **options)
        return drive.gnss.p_world_ant_m[1:-1] - truth_at(drive, drive.gnss.t_ns[1:-1])

    white = errors(gps_sigma_m=2.0, gps_bias_sigma_m=0.0)
    assert white.std() == pytest.approx(2.0, rel=0.1)
    slow = errors(gps_sigma_m=0.001, gps_bias_sigma_m=3.0, gps_bias_tau_s=0.5)
    assert slow.std() == pytest.approx(3.0, rel=0.3)
    assert (slow[1:] * slow[:-1]).mean() / (slow**2).mean() > 0.85


def test_the_rig_states_the_bias_or_that_there_is_none(recording):
    rig = import_mcity_roadside(recording, trial=4).rig
    assert (rig.gnss_bias.sigma_m, rig.gnss_bias.tau_s) == (1.3, 60.0)
    assert import_mcity_roadside(recording, trial=4, gps_bias_sigma_m=0).rig.gnss_bias is None


def test_odometry_comes_only_when_asked_for_with_its_noise(recording):
    assert set(import_mcity_roadside(recording, trial=4).tables) == {"gnss", "detections"}
    told = import_mcity_roadside(recording, trial=4, odometry=True).tables["odometry"]
    assert len(told) == 10 * SECONDS
    np.testing.assert_allclose(told.sigma_speed_mps, 0.1, rtol=1e-3)
    assert (told.speed_mps - SPEED_MPS).std() == pytest.approx(0.1, rel=0.15)
    assert np.rad2deg(told.yaw_rate_radps.std()) == pytest.approx(0.5, rel=0.15)


def test_velocity_is_the_odometry_reckoned_from_the_true_heading(recording):
    tables = import_mcity_roadside(recording, trial=4, odometry=True, seed=3).tables
    told, velocity = tables["odometry"], tables["velocity"]
    np.testing.assert_allclose(np.hypot(*velocity.v_world_mps[:, :2].T), told.speed_mps)
    heading = np.arctan2(velocity.v_world_mps[:, 1], velocity.v_world_mps[:, 0])
    rates = (told.yaw_rate_radps[1:] + told.yaw_rate_radps[:-1]) / 2
    assert heading[0] == pytest.approx(0.0, abs=1e-3)
    np.testing.assert_allclose(np.diff(heading), rates * np.diff(told.t_ns) / 1e9, atol=1e-9)
    assert velocity.sigma_mps[-1] > velocity.sigma_mps[0]


def test_the_other_car_comes_in_as_a_user_with_a_truth_of_its_own(recording):
    drive = import_mcity_roadside(recording, trial=4, others=True)
    users, objects = drive.tables["users"], drive.objects
    assert (len(users), len(objects)) == (10 * SECONDS, 40 * SECONDS)
    assert set(users.user_id) == set(objects.object_id) == {1}
    assert not np.isin(objects.t_ns, users.t_ns).any()
    np.testing.assert_allclose(objects.p_world_m, np.zeros((len(objects), 2)), atol=1e-3)
    np.testing.assert_allclose(objects.v_world_mps, np.zeros((len(objects), 2)), atol=1e-3)
    assert np.abs(users.p_world_m).max() < 5.5
    assert "rows of other vehicles" not in drive.about.source
    assert import_mcity_roadside(recording, trial=4).objects is None


def test_receivers_of_two_cars_err_apart_and_alike_in_size(recording):
    options = {"gps_sigma_m": 0.001, "gps_bias_sigma_m": 3.0, "gps_bias_tau_s": 0.5}
    drive = import_mcity_roadside(recording, trial=4, gps_rate_hz=25, others=True, **options)
    own = (drive.gnss.p_world_ant_m[1:-1] - truth_at(drive, drive.gnss.t_ns[1:-1]))[:, :2]
    other = drive.tables["users"].p_world_m[1:-1]
    assert other.std() == pytest.approx(3.0, rel=0.3)
    assert abs((own * other).mean()) < 0.4 * 3.0**2
    assert drive.rig.user_bias.sigma_m == drive.rig.gnss_bias.sigma_m == 3.0


def test_leaps_in_the_rtk_of_the_other_car_are_counted(tmp_path):
    frames = rtk_frames()
    for frame in frames[:50]:
        frame["objs"][1] = thing(*place(9, 0), 1, "2")
    folder = write(tmp_path, seen_frames(), frames)
    for others, leaps in ((True, 1), (False, 0)):
        source = import_mcity_roadside(folder, trial=4, others=others).about.source
        assert f"steps of the RTK above 40 m/s, kept ({leaps})" in source


@pytest.mark.parametrize("left", ["0", "x"])
def test_others_are_refused_where_there_are_none_with_a_number(tmp_path, left):
    frames = rtk_frames()
    for frame in frames:
        frame["objs"][1]["id"] = left
    folder = write(tmp_path, seen_frames(), frames)
    with pytest.raises(InputError, match="others asks for vehicles beside 0 with whole numbers"):
        import_mcity_roadside(folder, trial=4, others=True)


def test_the_seed_changes_what_is_simulated_and_nothing_else(recording):
    a, b = (import_mcity_roadside(recording, trial=4, odometry=True, seed=s) for s in (0, 1))
    assert a.tables["detections"].same_as(b.tables["detections"])
    assert a.truth.same_as(b.truth)
    assert not any(a.tables[k].same_as(b.tables[k]) for k in ("gnss", "odometry", "velocity"))


def test_what_is_simulated_is_called_so(recording):
    about = import_mcity_roadside(recording, trial=4, odometry=True).about
    assert "GPS and odometry simulated" in about.title
    assert "velocity are simulated from the RTK (seed 0)" in about.source


def test_frames_out_of_order_are_sorted_and_counted(tmp_path):
    frames = seen_frames()
    frames = [*frames[10:], *frames[:10]]
    drive = import_mcity_roadside(write(tmp_path, frames, RTK), trial=4)
    assert "frames sorted into place (1)" in drive.about.source
    assert (np.diff(drive.tables["detections"].t_ns) >= 0).all()


def test_detections_outside_the_time_of_the_rtk_are_counted(tmp_path):
    frames = [*seen_frames(), {"timestamp": START_S + 60, "objs": [CAR] * 2}]
    drive = import_mcity_roadside(write(tmp_path, frames, RTK), trial=4)
    assert "detections outside the time of the RTK (2)" in drive.about.source


def test_the_rtk_may_be_the_cut_file(tmp_path):
    folder = write(tmp_path, seen_frames(), RTK, "gps_data_4_c.json")
    assert len(import_mcity_roadside(folder, trial=4).gnss) == 10 * SECONDS


def changed(frames: list[dict], **fields: object) -> list[dict]:
    """The frames with fields of the second object of the third frame changed, None: left out."""
    one = frames[2]["objs"][1]
    one.update(fields)
    for name, value in fields.items():
        if value is None:
            del one[name]
    return frames


@pytest.mark.parametrize(
    ("seen", "says"),
    [
        (
            changed(seen_frames(), lat=None),
            r"frame 2 \(from 0\), object 1 \(from 0\): 'lat' is mis",
        ),
        (changed(seen_frames(), lon="east"), r"object 1 \(from 0\): lon = 'east' is not a number"),
        (changed(seen_frames(), lat=200), r"latitude 200.0 deg is outside \[-90, 90\]"),
        (changed(seen_frames(), classType=None), r"'classType' is missing"),
        (changed(seen_frames(), id="abc"), r"id = 'abc' is not a whole number"),
        ([{"objs": []}], r"frame 0 \(from 0\): 'timestamp' is missing"),
        ([{"timestamp": 1.7e12, "objs": []}], r"timestamp = 1.7e\+12: expected seconds since 1970"),
        ([{"timestamp": START_S}], r"frame 0 \(from 0\): 'objs' is missing"),
        ([{"timestamp": START_S, "objs": [3]}], "expected fields by name, not 3"),
        ([{"timestamp": START_S, "objs": []}], "no frame holds an object"),
        ({"timestamp": START_S}, "expected a list of frames, not dict"),
        ('[{"timestamp": ', r"detection_4.json: not valid JSON: .*; copy the file again"),
        ([{"timestamp": 1.0, "objs": [CAR]}], "no frame falls into the time of the RTK"),
    ],
)
def test_faults_name_file_frame_object_and_field(tmp_path, seen, says):
    folder = write(tmp_path, seen, RTK)
    with pytest.raises(DriveError, match=says) as caught:
        import_mcity_roadside(folder, trial=4)
    assert "detection_4.json" in str(caught.value)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({}, "needs trial, one of 4: give --trial K"),
        ({"trial": 5}, r"has no dets/detection_5.json \(trials: 4\)"),
        ({"trial": 4, "vehicle": 2}, r"has no vehicle 2 \(there are: 0, 1\)"),
        ({"trial": 4, "vehicle": 1}, "never moves at 0.5 m/s; its heading is unknown"),
        ({"trial": 4, "gps_rate_hz": 50}, "gps_rate_hz = 50: expected above 0 to 25 Hz"),
        ({"trial": 4, "gps_sigma_m": 0.0}, "gps_sigma_m = 0.0: a standard deviation above 0"),
        ({"trial": 4, "gps_bias_sigma_m": -1.0}, "gps_bias_sigma_m = -1.0: expected metres"),
        ({"trial": 4, "gps_bias_tau_s": 0.0}, "gps_bias_tau_s = 0.0: expected seconds above 0"),
        ({"trial": 4, "seed": -1}, "seed = -1: expected a whole number from 0"),
        ({"trial": "four"}, "option trial = 'four' is not a whole number"),
    ],
)
def test_options_that_make_no_sense_are_refused(recording, options, says):
    with pytest.raises(InputError, match=says):
        import_recording("mcity-roadside", recording, **options)


def test_a_folder_without_the_files_is_told(tmp_path, recording):
    with pytest.raises(DriveError, match=r"holds no dets/detection_K\.json"):
        import_mcity_roadside(tmp_path / "nowhere", trial=4)
    (recording / "gts" / "gps_data_4.json").unlink()
    with pytest.raises(DriveError, match=r"has neither gps_data_4.json nor gps_data_4_c.json"):
        import_mcity_roadside(recording, trial=4)


def test_the_command_takes_the_options_as_flags_and_as_settings(recording, tmp_path, capsys):
    begin = ["import", "mcity-roadside", str(recording)]
    flags = ["--trial=4", "--vehicle=0", "--gps-rate=5", "--gps-sigma=0.7", "--gps-bias-sigma=2",
             "--gps-bias-tau=30", "--odometry", "--seed=6"]  # fmt: skip
    keys = ["trial=4", "vehicle=0", "gps_rate_hz=5", "gps_sigma_m=0.7", "gps_bias_sigma_m=2",
            "gps_bias_tau_s=30", "odometry=true", "seed=6"]  # fmt: skip
    sets = [word for key in keys for word in ("--set", key)]
    for name, options in (("flags", flags), ("sets", sets)):
        assert main([*begin, *options, "--out", str(tmp_path / name)]) == 0
    assert "left out" in capsys.readouterr().out
    a, b = open_drive(tmp_path / "flags"), open_drive(tmp_path / "sets")
    assert all(a.tables[name].same_as(b.tables[name]) for name in a.tables)
    assert a.rig.gnss_bias.tau_s == 30
    assert set(a.tables) == {"gnss", "odometry", "velocity", "detections"}


def test_a_flag_and_the_setting_of_its_name_contradict(recording, tmp_path, capsys):
    words = ["import", "mcity-roadside", str(recording), "--trial", "4", "--set", "trial=4"]
    assert main([*words, "--out", str(tmp_path / "x")]) == 2
    assert "--set trial and the option of that name" in capsys.readouterr().err


def test_the_sample_is_what_the_importer_makes_of_the_recording(source):
    made = import_mcity_roadside(source, trial=13, odometry=True)
    sample = open_drive("mcity-13")
    assert all(sample.tables[name].same_as(made.tables[name]) for name in made.tables)
    np.testing.assert_allclose(sample.truth.p_world_m, made.truth.p_world_m)
    assert sample.about == made.about


def test_detections_of_the_sample_lie_by_its_truth():
    drive = open_drive("mcity-13")
    table = drive.tables["detections"]
    seen_m = drive.infrastructure.nodes[0].to_world(table.p_node_m)
    off_m = np.hypot(*(seen_m - truth_at(drive, table.t_ns)[:, :2]).T)
    near = (off_m < 4.0) & (table.kind == VEHICLE)
    assert near.sum() == 443
    assert np.sqrt((off_m[near] ** 2).mean()) == pytest.approx(0.586, abs=0.005)


def test_turns_of_the_sample_agree_with_its_odometry():
    drive = open_drive("mcity-13")
    told = drive.tables["odometry"]
    turned = np.trapezoid(told.yaw_rate_radps, told.t_ns / 1e9 - told.t_ns[0] / 1e9)
    yaw = np.unwrap(drive.truth.yaw_rad)
    assert turned == pytest.approx(yaw[-1] - yaw[0], abs=0.1)


def test_licence_and_origin_lie_beside_the_sample():
    folder = Path(__file__).parents[2] / "datasets" / "real" / "mcity-13"
    assert "MIT License" in (folder / "LICENSE.txt").read_text()
    origin = (folder / "ORIGIN.txt").read_text()
    assert "SIMULATED: gnss.csv" in origin
    assert "REAL: detections.csv" in origin


def test_of_two_cars_in_a_row_no_detection_is_taken_for_the_other(source):
    drive = import_mcity_roadside(source, trial=13, others=True)
    found = track_objects(drive, "test")
    for track, truth in ((found.ego, drive.truth), (found.users[1], drive.objects)):
        seen = [(epoch.t_ns, *z) for epoch in found.epochs
                for z in epoch.z_m[epoch.track == track]]  # fmt: skip
        t_ns, east_m, north_m = np.array(seen).T
        off = [np.interp(t_ns, truth.t_ns, axis) for axis in truth.p_world_m.T[:2]]
        assert len(t_ns) > 400
        assert np.hypot(east_m - off[0], north_m - off[1]).max() < 3.0
