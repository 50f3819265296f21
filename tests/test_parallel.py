"""The same work on many parts: what is made is as if one after the other had made it."""

import threading

import numpy as np
import pytest

import fgloc
from fgloc import parallel
from fgloc.parallel import each, processors


@pytest.fixture(params=[1, 3])
def on_processors(request, monkeypatch):
    monkeypatch.setattr(parallel, "processors", lambda: request.param)
    return request.param


def test_what_is_made_comes_in_the_order_of_the_parts(on_processors):
    assert each(lambda part: part**2, range(20)) == [part**2 for part in range(20)]
    assert each(len, []) == []


def test_parts_are_made_side_by_side(monkeypatch):
    monkeypatch.setattr(parallel, "processors", lambda: 2)
    both = threading.Barrier(2, timeout=10)
    assert sorted(each(lambda _: both.wait(), range(2))) == [0, 1]


def test_what_fails_first_among_the_parts_is_raised(on_processors):
    with pytest.raises(ZeroDivisionError, match="float"):
        each(lambda part: 1.0 / part if part else 1.0 / 0.0, [1, 0, 2])


def test_what_numpy_ignores_outside_it_ignores_inside(on_processors):
    with np.errstate(divide="ignore"):
        told = each(lambda part: np.ones(1) / part, [1.0, 0.0])
    np.testing.assert_array_equal(np.concatenate(told), [1.0, np.inf])


def test_at_least_one_processor_may_be_used():
    assert processors() >= 1


def test_a_drive_is_solved_to_the_same_bit_on_any_number_of_processors(monkeypatch):
    monkeypatch.setattr("fgloc.smoother.chain.LONG", 100)
    drive, found = fgloc.make("city", seed=3, duration_s=60.0), []
    for number in (1, 2, 4):
        monkeypatch.setattr(parallel, "processors", lambda number=number: number)
        found.append(fgloc.smooth(drive, settings=["keyframe_interval_s=0.1"]))
    assert all(one.trajectory.same_as(found[0].trajectory) for one in found)
    assert len({one.summary["cost"] for one in found}) == 1
