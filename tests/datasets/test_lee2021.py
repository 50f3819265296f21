"""Scenario lee2021/mcity: where it lies, what its errors are, what the node says."""

import numpy as np
import pytest

from fgloc import frames
from fgloc.datasets import lee2021_road as road
from fgloc.datasets import make
from fgloc.datasets.lee2021 import NAME, P_VEH_BOX_M, cases, mcity_node
from fgloc.datasets.lee2021_errors import (
    GNSS_BIAS,
    NODE_BIAS_SIGMA_M,
    NODE_BIAS_TAU_S,
    PAPER,
    turned,
)
from fgloc.datasets.lee2021_traffic import CAR_ID, FOLLOWER_ID, GHOST_ID
from fgloc.errors import InputError
from fgloc.timing import elapsed_s

SEEDS = range(20)
TABLE_I_M = np.array([[1.17, 0.65], [1.20, 1.05], [1.91, 0.82]])
GPS_M = np.array([[2.09, 0.78], [2.30, 0.43], [1.15, 0.33]])
NODE_M = np.array([[1.40, 0.50], [1.62, 0.53], [1.05, 0.59]])
"""Mean and standard deviation that the paper prints: Table I, and the cases of Table III."""


@pytest.fixture(scope="module")
def drives():
    return [make(NAME, seed) for seed in SEEDS]


@pytest.fixture(scope="module")
def exact():
    return [make(NAME, seed, errors="model") for seed in range(20)]


def gps_errors(drive):
    """(N, 3) ENU, and the attitude then."""
    truth = drive.truth.at(drive.gnss.t_ns).at_point(drive.rig.p_veh_ant_m)
    return drive.gnss.p_world_ant_m - truth.p_world_m, truth.R_world_veh


def own(drive):
    table = drive.tables["detections"]
    return table.take((table.object_id >= CAR_ID) & (table.object_id < FOLLOWER_ID))


def node_errors(drive):
    table = own(drive)
    truth = drive.truth.at(table.t_ns).at_point(drive.rig.p_veh_box_m)
    return drive.infrastructure.nodes[0].to_world(table.p_node_m) - truth.p_world_m[:, :2]


def spread(errors_m):
    return errors_m.mean(), errors_m.std()


def by_case(drive, t_ns, errors_m):
    t_s = elapsed_s(t_ns, drive.start_ns)
    spans = [case.covered_s for case in cases()]
    return [spread(errors_m[(t_s >= begin) & (t_s <= end)]) for begin, end in spans]


def test_map_and_node_lie_at_the_papers_utm_places():
    origin = road.origin()
    place = origin.to_geodetic(mcity_node().p_world_m)
    utm = frames.geodetic_to_utm(place[0], place[1], 17)
    np.testing.assert_allclose(utm, [277_495 + 7.13, 4_686_600 + 62.19], atol=1e-3)
    assert place[2] == pytest.approx(origin.height_m + 6.0, abs=1e-6)
    # The grid's North is turned by the convergence, -1.82 deg there: 62 m North are 2 m West.
    assert mcity_node().p_world_m[0] == pytest.approx(
        7.13 - 62.19 * np.sin(np.deg2rad(1.82)), abs=0.1
    )


def test_the_car_passes_three_times_through_range_and_tunnel():
    passes = cases()
    assert len(passes) == 3
    assert [case.occluded_s is None for case in passes] == [True, False, False]
    for case in passes:
        begin, end = case.covered_s
        assert 14 < end - begin < 15
        assert begin < case.tunnel_s[0] < case.tunnel_s[1] < end


def test_laps_are_closed_and_the_car_stops_before_the_end():
    motion = road.motion()
    speed = np.linalg.norm(motion.v_world_mps, axis=1)
    assert speed[:400].max() == 0
    assert speed[-100:].max() == 0
    assert speed.max() == pytest.approx(road.CRUISE_MPS)
    middle_s = [np.mean(case.covered_s) for case in cases()]
    at = motion.p_world_m[np.rint(np.array(middle_s) * road.RATE_HZ).astype(int)]
    np.testing.assert_allclose(at, at[[0, 0, 0]], atol=0.6)
    np.testing.assert_allclose(at[:, 1], mcity_node().p_world_m[1] - road.NODE_TO_ROAD_M, atol=1e-6)


def test_gps_errors_of_the_whole_run_are_those_of_table_i(drives):
    found = []
    for drive in drives:
        error_m, R_world_veh = gps_errors(drive)
        ahead, left, _ = np.einsum("nji,nj->in", R_world_veh, error_m)
        parts = np.abs(ahead), np.abs(left), np.hypot(*error_m[:, :2].T)
        found.append([spread(part) for part in parts])
    ratio = np.mean(found, axis=0) / TABLE_I_M
    assert np.abs(ratio[:, 0] - 1).max() < 0.10
    assert np.abs(ratio[:, 1] - 1).max() < 0.20


def test_gps_errors_of_the_cases_are_those_of_table_iii(drives):
    found = [by_case(d, d.gnss.t_ns, np.hypot(*gps_errors(d)[0][:, :2].T)) for d in drives]
    ratio = np.mean(found, axis=0) / GPS_M
    assert np.abs(ratio[:, 0] - 1).max() < 0.10
    assert np.abs(ratio[:, 1] - 1).max() < 0.20


def test_node_errors_of_the_cases_are_those_of_table_iii(drives):
    found = [by_case(d, own(d).t_ns, np.hypot(*node_errors(d).T)) for d in drives]
    ratio = np.mean(found, axis=0) / NODE_M
    assert np.abs(ratio[:, 0] - 1).max() < 0.10
    assert np.abs(ratio[:, 1] - 1).max() < 0.20


def test_what_the_drive_states_of_slow_errors_is_their_rms(drives):
    gps = np.concatenate([gps_errors(drive)[0][:, :2] for drive in drives])
    node = np.concatenate([node_errors(drive) for drive in drives])
    assert np.sqrt((gps**2).mean()) == pytest.approx(GNSS_BIAS.sigma_m, rel=0.1)
    assert np.sqrt((node**2).mean()) == pytest.approx(NODE_BIAS_SIGMA_M, rel=0.1)


def test_the_tunnel_is_where_the_gps_is_worst_in_a_case(drives):
    case = cases()[0]
    for drive in drives:
        size_m = np.hypot(*gps_errors(drive)[0][:, :2].T)
        t_s = elapsed_s(drive.gnss.t_ns, drive.start_ns)
        covered = (t_s >= case.covered_s[0]) & (t_s <= case.covered_s[1])
        worst_s = t_s[covered][np.argmax(size_m[covered])]
        assert case.tunnel_s[0] < worst_s < case.tunnel_s[1]


def test_nothing_is_seen_of_the_car_while_it_is_hidden(drives):
    for case in cases()[1:]:
        t_s = elapsed_s(own(drives[0]).t_ns, drives[0].start_ns)
        begin, end = case.occluded_s
        assert not ((t_s >= begin) & (t_s <= end)).any()
        assert ((t_s > case.covered_s[0]) & (t_s < begin)).any()
        assert ((t_s > end) & (t_s < case.covered_s[1])).any()


def test_the_car_has_a_new_number_after_it_was_hidden(drives):
    table = own(drives[0])
    t_s = elapsed_s(table.t_ns, drives[0].start_ns)
    begin, end = cases()[2].occluded_s
    assert not set(table.object_id[t_s < begin]) & set(table.object_id[t_s > end])


def test_there_are_a_second_car_and_ghosts_too(drives):
    for drive in drives:
        ids = drive.tables["detections"].object_id
        assert ((ids >= FOLLOWER_ID) & (ids < GHOST_ID)).sum() > 300
        assert len(set(ids[ids >= GHOST_ID])) == 9


def test_frames_share_the_instants_of_fixes_and_arrive_late(drives):
    table, fixes = drives[0].tables["detections"], drives[0].gnss
    assert np.isin(table.t_ns, fixes.t_ns).all()
    late_s = (table.received_ns - table.t_ns) / 1e9
    assert 0.07 <= late_s.min() < 0.08
    assert 0.12 < late_s.max() <= 0.13
    later = make(NAME, 0, latency_s=0.5).tables["detections"]
    assert np.mean(later.received_ns - later.t_ns) / 1e9 == pytest.approx(0.5, abs=0.02)
    np.testing.assert_array_equal(later.p_node_m, table.p_node_m)


def test_exact_errors_are_stationary_gauss_markov_plus_the_stated_white(exact):
    gps = np.array([gps_errors(drive)[0] for drive in exact])
    var = GNSS_BIAS.sigma_m**2
    white = np.diagonal(exact[0].gnss.cov_world_m2[0])
    np.testing.assert_allclose((gps**2).mean((0, 1)), var + white, rtol=0.2)
    lag = round(GNSS_BIAS.tau_s * 10)
    assert (gps[:, lag:] * gps[:, :-lag]).mean() == pytest.approx(var / np.e, rel=0.25)
    lag = 1
    steps = (np.diff(gps, axis=1) ** 2).mean((0, 1))
    ou = 2 * var * (1 - np.exp(-0.1 / GNSS_BIAS.tau_s))
    np.testing.assert_allclose(steps, ou + 2 * white, rtol=0.05)


def test_exact_node_errors_are_as_the_drive_states(exact):
    whitened = []
    for drive in exact:
        table, error_m = own(drive), node_errors(drive)
        near = np.diff(table.t_ns) == 100_000_000
        cov = table.cov_node_m2[1:][near] + table.cov_node_m2[:-1][near]
        ou = 2 * NODE_BIAS_SIGMA_M**2 * (1 - np.exp(-0.1 / NODE_BIAS_TAU_S))
        step_m = np.diff(error_m, axis=0)[near]
        solved = np.linalg.solve(cov + ou * np.eye(2), step_m[..., None])
        whitened.append(np.einsum("ni,nij->n", step_m, solved))
    assert np.concatenate(whitened).mean() == pytest.approx(2.0, rel=0.05)
    rms_m = np.sqrt(np.mean(np.concatenate([node_errors(drive) for drive in exact]) ** 2))
    assert rms_m == pytest.approx(NODE_BIAS_SIGMA_M, rel=0.2)


def test_exact_drives_show_the_car_alone(exact):
    assert all(len(own(drive)) == len(drive.tables["detections"]) for drive in exact)


def test_velocities_have_the_white_noise_that_they_state(drives):
    drive = drives[0]
    table = drive.tables["velocity"]
    error_mps = table.v_world_mps - drive.truth.at(table.t_ns).v_world_mps
    assert error_mps.std() == pytest.approx(table.sigma_mps[0], rel=0.03)


def test_equal_seeds_give_equal_drives_and_others_do_not(drives):
    again = make(NAME, 0)
    assert all(again.tables[name].same_as(drives[0].tables[name]) for name in again.tables)
    assert again.truth.same_as(drives[0].truth)
    assert not any(again.tables[name].same_as(drives[1].tables[name]) for name in again.tables)


def test_the_box_of_the_car_is_not_its_origin(drives):
    np.testing.assert_array_equal(drives[0].rig.p_veh_box_m, P_VEH_BOX_M)
    # (18): the reference, here the box, is 0.0381 m ahead of the GPS.
    assert P_VEH_BOX_M[0] - drives[0].rig.p_veh_ant_m[0] == pytest.approx(0.0381)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"errors": "papers"}, "errors = 'papers': the nearest is 'paper'"),
        ({"latency_s": -0.1}, "latency_s = -0.1: expected 0 to 10 seconds"),
        ({"latency_s": float("nan")}, "latency_s = nan: expected 0 to 10 seconds"),
        ({"errors": 1}, "option errors = 1 is not text"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, says):
    with pytest.raises(InputError, match=says):
        make(NAME, 0, **options)


def test_turned_biases_are_as_large_and_point_anywhere():
    made = [turned(seed) for seed in range(40)]
    for name in ("gps_passing_m", "node_m"):
        biases = np.array([getattr(one, name) for one in made])  # (seeds, passes, 2)
        length = np.linalg.norm(getattr(PAPER, name), axis=-1)
        np.testing.assert_allclose(np.linalg.norm(biases, axis=-1), np.tile(length, (40, 1)))
        assert (np.abs(biases.mean(0)).max(-1) < 0.4 * length).all()
    one, other = (make(NAME, 1, errors=kind).gnss.p_world_ant_m for kind in ("turned", "paper"))
    assert (one != other).any()
    assert turned(3) == turned(3) != turned(4)
