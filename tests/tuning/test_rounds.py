"""Which fixes are withheld, and which of them the search never sees."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fgloc.errors import InputError
from fgloc.tuning.rounds import make_rounds


def test_lengths_are_one_fix_the_outage_and_their_geometric_mean():
    assert make_rounds(np.arange(600.0), 16.0, "drive").lengths == (1, 4, 16)
    assert make_rounds(np.arange(600) / 10, 20.0, "drive").lengths == (1, 7, 50)  # 600 / 12
    assert make_rounds(np.arange(47) * 10.0, 20.0, "drive").lengths == (1, 2)


def test_stretches_of_a_small_drive_by_hand():
    rounds = make_rounds(np.arange(24) * 10.0, 20.0, "drive")  # twelve stretches of two fixes
    *single, whole = rounds.seen
    assert whole.scored.tolist() == [2, 3, 10, 11, 18, 19]
    assert whole.stretch.tolist() == [1, 1, 5, 5, 9, 9]
    assert [one.scored.tolist() for one in single] == [
        [2, 4, 8, 10, 12, 16, 18, 20], [3, 5, 9, 11, 13, 17, 19, 21],
    ]  # fmt: skip
    assert rounds.unseen[-1].scored.tolist() == [6, 7, 14, 15]
    assert np.flatnonzero(whole.withheld).tolist() == [2, 3, 6, 7, 10, 11, 14, 15, 18, 19]
    assert np.flatnonzero(rounds.unseen[0].withheld).tolist() == [6, 14]


@given(n=st.integers(24, 900), every_s=st.sampled_from([0.1, 1.0, 10.0]),
       outage_s=st.floats(0.1, 100.0))  # fmt: skip
def test_the_search_never_sees_what_it_is_judged_on(n, every_s, outage_s):
    t_s = np.arange(n) * max(every_s, 33.0 / n)
    rounds = make_rounds(t_s, outage_s, "drive")
    unseen = np.unique(np.concatenate([one.scored for one in rounds.unseen]))
    assert len(unseen) > 0 and 0 not in unseen and n - 1 not in unseen
    for one in rounds.seen:
        assert one.withheld[unseen].all() and not np.isin(one.scored, unseen).any()
    for one in (*rounds.seen, *rounds.unseen):
        assert len(one.scored) > 0 and one.withheld[one.scored].all()
    for length in rounds.lengths[:-1]:  # each fix once for each of the shorter lengths
        scored = np.concatenate([one.scored for one in rounds.unseen if one.fixes == length])
        assert sorted(scored) == unseen.tolist()


def test_a_drive_that_is_too_short_is_refused():
    with pytest.raises(InputError, match=r"'stub' has 23 usable fixes over 22\.0 s; .* longer"):
        make_rounds(np.arange(23.0), 20.0, "stub")
    with pytest.raises(InputError, match=r"has 291 usable fixes over 29\.0 s"):
        make_rounds(np.arange(291) / 10, 20.0, "stub")
