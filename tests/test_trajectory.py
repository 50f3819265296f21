"""Trajectories: interpolation, other points of the vehicle, covariances."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fgloc import frames
from fgloc.errors import InputError
from fgloc.trajectory import Trajectory

T0_NS = 1_751_900_000_123_456_789
INT64 = np.iinfo(np.int64)
S = 1_000_000_000


def some_trajectory(n: int = 6, seed: int = 0) -> Trajectory:
    rng = np.random.default_rng(seed)
    half = rng.standard_normal((n, 6, 6)) * 0.1
    return Trajectory(
        T0_NS + np.cumsum(rng.integers(1, S, n)),
        rng.standard_normal((n, 3)) * 100,
        frames.exp_so3(rng.standard_normal((n, 3))),
        rng.standard_normal((n, 3)),
        half @ half.swapaxes(-1, -2),
    )


def line(**parts) -> Trajectory:
    """Two states a second apart, 10 m along East."""
    return Trajectory([T0_NS, T0_NS + S], [[0.0, 0, 0], [10.0, 0, 0]], **parts)


def test_stamps_that_are_no_integers_are_refused():
    with pytest.raises(InputError, match="trajectory t_ns is of type float64; give whole nanos"):
        Trajectory([1e18, 2e18], np.zeros((2, 3)))


def test_a_trajectory_may_have_no_states():
    assert len(Trajectory([], np.zeros((0, 3)))) == 0


# Interpolation


@pytest.mark.parametrize("seed", range(5))
def test_at_its_own_instants_a_trajectory_is_itself(seed):
    trajectory = some_trajectory(seed=seed)
    assert trajectory.at(trajectory.t_ns).same_as(trajectory)


@pytest.mark.parametrize("row", range(6))
def test_at_one_of_its_instants_a_trajectory_gives_that_state(row):
    trajectory = some_trajectory()
    there, state = trajectory.at(trajectory.t_ns[[row]]), trajectory.take([row])
    for name in ("t_ns", "p_world_m", "R_world_veh", "v_world_mps", "cov"):
        np.testing.assert_allclose(
            getattr(there, name), getattr(state, name), rtol=0, atol=1e-13, err_msg=name
        )


@given(arrays(float, (4, 3), elements=st.floats(-5, 5)), st.integers(0, 3 * S))
def test_motion_of_third_order_is_met_exactly_where_velocities_are_known(coefficients, into_ns):
    def motion(t_s):
        powers = np.power.outer(t_s, np.arange(4))
        slopes = np.arange(1, 4) * np.power.outer(t_s, np.arange(3))
        return powers @ coefficients, slopes @ coefficients[1:]

    knots_s = np.array([0, 1, 3])
    p, v = motion(knots_s)
    t_ns = np.array([T0_NS + into_ns])
    there = Trajectory(T0_NS + knots_s * S, p, v_world_mps=v).at(t_ns)
    p_there, v_there = motion(np.array([into_ns / S]))
    np.testing.assert_allclose(there.p_world_m, p_there, rtol=0, atol=1e-10)
    np.testing.assert_allclose(there.v_world_mps, v_there, rtol=0, atol=1e-10)


def test_without_velocities_the_way_is_straight():
    assert line().at([T0_NS + S // 4]).p_world_m.tolist() == [[2.5, 0, 0]]


def test_attitude_turns_at_a_constant_rate():
    turned = line(R_world_veh=frames.yaw_matrix([0.5, 1.3])).at([T0_NS + S // 4])
    assert turned.yaw_rad == pytest.approx([0.7])


def test_attitude_turns_the_short_way_through_south():
    turned = line(R_world_veh=frames.yaw_matrix([3.0, -3.0])).at([T0_NS + S // 2])
    assert abs(turned.yaw_rad[0]) == pytest.approx(np.pi)


def test_covariance_is_mixed_of_its_neighbours():
    cov = np.stack([np.eye(6), 3 * np.eye(6)])
    np.testing.assert_allclose(line(cov=cov).at([T0_NS + S // 4]).cov[0], 1.5 * np.eye(6))


@pytest.mark.parametrize("off_ns", [-1, S + 1])
def test_no_state_outside_the_span(off_ns):
    with pytest.raises(InputError, match="outside the trajectory's span"):
        line().at([T0_NS + off_ns])


def test_a_single_state_holds_at_its_own_instant_only():
    one = line().take([1])
    assert one.at(one.t_ns).p_world_m.tolist() == [[10, 0, 0]]
    with pytest.raises(InputError, match="outside the trajectory's span"):
        one.at(one.t_ns + 1)


def test_coverage_ends_with_the_span_and_at_gaps():
    trajectory = Trajectory(T0_NS + np.array([0, 1, 5]) * S, np.zeros((3, 3)))
    t_ns = T0_NS + np.array([-1, 0, S // 2, S, S + 1, 5 * S, 5 * S + 1])
    assert trajectory.covers(t_ns).tolist() == [0, 1, 1, 1, 1, 1, 0]
    assert trajectory.covers(t_ns, max_gap_s=2.0).tolist() == [0, 1, 1, 1, 0, 1, 0]


def test_no_states_cover_nothing():
    assert line().take(slice(0, 0)).covers([T0_NS]).tolist() == [False]


# Points of the vehicle


def test_another_point_is_the_lever_arm_away_in_the_direction_the_vehicle_faces():
    facing_north = line(R_world_veh=frames.yaw_matrix([np.pi / 2] * 2)).at_point([2.0, 1.0, 0.5])
    np.testing.assert_allclose(facing_north.p_world_m[0], [-1.0, 2.0, 0.5], atol=1e-15)
    assert facing_north.p_veh_point_m.tolist() == [2.0, 1.0, 0.5]


@given(arrays(float, 3, elements=st.floats(-5, 5)))
def test_to_another_point_and_back_is_the_same_trajectory(lever_m):
    here = some_trajectory()
    back = here.at_point(lever_m).at_point([0, 0, 0])
    np.testing.assert_allclose(back.p_world_m, here.p_world_m, atol=1e-12)
    np.testing.assert_allclose(back.cov, here.cov, atol=1e-12)
    np.testing.assert_array_equal(back.R_world_veh, here.R_world_veh)


def test_at_its_own_point_a_trajectory_is_itself_even_without_attitude():
    assert line(p_veh_point_m=[1, 2, 3]).at_point([1, 2, 3]).p_veh_point_m.tolist() == [1, 2, 3]
    with pytest.raises(InputError, match="positions only; an attitude is needed"):
        line().at_point([1, 0, 0])


def test_a_velocity_is_not_carried_to_another_point():
    assert some_trajectory().at_point([1, 0, 0]).v_world_mps is None


def test_covariance_at_another_point_is_what_many_draws_show():
    rng = np.random.default_rng(7)
    here = some_trajectory(n=1)
    cov = here.cov * 1e-4  # so small that the lever arm's turn is linear
    there = Trajectory(here.t_ns, here.p_world_m, here.R_world_veh, cov=cov).at_point([3, -2, 1])

    draws = rng.multivariate_normal(np.zeros(6), cov[0], 200_000, method="cholesky")
    arm_world = frames.exp_so3(draws[:, 3:]) @ here.R_world_veh[0] @ [3, -2, 1]
    p_there = here.p_world_m + draws[:, :3] + arm_world
    seen = np.cov(np.hstack([p_there, draws[:, 3:]]).T)
    sigma = np.sqrt(np.diagonal(seen))
    np.testing.assert_allclose(there.cov[0] / np.outer(sigma, sigma),
                               seen / np.outer(sigma, sigma), atol=0.01)  # fmt: skip


def test_sigmas_along_and_across_follow_the_heading():
    cov = np.zeros((2, 6, 6))
    cov[:, 0, 0], cov[:, 1, 1] = 4.0, 9.0
    along, across = line(
        R_world_veh=frames.yaw_matrix([0.0, np.pi / 2]), cov=cov
    ).sigma_along_across_m()
    np.testing.assert_allclose(along, [2, 3])
    np.testing.assert_allclose(across, [3, 2])


@given(st.floats(-3.1, 3.1))
def test_variances_along_and_across_add_up_to_those_of_east_and_north(yaw_rad):
    source = some_trajectory(n=2)
    turned = line(R_world_veh=frames.yaw_matrix([yaw_rad] * 2), cov=source.cov)
    along, across = turned.sigma_along_across_m()
    np.testing.assert_allclose(
        along**2 + across**2, source.cov[:, 0, 0] + source.cov[:, 1, 1], rtol=1e-12
    )


def test_sigmas_need_a_covariance():
    with pytest.raises(InputError, match="has no covariance"):
        line(R_world_veh=frames.yaw_matrix([0.0, 0.0])).sigma_along_across_m()


# What is refused


@pytest.mark.parametrize("t_ns", [(5, 5), (5, 4), (INT64.max, INT64.min)])
def test_time_must_increase(t_ns):
    with pytest.raises(InputError, match=f"trajectory row 1: t_ns {t_ns[1]} does not increase"):
        Trajectory(t_ns, np.zeros((2, 3)))


def test_time_may_increase_by_more_than_64_bits_hold():
    assert len(Trajectory((INT64.min, INT64.max), np.zeros((2, 3)))) == 2


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"R_world_veh": np.eye(3)}, r"R_world_veh has shape \(3, 3\), expected \(2, 3, 3\)"),
        ({"v_world_mps": np.zeros((3, 3))}, r"v_world_mps has shape \(3, 3\), expected \(2, 3\)"),
        ({"cov": np.zeros((2, 3, 3))}, r"cov has shape \(2, 3, 3\), expected \(2, 6, 6\)"),
        ({"p_veh_point_m": [1.0]}, r"p_veh_point_m has shape \(1,\), expected \(3,\)"),
        ({"v_world_mps": [[0, 0, 0], [0, np.nan, 0]]}, "v_world_mps is not finite at row 1"),
    ],
)
def test_parts_that_do_not_fit_are_refused(parts, message):
    with pytest.raises(InputError, match=message):
        line(**parts)


def test_instants_are_a_single_row():
    with pytest.raises(InputError, match=r"t_ns has shape \(2, 1\)"):
        Trajectory([[1], [2]], np.zeros((2, 3)))


def test_states_cannot_be_written_to_nor_follow_the_array_they_were_made_of():
    p_world_m = np.zeros((2, 3))
    trajectory = Trajectory([1, 2], p_world_m)
    p_world_m[0] = 99.0
    assert not trajectory.p_world_m.any()
    with pytest.raises(ValueError, match="read-only"):
        trajectory.p_world_m[0] = 1.0


def test_take_selects_states_of_all_parts():
    some = some_trajectory()
    taken = some.take(slice(1, 3))
    assert taken.t_ns.tolist() == some.t_ns[1:3].tolist()
    assert taken.R_world_veh.shape == taken.cov[:, :3, :3].shape == (2, 3, 3)
    assert line().take([0]).cov is None


def test_trajectories_are_the_same_where_every_bit_is():
    assert some_trajectory().same_as(some_trajectory())
    assert not some_trajectory().same_as(some_trajectory(seed=1))
    assert not line().same_as(line(v_world_mps=np.zeros((2, 3))))
