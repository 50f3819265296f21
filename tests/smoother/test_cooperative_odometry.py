"""The car's own speeds, yaw rates and velocities in the cooperative graph."""

import dataclasses

import numpy as np
import pytest

import fgloc
from fgloc.config import SmoothConfig
from fgloc.correspondence.tracks import track_objects
from fgloc.drive import Drive, GnssBias, Rig
from fgloc.errors import DriveError
from fgloc.frames import Origin, yaw_matrix
from fgloc.infrastructure import Infrastructure, Node
from fgloc.measurements import (
    VEHICLE,
    EnuVelocities,
    GnssFixes,
    NodeDetections,
    Odometry,
    UserFixes,
    WheelSpeeds,
)
from fgloc.smoother.cooperative import run_online
from fgloc.smoother.cooperative_graph import Grown
from fgloc.smoother.cooperative_lag import Window
from fgloc.smoother.cooperative_model import Roster
from fgloc.smoother.cooperative_odometry import own_motion, rolling
from fgloc.trajectory import Trajectory
from fgloc.verdicts import Verdict

SPEED_MPS, RATE_RADPS, END_S = 8.0, 0.15, 16.0
RADIUS_M = SPEED_MPS / RATE_RADPS
SIGMA_MPS, SIGMA_RADPS, FIX_M = 0.1, 0.01, 1.0


def seconds(rate_hz, end_s=END_S):
    return (1e9 * np.arange(0, end_s, 1 / rate_hz)).astype(np.int64)


def circle(t_ns):
    """Places (n, 2), velocities (n, 2), headings (n,) of a car that turns left all the time."""
    yaw = 0.3 + RATE_RADPS * t_ns / 1e9
    p = RADIUS_M * np.stack([np.sin(yaw), -np.cos(yaw)], -1)
    return p, SPEED_MPS * np.stack([np.cos(yaw), np.sin(yaw)], -1), yaw


def driving(seed=0, fixes_until_s=END_S, scale=1.0, bias_radps=0.0):
    """A car with fixes and odometry, another with fixes, and a node that sees the other."""
    rng = np.random.default_rng(seed)
    fix_ns, told_ns, see_ns = seconds(2, fixes_until_s), seconds(10), seconds(5) + 137_000_000
    p, n = circle(fix_ns)[0], len(fix_ns)
    other = np.array([5.0, 5.0])
    white = np.tile(FIX_M**2 * np.eye(3), (n, 1, 1))
    tables = {
        "gnss": GnssFixes(fix_ns, fix_ns, np.pad(p + FIX_M * rng.standard_normal((n, 2)),
                                                 ((0, 0), (0, 1))), white, np.full((n, 3), np.nan)),
        "users": UserFixes(see_ns, see_ns, np.full(len(see_ns), 1),
                           other + rng.standard_normal((len(see_ns), 2)),
                           np.tile(np.eye(2), (len(see_ns), 1, 1))),
        "detections": NodeDetections(see_ns, see_ns, np.zeros(len(see_ns), int),
                                     np.full(len(see_ns), 9), np.full(len(see_ns), VEHICLE),
                                     other + 0.2 * rng.standard_normal((len(see_ns), 2)),
                                     np.tile(0.04 * np.eye(2), (len(see_ns), 1, 1))),
        "odometry": Odometry(
            told_ns, told_ns,
            SPEED_MPS / scale + SIGMA_MPS * rng.standard_normal(len(told_ns)),
            RATE_RADPS + bias_radps + SIGMA_RADPS * rng.standard_normal(len(told_ns)),
            np.full(len(told_ns), SIGMA_MPS), np.full(len(told_ns), SIGMA_RADPS)),
    }  # fmt: skip
    t_ns = seconds(100)
    p, _, yaw = circle(t_ns)
    truth = Trajectory(t_ns, np.pad(p, ((0, 0), (0, 1))), yaw_matrix(yaw))
    return Drive("circle", Origin(42.3, -83.7, 0.0), Rig(), tables, truth,
                 infrastructure=Infrastructure((Node("n", np.zeros(3)),)))  # fmt: skip


def without(drive, *names):
    return dataclasses.replace(
        drive, tables={name: table for name, table in drive.tables.items() if name not in names}
    )


def rmse(result, from_s=6.0):
    """Of the car: position in m and heading in rad."""
    own = result.trajectory
    late = own.t_ns > from_s * 1e9
    p, _, yaw = circle(own.t_ns[late])
    e = own.p_world_m[late, :2] - p
    off = np.angle(np.exp(1j * (own.yaw_rad[late] - yaw)))
    return float(np.sqrt((e**2).sum(-1).mean())), float(np.sqrt((off**2).mean()))


@pytest.mark.parametrize("mode", ["batch", "fixed-lag"])
def test_what_the_car_tells_of_its_motion_makes_it_better(mode):
    drive = driving()
    blind, result = (fgloc.smooth(d, mode=mode) for d in (without(drive, "odometry"), drive))
    assert rmse(result)[0] < 0.6 * rmse(blind)[0]
    assert rmse(result)[1] < 0.03
    assert result.verdicts["odometry"].is_(Verdict.USED).all()


@pytest.mark.parametrize("seed", [1, 2])
def test_claimed_covariances_hold_with_odometry(seed):
    result = fgloc.smooth(driving(seed), mode="batch")
    own = result.trajectory
    p, _, yaw = circle(own.t_ns)
    e = np.column_stack([own.p_world_m[:, :2] - p, np.angle(np.exp(1j * (own.yaw_rad - yaw)))])
    nees = np.einsum(
        "ni,ni->n", e[:, :2], np.linalg.solve(own.cov[:, :2, :2], e[:, :2, None])[..., 0]
    )
    assert 0.1 < nees.mean() / 2 < 3.0
    assert (e[:, 2] ** 2 / own.cov[:, 5, 5]).mean() < 4.0


def test_the_car_goes_on_where_it_has_no_fixes_for_longer_than_a_track_lives():
    result = fgloc.smooth(driving(fixes_until_s=9.0), mode="fixed-lag")
    own = result.trajectory
    assert own.t_ns[-1] > 15.5e9
    assert np.linalg.norm(own.p_world_m[-1, :2] - circle(own.t_ns[-1:])[0][0]) < 3.0


def test_the_scale_of_the_wheels_and_the_error_of_the_yaw_rate_are_found():
    drive = driving(3, scale=1.03, bias_radps=0.004)
    tight = SmoothConfig(vehicle={"scale_sigma": 1e-6}, motion={"yaw_rate_bias_radps": 1e-6})
    loose, stiff = (rmse(fgloc.smooth(drive, config=c, mode="batch")) for c in (None, tight))
    assert loose[0] < stiff[0]


@pytest.mark.parametrize("latest", [0, 400_000_000])
def test_the_newest_states_over_a_lag_are_those_of_the_whole_graph(latest):
    drive = driving(4)
    seen = drive.tables["detections"]
    late = seen.t_ns + np.random.default_rng(0).integers(0, latest + 1, len(seen))
    drive = drive.with_tables(detections=dataclasses.replace(seen, received_ns=late))
    drive = dataclasses.replace(drive, rig=Rig(gnss_bias=GnssBias(0.5, 20.0)))
    found = []
    for graph in (Grown, lambda roster: Window(roster, 1.0)):
        epochs = track_objects(drive, "test")
        own = own_motion(drive, SmoothConfig(), epochs)
        epochs = epochs.with_instants(own.t_ns)
        roster = Roster(epochs.ego, drive.infrastructure.nodes, epochs.slow, own)
        states, _, _ = run_online(epochs, roster, graph(roster), 1.0)
        found.append((states, [epoch.yaw_rad for epoch in epochs.epochs]))
    (whole, yaw), (lag, lag_yaw) = found
    assert np.isfinite(yaw).sum() > 100
    assert lag_yaw == pytest.approx(yaw, abs=1e-7, nan_ok=True)
    assert lag.state == pytest.approx(whole.state, abs=1e-6)
    assert lag.cov == pytest.approx(whole.cov, abs=1e-5, rel=1e-6)


def test_velocities_in_the_world_are_taken_where_nothing_tells_how_the_car_turns():
    drive = driving(5)
    t_ns = drive.tables["odometry"].t_ns
    v = np.pad(circle(t_ns)[1], ((0, 0), (0, 1)))
    told = EnuVelocities(t_ns, t_ns, v, np.full(len(t_ns), 0.1))
    other = without(drive, "odometry").with_tables(velocity=told)
    result = fgloc.smooth(other, mode="batch")
    assert result.verdicts["velocity"].is_(Verdict.USED).all()
    assert rmse(result)[0] < 0.6 * rmse(fgloc.smooth(without(other, "velocity"), mode="batch"))[0]


def test_wheels_in_reverse_roll_against_the_heading():
    drive = driving(6)
    told = drive.tables["odometry"]
    back = drive.with_tables(odometry=dataclasses.replace(told, speed_mps=-told.speed_mps))
    forth, reverse = (fgloc.smooth(d, mode="batch").trajectory for d in (drive, back))
    assert reverse.p_world_m == pytest.approx(forth.p_world_m, abs=1e-3)
    assert np.cos(reverse.yaw_rad - forth.yaw_rad) == pytest.approx(-1, abs=1e-3)


def test_a_car_that_never_drives_has_no_heading_and_says_so_of_its_rows():
    drive = driving(7)
    told, fixes = drive.tables["odometry"], drive.tables["gnss"]
    still = drive.with_tables(
        odometry=dataclasses.replace(told, speed_mps=0 * told.speed_mps),
        gnss=dataclasses.replace(fixes, p_world_ant_m=0 * fixes.p_world_ant_m),
    )
    result = fgloc.smooth(still, mode="batch")
    assert not result.verdicts["odometry"].is_(Verdict.USED).any()
    assert set(result.verdicts["odometry"].reason) == {"the car has no heading"}


def test_speeds_without_yaw_rates_are_taken_too():
    drive = driving(8)
    told = drive.tables["odometry"]
    wheel = WheelSpeeds(told.t_ns, told.t_ns, told.speed_mps, told.sigma_speed_mps)
    other = without(drive, "odometry").with_tables(wheel=wheel)
    result = fgloc.smooth(other, mode="batch")
    assert result.verdicts["wheel"].is_(Verdict.USED).all()
    assert rmse(result)[0] < rmse(fgloc.smooth(without(drive, "odometry"), mode="batch"))[0]


def test_a_motion_that_the_drive_does_not_tell_is_an_error():
    drive = without(driving(), "odometry")
    for kind in ("odometry", "imu"):
        config = SmoothConfig(motion={"kind": kind})
        with pytest.raises(DriveError, match=f"motion.kind = {kind}"):
            fgloc.smooth(drive, config=config)


def test_rolling_is_the_linearisation_of_wheels_that_do_not_slide():
    sigmas, speed, yaw, scale = np.array([0.1, 0.05]), 7.0, 0.8, 0.0

    def residual(x):
        v, h, k = x[:2], x[2], x[3]
        ahead = np.cos(h) * v[0] + np.sin(h) * v[1]
        left = -np.sin(h) * v[0] + np.cos(h) * v[1]
        return np.array([ahead - (1 + k) * speed, left]) / sigmas

    at = np.array([speed * np.cos(yaw), speed * np.sin(yaw), yaw, scale])
    rows = rolling(speed, yaw, sigmas)
    A = np.column_stack([rows.v, rows.h, rows.o[:, 1]])
    numeric = [(residual(at + d) - residual(at - d)) / 2e-6 for d in 1e-6 * np.eye(4)]
    assert pytest.approx(np.array(numeric).T, abs=1e-6) == A
    assert A @ at == pytest.approx(rows.b)
    assert rows.o[:, 0] == pytest.approx(0)


def test_the_other_car_is_as_good_as_before():
    drive = driving(9)
    found = [fgloc.smooth(d, mode="batch").objects for d in (drive, without(drive, "odometry"))]
    ends = [objects.state[-1] for objects in found]
    assert ends[0] == pytest.approx(ends[1], abs=1e-6)


def test_what_the_drive_states_and_the_graph_does_not_take_is_told():
    drive = driving()
    arm = dataclasses.replace(drive, rig=Rig(p_veh_ant_m=np.array([3.0, -4.0, 1.5])))
    assert fgloc.smooth(drive, mode="fixed-lag").events == ()
    (event,) = fgloc.smooth(arm, mode="fixed-lag").events
    assert "antenna" in event.text
    assert "5.00 m" in event.text
