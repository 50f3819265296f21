"""The chain's optimum and covariances are GTSAM's, on real and simulated drives."""

from dataclasses import replace

import numpy as np
import pytest

from fgloc.config import load_config
from fgloc.datasets import make, open_drive
from fgloc.datasets.degrade import degrade
from fgloc.errors import SolverError
from fgloc.frames import log_so3
from fgloc.smoother.band import Vector
from fgloc.smoother.chain import Chain
from fgloc.smoother.graph import GraphModel
from fgloc.smoother.guess import guess, gyro_yaw
from fgloc.smoother.states import Robustness, States
from fgloc.smoother.whole import Whole
from fgloc.sync import plan

CASES = {
    "A": {},
    "B": {"outage": (75, 15, 45)},
    "C": {"outage": (75, 30, 90)},
    "D": {"noise_enu_m": (1, 1, 2), "seed": 0},
}


def solvers(drive, **settings):
    """The model of a drive, its guess, and its graph as a chain and for GTSAM."""
    config = load_config(**settings)
    model = GraphModel(drive, plan(drive, config), config)
    start = guess(model, 0, len(model) - 1, gyro_yaw(model))
    return model, start, Chain(model, start, model.deltas()[0]), Whole(model, start)


def robustness(chain, gated=False):
    """The configured loss, with some fixes gated."""
    gnss = chain.model.config.gnss
    width = np.inf if gnss.loss == "none" or chain.model.has_gnss_bias else gnss.loss_width
    return Robustness(gated | np.zeros(len(chain.fixed), bool), width)


def assert_same_optimum(drive, gated=(), **settings):
    """Cost within 1e-6, positions within 0.1 mm, covariances within 0.1 %."""
    settings = {"solver": {"cost_tolerance": 1e-7}, **settings}
    _, start, chain, whole = solvers(drive, **settings)
    robust = robustness(chain, np.isin(np.arange(len(chain.fixed)), gated))
    near, _, _ = chain.optimum(States.of(start), replace(robust, plain=True), rough=True)
    ours, cost, _ = chain.optimum(near, robust)
    # GTSAM's steps are damped and its robust tail is long: it starts where we ended.
    theirs, its_cost, _ = whole.optimum(ours, robust)
    assert cost == pytest.approx(its_cost, rel=1e-6)
    assert np.abs(ours.p - theirs.p).max() < 1e-4
    assert np.abs(log_so3(ours.R.swapaxes(-1, -2) @ theirs.R)).max() < 1e-5
    assert np.abs(ours.v - theirs.v).max() < 1e-4
    for mine, its in zip(
        chain.covariances(theirs, robust), whole.covariances(theirs, robust), strict=True
    ):
        apart = np.linalg.norm(mine - its, axis=(1, 2)) / np.linalg.norm(its, axis=(1, 2))
        assert apart.max() < 1e-3


@pytest.mark.parametrize("case", CASES)
def test_on_the_real_drive(case):
    drive = open_drive("mems-rtk")
    assert_same_optimum(degrade(drive, **CASES[case]) if CASES[case] else drive)


@pytest.mark.parametrize("seed", [0, 1])
def test_on_simulated_drives_whose_keyframes_share_biases(city, seed):
    assert_same_optimum(city(seed, 30.0))


def test_where_some_fixes_are_gated(city):
    assert_same_optimum(city(0, 20.0), gated=[3, 4, 5, 80])


@pytest.mark.parametrize("loss", ["none", "cauchy"])
def test_under_every_loss(city, loss):
    assert_same_optimum(city(1, 20.0), gnss={"loss": loss})


def test_with_a_gap_of_the_imu(city, altered):
    assert_same_optimum(altered.without_imu(city(1, 30.0), 12.0, 14.0))


def test_with_a_bias_of_gnss(city):
    assert_same_optimum(degrade(city(0, 30.0), keep_every=5), gnss={"bias_sigma_m": 2.0})


@pytest.mark.parametrize("asked", ["non_holonomic", "zero_velocity", "wheel_speed"])
def test_with_each_constraint_of_the_vehicle(city, altered, asked):
    drive = altered.reversing(10.0, 20.0) if asked == "zero_velocity" else city(1, 30.0)
    assert_same_optimum(drive, vehicle={"wheel_speed": False, asked: True})


def test_the_cost_anywhere_is_that_of_the_graph(city):
    """Not only at the optimum: attitudes, speeds and biases off by what a bad guess is off by."""
    _, start, chain, whole = solvers(city(0, 10.0), gnss={"loss": "none"})
    rng, robust = np.random.default_rng(0), robustness(chain)
    step = Vector(0.1 * rng.normal(size=(chain.n, 15)), np.zeros(chain.shared))
    states = chain.moved(States.of(start), step)
    graph, values = whole._graph(robust), whole._values(states)
    assert chain.linearize(states, robust, "newton")[0] == pytest.approx(graph.error(values))


def test_a_step_lowers_the_cost_by_what_it_promises(city):
    _, start, chain, _ = solvers(city(0, 10.0))
    robust = replace(robustness(chain), plain=True)
    states, cost, _ = chain.optimum(States.of(start), robust)
    rng = np.random.default_rng(1)
    tangent = 1e-5 * rng.normal(size=(chain.n, 15)) * np.repeat([1, 1e-2], [9, 6])
    away = chain.moved(states, Vector(tangent, np.zeros(chain.shared)))
    value, band = chain.linearize(away, robust, "newton")
    promise = band.factor().solve(band.gradient).dot(band.gradient) / 2
    assert value - cost == pytest.approx(promise, rel=1e-2)


def test_a_fix_out_of_all_bounds_is_an_error_that_names_its_keyframe():
    model, start, chain, _ = solvers(make("city", duration_s=10.0))
    model.fixes.p_world_ant_m.flags.writeable = True
    model.fixes.p_world_ant_m[model.fix_of[50]] = 1e300
    with pytest.raises(SolverError, match=r"the solver failed at the \w+ of keyframe 50, t = 5.00"):
        chain.optimum(States.of(start), robustness(chain))
