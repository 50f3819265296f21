"""The map from box centres to the road: the printed weights, its edges, and how far to trust it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fgloc.datasets.calibration_set import read_calibration, write_calibration
from fgloc.errors import DriveError, InputError
from fgloc.perception.idw import Calibration, IdwMap
from fgloc.perception.map_error import LEAST_SIGMA_M, ErrorMap, left_out
from fgloc.perception.pixel_maps import HomographyMap, LinearMap

SQUARE_PX = np.array([[0.0, 0], [10, 0], [0, 10], [10, 10]])
PROJECTION = np.array([[0.1, 0.02, 3.0], [0.01, 0.2, -5.0], [0.0001, 0.002, 1.0]])


def projected(u_px):
    mapped = np.c_[u_px, np.ones(len(u_px))] @ PROJECTION.T
    return mapped[:, :2] / mapped[:, 2:]


def road(n: int = 400, seed: int = 0, noise_m: float = 0.0) -> Calibration:
    rng = np.random.default_rng(seed)
    u_px = rng.uniform(0, 500, (n, 2))
    return Calibration(u_px, projected(u_px) + noise_m * rng.standard_normal((n, 2)))


MAPS = (IdwMap, HomographyMap, LinearMap)


def test_weights_are_those_of_the_printed_equations():
    places = np.array([[0.0, 0], [1, 0], [0, 1], [1, 1]])
    found = IdwMap(Calibration(SQUARE_PX, places), power=2).place([[3.0, 0.0]])
    inverse = 1 / np.array([9.0, 49, 109, 149])  # squared distances, p = 2
    np.testing.assert_allclose(found[0], inverse / inverse.sum() @ places)


@pytest.mark.parametrize("power", [1.5, 5, 40])
def test_at_a_calibration_point_the_map_is_exact(power):
    calibration = road()
    found = IdwMap(calibration, power).place(calibration.u_px)
    np.testing.assert_allclose(found, calibration.p_world_m, atol=1e-12)


@given(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4), st.floats(1.01, 60))
def test_a_mean_never_leaves_the_hull_of_the_positions(u, v, power):
    calibration = road(60)
    found = IdwMap(calibration, power).place([[u, v]])[0]
    assert (found >= calibration.p_world_m.min(0) - 1e-9).all()
    assert (found <= calibration.p_world_m.max(0) + 1e-9).all()


def test_a_great_power_takes_the_nearest_point():
    found = IdwMap(Calibration(SQUARE_PX, SQUARE_PX), power=60).place([[3.0, 2.0]])
    np.testing.assert_allclose(found, [[0, 0]], atol=1e-6)


def test_one_centre_with_two_places_is_their_mean():
    u_px, p = np.r_[SQUARE_PX, SQUARE_PX[:1]], np.r_[SQUARE_PX, [[2.0, 4.0]]]
    np.testing.assert_allclose(IdwMap(Calibration(u_px, p)).place([[0.0, 0.0]]), [[1, 2]])


def test_neighbours_beyond_the_nearest_hardly_weigh_at_the_thesis_power():
    calibration, asked = road(), np.random.default_rng(1).uniform(100, 400, (50, 2))
    near, all_of_them = IdwMap(calibration), IdwMap(calibration, neighbours=400)
    change_m = near.place(asked) - all_of_them.place(asked)
    assert np.sqrt(np.mean(change_m**2)) < 0.02


def test_centres_outside_of_the_calibrated_image_are_told():
    one = IdwMap(road())
    inside = one.inside([[250.0, 250], [900, 250], [-400, -400]])
    np.testing.assert_array_equal(inside, [True, False, False])


def test_a_denser_calibration_errs_less():
    asked = np.random.default_rng(1).uniform(50, 450, (300, 2))
    rmse = [
        np.sqrt(np.mean((IdwMap(road(n)).place(asked) - projected(asked)) ** 2))
        for n in (50, 400, 3200)
    ]
    assert rmse[0] > 1.5 * rmse[1] > 1.5 * rmse[2]


@pytest.mark.parametrize("kind", [HomographyMap, LinearMap])
def test_the_other_maps_have_the_same_interface(kind):
    calibration = road(200)
    asked = np.random.default_rng(1).uniform(100, 400, (50, 2))
    np.testing.assert_allclose(kind(calibration).place(asked), projected(asked), atol=0.6)


def test_a_homography_is_exact_where_the_camera_is_one():
    asked = np.random.default_rng(1).uniform(0, 500, (50, 2))
    np.testing.assert_allclose(HomographyMap(road()).place(asked), projected(asked), atol=1e-6)


def test_linear_interpolation_knows_nothing_outside_of_its_points():
    assert np.isnan(LinearMap(road()).place([[900.0, 900.0]])).all()


@pytest.mark.parametrize("kind", MAPS)
def test_leaving_one_out_is_a_map_of_the_others(kind):
    calibration, row = road(40), 7
    others = np.arange(40) != row
    rest = Calibration(calibration.u_px[others], calibration.p_world_m[others])
    np.testing.assert_allclose(
        kind(calibration).without_own()[row], kind(rest).place(calibration.u_px[[row]])[0],
        atol=1e-9,
    )  # fmt: skip


def test_with_numbered_passes_all_of_a_points_own_pass_is_left_out():
    calibration, run = road(40), np.arange(40) % 4
    numbered = Calibration(calibration.u_px, calibration.p_world_m, run)
    placed, own = left_out(IdwMap, numbered), run == 2
    others = IdwMap(calibration.take(~own))
    np.testing.assert_array_equal(placed[own], others.place(calibration.u_px[own]))


def test_the_covariance_is_that_of_the_errors_left_out():
    calibration = road(3000, noise_m=0.4)
    errors = ErrorMap.of(IdwMap, calibration, neighbours=300)
    cov = errors.covariance_m2([[250.0, 250.0]])[0]
    # A mean of several noisy positions less a noisy one: between 1 and 2 times 0.4 m squared,
    # and a little for the map's own error between points.
    assert 0.16 < cov[0, 0] < 0.4
    assert 0.16 < cov[1, 1] < 0.4


def test_the_covariance_is_positive_even_where_nothing_errs():
    calibration = Calibration(SQUARE_PX, np.zeros((4, 2)))
    cov = ErrorMap.of(IdwMap, calibration).covariance_m2([[5.0, 5.0]])
    np.testing.assert_allclose(cov, [LEAST_SIGMA_M**2 * np.eye(2)])


@pytest.mark.parametrize(
    ("u_px", "p", "says"),
    [
        (SQUARE_PX[:3], SQUARE_PX[:3], "3 pairs; at least 4"),
        (SQUARE_PX, SQUARE_PX[:3], r"both must be \(N, 2\)"),
        (SQUARE_PX, np.full((4, 2), np.nan), "pair 0 is not finite"),
    ],
)
def test_a_calibration_that_is_none_is_refused(u_px, p, says):
    with pytest.raises(InputError, match=says):
        Calibration(u_px, p)


@pytest.mark.parametrize(("option", "says"), [({"power": 1.0}, "power = 1"),
                                              ({"neighbours": 0}, "neighbours = 0")])  # fmt: skip
def test_a_map_of_impossible_options_is_refused(option, says):
    with pytest.raises(InputError, match=says):
        IdwMap(road(), **option)


def test_centres_on_one_line_give_no_linear_map():
    line = np.c_[np.arange(5.0), np.arange(5.0)]
    with pytest.raises(InputError, match="on one line"):
        LinearMap(Calibration(line, line)).place([[1.0, 1.0]])


def test_a_calibration_file_is_read_back_exactly(tmp_path):
    calibration = road()
    write_calibration(calibration, tmp_path / "camera.csv")
    again = read_calibration(tmp_path / "camera.csv")
    np.testing.assert_array_equal(again.u_px, calibration.u_px)
    np.testing.assert_array_equal(again.p_world_m, calibration.p_world_m)
    assert again.run is None


def test_a_calibration_file_keeps_the_passes(tmp_path):
    calibration = Calibration(SQUARE_PX, SQUARE_PX, np.array([0, 0, 1, 1]))
    write_calibration(calibration, tmp_path / "camera.csv")
    np.testing.assert_array_equal(read_calibration(tmp_path / "camera.csv").run, [0, 0, 1, 1])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("u_px,v_px,east_m,north_m\n1,2,3,nan\n", "camera.csv:2: north_m is nan"),
        ("u_px,v_px,east_m,north_m\n1,2,3,4\n", "camera.csv: calibration: 1 pairs"),
        ("u_px,v_px,east_ft,north_ft\n1,2,3,4\n", "unknown unit 'ft' in column 'east_ft'"),
        ("u_px,v_px,east_m\n1,2,3\n", "missing column north_m"),
        ("u_px,v_px,east_m,north_m\n1,2,3,x\n", "camera.csv:2: north_m = 'x' is not a number"),
    ],
)
def test_a_faulty_calibration_file_is_refused_by_place(tmp_path, text, says):
    (tmp_path / "camera.csv").write_text(text)
    with pytest.raises(DriveError, match=says):
        read_calibration(tmp_path / "camera.csv")
