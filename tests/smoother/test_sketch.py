"""A sketch leads to where the whole chain leads, and is left alone where it would not help."""

from dataclasses import replace

import numpy as np
import pytest

from fgloc.config import load_config
from fgloc.datasets.degrade import degrade
from fgloc.errors import SolverError
from fgloc.smoother import sketch
from fgloc.smoother.chain import Chain
from fgloc.smoother.guess import guess, yaw_by_turns
from fgloc.smoother.model import Model
from fgloc.smoother.states import Robustness, States
from fgloc.sync import plan

NOTHING = {"gnss": {"loss": "none"}}


def chain_of(drive, **settings):
    """The chain of a drive and its guess."""
    config = load_config(**settings)
    model = Model(drive, plan(drive, config), config)
    start = guess(model, 0, len(model) - 1, yaw_by_turns(model))
    return Chain(model, start, model.deltas()[0]), States.of(start, model)


def plainly(chain):
    return Robustness(chain.model.positions.candidates, np.inf, plain=True)


def test_there_is_a_keyframe_for_each_second_and_it_has_a_fix(city):
    chain, _ = chain_of(city(0, 20.05), keyframe_interval_s=0.03)
    keys = sketch.few_keyframes(chain.model, chain.n)
    assert keys[0] == 0 and keys[-1] == chain.n - 1
    np.testing.assert_allclose(chain.model.t_s[keys[:-1]], np.arange(21), atol=1e-6)
    assert np.isin(keys[:-1], chain.model.key_of).all()


def test_where_fixes_are_a_second_apart_there_is_none(city):
    chain, _ = chain_of(degrade(city(0, 20.0), keep_every=10))
    assert sketch.few_keyframes(chain.model, chain.n) is None


def test_the_imu_between_few_keyframes_carries_them_to_all_the_others(city):
    """States that fit the IMU exactly are found again from a few of them."""
    chain, states = chain_of(city(1, 10.0))
    keys = sketch.few_keyframes(chain.model, chain.n)
    g = chain.model.gravity_mps2
    all_keys = np.array([0, chain.n - 1])
    exact = sketch.all_states(states.take(all_keys), all_keys, chain.deltas, chain.bias_of, g)
    again = sketch.all_states(exact.take(keys), keys, chain.deltas, chain.bias_of, g)
    inner = slice(chain.n - 1)  # the last was given, not reached
    np.testing.assert_allclose(again.p[inner], exact.p[inner], atol=1e-9)
    np.testing.assert_allclose(again.R[inner], exact.R[inner], atol=1e-12)
    few = Chain(
        sketch.few_model(chain.model, keys, np.zeros(chain.rows, bool)),
        chain._prior,
        sketch.few_deltas(chain.deltas, keys),
    )
    term = few._motion(again.take(keys), slice(0, len(keys) - 2))
    assert np.abs(term.error).max() < 1e-4


@pytest.mark.parametrize("seed", [0, 1])
def test_it_ends_near_the_optimum_from_which_the_whole_chain_starts(city, seed):
    chain, start = chain_of(city(seed, 30.0), **NOTHING)
    near, _, _ = chain.optimum(start, plainly(chain), rough=True)
    best, cost, iterations = chain.optimum(near, plainly(chain))
    assert iterations <= 3
    assert np.abs(near.p - best.p).max() < 2.0
    unsketched, its_cost, _ = chain.optimum(start, plainly(chain))
    assert cost == pytest.approx(its_cost, rel=1e-7)
    assert np.abs(best.p - unsketched.p).max() < 1e-4


def test_a_bias_is_the_same_in_all_its_copies(city):
    chain, start = chain_of(city(0, 20.0))
    near, _, _ = chain.optimum(start, plainly(chain), rough=True)
    changes = np.diff(near.bias, axis=0).any(-1)
    assert changes.any() and not (changes & (np.diff(chain.bias_of) == 0)).any()


def test_where_it_does_not_fit_or_fails_the_whole_chain_is_solved(city, monkeypatch):
    chain, start = chain_of(city(0, 20.0))
    solved, _, _ = chain.optimum(start, plainly(chain))
    monkeypatch.setattr("fgloc.smoother.chain.misfit", lambda fixes: 0.0)
    near, _, _ = chain.optimum(start, plainly(chain), rough=True)
    assert np.abs(near.p - solved.p).max() < 1e-2

    def fail(*args):
        raise SolverError("no")

    monkeypatch.setattr("fgloc.smoother.newton.Descent.run", fail)
    with pytest.raises(SolverError):
        chain.optimum(start, replace(plainly(chain)), rough=True)
