"""Work on portions by all cores."""

import numpy as np
import pytest

from fgloc.portions import on_all_cores


@pytest.fixture(params=[1, 2, 5], autouse=True)
def cores(request, monkeypatch):
    """However many there are, or seem to be."""
    monkeypatch.setattr("os.cpu_count", lambda: request.param)


def test_results_come_in_the_order_of_the_portions():
    assert on_all_cores(lambda k: k**2, range(50)) == [k**2 for k in range(50)]
    assert on_all_cores(lambda k: k, []) == []


def test_the_first_portion_that_fails_is_told():
    def work(k):
        if k >= 3:
            raise ValueError(f"portion {k}")

    with pytest.raises(ValueError, match="portion 3"):
        on_all_cores(work, range(9))


def test_what_numpy_is_to_overlook_is_overlooked_everywhere():
    with np.errstate(over="ignore"):
        assert on_all_cores(lambda k: float(np.exp(np.array(1000.0 + k))), range(4)) == [np.inf] * 4
    with np.errstate(over="raise"), pytest.raises(FloatingPointError):
        on_all_cores(lambda k: np.exp(np.array(1000.0 + k)), range(4))
