"""Verdicts: one for each row, and totals that add up."""

import numpy as np

from fgloc.measurements import WheelSpeeds
from fgloc.verdicts import SourceVerdicts, Verdict, counts


def some_verdicts() -> SourceVerdicts:
    t_ns = np.arange(5)
    return SourceVerdicts.of("wheel", WheelSpeeds(t_ns, t_ns, np.ones(5), np.ones(5)))


def test_every_row_has_a_verdict_from_the_start():
    assert counts({"wheel": some_verdicts()}) == {"wheel": {"unused": 5}}


def test_counts_are_plain_text_by_name_and_add_up_to_the_rows():
    verdicts = some_verdicts()
    verdicts.set([0, 1], Verdict.USED)
    verdicts.set(verdicts.t_ns == 4, Verdict.GATED, "too far")
    found = verdicts.counts()
    assert list(found.items()) == [("gated", 1), ("unused", 2), ("used", 2)]
    assert {type(name) for name in found} == {str}
    assert sum(found.values()) == len(verdicts)
    assert verdicts.reason.tolist() == ["", "", "", "", "too far"]


def test_a_verdict_and_its_text_are_one_key():
    assert {Verdict.USED: 1}["used"] == 1
    assert "down-weighted" in {Verdict.DOWN_WEIGHTED}
