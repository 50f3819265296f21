"""Stamps that are late: configured, estimated, told of, and refused where it cannot be."""

from dataclasses import replace

import numpy as np
import pytest

from fgloc.config import load_config
from fgloc.datasets import open_drive
from fgloc.errors import ConfigError
from fgloc.smoother.batch import run_batch
from fgloc.smoother.lines import slopes
from fgloc.smoother.model import Model
from fgloc.sync import plan

from .without_imu import drive_of

WHEELS = {"wheel_speed": True}


def late(drive, table, by_s):
    """The drive with one table stamped late."""
    rows = drive.tables[table]
    by_ns = round(by_s * 1e9)
    columns = {"t_ns": rows.t_ns + by_ns, "received_ns": rows.received_ns + by_ns}
    return drive.with_tables(**{table: replace(rows, **columns)})


def allowed_m(drive, run, rmse_m, told):
    """What the drive gives on time, and the way that it goes in three sigmas of the lateness."""
    speed_mps = np.sqrt((drive.truth.v_world_mps**2).sum(-1).mean())
    return rmse_m(run(drive).trajectory, drive, 5.0) + 3 * told["sigma_s"] * speed_mps


@pytest.mark.parametrize("by_s", [0.13, -0.4])
def test_late_fixes_are_found_and_cost_no_accuracy(city, run, rmse_m, by_s):
    drive = city(3, 60.0)
    result = run(late(drive, "gnss", by_s), clock={"estimate": "gnss"})
    told = result.summary["clock"]["gnss"]
    assert told["observable"]
    assert abs(told["late_s"] - by_s) < 3 * told["sigma_s"] < 0.1
    assert rmse_m(result.trajectory, drive, 5.0) < allowed_m(drive, run, rmse_m, told)


def test_the_sigma_of_the_lateness_holds_over_drives(city, run):
    """NEES of ten drives: chi-square with 10 degrees, 0.1 % to either side."""
    found = [
        run(city(seed, 40.0), clock={"estimate": "gnss"}).summary["clock"]["gnss"]
        for seed in range(10)
    ]
    assert 1.48 < sum((one["late_s"] / one["sigma_s"]) ** 2 for one in found) < 29.6


def test_a_late_imu_is_the_same_seen_from_the_fixes_clock(city, run, rmse_m):
    drive = city(3, 60.0)
    result = run(late(drive, "imu", 0.13), clock={"estimate": "imu"})
    told = result.summary["clock"]["imu"]
    assert abs(told["late_s"] - 0.13) < 3 * told["sigma_s"]
    assert rmse_m(result.trajectory, drive, 5.0) < allowed_m(drive, run, rmse_m, told)


def test_a_configured_lateness_makes_up_for_it(city, run, apart):
    drive = city(3, 30.0)
    shifted = run(late(drive, "gnss", 0.2), clock={"gnss_s": 0.2})
    assert apart(shifted.trajectory, run(drive).trajectory).m.max() == 0


def test_a_causal_run_takes_a_configured_lateness_too(city, run, rmse_m):
    drive = late(city(3, 30.0), "gnss", 0.2)
    told, untold = (
        rmse_m(run(drive, "fixed-lag", clock={"gnss_s": s}).trajectory, drive, 10.0)
        for s in (0.2, 0.0)
    )
    assert told < 0.5 * untold


def test_a_car_that_stands_shows_no_lateness_and_is_told_so(altered, run):
    told = run(altered.standing(20.0), clock={"estimate": "gnss"}).summary["clock"]["gnss"]
    assert not told["observable"]
    assert told["sigma_s"] == pytest.approx(0.3, rel=0.1)
    assert "hardly shows it" in told["text"]


def test_the_imu_of_the_real_drive_is_late_and_the_withheld_fixes_agree(run, rmse_m):
    """They were not used: a lateness that was not real would not bring the path closer to them."""
    drive = open_drive("mems-rtk")
    estimated = run(drive, clock={"estimate": "imu"})
    assert estimated.summary["clock"]["imu"]["late_s"] == pytest.approx(0.089, abs=0.01)
    near = estimated.trajectory.at_point(drive.rig.p_veh_ant_m)
    plain = run(drive).trajectory.at_point(drive.rig.p_veh_ant_m)
    errors = [
        np.linalg.norm((t.at(drive.truth.t_ns).p_world_m - drive.truth.p_world_m)[:, :2], axis=1)
        for t in (near, plain)
    ]
    assert np.sqrt((errors[0][300:] ** 2).mean()) < 0.8 * np.sqrt((errors[1][300:] ** 2).mean())


def test_the_nis_of_fixes_counts_what_is_not_known_of_the_clock(city, run):
    """As with a known clock: a fix is held against a path whose lateness the others tell."""
    drive = city(3, 60.0)
    estimated, known = (
        run(drive, clock={"estimate": how}).verdicts["gnss"].nis for how in ("gnss", "none")
    )
    assert estimated.min() > 0
    assert np.median(estimated) == pytest.approx(np.median(known), rel=0.1)


@pytest.mark.parametrize("by_s", [0.15, -0.3])
def test_late_wheels_are_found_beside_the_fixes(city, run, by_s):
    told = run(
        late(city(3, 60.0), "wheel", by_s), vehicle=WHEELS, clock={"estimate": "wheel"}
    ).summary["clock"]["wheel"]
    assert told["observable"]
    assert abs(told["late_s"] - by_s) < 3 * told["sigma_s"] < 0.06


def test_several_clocks_are_estimated_at_once(city, run, rmse_m):
    drive = late(late(city(3, 60.0), "wheel", 0.15), "gnss", -0.2)
    result = run(drive, vehicle=WHEELS, clock={"estimate": "gnss, wheel"})
    for source, by_s in (("gnss", -0.2), ("wheel", 0.15)):
        told = result.summary["clock"][source]
        assert abs(told["late_s"] - by_s) < 3 * told["sigma_s"] < 0.1
    said = [event.text for event in result.events if event.kind == "clock"]
    assert len(said) == 2 and said[0].startswith("gnss stamps are -0.")


def test_where_all_but_the_imu_are_late_it_is_the_imu(city, run):
    """Wheels that are later still have a lateness of their own beside it."""
    drive = late(late(city(3, 60.0), "imu", -0.1), "wheel", 0.2)
    found = run(drive, vehicle=WHEELS, clock={"estimate": ["imu", "wheel"]}).summary["clock"]
    assert abs(found["imu"]["late_s"] + 0.1) < 3 * found["imu"]["sigma_s"]
    assert abs(found["wheel"]["late_s"] - 0.2) < 3 * found["wheel"]["sigma_s"]


def test_the_sigma_of_the_wheels_lateness_holds_over_drives(city, run):
    """NEES of six drives: chi-square with 6 degrees, 0.1 % to either side."""
    settings = {"vehicle": WHEELS, "clock": {"estimate": "wheel"}}
    found = [run(city(seed, 40.0), **settings).summary["clock"]["wheel"] for seed in range(6)]
    assert 0.38 < sum((one["late_s"] / one["sigma_s"]) ** 2 for one in found) < 22.46


def test_the_wheels_lateness_is_where_gtsams_cost_is_least(city):
    """GTSAM is given wheel speeds as they were so much later, and the prior's part is added."""
    drive, tight = late(city(3, 30.0), "wheel", 0.05), {"cost_tolerance": 1e-9}
    config = load_config(vehicle=WHEELS, clock={"estimate": "wheel"}, solver=tight)
    model = Model(drive, plan(drive, config), config)
    ours = run_batch(model)
    late_s, sigma_s = float(ours.states.late_s[0]), float(ours.sigmas.late_s[0])
    slope = slopes(drive.tables["wheel"].t_ns, drive.tables["wheel"].speed_mps[:, None])[:, 0]
    costs = []
    for at_s in (late_s - sigma_s, late_s, late_s + sigma_s):
        speed = drive.tables["wheel"].speed_mps + at_s * slope
        changed = drive.with_tables(wheel=replace(drive.tables["wheel"], speed_mps=speed))
        plain = load_config(vehicle=WHEELS, solver={"batch": "gtsam", **tight})
        theirs = run_batch(Model(changed, plan(changed, plain), plain))
        costs.append(theirs.cost + 0.5 * (at_s / config.clock.sigma_s) ** 2)
    assert costs[1] == pytest.approx(ours.cost, abs=1e-3)
    assert np.array(costs[::2]) - costs[1] == pytest.approx([0.5, 0.5], abs=0.03)


def test_late_velocities_are_found_against_the_fixes(run):
    told = run(
        late(drive_of("velocity", duration_s=40.0), "velocity", 0.2), clock={"estimate": "velocity"}
    ).summary["clock"]["velocity"]
    assert abs(told["late_s"] - 0.2) < 3 * told["sigma_s"] < 0.1


@pytest.mark.parametrize("settings", [{"mode": "fixed-lag"}, {"solver": {"batch": "gtsam"}}])
def test_estimating_takes_the_whole_drive_and_the_chain(city, run, settings):
    with pytest.raises(ConfigError, match=r"clock.estimate goes with (mode batch|solver.batch)"):
        run(city(0, 10.0), clock={"estimate": "gnss"}, **settings)


@pytest.mark.parametrize(
    ("estimate", "kinds", "motion", "message"),
    [
        ("wheel", (), {}, "nothing of it is in use .in use: gnss."),
        ("gnss", (), {}, "one of these clocks must be that of the trajectory"),
        ("imu", ("wheel",), {}, "carried by constant-velocity, not by an IMU"),
        ("wheel", ("odometry",), {}, "carried by odometry, whose clock is then"),
    ],
)
def test_a_clock_that_nothing_can_be_held_against_is_refused(run, estimate, kinds, motion, message):
    drive = drive_of(*kinds, duration_s=10.0)
    with pytest.raises(ConfigError, match=message):
        run(drive, clock={"estimate": estimate}, motion=motion)


def test_a_list_of_clocks_is_given_as_words_with_commas():
    asked = load_config(settings=["clock.estimate=gnss,wheel"]).clock.estimate
    assert (
        asked == ("gnss", "wheel") and load_config(clock={"estimate": "none"}).clock.estimate == ()
    )
    with pytest.raises(ConfigError, match=r"clock.estimate.1 = 'whel'"):
        load_config(settings=["clock.estimate=gnss,whel"])
