"""Velocities whose speed and direction err by a constant: found, and not taken for noise."""

from dataclasses import replace

import numpy as np
import pytest

from fgloc.datasets import make
from fgloc.drive import VelocityErrors
from fgloc.evaluation.consistency import nees
from fgloc.frames import yaw_matrix

from .test_chain import assert_same_optimum
from .without_imu import drive_of

STATED = VelocityErrors(0.02, 0.01)
SCALE, TURN_RAD = 1.03, -0.015


def erring(duration_s=30.0, stated=STATED):
    """Fixes five times a second, and velocities too fast by 3 % and turned to the right."""
    drive = drive_of("velocity", duration_s=duration_s, fix_s=0.2)
    told = drive.tables["velocity"]
    v = SCALE * told.v_world_mps @ yaw_matrix(TURN_RAD).T
    rig = replace(drive.rig, velocity_errors=stated)
    return replace(drive, rig=rig).with_tables(velocity=replace(told, v_world_mps=v))


@pytest.mark.parametrize("unheld", [{}, {"velocity": frozenset({40, 41})}])
def test_the_chain_has_the_optimum_of_gtsam(unheld):
    drive = erring(duration_s=15.0)
    assert_same_optimum(drive, unheld=unheld, solver={"cost_tolerance": 1e-10})


@pytest.mark.parametrize("mode", ["batch", "fixed-lag", "incremental"])
def test_what_speed_and_direction_err_is_found_to_three_sigmas(mode, run):
    found = run(erring(), mode).summary["vehicle"]
    off = found["velocity_scale"] - SCALE
    turned = found["velocity_heading_error_rad"] - TURN_RAD
    assert abs(off) < 3 * found["velocity_scale_sigma"] < 0.02
    assert abs(turned) < 3 * found["velocity_heading_error_sigma_rad"] < 0.02


def test_a_setting_goes_before_what_the_rig_states(run):
    stated = run(erring(10.0)).summary["vehicle"]["velocity_scale_sigma"]
    wide = {"velocity_scale_sigma": 0.5, "velocity_heading_sigma_rad": 0.5}
    assert run(erring(10.0), motion=wide).summary["vehicle"]["velocity_scale_sigma"] > stated
    none = {"velocity_scale_sigma": 0.0, "velocity_heading_sigma_rad": 0.0}
    assert "vehicle" not in run(erring(10.0), motion=none).summary


def test_no_error_is_estimated_where_none_is_stated(run):
    assert "vehicle" not in run(erring(10.0, stated=None)).summary


@pytest.mark.parametrize(("mode", "drives"), [("batch", 8), ("fixed-lag", 3)])
def test_past_roadside_cameras_the_graph_is_as_sure_as_it_may_be(mode, drives, run):
    """Normalised squared errors in the plane over drives of 20 s, by their dimension."""
    told = []
    for seed in range(200, 200 + drives):
        drive = make("marr2019/iea", seed=seed)
        own = run(drive, mode).trajectory
        own = own.take(np.isin(own.t_ns, drive.truth.t_ns))
        error = (own.p_world_m - drive.truth.at(own.t_ns).p_world_m)[:, :2]
        told.append(nees(error, own.cov[:, :2, :2]))
    assert 0.4 < np.mean(np.concatenate(told)) / 2 < 2.0
