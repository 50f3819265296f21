"""Detections alone as an estimate: which of them is the vehicle, and what they are worth."""

from dataclasses import replace

import numpy as np
import pytest

import fgloc
from fgloc.errors import DriveError, InputError
from fgloc.evaluation import errors

from .roadside import CAR_ID, roadside_drive


@pytest.fixture(scope="module")
def drive():
    return roadside_drive(0)


def test_the_object_nearest_to_the_fixes_is_taken_and_its_errors_are_the_nodes(drive):
    result = fgloc.baseline(drive, "raw:detections")
    own, table = result.verdicts["detections"], drive.tables["detections"]
    used = own.is_("used")
    assert np.isin(table.object_id[used], [CAR_ID, CAR_ID + 10]).mean() > 0.95
    assert own.is_("gated").any() and sum(own.counts().values()) == len(table)
    np.testing.assert_array_equal(result.trajectory.p_veh_point_m, drive.rig.p_veh_box_m)


def test_without_others_around_their_errors_are_what_the_law_says():
    drive = roadside_drive(0, ghosts=False)
    found = fgloc.baseline(drive, "raw:detections").trajectory
    scored = errors(found, drive.truth.take(np.isin(drive.truth.t_ns, found.t_ns)))
    assert scored.nees_horizontal.mean() / 2 == pytest.approx(1.0, abs=0.2)
    assert np.sqrt(np.mean(scored.up_m**2)) == pytest.approx(2.0, abs=0.4)


def test_a_stated_covariance_is_turned_from_the_nodes_axes_to_the_world(drive):
    table = drive.tables["detections"]
    stated = replace(table, cov_node_m2=np.tile(np.diag([4.0, 0.01]), (len(table), 1, 1)))
    cov = fgloc.baseline(drive.with_tables(detections=stated), "raw:detections").trajectory.cov
    c, s = np.cos(0.7), np.sin(0.7)
    np.testing.assert_allclose(cov[0, 0, 0], 4 * c**2 + 0.01 * s**2)


def test_where_no_fix_is_near_the_message_says_so(drive):
    away = replace(drive.gnss, p_world_ant_m=drive.gnss.p_world_ant_m + 1e4)
    with pytest.raises(DriveError, match=r"none of the .* detections lies within 5 m of a fix"):
        fgloc.baseline(drive.with_tables(gnss=away), "raw:detections")


def test_a_source_without_positions_is_refused_with_those_that_have_them(drive):
    with pytest.raises(InputError, match="there are: raw:gnss, raw:detections"):
        fgloc.baseline(drive, "raw:velocity")
