"""ICP and CPD: fits by hand, the worked case of the thesis, what the printed forms get wrong."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fgloc.correspondence import Rigid, Status, cpd, fit, icp, match, with_dummies
from fgloc.correspondence.dummies import DUMMY_SIGMA_M
from fgloc.correspondence.icp import J_MAX
from fgloc.correspondence.rigid import rotation
from fgloc.errors import InputError

# Table 4.1: the car's objects 0 to 4 are the node's 3, 6, 1, 4 and 2; 5 and 7 are hidden from it.
TABLE_4_1 = [(0, 3), (1, 6), (2, 1), (3, 4), (4, 2)]
WORLD = np.array(
    [[12.0, 18.0], [-9.0, 4.0], [3.0, -2.0], [25.0, -11.0], [-20.0, -16.0], [6.0, 9.0],
     [-3.0, 27.0]]
)  # fmt: skip
YAW_RAD = np.deg2rad(-47.257)
POSE = Rigid(YAW_RAD, WORLD[2])


@pytest.fixture
def case():
    """Points of the node, points of the car, true pairs counted from 0."""
    pairs = np.array(TABLE_4_1) - [0, 1]
    return WORLD, (WORLD[pairs[:, 1]] - POSE.t_m) @ rotation(YAW_RAD), pairs


def same_pairs(found, pairs):
    return sorted(map(tuple, found.pairs)) == sorted(map(tuple, pairs))


def test_a_quarter_turn_is_fitted_by_hand():
    found = fit(np.array([[1.0, 0], [0, 1], [-1, 0]]), np.array([[5.0, 6], [4, 5], [5, 4]]))
    assert found.yaw_rad == pytest.approx(np.pi / 2)
    assert found.t_m == pytest.approx([5, 5])


@given(
    yaw=st.floats(-3.1, 3.1),
    x=st.floats(-50, 50),
    y=st.floats(-50, 50),
    weight=st.lists(st.floats(0.1, 10), min_size=4, max_size=4),
)
def test_the_fit_undoes_any_motion(yaw, x, y, weight):
    points = np.array([[0.0, 0], [10, 2], [-4, 7], [3, -8]])
    found = fit(points, Rigid(yaw, np.array([x, y])).apply(points), np.array(weight))
    assert found.yaw_rad == pytest.approx(yaw, abs=1e-9)
    assert found.t_m == pytest.approx([x, y], abs=1e-7)


def test_the_fit_is_that_of_the_singular_value_decomposition():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 6, 2))
    U, _, Vt = np.linalg.svd((b - b.mean(0)).T @ (a - a.mean(0)))
    R = U @ np.diag([1, np.linalg.det(U @ Vt)]) @ Vt
    assert rotation(fit(a, b).yaw_rad) == pytest.approx(R)


def test_motions_are_put_together_in_order():
    first, then = Rigid(0.4, np.array([1.0, 2])), Rigid(-1.1, np.array([-3.0, 0.5]))
    p = np.array([[2.0, -1.0]])
    assert then.after(first).apply(p) == pytest.approx(then.apply(first.apply(p)))


def test_table_4_1_is_found_without_a_first_guess(case):
    world, veh, pairs = case
    found = match(world, veh)
    assert found.status == Status.MATCHED
    assert same_pairs(found, pairs)
    assert np.rad2deg(found.pose.yaw_rad) == pytest.approx(-47.257, abs=1e-6)
    assert found.pose.t_m == pytest.approx(WORLD[2])


@pytest.mark.parametrize("method", [icp, cpd])
def test_table_4_1_is_found_from_near_by(case, method):
    world, veh, pairs = case
    found = method(world, veh, Rigid(YAW_RAD + 0.05, WORLD[2] + 0.5))
    assert same_pairs(found, pairs)
    assert found.pose.yaw_rad == pytest.approx(YAW_RAD, abs=1e-3)


def test_icp_is_stuck_in_a_local_minimum_from_the_identity(case):
    world, veh, _ = case
    assert abs(icp(world, veh).pose.yaw_rad - YAW_RAD) > np.deg2rad(5)


def test_printed_icp_finds_the_nearest_partner_of_every_object(case):
    world, veh, pairs = case
    found = icp(world, veh, POSE, printed=True)
    assert len(found.pairs) == len(world) > len(pairs)


def test_printed_icp_stops_at_once_where_nothing_is_hidden_and_nothing_noisy(case):
    world, veh, pairs = case
    seen = world[pairs[:, 1]]
    assert icp(seen, veh, POSE, printed=True).iterations == 1
    noise = 0.3 * np.random.default_rng(0).standard_normal(seen.shape)
    assert icp(seen + noise, veh, POSE, printed=True).iterations == J_MAX
    assert icp(seen + noise, veh, POSE).iterations < 20


def test_printed_cpd_keeps_its_spread_and_so_leaves_a_good_start(case):
    world, veh, _ = case
    start = Rigid(YAW_RAD + 0.05, WORLD[2] + 0.5)
    off = [abs(cpd(world, veh, start, printed=p).pose.yaw_rad - YAW_RAD) for p in (False, True)]
    assert off[1] > 10 * off[0]


@pytest.mark.parametrize("method", [icp, cpd, match])
def test_of_nothing_there_is_no_correspondence(method):
    assert method(np.empty((0, 2)), np.zeros((1, 2))).status == Status.NONE


@pytest.mark.parametrize("method", [icp, cpd, match])
def test_points_that_are_no_points_are_refused(method):
    with pytest.raises(InputError, match="p_veh_m: expected finite points"):
        method(np.zeros((3, 2)), np.full((3, 2), np.nan))


def test_hidden_objects_get_dummies_that_weigh_nothing(case):
    world, veh, pairs = case
    seen, cov = with_dummies(match(world, veh), world, veh, np.tile(0.09 * np.eye(2), (5, 1, 1)))
    assert seen[pairs[:, 1]] == pytest.approx(veh)
    hidden = [4, 6]
    assert POSE.apply(seen[hidden]) == pytest.approx(world[hidden])
    assert cov[hidden, 0, 0] == pytest.approx(DUMMY_SIGMA_M**2)
    assert cov[pairs[:, 1], 0, 0] == pytest.approx(0.09)
