"""Road users that say where they are, in the cooperative graph: two cars in a row past a node."""

import dataclasses

import numpy as np
import pytest

import fgloc
from fgloc import baselines
from fgloc.drive import Drive, GnssBias, Rig
from fgloc.evaluation.objects import errors_by_object, score_objects
from fgloc.frames import Origin, yaw_matrix
from fgloc.infrastructure import Infrastructure, Node
from fgloc.measurements import VEHICLE, GnssFixes, NodeDetections, ObjectTruth, UserFixes
from fgloc.smoother import is_cooperative
from fgloc.trajectory import Trajectory
from fgloc.verdicts import Verdict

STEP_NS, STEPS, SPEED_MPS, GAP_M = 100_000_000, 80, 8.0, 6.0
OFFSET_NS = 30_000_000
SLOW = GnssBias(1.3, 60.0)
OWN_OFF_M, USER_OFF_M = np.array([1.5, -1.0]), np.array([-1.0, 2.0])


def places(t_ns):
    """(n, 2) of the first car, to the East along a road; the other is `GAP_M` behind."""
    return np.stack([SPEED_MPS * t_ns / 1e9 - 30.0, np.full(len(t_ns), 5.0)], -1)


def two_cars(seed=0, node_sees_until_s=99.0, node_bias_m=0.0):
    """Fixes with 0.3 m of white noise and a constant error each; the node sees both to 0.2 m."""
    rng = np.random.default_rng(seed)
    fix_ns, see_ns = STEP_NS * np.arange(STEPS), STEP_NS * np.arange(STEPS) + OFFSET_NS
    fixes, users = (
        places(fix_ns) - [back, 0] + off + 0.3 * rng.standard_normal((STEPS, 2))
        for back, off in ((0, OWN_OFF_M), (GAP_M, USER_OFF_M))
    )
    see_ns = np.repeat(see_ns[see_ns < node_sees_until_s * 1e9], 3)
    who = np.tile([0, 1, 2], len(see_ns) // 3)
    seen = places(see_ns) - np.outer(who, [GAP_M, 0])
    seen[who == 2] = [4.0, 9.0]  # parked by the road
    seen += 0.2 * rng.standard_normal(seen.shape) + node_bias_m * np.array([1.0, 0.0])
    n, m = STEPS, len(see_ns)
    cov = np.tile(0.09 * np.eye(3), (n, 1, 1))
    tables = {
        "gnss": GnssFixes(fix_ns, fix_ns, np.pad(fixes, ((0, 0), (0, 1))), cov,
                          np.full((n, 3), np.nan)),
        "users": UserFixes(fix_ns, fix_ns, np.full(n, 5), users, cov[:, :2, :2]),
        "detections": NodeDetections(see_ns, see_ns, np.zeros(m, int), 70 + who,
                                     np.full(m, VEHICLE), seen,
                                     np.tile(0.04 * np.eye(2), (m, 1, 1))),
    }  # fmt: skip
    every_ns = np.arange(0, STEP_NS * STEPS, 10_000_000)
    p, v = places(every_ns), np.tile([SPEED_MPS, 0.0], (len(every_ns), 1))
    truth = Trajectory(every_ns, np.pad(p, ((0, 0), (0, 1))), yaw_matrix(np.zeros(len(p))))
    others = ObjectTruth(every_ns, every_ns, np.full(len(p), 5), p - [GAP_M, 0], v)
    node = Node("n", np.zeros(3))
    rig = Rig(gnss_bias=SLOW, user_bias=SLOW)
    return Drive("two cars", Origin(42.3, -83.7, 0.0), rig, tables, truth,
                 infrastructure=Infrastructure((node,)), objects=others)  # fmt: skip


def rmse_m(result, drive):
    """Of the car and of the other one, the first second left out."""
    own = result.trajectory
    e = own.p_world_m[:, :2] - places(own.t_ns)
    t_ns, theirs, _ = errors_by_object(result.objects, drive.objects)[5]
    late = [e[own.t_ns > 1e9], theirs[t_ns > 1e9]]
    return [float(np.sqrt((one**2).sum(-1).mean())) for one in late]


def test_a_drive_with_users_that_say_where_they_are_is_cooperative():
    drive = dataclasses.replace(two_cars(), objects=None)
    assert is_cooperative(drive)
    tables = {name: table for name, table in drive.tables.items() if name != "users"}
    assert not is_cooperative(dataclasses.replace(drive, tables=tables))


@pytest.mark.parametrize(("mode", "limit_m"), [("batch", 0.15), ("fixed-lag", 0.35)])
def test_both_cars_are_where_the_node_sees_them_not_where_their_fixes_are(mode, limit_m):
    drive = two_cars()
    result = fgloc.smooth(drive, mode=mode)
    assert max(rmse_m(result, drive)) < limit_m
    for name, table in drive.tables.items():
        assert sum(result.verdicts[name].counts().values()) == len(table)
    assert result.verdicts["users"].is_(Verdict.USED).all()


def test_what_the_node_showed_of_the_fixes_errors_holds_when_it_sees_nobody_any_more():
    drive = two_cars(node_sees_until_s=4.0)
    result = fgloc.smooth(drive, mode="batch")
    assert max(rmse_m(result, drive)) < 0.5  # fixes err by 1.8 and 2.2 m
    white = dataclasses.replace(drive, rig=Rig())
    assert min(rmse_m(fgloc.smooth(white, mode="batch"), drive)) > 1.0


def test_the_fixes_of_both_cars_tell_of_the_nodes_slow_error():
    drive = two_cars(node_bias_m=2.0)
    node = Node("n", np.zeros(3), bias_sigma_m=2.0, bias_tau_s=600.0)
    rig = Rig(gnss_bias=GnssBias(0.3, 60.0), user_bias=GnssBias(0.3, 60.0))
    fixes = {
        name: dataclasses.replace(table, **{column: getattr(table, column) - off})
        for name, column, off in (("gnss", "p_world_ant_m", [*OWN_OFF_M, 0.0]),
                                  ("users", "p_world_m", USER_OFF_M))
        for table in (drive.tables[name],)
    }  # fmt: skip
    good = dataclasses.replace(drive.with_tables(**fixes), rig=rig,
                               infrastructure=Infrastructure((node,)))  # fmt: skip
    assert max(rmse_m(fgloc.smooth(good, mode="batch"), good)) < 0.6
    blind = dataclasses.replace(good, infrastructure=drive.infrastructure)
    assert min(rmse_m(fgloc.smooth(blind, mode="batch"), good)) > 1.2


def test_the_smoothed_and_the_filtered_end_are_the_same():
    drive = two_cars(1)
    whole, grown = (fgloc.smooth(drive, mode=mode) for mode in ("batch", "incremental"))
    a, b = (result.trajectory for result in (whole, grown))
    assert a.p_world_m[-1] == pytest.approx(b.p_world_m[-1], abs=1e-4)
    assert a.cov[-1, :2, :2] == pytest.approx(b.cov[-1, :2, :2], abs=1e-4)


def test_a_leap_of_the_other_cars_fixes_is_gated_and_told():
    drive = two_cars()
    users = drive.tables["users"]
    p = users.p_world_m.copy()
    p[40:45] += [30.0, 0.0]
    leaping = drive.with_tables(users=dataclasses.replace(users, p_world_m=p))
    result = fgloc.smooth(leaping, mode="batch")
    assert result.verdicts["users"].counts()[Verdict.GATED] == 5
    assert rmse_m(result, drive)[1] < 0.15


@pytest.mark.parametrize("others", ["users", "objects"])
def test_a_fix_without_a_position_is_invalid_though_its_covariance_is_finite(others):
    drive = two_cars()
    gnss = drive.tables["gnss"]
    p = gnss.p_world_ant_m.copy()
    p[40] = np.nan
    tables = {**drive.tables, "gnss": dataclasses.replace(gnss, p_world_ant_m=p)}
    if others == "objects":
        del tables["users"]
    result = fgloc.smooth(dataclasses.replace(drive, tables=tables), mode="batch")
    assert result.verdicts["gnss"].is_(Verdict.INVALID).nonzero()[0].tolist() == [40]
    assert np.isfinite(result.trajectory.p_world_m).all()


def test_users_keep_their_numbers_and_are_scored_as_themselves():
    drive = two_cars()
    result = fgloc.smooth(drive, mode="batch")
    assert set(result.objects.user_id) == {5, -1}  # the other car, and who is parked
    metrics = score_objects(result.objects, drive.objects, drive.start_ns)
    assert metrics["objects.5.followed_share"].value > 0.99
    assert metrics["objects.5.horizontal_rmse_m"].value < 0.3


@pytest.mark.parametrize("method", ["khamooshi2023-kcf", "covariance-intersection"])
def test_the_filters_take_what_users_say_as_well(method):
    drive = two_cars(node_sees_until_s=2.0)
    result = baselines.run(drive, method)
    t_ns, e, _ = errors_by_object(result.objects, drive.objects)[5]
    assert t_ns[-1] > 7.8e9
    assert np.linalg.norm(e[-1]) < 3.0
    assert result.verdicts["users"].is_(Verdict.USED).all()
