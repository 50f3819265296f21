"""The graph of Smart Codes: derivatives, and what it finds beside the documented filter."""

import dataclasses

import numpy as np
import pytest

import fgloc
from fgloc.baselines.marr2019_smart_code import run as run_filter
from fgloc.constraints import LEAST_ERROR
from fgloc.drive import VelocityErrors
from fgloc.errors import DriveError, InputError
from fgloc.measurements import EnuVelocities
from fgloc.smoother.codes import SETTINGS, smooth_codes
from fgloc.smoother.codes_build import build
from fgloc.smoother.codes_sightings import BIASES
from fgloc.verdicts import SourceVerdicts

from .code_drives import assert_gradients_are_differences, drive, error_m, mean_nees, model_of


def test_gradients_are_the_differences_of_the_cost():
    assert_gradients_are_differences(model_of(drive()))


def direction_sigma_rad(one, rows) -> np.ndarray:
    """As the graph has it, of some rows of the sightings, seen without noise of the pixels."""
    one = one.with_tables(smart_codes=one.tables["smart_codes"].take(rows))
    settings = dataclasses.replace(SETTINGS, corner_sigma_px=0.0)
    model = build(one, settings, SourceVerdicts.of("smart_codes", one.tables["smart_codes"]))
    return model.sightings[0].direction_sigma_rad


def test_an_error_of_the_course_that_sightings_share_is_not_new_each_time():
    one = drive()
    codes, told = one.tables["smart_codes"], one.tables["velocity"]
    large = np.flatnonzero(codes.sign == 0)
    apart, at_once = large[: 12 * 15 : 15], np.repeat(large[30], 12)
    near = np.abs(codes.t_ns[apart][:, None] - told.t_ns) <= 100_000_000
    alone = told.sigma_mps[0] / 4.5 / np.sqrt(near.sum(1))
    np.testing.assert_allclose(direction_sigma_rad(one, apart), alone, rtol=0.04)
    np.testing.assert_allclose(direction_sigma_rad(one, at_once), alone[2] * np.sqrt(12), rtol=0.04)
    # A window of 0.2 s shares 5/6 of itself with that of the next frame, 4/6 with the one after.
    third = direction_sigma_rad(one, large[:60])[30]
    assert third == pytest.approx(alone[2] * np.sqrt(6), rel=0.04)


def test_the_drive_states_how_far_its_velocities_may_err_and_nothing_is_taken_for_zero():
    one = drive()
    for stated, sigma in (((0.01, 0.02), (0.01, 0.02)), ((0.0, 0.0), (LEAST_ERROR, LEAST_ERROR))):
        rig = dataclasses.replace(one.rig, velocity_errors=VelocityErrors(*stated))
        other = dataclasses.replace(one, rig=rig)
        model = build(other, SETTINGS, SourceVerdicts.of("smart_codes", one.tables["smart_codes"]))
        np.testing.assert_allclose(model.prior[1][:2], sigma)
    silent = dataclasses.replace(one, rig=dataclasses.replace(one.rig, velocity_errors=None))
    assert smooth_codes(silent).summary["codes"]["speed_scale"] == pytest.approx(1, abs=0.05)


def test_without_noise_the_camera_is_found():
    one = drive(corner_sigma_px=0.0, quantised=False)
    assert np.abs(error_m(one, smooth_codes(one).trajectory)).max() < 0.15


def test_a_speed_that_is_told_wrong_is_found():
    one = drive()
    told = one.tables["velocity"]
    fast = EnuVelocities(told.t_ns, told.received_ns, told.v_world_mps * 1.03, told.sigma_mps)
    true, found = (smooth_codes(d).summary["codes"]["speed_scale"]
                   for d in (one, one.with_tables(velocity=fast)))  # fmt: skip
    assert found / true == pytest.approx(1 / 1.03, abs=0.01)


def test_it_errs_less_than_half_as_much_as_the_filter():
    rows = []
    for seed in range(2):
        for path, yaw_deg in (("left", 30.0), ("middle", 30.0), ("right", 0.0), ("near", 0.0)):
            one = drive(seed, path, yaw_deg)
            told = [run_filter(one).trajectory] + [
                smooth_codes(one, lag_s).trajectory for lag_s in (5.0, None)
            ]
            first, last = (
                max(t.t_ns[0] for t in told), min(one.truth.t_ns[-1], *(t.t_ns[-1] for t in told))
            )  # fmt: skip
            t_ns = told[0].t_ns[(told[0].t_ns >= first) & (told[0].t_ns <= last)]
            rows.append([np.linalg.norm(error_m(one, t, t_ns), axis=1).mean() for t in told])
    of_filter, of_lag, of_batch = np.mean(rows, axis=0)
    assert of_lag < 0.7 * of_filter
    assert of_batch < 0.5 * of_filter


def test_the_covariance_does_not_claim_too_much():
    assert 0.1 < np.mean([mean_nees(drive(seed)) for seed in range(4)]) < 1.5


def test_each_size_of_sign_has_its_bias_and_every_row_a_verdict():
    one = drive(path="near", yaw_deg=0.0)
    result = fgloc.smooth(one)
    assert len(result.summary["codes"]["range_bias_m"]) == 2
    assert sum(result.summary["counts"]["smart_codes"].values()) == len(one.tables["smart_codes"])
    assert len(build(one, SETTINGS, result.verdicts["smart_codes"]).prior[0]) == BIASES + 2


def test_modes_and_lacks_are_told():
    one = drive()
    assert fgloc.smooth(one, "fixed-lag").causal
    with pytest.raises(InputError, match="not incremental"):
        fgloc.smooth(one, "incremental")
    blind = dataclasses.replace(one, rig=dataclasses.replace(one.rig, camera=None))
    few = one.with_tables(smart_codes=one.tables["smart_codes"].take(slice(4)))
    for faulty, says in ((blind, r"\[rig.camera\]"), (few, "4 Smart Codes tell a range")):
        with pytest.raises(DriveError, match=says):
            smooth_codes(faulty)
