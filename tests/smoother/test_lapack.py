"""LAPACK by its address against scipy's own functions in Python."""

import subprocess
import sys

import numpy as np
import pytest
from scipy.linalg import cholesky_banded, solve_triangular

from fgloc.smoother import lapack

M, WIDTH = 12, 4


@pytest.fixture
def band():
    """Columns (12, 6) of a positive definite matrix, from the diagonal on down to 4 places below;
    the sixth place is not its own."""
    columns = np.random.default_rng(0).normal(size=(M, WIDTH + 2))
    columns[:, 0] = 10 + np.abs(columns).sum(1)
    return columns


def lower(columns):
    """The dense lower triangle (12, 12) of a band."""
    return sum(np.diag(columns[: M - k, k], -k) for k in range(WIDTH + 1))


def test_the_factor_of_a_band_is_scipys_and_its_other_places_are_left_alone(band):
    before = band.copy()
    assert lapack.factorize(band, WIDTH) == 0
    known = cholesky_banded(before[:, : WIDTH + 1].T, lower=True)
    np.testing.assert_allclose(lower(band), lower(known.T), rtol=1e-12)
    np.testing.assert_array_equal(band[:, WIDTH + 1], before[:, WIDTH + 1])


def test_the_first_column_that_is_not_positive_definite_is_told(band):
    band[7, 0] = -1.0
    assert lapack.factorize(band, WIDTH) == 8


@pytest.mark.parametrize("transposed", [False, True])
def test_both_triangles_are_solved_in_place_for_several_columns(band, transposed):
    columns = np.random.default_rng(1).normal(size=(3, M))
    known = solve_triangular(lower(band), columns.T, trans=transposed, lower=True)
    lapack.substitute(band, WIDTH, columns, transposed=transposed)
    np.testing.assert_allclose(columns.T, known, rtol=1e-12)


def test_an_array_that_lapack_would_misread_is_refused(band):
    with pytest.raises(ValueError, match="contiguous"):
        lapack.factorize(band[:, :-1], WIDTH)


LATER = """
import sys
from fgloc.smoother import lapack
assert "scipy.linalg" not in sys.modules, "all of scipy.linalg was imported"
import scipy.linalg, scipy.interpolate, scipy.optimize, scipy.spatial
assert scipy.linalg.cython_lapack is lapack.MODULE
assert scipy.linalg.cython_lapack.__pyx_capi__
"""


def test_lapack_comes_without_scipy_linalg_which_may_still_be_imported_afterwards():
    subprocess.run([sys.executable, "-c", LATER], check=True)


@pytest.mark.parametrize("there", ["scipy.linalg", "nothing to be loaded by itself"])
def test_lapack_is_found_in_its_usual_place_too(monkeypatch, there):
    from scipy.linalg import cython_lapack

    if there != "scipy.linalg":
        monkeypatch.delitem(sys.modules, "scipy.linalg")
        monkeypatch.setattr(lapack.PathFinder, "find_spec", lambda *asked: None)
    assert lapack._offered() is cython_lapack
