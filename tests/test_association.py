"""Which candidate is the car: one a frame, the nearest, with the node's own number as a witness."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fgloc.association import Witness, explanations, nearest

ONE_NODE = np.zeros(100, int)


def pick(frame, object_id, nis, limit=9.0) -> list[int]:
    frame = np.array(frame)
    chosen = nearest(frame, ONE_NODE[: len(frame)], np.array(object_id), np.array(nis, float),
                     np.full(len(frame), limit))  # fmt: skip
    return np.flatnonzero(chosen).tolist()


def test_the_nearest_of_a_frame_is_the_car():
    assert pick([0, 0, 1, 1], [5, 6, 5, 6], [1.0, 4.0, 0.5, 7.0]) == [0, 2]


def test_what_does_not_pass_the_gate_is_not_the_car():
    assert pick([0, 1, 2], [5, 5, 5], [1.0, 9.1, 8.9]) == [0, 2]


def test_a_neighbour_that_is_nearer_for_a_moment_does_not_take_over():
    frame, number = np.repeat(np.arange(10), 2), np.tile([5, 6], 10)
    nis = np.tile([1.0, 6.0], 10)
    nis[[8, 9]] = 2.0, 1.5  # in frame 4 the other one is a little nearer
    assert pick(frame, number, nis) == np.flatnonzero(number == 5).tolist()


def test_a_number_that_changes_is_followed():
    frame, number = np.arange(10), np.repeat([5, 8], 5)
    assert pick(frame, number, np.full(10, 2.0)) == list(range(10))


def test_without_numbers_only_nearness_counts():
    assert pick([0, 0, 1, 1], [-1, -1, -1, -1], [1.0, 2.0, 2.0, 1.0]) == [0, 3]


@given(st.lists(st.tuples(st.integers(0, 5), st.integers(-1, 3), st.floats(0, 20)), max_size=30))
def test_each_frame_has_at_most_one_car_and_it_fits(rows):
    frame, number, nis = (np.array(column) for column in zip(*rows, strict=True)) if rows else (
        np.zeros(0, int),) * 3  # fmt: skip
    chosen = pick(frame, number, nis)
    assert len(set(frame[chosen].tolist())) == len(chosen)
    assert (nis[chosen] <= 9.0).all()
    assert {f for f, n in zip(frame, nis, strict=True) if n <= 9.0} == set(frame[chosen].tolist())


def test_a_witness_counts_by_laplaces_rule():
    witness = Witness()
    assert witness.cost(0, 7) == -2 * np.log(1 / 2)
    for is_car in (True, True, False):
        witness.note(0, 7, car=is_car)
    assert witness.cost(0, 7) == -2 * np.log(3 / 5)
    assert witness.cost(0, -1) == -2 * np.log(1 / 2)
    assert witness.cost(1, 7) == -2 * np.log(1 / 2)


def test_what_was_not_the_car_is_explained():
    frame = np.array([0, 0, 1, 1, 2, 2, 3, 3, 4])
    number = np.array([5, 6, 5, 6, 5, 6, 5, 9, 5])
    chosen = np.array([1, 0, 1, 0, 1, 0, 1, 0, 0], bool)
    fits = np.array([1, 1, 1, 0, 1, 0, 1, 0, 0], bool)
    told = explanations(frame, ONE_NODE[:9], number, chosen, fits)
    road_user = (True, "object 6 is another road user: the car in 0 of 3 frames")
    assert told[:3] == [road_user] * 3
    assert told[3] == (True, "object 9 was seen 1 times only: a ghost")
    assert told[4] == (False, "does not fit")
