"""The matching that is not stuck: bounds that hold, honest doubt, the exhaustive oracle."""

import numpy as np
import pytest

from fgloc.correspondence import Rigid, Status, is_ambiguous, match
from fgloc.correspondence.oracle import search
from fgloc.correspondence.rigid import wrapped
from fgloc.correspondence.voting import BIN_RAD, alike, bounds
from fgloc.datasets.khamooshi2023_layouts import make_layouts
from fgloc.errors import InputError
from fgloc.evaluation.correspondence import METHODS, study, wilson

REACH_M = 3 * 0.3 * 2**0.5
SQUARE = np.array([[10.0, 10], [-10, 10], [-10, -10], [10, -10]])


def off_rad(found, layout):
    return abs(wrapped(found.pose.yaw_rad - layout.yaw_rad))


def test_lengths_that_are_alike_are_all_found():
    rng = np.random.default_rng(1)
    a, b = rng.uniform(0, 50, 30), rng.uniform(0, 50, 40)
    expected = np.argwhere(np.abs(a[:, None] - b) <= 1.5)
    assert sorted(zip(*alike(a, b, 1.5), strict=True)) == sorted(map(tuple, expected))


@pytest.mark.parametrize("seed", range(5))
def test_no_bound_is_below_the_pairs_of_a_true_motion(seed):
    (x,) = make_layouts(seed, 12, 1, sigma_m=0.2)
    bound = bounds(x.p_world_m, x.p_veh_m, slice(None), REACH_M)
    bin_ = int((x.yaw_rad % (2 * np.pi)) / BIN_RAD)
    assert (bound[x.pairs[:, 0], x.pairs[:, 1], bin_] >= len(x.pairs)).all()


def test_a_square_is_ambiguous_and_an_object_more_makes_it_clear():
    car = np.concatenate([[[0.0, 0.0]], SQUARE])
    assert match(SQUARE, SQUARE - SQUARE[0]).status == Status.AMBIGUOUS
    assert match(np.concatenate([car, [[25.0, 4.0]]]), np.concatenate([car, [[25.0, 4.0]]])
                 ).status == Status.MATCHED  # fmt: skip


def test_two_pairs_can_always_be_swapped():
    points = np.array([[0.0, 0.0], [20.0, 0.0]])
    assert match(points, points).status == Status.AMBIGUOUS
    assert is_ambiguous(points, points, 0.0, np.array([[0, 0], [1, 1]]))


@pytest.mark.parametrize("objects", [5, 20])
def test_clear_layouts_are_matched_under_any_heading(objects):
    clear = [
        x for x in make_layouts(1, objects, 40)
        if not is_ambiguous(x.p_world_m, x.p_veh_m, x.yaw_rad, x.pairs)
    ]  # fmt: skip
    found = [match(x.p_world_m, x.p_veh_m, doubt=2e-4) for x in clear]
    assert len(clear) > 20
    assert all(off_rad(f, x) < np.deg2rad(5) for f, x in zip(found, clear, strict=True))
    claimed = [set(map(tuple, f.pairs)) for f in found]
    true = [set(map(tuple, x.pairs)) for x in clear]
    assert all(a <= b for a, b in zip(claimed, true, strict=True))


def test_probabilities_of_pairs_are_what_they_say():
    expected, wrong, n = 0.0, 0, 0
    for x in make_layouts(7, 20, 60):
        found = match(x.p_world_m, x.p_veh_m)
        true = set(map(tuple, x.pairs))
        doubtful = found.probability < 0.99
        pairs = np.concatenate([found.pairs, found.likely])[doubtful]
        expected += float((1 - found.probability[doubtful]).sum())
        wrong += sum(tuple(pair) not in true for pair in pairs)
        n += len(pairs)
    assert n > 50
    assert abs(wrong - expected) < 3 * np.sqrt(expected)


def test_the_doubt_decides_how_many_pairs_are_claimed():
    (x,) = make_layouts(3, 20, 1)
    strict, lax = (match(x.p_world_m, x.p_veh_m, doubt=d) for d in (1e-4, 0.5))
    assert len(strict.pairs) < len(lax.pairs)
    assert len(strict.pairs) + len(strict.likely) == len(lax.pairs) + len(lax.likely)


@pytest.mark.parametrize("objects", [3, 4, 6])
def test_the_oracle_says_the_same_with_and_without_its_shortcut(objects):
    said = []
    for x in make_layouts(2, objects, 60):
        variance = 0.09 * np.r_[1.0, np.full(len(x.p_veh_m) - 1, 2.0)]
        plain = len(x.pairs) < 2 or search(
            x.p_world_m, x.p_veh_m, x.yaw_rad, len(x.pairs), variance, REACH_M
        )
        said.append(is_ambiguous(x.p_world_m, x.p_veh_m, x.yaw_rad, x.pairs))
        assert said[-1] == plain
    assert any(said)


def test_the_oracle_finds_a_planted_second_answer():
    rng = np.random.default_rng(4)
    shape = rng.uniform(-15, 15, (4, 2))
    turned = Rigid(1.0, np.array([60.0, 0.0])).apply(shape)
    pairs = np.stack([np.arange(4)] * 2, -1)
    assert not is_ambiguous(shape, shape - shape[0], 0.0, pairs)
    assert is_ambiguous(np.concatenate([shape, turned]), shape - shape[0], 0.0, pairs)


def test_sigma_above_0_is_asked_for():
    with pytest.raises(InputError, match="sigma_m = 0"):
        match(SQUARE, SQUARE, sigma_m=0)


def test_wilson_interval_of_one_in_ten():
    low, high = wilson(1, 10)
    assert (low, high) == pytest.approx((0.0179, 0.4042), abs=1e-4)
    assert wilson(0, 10)[0] == 0


def test_the_study_counts_what_it_leaves_out_and_why_methods_fail():
    rows = {row.method: row for row in study(30, [5], seed=1)}
    assert set(rows) == set(METHODS)
    ours, printed = rows["consistent"], rows["icp-printed"]
    assert ours.failed.n == 30 - ours.ambiguous > 15
    assert ours.failed.value < rows["cpd"].failed.value <= printed.failed.value
    assert printed.wrong_pair.value == 1
    assert rows["cpd-warm"].heading.value < rows["cpd"].heading.value


def test_a_study_of_nothing_is_refused():
    with pytest.raises(InputError, match="at least one"):
        study(0, [5])
    with pytest.raises(InputError, match="2 objects: expected 3"):
        study(1, [2])
