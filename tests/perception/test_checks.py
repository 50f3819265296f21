"""What pairs of boxes and cuboids say of a camera's mount and clock, and how frames are grouped."""

import numpy as np
import pytest

from fgloc.perception.checks import align, remarks, unmatched
from fgloc.perception.recording import Frames
from fgloc.perception.schedule import missing, spread
from fgloc.perception.tracker import Match


def matches(shift=(0.0, 0.0), late_s=0.0, n=200, wild=0):
    rng = np.random.default_rng(0)
    found = []
    for k in range(n):
        at, speed = rng.uniform(200, 1000, 2), rng.uniform(-100, 100, 2)
        seen = at + shift - late_s * speed + 2.0 * rng.standard_normal(2)
        found.append(Match(0, at, seen + (300 if k < wild else 0), speed, 3.0))
    return found


def test_a_good_camera_gives_no_remark():
    found = align(matches())
    assert np.abs(found.shift_px).max() < 1
    assert abs(found.late_s) < 0.01
    assert remarks("camera", found) == []


def test_late_stamps_are_told_from_a_turned_mount():
    late = align(matches(late_s=0.2))
    assert late.late_s == pytest.approx(0.2, abs=0.01)
    assert len(remarks("camera", late)) == 1
    assert "+0.2" in remarks("camera", late)[0]
    assert "clock_ahead_s" in remarks("camera", late)[0]
    turned = align(matches(shift=(25.0, -3.0)))
    np.testing.assert_allclose(turned.shift_px, [25, -3], atol=1)
    assert "mount" in remarks("camera", turned)[0]


def test_wrong_pairs_do_not_pull():
    found = align(matches(late_s=0.1, wild=10))
    assert found.late_s == pytest.approx(0.1, abs=0.03)
    assert np.abs(found.shift_px).max() < 4


def test_few_pairs_say_nothing():
    assert align(matches(n=20)) is None


def test_boxes_on_nothing_are_told():
    assert "3 of 100 boxes" in unmatched("camera", 100, 3)
    assert unmatched("camera", 100, 60) == ""
    assert unmatched("camera", 10, 0) == ""


def test_missing_frames_are_counted_by_the_usual_step():
    t_ns = np.array([0, 1, 2, 5, 6, 8]) * 100_000_000
    frames = Frames("camera", t_ns, t_ns, lambda k: None)
    assert missing(frames) == "camera: 3 of 9 frames are missing; the longest gap is 0.3 s"
    whole = Frames("camera", t_ns[:3], t_ns[:3], lambda k: None)
    assert missing(whole) == ""


@pytest.mark.parametrize(("count", "wanted"), [(10, 4), (3, 10), (1, 5), (0, 5)])
def test_frames_are_spread_over_the_whole(count, wanted):
    chosen = spread(count, wanted)
    assert len(chosen) == min(count, wanted)
    if count > 1:
        assert (chosen[0], chosen[-1]) == (0, count - 1)
