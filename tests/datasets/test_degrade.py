"""Degrading a drive: every fix is accounted for, and what is removed becomes truth."""

import dataclasses

import numpy as np
import pytest

from fgloc.datasets import open_drive
from fgloc.datasets.city import make_city
from fgloc.datasets.degrade import Outage, degrade
from fgloc.drive import Drive, Rig
from fgloc.errors import InputError
from fgloc.frames import Origin
from fgloc.measurements import GnssFixes

NS = 1_000_000_000


def line_drive(n: int = 101) -> Drive:
    """Fixes at 1 Hz along a straight line, without truth."""
    t_ns = 10**18 + np.arange(n) * NS
    position = np.stack([np.arange(n), np.zeros(n), np.zeros(n)], -1).astype(float)
    fixes = GnssFixes(t_ns, t_ns, position, np.tile(np.eye(3), (n, 1, 1)), np.ones((n, 3)))
    rig = Rig(p_veh_ant_m=np.array([1.0, 0, 1.5]))
    return Drive("line", Origin(50, 8, 100), rig, {"gnss": fixes})


def seconds(table) -> list[int]:
    return ((table.t_ns - 10**18) // NS).tolist()


def test_an_outage_covers_its_beginning_but_not_its_end():
    drive = degrade(line_drive(), outage=(10, 3, 40))
    assert seconds(drive.truth) == [10, 11, 12, 50, 51, 52, 90, 91, 92]
    assert sorted(seconds(drive.gnss) + seconds(drive.truth)) == list(range(101))


def test_an_outage_that_nothing_would_end_is_not_begun():
    assert seconds(degrade(line_drive(93), outage=(10, 3, 40)).truth)[-1] == 52
    assert seconds(degrade(line_drive(94), outage=(10, 3, 40)).truth)[-1] == 92


def test_every_nth_fix_stays():
    drive = degrade(line_drive(10), keep_every=4)
    assert seconds(drive.gnss) == [0, 4, 8]
    assert seconds(drive.truth) == [1, 2, 3, 5, 6, 7, 9]


def test_removed_and_kept_add_up_and_are_told():
    drive = degrade(line_drive(), keep_every=2, outage=(10, 3, 40))
    assert len(drive.gnss) + len(drive.truth) == 101
    assert f"{len(drive.truth)} of 101 fixes removed, {len(drive.gnss)} kept" in drive.about.source
    assert "3 outages of 3 s from 10 s on" in drive.about.title


def test_removed_fixes_become_truth_of_the_antenna():
    drive = degrade(line_drive(), keep_every=2)
    np.testing.assert_array_equal(drive.truth.p_veh_point_m, [1.0, 0, 1.5])
    np.testing.assert_array_equal(drive.truth.p_world_m[:, 0], seconds(drive.truth))
    assert drive.truth.R_world_veh is None
    np.testing.assert_array_equal(drive.truth.v_world_mps, 1)


def test_noise_replaces_covariance_and_all_fixes_become_truth():
    before = line_drive(2001)
    after = degrade(before, noise_enu_m=(1, 2, 3), seed=4)
    assert len(after.gnss) == len(after.truth) == 2001
    np.testing.assert_array_equal(after.truth.p_world_m, before.gnss.p_world_ant_m)
    error = after.gnss.p_world_ant_m - before.gnss.p_world_ant_m
    np.testing.assert_allclose(error.std(axis=0), [1, 2, 3], rtol=0.07)
    np.testing.assert_array_equal(after.gnss.cov_world_m2[7], np.diag([1.0, 4.0, 9.0]))
    assert np.isnan(after.gnss.v_world_mps).all()


def test_noise_depends_on_the_seed_and_on_nothing_else():
    drive = line_drive()
    once = degrade(drive, noise_enu_m=(1, 1, 2), seed=1)
    assert once.gnss.same_as(degrade(drive, noise_enu_m=(1, 1, 2), seed=1).gnss)
    assert not once.gnss.same_as(degrade(drive, noise_enu_m=(1, 1, 2), seed=2).gnss)


def test_a_truth_with_attitude_stays_as_it_is():
    drive = make_city(1, 30.0)
    assert degrade(drive, outage=(5, 5, 10)).truth.same_as(drive.truth)
    assert degrade(drive, noise_enu_m=(3, 3, 5)).truth.same_as(drive.truth)


def test_a_second_degrading_adds_to_the_truth_of_the_first():
    once = degrade(line_drive(), keep_every=2)
    twice = degrade(once, outage=(10, 5, 40))
    assert sorted(seconds(twice.gnss) + seconds(twice.truth)) == list(range(101))
    assert len(twice.truth) > len(once.truth)
    assert twice.about.source.count("degraded:") == 2


def test_of_duplicate_fixes_the_first_becomes_truth():
    drive = line_drive(10)
    rows = [0, 1, 2, 2, 3, 4, 5, 6, 7, 8, 9]
    drive = drive.with_tables(gnss=drive.gnss.take(rows))
    assert seconds(degrade(drive, noise_enu_m=(1, 1, 1)).truth) == list(range(10))


def test_a_truth_of_another_point_cannot_be_joined():
    drive = degrade(line_drive(), keep_every=2)
    moved = dataclasses.replace(drive.truth, p_veh_point_m=np.zeros(3))
    with pytest.raises(InputError, match="tells of the point"):
        degrade(dataclasses.replace(drive, truth=moved), keep_every=2)


@pytest.mark.parametrize(
    ("options", "removed", "truth"),
    [
        ({"outage": (75, 15, 45)}, 11 * 15, 1626 + 11 * 15),
        ({"outage": (75, 30, 90)}, 5 * 30, 1626 + 5 * 30),
        ({"noise_enu_m": (1, 1, 2)}, 0, 1626 + 543),
    ],
)
def test_the_cases_of_the_real_sample_add_up(options, removed, truth):
    drive = degrade(open_drive("mems-rtk"), **options)
    assert len(drive.gnss) == 543 - removed
    assert len(drive.truth) == truth
    assert drive.truth.v_world_mps is not None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "nothing to degrade"),
        ({"keep_every": 0}, "keep_every = 0: expected a whole number from 1"),
        ({"noise_enu_m": (1, 1)}, "expected three sigmas above 0 m"),
        ({"noise_enu_m": (1, 0, 1)}, "expected three sigmas above 0 m"),
        ({"outage": (90, 30, 45)}, "no outage of 30 s from 90 s on ends within the 100 s"),
        ({"outage": (-1, 30, 45)}, "outage first_s = -1: expected seconds, 0 or more"),
        ({"outage": (10, 45, 45)}, "the length must be above 0 and below the period"),
        ({"outage": (10, 0, 45)}, "the length must be above 0 and below the period"),
        ({"noise_enu_m": (1, 1, 1), "seed": -1}, "seed = -1"),
    ],
)
def test_options_without_sense_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        degrade(line_drive(), **options)


def test_an_outage_may_be_given_by_name():
    drive = line_drive()
    by_name = degrade(drive, outage=Outage(first_s=10, length_s=3, period_s=40))
    assert by_name.gnss.same_as(degrade(drive, outage=(10, 3, 40)).gnss)
