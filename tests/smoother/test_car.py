"""The vehicle's constraints in the graph: what they estimate, what they save, what they refuse."""

import dataclasses

import gtsam
import numpy as np
import pytest

from fgloc.config import load_config
from fgloc.constraints import NON_HOLONOMIC, STANDSTILL
from fgloc.factors import vehicle
from fgloc.smoother.graph import GraphModel, State
from fgloc.smoother.tree import as_graph
from fgloc.sync import plan

RIGID = {"wheel_speed": True, "non_holonomic": True, "zero_velocity": True,
         "pitch_rad_per_mps2": 0.0, "point_sigma_m": 0.05}  # fmt: skip
"""What is true of a simulated car: no springs, and an axle that is where the rig says."""
WHEELS = {"wheel_speed": True}


def with_wheel(drive, change):
    """The drive with the wheel speeds (N,) that `change` makes of them."""
    wheel = drive.tables["wheel"]
    speed = change(np.array(wheel.speed_mps))
    return drive.with_tables(wheel=dataclasses.replace(wheel, speed_mps=speed))


@pytest.mark.parametrize("mode", ["fixed-lag", "incremental", "batch"])
def test_wheels_and_a_car_that_keeps_its_lane_outlast_the_fixes(
    city, altered, run, against_truth, mode
):
    """Ten seconds without fixes: the error stays below that of the IMU alone."""
    drive = altered.without_fixes(city(0, 60.0), 40.0, 50.0)
    alone = against_truth(run(drive, mode, vehicle={}).trajectory, drive, 40.0)
    held = against_truth(run(drive, mode, vehicle=RIGID).trajectory, drive, 40.0)
    inside = alone.t_ns <= drive.start_ns + 50_000_000_000
    assert held.horizontal_m[inside].max() < 3.0
    assert held.horizontal_m[inside].max() < alone.horizontal_m[inside].max()


@pytest.mark.parametrize("mode", ["fixed-lag", "batch"])
def test_the_scale_of_the_wheels_is_estimated(city, run, mode):
    drive = with_wheel(city(0, 60.0), lambda speed: speed / 1.03)
    found = run(drive, mode, vehicle=RIGID).summary["vehicle"]
    assert found["wheel_scale"] == pytest.approx(1.03, abs=0.005)
    assert abs(found["mounting_yaw_deg"]) < 0.5


def test_sigmas_of_wheels_can_be_scaled(city, run):
    drive = city(0, 30.0)
    wheel = drive.tables["wheel"]
    small = drive.with_tables(wheel=dataclasses.replace(wheel, sigma_mps=wheel.sigma_mps / 4))
    scaled = run(small, vehicle={**WHEELS, "wheel_sigma_scale": 4.0}).verdicts["wheel"].nis
    np.testing.assert_allclose(scaled, run(drive, vehicle=WHEELS).verdicts["wheel"].nis, rtol=1e-6)


@pytest.mark.parametrize("mode", ["fixed-lag", "batch"])
def test_every_constraint_has_a_verdict(city, run, mode):
    result = run(city(0, 40.0), mode, vehicle=RIGID)
    counts = result.summary["counts"]
    assert sum(counts["wheel"].values()) == 2001
    assert counts["wheel"]["used"] >= 35
    assert counts[NON_HOLONOMIC]["used"] >= 35
    assert counts[STANDSTILL]["used"] >= 2


def test_slip_and_wheel_speeds_are_as_far_off_as_they_were_predicted(city, run):
    """Two degrees of freedom, causal, once the yaw is known; a simulated car does not slip at all,
    so it is rather less."""
    verdicts = run(city(0, 60.0), "fixed-lag", vehicle=RIGID).verdicts
    nis = verdicts[NON_HOLONOMIC].nis[verdicts[NON_HOLONOMIC].dof == 2]
    assert len(nis) >= 40
    assert 0.2 < np.mean(nis) < 2.6
    nis = verdicts["wheel"].nis[verdicts["wheel"].dof == 1]
    assert np.mean(nis) == pytest.approx(1, abs=3 * np.sqrt(2 / len(nis)))


def test_in_a_batch_wheels_are_as_far_off_as_all_others_predict(city, run):
    """The NIS of each against all others: mean of 61 with one degree of freedom, three sigmas."""
    verdicts = run(city(1, 60.0), "batch", vehicle=RIGID).verdicts
    told = verdicts["wheel"]
    assert np.mean(told.nis[told.dof == 1]) == pytest.approx(1, abs=3 * np.sqrt(2 / 61))
    assert np.isfinite(told.threshold[told.dof == 1]).all()
    for source, dof in ((NON_HOLONOMIC, 2), (STANDSTILL, 3)):
        assert (verdicts[source].dof == dof).all() and np.isfinite(verdicts[source].nis).all()
    assert np.isnan(verdicts[NON_HOLONOMIC].threshold).all()  # nobody's measurement has no gate


@pytest.mark.parametrize("mode", ["fixed-lag", "batch"])
def test_wheels_that_spin_are_gated(city, run, mode):
    """From the thirtieth second on the wheels tell 8 m/s more for two seconds."""

    def spin(speed):
        speed[1500:1600] += 8.0
        return speed

    told = run(with_wheel(city(0, 40.0), spin), mode, vehicle=WHEELS).verdicts["wheel"]
    rows = np.flatnonzero(told.verdict == "gated")
    assert set(rows) <= set(range(1500, 1600)) and len(rows) == 2
    assert (told.nis[rows] > told.threshold[rows]).all()


def test_wheel_speeds_that_come_late_enter_at_their_instant_or_not_at_all(city, run):
    drive = city(0, 40.0)
    wheel = drive.tables["wheel"]
    for delay_s, verdict, least in ((1.5, "used", 40), (9.0, "late", 10)):
        received = wheel.received_ns + round(delay_s * 1e9)
        late = drive.with_tables(wheel=dataclasses.replace(wheel, received_ns=received))
        told = run(late, "fixed-lag", vehicle=WHEELS).verdicts["wheel"].counts()
        assert told[verdict] >= least


def test_the_numpy_residuals_have_the_cost_of_the_native_factors(city):
    """Of an axle that slides by a tenth of a metre a second, to a millionth of the chi-square."""
    drive, config = city(0, 20.0), load_config(vehicle=RIGID)
    model = GraphModel(drive, plan(drive, config), config)
    car, j = model.car, int(np.flatnonzero(model.car.wheel_row >= 0)[12])
    pose, bias = gtsam.Pose3(gtsam.Rot3.Expmap([0.1, 0.2, 2.0]), [5, 6, 7]), np.full(6, 0.01)
    car.found = np.array([0.01, -0.02, 1.01])
    v = pose.rotation().matrix() @ [1.01 * car.wheels.speed_mps[car.wheel_row[j]], 0.1, 0.05]
    native = gtsam.Values()
    model.insert_shared(native)
    state = State(pose, v, gtsam.imuBias.ConstantBias(bias[:3], bias[3:]))
    model.insert(native, j, state, new_bias=True)
    car.insert(native, j, pose, v, state.bias)
    cost = as_graph([*car.axis_factors(j), *car.wheel_factors(j)]).error(native)

    R, rate = pose.rotation().matrix()[None], car.rate_radps[[j]]
    u = vehicle.body_velocity(R, v[None], rate, bias[None], car.arm)
    slip = vehicle.non_holonomic(u, [0.01, -0.02]).error[0] / car.slip_sigmas_mps[j]
    speed = car.wheels.speed_mps[car.wheel_row[[j]]]
    miss = vehicle.wheel(u, [0.01, -0.02], 1.01, speed).error[0] / 0.05
    norms = np.linalg.norm(slip), np.linalg.norm(miss)
    ours = [n**2 / 2 if n < w else w * (n - w / 2) for n, w in zip(norms, (3.0, 2.6), strict=True)]
    assert cost == pytest.approx(sum(ours), rel=1e-6)
