"""Which candidates go on as one object, and are the car by all frames together."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgloc.following import Strays, followed

TAU_S, LIMIT = 60.0, 14.0


def strays(rows, sigma_m=1.5, noise_m=0.1, tau_s=TAU_S) -> Strays:
    """Rows of seconds, number, and error east in m; a frame for each instant."""
    t_s, number, east_m = np.array(rows, float).reshape(-1, 3).T
    n = len(t_s)
    _, frame = np.unique(t_s, return_inverse=True)
    eye = np.tile(np.eye(2), (n, 1, 1))
    error_m = np.stack([east_m, np.zeros(n)], -1)
    return Strays(t_s, frame, number.astype(int), error_m, sigma_m**2 * eye, noise_m**2 * eye,
                  tau_s, np.full(n, LIMIT))  # fmt: skip


def chosen(rows, **how) -> list[int]:
    return np.flatnonzero(followed(strays(rows, **how))).tolist()


def drive(number_of_car=5, number_of_other=6):
    """Twenty seconds at 10 Hz beside a car 6 m ahead, while the fixes drift from 0 to -4 m."""
    rows = []
    for k in range(200):
        drift_m = -4.0 * k / 199
        rows += [(k / 10, number_of_car, drift_m), (k / 10, number_of_other, drift_m + 6.0)]
    return rows


@pytest.mark.parametrize("numbers", [(5, 6), (-1, -1)])
def test_a_neighbour_on_which_the_drift_falls_for_a_while_is_not_the_car(numbers):
    rows = drive(*numbers)
    nearest = [min((0, 1), key=lambda i, k=k: abs(rows[2 * k + i][2])) for k in range(200)]
    assert 1 in nearest[150:]
    assert chosen(rows) == list(range(0, 400, 2))


def test_the_car_is_found_again_under_another_number():
    rows = drive()
    rows = [(t, 9 if n == 5 and t >= 10 else n, e) for t, n, e in rows]
    assert chosen(rows) == list(range(0, 400, 2))


def test_where_only_the_neighbour_is_seen_none_is_the_car():
    rows = [row for row in drive() if row[1] == 6 or not 8 <= row[0] < 12]
    assert {rows[i][1] for i in chosen(rows)} == {5}


def test_a_single_detection_elsewhere_is_passed_over():
    rows = [(k / 10, -1, 3.0 if k == 50 else 0.1) for k in range(100)]
    assert chosen(rows) == [k for k in range(100) if k != 50]


def test_after_minutes_the_drift_may_be_another():
    rows = [(k / 10, 1, 0.5) for k in range(50)] + [(300 + k / 10, 2, -3.0) for k in range(50)]
    assert chosen(rows) == list(range(100))


def test_what_does_not_fit_at_all_is_not_the_car():
    assert chosen([(0.0, 1, 30.0), (0.1, 1, 30.0)]) == []
    assert chosen([]) == []


def test_without_a_number_or_with_one_a_lone_object_is_followed_at_once():
    assert chosen([(k / 10, 3, 0.01 * k) for k in range(100)]) == list(range(100))
    assert chosen([(k / 10, -1, 0.01 * k) for k in range(100)]) == list(range(100))


@settings(max_examples=50)
@given(st.lists(st.tuples(st.integers(0, 30), st.integers(-1, 3), st.floats(-8, 8)), max_size=60))
def test_each_frame_has_at_most_one_car_and_it_fits(rows):
    told = strays(sorted(rows))
    picked = followed(told)
    assert len(set(told.frame[picked].tolist())) == picked.sum()
    assert (told.nis[picked] <= LIMIT).all()
    assert picked.any() == bool((told.nis <= LIMIT).any())
