"""The filter of Lee et al. (2021), equation by equation, with numbers worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest

from fgloc.baselines.lee2021_filter import (
    BEYOND,
    FAR,
    LEE2021,
    PRINTED,
    SECOND,
    TAKEN,
    UNSEEN,
    Belief,
    Filter,
    gps_cov_m2,
    node_cov_m2,
)
from fgloc.baselines.lee2021_sync import Candidates, Synchronised
from fgloc.factors.detection import lee2021_sigma_m

STEP_NS = 100_000_000


def synchronised(fixes, seen=(), v_mps=(10.0, 0.0, 0.0)) -> Synchronised:
    """Fixes every 0.1 s; `seen` are (stamp, East, North, distance, in range)."""
    n, seen = len(fixes), sorted(seen)
    columns = np.array([one[1:4] for one in seen]).reshape(-1, 3)
    rows = np.arange(len(seen))
    return Synchronised(
        np.arange(n) * STEP_NS, np.arange(n), np.array(fixes, float), np.tile(v_mps, (n, 1)),
        Candidates(np.array([one[0] for one in seen], int), np.stack([rows, rows], -1),
                   columns[:, :2], columns[:, 2], np.array([one[4] for one in seen], bool)),
    )  # fmt: skip


def test_the_prediction_moves_with_the_velocity_and_adds_the_process_noise():
    now = Belief(np.array([1.0, 2.0]), np.diag([0.25, 1.0])).predicted(
        np.array([10, -5.0]), 0.1, 0.2
    )
    np.testing.assert_allclose(now.x_m, [2.0, 1.5])
    np.testing.assert_allclose(now.cov_m2, np.diag([0.29, 1.04]))


def test_an_update_weighs_each_axis_by_its_variances():
    # East: 0.36 against 0.64, a gain of 0.36; North: 4 against 4, a gain of a half.
    belief = Belief(np.zeros(2), np.diag([0.36, 4.0]))
    now, nis = belief.updated(np.array([1.0, 2.0]), gps_cov_m2())
    np.testing.assert_allclose(now.x_m, [0.36, 1.0])
    np.testing.assert_allclose(now.cov_m2, np.diag([0.36 * 0.64, 2.0]))
    assert nis == pytest.approx(1.0 / 1.0 + 4.0 / 8.0)


def test_the_covariances_are_those_of_table_ii():
    np.testing.assert_allclose(gps_cov_m2(), [[0.64, 0], [0, 4.0]])
    np.testing.assert_allclose(gps_cov_m2(PRINTED), [[0.64, 1.6], [1.6, 4.0]])
    np.testing.assert_allclose(node_cov_m2(40.0), np.diag([1.338**2, 0.09]))


@pytest.mark.parametrize(
    ("distance_m", "sigma_m"),
    [(0.0, 0.702), (5.0, 0.447), (13.7647, 0.3), (20.0, 0.318), (40.0, 1.338), (60.0, 2.358)],
)
def test_the_sigma_along_grows_with_the_distance_and_has_a_floor(distance_m, sigma_m):
    assert lee2021_sigma_m(distance_m, LEE2021.floor_m) == pytest.approx(sigma_m)


def test_the_fix_comes_first_and_then_the_candidate_nearest_to_the_prediction():
    data = synchronised([[0, 0], [1, 0]], [(1, 1.2, 0.1, 40.0, True), (1, 2.5, 0.0, 40.0, True)])
    steps = Filter(data)
    last = steps.run()[-1]
    by_hand = Belief(np.zeros(2), gps_cov_m2())
    by_hand = by_hand.predicted(np.array([10.0, 0]), 0.1, LEE2021.process_sigma_m)
    by_hand, _ = by_hand.updated(np.array([1.0, 0]), gps_cov_m2())
    by_hand, nis = by_hand.updated(np.array([1.2, 0.1]), node_cov_m2(40.0))
    np.testing.assert_allclose(last.x_m, by_hand.x_m, atol=1e-12)
    np.testing.assert_allclose(last.cov_m2, by_hand.cov_m2, atol=1e-12)
    assert steps.candidates.fate.tolist() == [TAKEN, SECOND]
    assert steps.candidates.nis[0] == pytest.approx(nis)


def test_what_is_farther_than_the_threshold_or_beyond_the_range_is_left_out():
    data = synchronised(
        [[0, 0], [1, 5.01]],
        [(1, 1.0, 0.0, 70.0, False), (1, 6.01, 0.0, 40.0, True), (1, 5.99, 0.0, 40.0, True)],
    )
    steps = Filter(data)
    steps.run()
    assert steps.fixes.fate.tolist() == [TAKEN, FAR]
    assert steps.candidates.fate.tolist() == [BEYOND, TAKEN, FAR]
    assert steps.candidates.far_m.tolist() == pytest.approx([0.0, 4.99, 5.01])


def test_after_five_seconds_of_rejected_fixes_it_starts_anew():
    fixes = [[k, 0.0 if k == 0 else 50.0] for k in range(60)]
    steps = Filter(synchronised(fixes))
    beliefs = steps.run()
    assert steps.restarts == [51]
    assert beliefs[50].x_m[1] == 0 and beliefs[51].x_m.tolist() == [51, 50]
    assert (steps.fixes.fate == TAKEN).sum() == 1 + 9 and UNSEEN not in steps.fixes.fate


@pytest.mark.parametrize("distance_m", [11.41, 16.12])
def test_as_printed_the_covariance_is_singular_and_the_state_jumps_where_the_lines_are_parallel(
    distance_m,
):
    assert np.linalg.det(gps_cov_m2(PRINTED)) == pytest.approx(0, abs=1e-12)
    jumps = {}
    for p in (LEE2021, PRINTED):
        sight = (0, 0.0, 1.0, distance_m, True)  # one metre beside the fix
        belief = Filter(synchronised([[0, 0]], [sight]), p).run()[0]
        jumps[p.correlation] = np.linalg.norm(belief.x_m)
        if p is PRINTED:
            assert np.abs(belief.cov_m2).max() < 1e-6  # and it is sure of that
    assert jumps[0.0] < 1.0 < 10.0 < jumps[1.0]


def test_as_printed_the_process_noise_hardly_matters():
    sight = (1, 1.3, 0.4, 40.0, True)
    ends = []
    for sigma_m in (0.5, 50.0):
        p = replace(PRINTED, process_sigma_m=sigma_m)
        ends.append(Filter(synchronised([[0, 0], [1.5, 0.2]], [sight]), p).run()[-1])
    regular = [
        Filter(synchronised([[0, 0], [1.5, 0.2]], [sight]),
               replace(LEE2021, process_sigma_m=s)).run()[-1] for s in (0.5, 50.0)
    ]  # fmt: skip
    moved = np.linalg.norm(ends[1].x_m - ends[0].x_m)
    assert moved < 0.25 * np.linalg.norm(regular[1].x_m - regular[0].x_m)
    assert np.abs(ends[1].cov_m2).max() < 1e-3
