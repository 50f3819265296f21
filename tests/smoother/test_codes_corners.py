"""The graph of Smart Codes by their corners: derivatives, both square poses, what corners bring."""

import dataclasses

import numpy as np
import pytest

from fgloc.infrastructure import Infrastructure
from fgloc.perception.square_pose import square_poses
from fgloc.smoother.codes import smooth_codes
from fgloc.smoother.codes_build import START_READS
from fgloc.smoother.codes_sightings import BIASES
from fgloc.smoother.ranges_start import optimize
from fgloc.verdicts import Verdict

from .code_drives import assert_gradients_are_differences, error_m, mean_nees, model_of
from .code_drives import drive as plain_drive

CASES = (("left", 30.0), ("right", 0.0), ("near", 0.0))


def drive(seed=0, path="middle", yaw_deg=30.0, corners=True, **options):
    return plain_drive(seed, path, yaw_deg, corners=corners, **options)


def with_corners(one, corners_px):
    codes = dataclasses.replace(one.tables["smart_codes"], corners_px=corners_px)
    return one.with_tables(smart_codes=codes)


def half_without(one):
    """Every other sighting without its corners."""
    corners = one.tables["smart_codes"].corners_px.copy()
    corners[::2] = np.nan
    return with_corners(one, corners)


def mean_error_m(one, lag_s) -> float:
    return np.linalg.norm(error_m(one, smooth_codes(one, lag_s).trajectory), axis=1).mean()


def test_gradients_are_the_differences_of_the_cost():
    assert_gradients_are_differences(model_of(half_without(drive())))


def test_without_noise_the_camera_is_found():
    one = drive(corner_sigma_px=0.0, quantised=False)
    assert np.abs(error_m(one, smooth_codes(one).trajectory)).max() < 0.05


def places_by_square_poses(one) -> np.ndarray:
    """(10, 2, 2) East and North by the first sightings, for both poses of each."""
    codes, camera = one.tables["smart_codes"], one.rig.camera
    places = []
    for number, corners in zip(codes.sign[:START_READS], codes.corners_px, strict=False):
        sign = one.infrastructure.signs[number]
        poses = square_poses(corners, sign.size_m, camera.focal_px, camera.principal_px)
        right_out = poses.p_code_cam_m[:, [0, 2]]
        places.append(sign.p_world_m[:2] + right_out @ sign.R_world_sign[:, ::-1].T)
    return np.array(places)


@pytest.mark.parametrize(("path", "yaw_deg"), CASES)
def test_from_either_pose_of_the_square_it_settles_on_the_same_path(path, yaw_deg):
    one = drive(1, path, yaw_deg)
    model, places = model_of(one), places_by_square_poses(one).mean(0)
    apart = np.linalg.norm(places[0] - places[1])
    assert apart > 1.0
    (a, _, cost_a), (b, _, cost_b), (own, _, cost) = (
        optimize(other, other.first_path(), other.prior[0])
        for other in (*(dataclasses.replace(model, start_m=p) for p in places), model)
    )
    np.testing.assert_allclose([cost_a, cost_b], cost, rtol=1e-3)
    np.testing.assert_allclose(np.stack([a, b]), np.stack([own, own]), atol=0.01)


def test_corners_bring_both_graphs_nearer_to_the_truth():
    told = [
        [mean_error_m(drive(seed, path, yaw_deg, corners), lag_s)
         for corners in (False, True) for lag_s in (5.0, None)]
        for seed in range(2) for path, yaw_deg in CASES[::2]
    ]  # fmt: skip
    lag, batch, lag_by_corners, batch_by_corners = np.mean(told, axis=0)
    assert lag_by_corners < 0.7 * lag
    assert batch_by_corners < 0.8 * batch


def test_the_covariance_is_about_that_of_the_errors():
    assert 0.3 < np.mean([mean_nees(drive(seed)) for seed in range(4)]) < 1.7


def test_a_side_that_is_longer_than_its_record_is_found():
    one = drive(path="left")
    signs = tuple(dataclasses.replace(sign, size_m=sign.size_m / 1.01) if i == 0 else sign
                  for i, sign in enumerate(one.infrastructure.signs))  # fmt: skip
    wrong = dataclasses.replace(one, infrastructure=Infrastructure(signs=signs))
    found = [smooth_codes(d).summary["codes"]["side_share"][0] for d in (one, wrong)]
    assert found[1] - found[0] == pytest.approx(0.01, abs=0.003)


def test_sightings_with_and_without_corners_share_a_graph():
    one = half_without(drive())
    result = smooth_codes(one)
    codes = result.summary["codes"]
    assert (len(codes["range_bias_m"]), len(codes["side_share"])) == (2, 2)
    assert len(model_of(one).prior[0]) == BIASES + 4
    assert sum(result.summary["counts"]["smart_codes"].values()) == len(one.tables["smart_codes"])
    assert np.linalg.norm(error_m(one, result.trajectory), axis=1).mean() < 0.1


def test_corners_serve_where_the_size_says_too_near():
    one = drive()
    codes = one.tables["smart_codes"]
    height_px = np.where(np.arange(len(codes)) == 40, 5000.0, codes.height_px)
    high = one.with_tables(smart_codes=dataclasses.replace(codes, height_px=height_px))
    sized = with_corners(high, np.full_like(codes.corners_px, np.nan))
    by_size, by_corners = (smooth_codes(d).verdicts["smart_codes"] for d in (sized, high))
    assert (by_size.is_(Verdict.UNUSED)[40], by_size.reason[40]) == (True, "too near")
    assert by_corners.is_(Verdict.USED)[40]


def test_corners_that_were_misread_are_told_from_the_others():
    one = drive()
    corners = one.tables["smart_codes"].corners_px.copy()
    corners[40, 2] += [6.0, -4.0]
    verdicts = smooth_codes(with_corners(one, corners)).verdicts["smart_codes"]
    assert verdicts.is_(Verdict.DOWN_WEIGHTED)[40]
    assert verdicts.is_(Verdict.DOWN_WEIGHTED).mean() < 0.05
