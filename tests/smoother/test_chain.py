"""The chain's optimum and covariances are GTSAM's, on real and simulated drives."""

from dataclasses import replace

import numpy as np
import pytest
from gtsam.symbol_shorthand import B, K, V, X

from fgloc.datasets import make, open_drive
from fgloc.datasets.degrade import degrade
from fgloc.errors import SolverError
from fgloc.factors import vehicle
from fgloc.infrastructure import Infrastructure, Node
from fgloc.measurements import NodeDetections
from fgloc.smoother.band import Vector
from fgloc.smoother.solve import covariances
from fgloc.smoother.states import States

from .optima import apart, relative, robustness, solvers

CASES = {
    "A": {},
    "B": {"outage": (75, 15, 45)},
    "C": {"outage": (75, 30, 90)},
    "D": {"noise_enu_m": (1, 1, 2), "seed": 0},
}


def seen_by_a_node(drive, **node):
    """The drive past a node that sees the centre of the car's box twice a second."""
    rng, at = np.random.default_rng(5), slice(0, None, 25)
    truth, box = drive.truth, np.array([1.4, 0.1, 0.0])
    place = Node("pole", truth.p_world_m[len(truth) // 2] + [8.0, 5.0, 6.0], 0.4, **node)
    t_ns, p = truth.t_ns[at], (truth.p_world_m + truth.R_world_veh @ box)[at, :2]
    n = len(t_ns)
    seen = NodeDetections(
        t_ns, t_ns, np.zeros(n), np.full(n, 7), np.ones(n),
        place.from_world(p + 0.3 * rng.normal(size=(n, 2))), np.tile(0.09 * np.eye(2), (n, 1, 1)),
    )  # fmt: skip
    rig = replace(drive.rig, p_veh_box_m=box)
    drive = replace(drive, rig=rig, infrastructure=Infrastructure((place,)))
    return drive.with_tables(detections=seen)


def assert_same_optimum(drive, gated=(), unheld=(), **settings):
    """Cost within 1e-6, positions within 0.1 mm, covariances within 0.1 %."""
    found = apart(drive, gated, unheld, **settings)
    assert found.cost < 1e-6
    assert found.p_m < 1e-4
    assert found.turn_rad < 1e-5
    assert found.v_mps < 1e-4
    assert found.cov < 1e-3
    assert found.predicted < 1e-3


def test_what_the_car_says_is_predicted_as_well_as_by_gtsam(city):
    """From GTSAM's joint covariance of pose, velocity, bias and calibration at a few keyframes."""
    settings = {"vehicle": {"non_holonomic": True, "wheel_speed": True}}
    model, start, chain, whole = solvers(city(1, 20.0), **settings)
    robust = robustness(chain)
    states, _, _ = chain.optimum(States.of(start, model), robust)
    joint = covariances(whole._graph(robust), whole._values(states, robust), model)
    by_calibration = np.zeros((3, 6))  # pitch, yaw, scale: how they are kept in a bias variable
    by_calibration[[0, 1, 2], [4, 5, 0]] = -vehicle.MOUNTING_S, -vehicle.MOUNTING_S, -1.0
    mine = chain.covariances(states, robust).held
    for source, keys in model.car.keys_of.items():
        term = chain.held_term(source, states, keys)
        for i, j in ((3, keys[3]), (12, keys[12])):
            cov = joint([X(j), V(j), B(int(model.bias_of[j])), K(0)])
            J = np.hstack([term.jacobian[i, :, :15], term.jacobian[i, :, 15:] @ by_calibration])
            assert relative(mine[source][[i]], (J @ cov @ J.T)[None])[0] < 1e-3


SHARED = {
    "a bias that keyframes share": ({}, {}),
    "a survey that is off": ({"sigma_position_m": 0.5, "sigma_yaw_rad": 0.02}, {}),
    "the vehicle's calibration": ({}, {"vehicle": {"non_holonomic": True, "wheel_speed": True}}),
    "slow errors of the node": ({"bias_sigma_m": 1.0, "bias_tau_s": 20.0}, {}),
    "a post that sways": (None, {}),
}


@pytest.mark.parametrize("what", SHARED)
@pytest.mark.parametrize("changed", [{"BLOCKS_AT_ONCE": 7}, {"LONG": 9, "BLOCKS_AT_ONCE": 7}])
def test_portions_and_sections_make_no_difference(city, monkeypatch, what, changed):
    node, settings = SHARED[what]
    drive = make("khamooshi2023/sway-drive", seed=5, duration_s=8.0, users=1)
    drive = drive if node is None else seen_by_a_node(city(1, 20.0), **node)
    model, start, one, _ = solvers(drive, **settings)
    states, robust = States.of(start, model), robustness(one)
    cost, whole = one.linearize(states, robust, "weights")
    for name, value in changed.items():
        monkeypatch.setattr(f"fgloc.smoother.chain.{name}", value)
    cost_of_many, many = one.linearize(states, robust, "weights")
    assert cost_of_many == pytest.approx(cost, rel=1e-12)
    for one_half, half in zip(whole.halves, many.halves, strict=True):
        np.testing.assert_allclose(half.panels, one_half.panels, rtol=1e-9, atol=1e-6)
    a, b = flat(whole.gradient), flat(many.gradient)
    np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * np.abs(a).max())
    np.testing.assert_allclose(many.corner, whole.corner, rtol=1e-9)
    x, y = (flat(band.factor().solve(band.gradient)) for band in (whole, many))
    np.testing.assert_allclose(x, y, atol=1e-6 * np.abs(x).max())


def flat(vector):
    return np.append(vector.blocks.ravel(), vector.border)


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


def test_where_some_wheel_speeds_are_gated(city):
    drive = city(1, 20.0)
    keys = np.flatnonzero(solvers(drive, vehicle={"wheel_speed": True})[0].car.wheel_row >= 0)
    out = {"wheel": frozenset(keys[[3, 4, 9]].tolist())}
    assert_same_optimum(drive, unheld=out, vehicle={"wheel_speed": True})


@pytest.mark.parametrize(
    ("node", "settings"),
    [
        ({}, {"loss": "none"}),
        ({"bias_sigma_m": 0.5}, {"loss": "huber"}),
        ({"bias_sigma_m": 0.5, "sigma_position_m": 0.2, "sigma_yaw_rad": 0.01}, {}),
        ({}, {"offset_sigma_m": 0.5}),
    ],
)
def test_with_what_a_node_sees(city, node, settings):
    drive = seen_by_a_node(city(0, 20.0), **node)
    settings = {"loss_width": 1.5, **settings}  # so that it acts on many
    # Slow errors and an offset leave the position of the whole drive loose: the cost is flat there.
    solver = {"cost_tolerance": 1e-9}
    assert_same_optimum(drive, gnss={"bias_sigma_m": 1.0}, detections=settings, solver=solver)


@pytest.mark.parametrize("every", [1, 3])
@pytest.mark.parametrize("node", [{}, {"bias_sigma_m": 0.3, "sigma_level_rad": 0.01}])
def test_with_heights_that_a_node_tells(city, node, every):
    drive = seen_by_a_node(city(0, 20.0), **node)
    seen, truth = drive.tables["detections"], drive.truth.take(slice(0, None, 25))
    told = np.arange(len(seen)) % every == 0
    up_m = truth.at_point(drive.rig.p_veh_box_m).p_world_m[:, 2]
    up_m = up_m + 0.2 * np.random.default_rng(6).normal(size=len(seen))
    up_m -= drive.infrastructure.nodes[0].p_world_m[2]
    sigma_m = np.full(len(seen), 0.2)
    up_m, sigma_m = (np.where(told, column, np.nan) for column in (up_m, sigma_m))
    high = replace(seen, up_node_m=up_m, sigma_up_m=sigma_m)
    settings = {"detections": {"loss_width": 2.0}, "solver": {"cost_tolerance": 1e-9}}
    assert_same_optimum(drive.with_tables(detections=high), gnss={"bias_sigma_m": 1.0}, **settings)


def test_the_last_steps_factor_gives_the_covariances_of_the_optimum(city):
    """The factor that is left over is that of before the last step."""
    _, start, chain, _ = solvers(city(0, 30.0))
    robust = robustness(chain)
    near, _, _ = chain.optimum(
        States.of(start, chain.model), replace(robust, plain=True), rough=True
    )
    best, _, _ = chain.optimum(near, robust)
    assert chain._last is not None
    left_over = chain.covariances(best, robust).poses
    anew = chain.covariances(replace(best), robust).poses
    assert 0 < relative(left_over, anew).max() < 1e-3


def test_the_cost_anywhere_is_that_of_the_graph(city):
    """Not only at the optimum: attitudes, speeds and biases off by what a bad guess is off by."""
    _, start, chain, whole = solvers(city(0, 10.0), gnss={"loss": "none"})
    rng, robust = np.random.default_rng(0), robustness(chain)
    step = Vector(0.1 * rng.normal(size=(chain.n, 15)), np.zeros(chain.border.size))
    states = chain.moved(States.of(start, chain.model), step)
    graph, values = whole._graph(robust), whole._values(states, robust)
    assert chain.linearize(states, robust, "newton")[0] == pytest.approx(graph.error(values))


def test_a_step_lowers_the_cost_by_what_it_promises(city):
    _, start, chain, _ = solvers(city(0, 10.0))
    robust = replace(robustness(chain), plain=True)
    states, cost, _ = chain.optimum(States.of(start, chain.model), robust)
    rng = np.random.default_rng(1)
    tangent = 1e-5 * rng.normal(size=(chain.n, 15)) * np.repeat([1, 1e-2], [9, 6])
    away = chain.moved(states, Vector(tangent, np.zeros(chain.border.size)))
    value, band = chain.linearize(away, robust, "newton")
    promise = band.factor().solve(band.gradient).dot(band.gradient) / 2
    assert value - cost == pytest.approx(promise, rel=1e-2)


def test_a_fix_out_of_all_bounds_is_an_error_that_names_its_keyframe():
    model, start, chain, _ = solvers(make("city", duration_s=10.0))
    model.positions.z_world_m[50] = 1e300
    with pytest.raises(SolverError, match=r"the solver failed at the \w+ of keyframe 50, t = 5.00"):
        chain.optimum(States.of(start, chain.model), robustness(chain))
