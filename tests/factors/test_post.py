"""Posts: the bending mode against statics and tables, the motion against closed forms."""

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fgloc.errors import InputError
from fgloc.factors import post as model
from fgloc.factors.bending import HollowPost, mass_damping_per_s, post_of
from fgloc.infrastructure import Post

ALUMINIUM = HollowPost(10.0, 0.2, 0.005)
POST = Post("pole", 10.0, 1.97, 0.05, 20.0, 0.1377, 200.0, 0.5)


def test_ten_metres_of_aluminium_swing_at_two_hertz():
    assert pytest.approx(82.7, abs=0.05) == ALUMINIUM.mass_kg
    assert ALUMINIUM.angular_frequency_radps / (2 * np.pi) == pytest.approx(1.97, abs=0.005)
    # With the total mass under the root, as Eq. (3.21) is printed, it would be 0.62 Hz.
    printed = 3.516 / 100 * np.sqrt(70e9 * ALUMINIUM.second_moment_m4 / ALUMINIUM.mass_kg)
    assert printed / (2 * np.pi) == pytest.approx(0.62, abs=0.005)


def test_the_modal_mass_moves_as_statics_says():
    assert ALUMINIUM.modal_mass_kg / ALUMINIUM.mass_kg == pytest.approx(0.2427, abs=1e-4)
    moved_m = 1500 / (ALUMINIUM.modal_mass_kg * ALUMINIUM.angular_frequency_radps**2)
    assert moved_m == pytest.approx(0.49, abs=0.005)
    # Over the total mass, as Eq. (3.24) is printed, it would be a quarter of that.
    assert 1500 / (ALUMINIUM.mass_kg * ALUMINIUM.angular_frequency_radps**2) < 0.13


def test_the_tip_of_a_bent_post_tilts_more_than_a_straight_one():
    # phi'(h) h / phi(h) of a clamped beam, 1.3765 in tables of beam modes.
    assert ALUMINIUM.tip_slope_per_m * 10 == pytest.approx(1.3765, abs=1e-4)
    assert post_of("n", ALUMINIUM, 0.05, 1, 1, straight=True).tip_slope_per_m == 0.1


def test_a_heavy_top_makes_a_massless_spring():
    heavy = HollowPost(10.0, 0.2, 0.005, top_mass_kg=1e5)
    w = np.sqrt(heavy.tip_stiffness_npm / 1e5)
    assert heavy.angular_frequency_radps == pytest.approx(w, rel=1e-3)
    assert heavy.tip_slope_per_m * 10 == pytest.approx(1.5, abs=1e-3)  # a tip load bends it so


def test_a_tenth_of_the_mass_on_top_slows_it_by_rayleighs_share():
    # Rayleigh's quotient with the unloaded shape, of which a quarter of the mass moves.
    loaded = HollowPost(10.0, 0.2, 0.005, top_mass_kg=0.1 * ALUMINIUM.mass_kg)
    share = loaded.angular_frequency_radps / ALUMINIUM.angular_frequency_radps
    assert share == pytest.approx(np.sqrt(0.25 / 0.35), rel=2e-3)


@pytest.mark.parametrize(
    ("numbers", "says"), [((0, 0.2, 0.005), "height_m = 0"), ((10, 0.2, 0.11), "wall_m = 0.11")]
)
def test_an_impossible_post_is_refused(numbers, says):
    with pytest.raises(InputError, match=says):
        HollowPost(*numbers)


def test_five_per_cent_meet_the_papers_bounds_and_two_do_not():
    w = ALUMINIUM.angular_frequency_radps
    assert 1 < mass_damping_per_s(w, 0.05) < 2 * w
    assert mass_damping_per_s(w, 0.02) < 1


@given(st.floats(0.3, 8), st.floats(0.001, 0.9), st.floats(0.001, 2))
def test_a_free_post_rings_down_in_its_closed_form(frequency_hz, damping, dt_s):
    w = 2 * np.pi * frequency_hz
    wd, decay = w * np.sqrt(1 - damping**2), np.exp(-damping * w * dt_s)
    c, s = decay * np.cos(wd * dt_s), decay * np.sin(wd * dt_s)
    expected = [[c + damping * w / wd * s, s / wd], [-(w**2) / wd * s, c - damping * w / wd * s]]
    found = model.white_load_step(frequency_hz, damping, 1.0, dt_s).transition
    np.testing.assert_allclose(found, expected, atol=1e-9 * w)


def test_white_wind_gives_the_spread_of_the_textbook():
    # Displacement of an oscillator under white acceleration of density S: S / (4 xi w^3).
    long = model.white_load_step(1.97, 0.05, 3.0, 60.0).noise
    w = 2 * np.pi * 1.97
    np.testing.assert_allclose(np.diag(long), [3 / (0.2 * w**3), 3 / (0.2 * w)], rtol=1e-6)


@pytest.mark.parametrize("dt_s", [1e-9, 1e-4, 0.1, 0.4, 0.5, 3600.0])
def test_the_noise_is_positive_over_any_step(dt_s):
    noise = model.axis_step(POST, dt_s).noise
    np.linalg.cholesky(noise / np.sqrt(np.outer(np.diag(noise), np.diag(noise))))
    # Over a short step the load alone is driven: 2 s^2 dt / tau.
    if dt_s < 1e-3:
        assert noise[2, 2] == pytest.approx(2 * 10**2 * dt_s / 0.5, rel=1e-3)


@given(st.floats(0.001, 1), st.floats(0.001, 1))
def test_two_steps_are_one(first_s, second_s):
    a, b = model.axis_step(POST, first_s), model.axis_step(POST, second_s)
    both = model.axis_step(POST, first_s + second_s)
    np.testing.assert_allclose(b.transition @ a.transition, both.transition, atol=1e-9)
    noise = b.transition @ a.noise @ b.transition.T + b.noise
    np.testing.assert_allclose(noise, both.noise, rtol=1e-6, atol=1e-9)


def test_the_spread_of_long_wind_stays_and_has_the_loads_own():
    spread, step = model.axis_spread(POST), model.axis_step(POST, 0.1)
    np.testing.assert_allclose(step.transition @ spread @ step.transition.T + step.noise, spread,
                               rtol=1e-8, atol=1e-9)  # fmt: skip
    assert np.sqrt(spread[2, 2]) == pytest.approx(200 / 20)


def test_the_tip_leans_to_where_it_moves():
    np.testing.assert_allclose(model.tilt_rad(np.array([[0.1, 0.2]]), 0.1), [[-0.02, 0.01]])


def test_the_pose_jacobian_is_that_of_the_residual():
    state, told = np.array([[0.1, 1, 2, -0.2, 3, 4]]), np.zeros((1, 2))
    J = model.pose_jacobian(0.14)
    for k in range(6):
        step = 1e-6 * np.eye(6)[[k]]
        change = model.pose_residual(state + step, told, told, 0.14)
        change = change - model.pose_residual(state - step, told, told, 0.14)
        np.testing.assert_allclose(change[0] / 2e-6, J[:, k], atol=1e-8)


def test_native_factors_charge_what_the_model_says():
    state, later = np.random.default_rng(0).standard_normal((2, 6))
    values = gtsam.Values()
    values.insert(1, state)
    values.insert(2, later)
    step = model.post_step(POST, 0.1)
    off = later - step.transition @ state
    expected = off @ np.linalg.solve(step.noise, off) / 2
    assert model.sway_factor(1, 2, POST, 0.1).error(values) == pytest.approx(expected, rel=1e-6)
    told, sigmas = np.array([0.1, np.nan, 0.02, -0.01]), np.array([0.01, np.nan, 1e-3, 2e-3])
    error = model.pose_residual(state[None], told[None, :2], told[None, 2:], 0.14)[0] / sigmas
    found = model.pose_factor(1, told, sigmas, 0.14).error(values)
    assert found == pytest.approx(np.nansum(error**2) / 2)
    spread = np.kron(np.eye(2), model.axis_spread(POST))
    rest = state @ np.linalg.solve(spread, state) / 2
    assert model.rest_factor(1, POST).error(values) == pytest.approx(rest)
