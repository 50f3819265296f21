"""Road users that say where they are: their filter, and which detection is whose."""

import numpy as np
import pytest

from fgloc.correspondence.tellers import GATE, Teller, Tellers
from fgloc.drive import GnssBias

I = np.eye(2)  # noqa: E741
SLOW, OF_NODES = GnssBias(1.3, 60.0), GnssBias(0.3, 5.0)
SECOND = 1_000_000_000


def standing(track_places, tellers=None, t_ns=0):
    """Everybody tells a place with 0.5 m of white noise."""
    tellers = tellers or Tellers()
    for track, place in track_places.items():
        tellers.told(track, t_ns, np.array(place, float), 0.25 * I, SLOW, OF_NODES)
    return tellers


def claim(tellers, number, places, t_ns=0):
    places = np.array(places, float)
    R_m2 = np.tile(0.01 * I, (len(places), 1, 1))
    return tellers.claim(t_ns, 0, np.array(number), places, R_m2).tolist()


def test_a_fix_leaves_the_place_as_uncertain_as_both_its_errors():
    teller = Teller(0, np.zeros(2), 0.25 * I, SLOW, OF_NODES)
    assert teller.P[:2, :2] == pytest.approx((0.25 + 1.3**2) * I)
    # What the fix says again is known but for the white noise of both.
    S = teller.P[:2, :2] + 2 * teller.P[:2, 4:6] + teller.P[4:6, 4:6]
    assert pytest.approx(0.25 * I) == S


def test_a_sighting_tells_of_the_slow_error_of_the_fixes():
    teller = Teller(0, np.array([2.0, 0.0]), 0.01 * I, SLOW, None)
    teller.seen(np.zeros(2), 0.01 * I)
    share = 1.3**2 / (1.3**2 + 0.02)  # by hand: prior variance over that of the difference
    assert teller.x[4] == pytest.approx(2.0 * share)
    assert teller.P[4, 4] == pytest.approx(1.3**2 * (1 - share))


def test_slow_errors_forget_themselves():
    teller = Teller(0, np.zeros(2), 0.25 * I, SLOW, OF_NODES)
    teller.seen(np.array([2.0, 0.0]), 0.01 * I)
    before = teller.x[4:].copy()
    teller.predict(5 * SECOND)
    assert teller.x[4:6] == pytest.approx(before[:2] * np.exp(-5 / 60))
    assert teller.x[6:] == pytest.approx(before[2:] * np.exp(-1))


def test_two_cars_in_a_row_are_told_apart_though_each_alone_would_take_the_other():
    # 4 m apart; the fixes of both are 2.5 m too far back, nearer to the follower's place.
    tellers = standing({0: (-2.5, 0.0), 1: (1.5, 0.0)})
    assert claim(tellers, [7, 8], [(0.0, 0.0), (4.0, 0.0)]) == [0, 1]
    alone = standing({1: (1.5, 0.0)})
    assert claim(alone, [7, 8], [(0.0, 0.0), (4.0, 0.0)]) == [1, -1]


def test_an_object_that_is_near_nobody_is_nobodys():
    tellers = standing({0: (0.0, 0.0)})
    far_m = 1.01 * np.sqrt(GATE * (0.25 + 1.3**2 + 0.3**2 + 0.01))
    assert claim(tellers, [7], [(far_m, 0.0)]) == [-1]
    assert claim(tellers, [7], [(0.98 * far_m, 0.0)]) == [0]
    assert claim(tellers, [], np.zeros((0, 2))) == []


def test_a_number_that_was_somebody_for_long_is_not_given_up_for_a_ghost_no_nearer_than_noise():
    tellers = standing({0: (0.0, 0.0)})
    for k in range(20):
        t_ns = k * SECOND // 10
        assert claim(tellers, [7], [(0.0, 0.0)], t_ns) == [0]
    assert claim(tellers, [7, 9], [(0.1, 0.0), (0.0, 0.0)], 2 * SECOND) == [0, -1]


def test_a_fix_that_cannot_be_is_refused_until_its_like_have_come_for_seconds():
    tellers = standing({0: (0.0, 0.0)})
    taken = []
    for k in range(1, 100):
        place = np.array([0.0, 0.0]) if k < 20 else np.array([40.0, 0.0])
        taken.append(tellers.told(0, k * SECOND // 10, place, 0.25 * I, SLOW, OF_NODES))
    assert all(taken[:19])
    assert not any(taken[19:30])
    assert taken[-1]
