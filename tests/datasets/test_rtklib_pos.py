"""Solution files of RTKLIB."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fgloc.datasets.rtklib_pos import _covariances, import_rtklib_pos
from fgloc.errors import DriveError

ABOUT = (
    "% program   : rnx2rtkp ver.2.4.3\n% obs start : 2026/09/15 08:49:49.0 GPST\n%\n"
    "% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,5:single,ns=# of satellites)\n"
)
NAMES = (
    "%  GPST          latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)"
    "  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio\n"
)
ROWS = (
    "2436 204589.000   44.470303520   90.294603461   613.3524   2  21   3.0000   2.0000   4.0000"
    "   1.0000  -0.5000  -1.5000   0.00    0.0\n"
    "2436 204601.250   44.470302864   90.294602471   615.8615   1  19   0.0034   0.0031   0.0099"
    "   0.0009  -0.0028  -0.0019   0.00    5.1\n"
)
POS = ABOUT + NAMES + ROWS


@pytest.fixture
def solution(tmp_path):
    def write(text: str):
        path = tmp_path / "rover.pos"
        path.write_text(text)
        return path

    return write


def calendar(text: str) -> str:
    """The same solution with its times as dates, which are those of GPS week 2436."""
    return text.replace("2436 204589.000", "2026/09/15 08:49:49.000").replace(
        "2436 204601.250", "2026/09/15 08:50:01.250"
    )


def test_golden_row_of_a_solution_in_gps_time(solution):
    drive = import_rtklib_pos(solution(POS))
    assert drive.gnss.t_ns.tolist() == [1_789_462_171_000_000_000, 1_789_462_183_250_000_000]
    assert (drive.origin.lat_deg, drive.origin.lon_deg) == (44.47030352, 90.294603461)
    assert (drive.origin.height_m, drive.origin.datum) == (613.3524, "ellipsoid")
    np.testing.assert_allclose(
        drive.gnss.cov_world_m2[0], [[4, 1, -0.25], [1, 9, -2.25], [-0.25, -2.25, 16]]
    )
    assert np.isnan(drive.gnss.v_world_mps).all()
    assert drive.about.source == "rover.pos; no rows were left out"


@pytest.mark.parametrize(("scale", "ahead_s"), [("GPST", 18), ("UTC ", 0), ("JST ", 32_400)])
def test_each_time_scale_becomes_posix_time(solution, scale, ahead_s):
    drive = import_rtklib_pos(solution(calendar(POS).replace("%  GPST", f"%  {scale}")))
    utc_ns = int(np.datetime64("2026-09-15T08:49:49", "ns").astype(np.int64))
    assert int(drive.gnss.t_ns[0]) == utc_ns - ahead_s * 10**9


def test_commas_between_the_columns_are_read_alike(solution):
    commas = "\n".join(",".join(line.split()) for line in ROWS.splitlines())
    names = "%  GPST," + ",".join(NAMES.split()[2:]) + "\n"
    apart = import_rtklib_pos(solution(ABOUT + names + commas))
    assert apart.gnss.same_as(import_rtklib_pos(solution(POS)).gnss)


def test_velocities_are_taken_where_there_are_some(solution):
    rows = "".join(f"{line} 1.5 2.5 -0.5\n" for line in ROWS.splitlines())
    names = NAMES.rstrip() + "    vn(m/s)    ve(m/s)    vu(m/s)\n"
    drive = import_rtklib_pos(solution(ABOUT + names + rows))
    np.testing.assert_array_equal(drive.gnss.v_world_mps, [[2.5, 1.5, -0.5]] * 2)


def test_geodetic_heights_are_above_mean_sea_level(solution):
    drive = import_rtklib_pos(solution(POS.replace("WGS84/ellipsoidal", "WGS84/geodetic")))
    assert drive.origin.datum == "msl"


def test_what_is_left_out_is_counted_by_its_reason(solution):
    none, single, flat = (
        ROWS.splitlines()[1].replace("   1  19", f"   {q}  19").replace("0.0031", sigma) + "\n"
        for q, sigma in ((0, "0.0031"), (5, "0.0031"), (1, "0.0000"))
    )
    drive = import_rtklib_pos(solution(POS + none + single + flat), worst_quality=2)
    assert len(drive.gnss) == 2
    assert drive.about.source.endswith(
        "left out: rows without a solution (1), rows of a quality above 2 (1), "
        "fixes whose covariance is not positive definite (1)"
    )


@given(st.lists(st.floats(-100, 100), min_size=6, max_size=6))
def test_covariances_are_squares_with_the_sign_of_the_root(roots):
    names = ("sde(m)", "sdn(m)", "sdu(m)", "sdne(m)", "sdeu(m)", "sdun(m)")
    one = {name: np.array([root]) for name, root in zip(names, roots, strict=True)}
    (cov,) = _covariances(one)
    signed = [cov[0, 0], cov[1, 1], cov[2, 2], cov[0, 1], cov[0, 2], cov[1, 2]]
    np.testing.assert_allclose(np.sign(signed) * np.sqrt(np.abs(signed)), roots, atol=1e-150)
    np.testing.assert_array_equal(cov, cov.T)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (NAMES, "", r"rover.pos: no header that names GPST, UTC or JST"),
        (
            "latitude(deg)",
            "latitude(d'\")",
            r"no column latitude\(deg\); degrees, minutes and seconds",
        ),
        (
            "latitude(deg)",
            "x-ecef(m)",
            r"no column latitude\(deg\); write it with out-solformat=llh",
        ),
        ("  sdne(m)", "", r"the header has no column sdne\(m\); needed are latitude\(deg\)"),
        ("   0.00    5.1", "", r"rover.pos:7: 13 values, expected 15 .* is the line cut off\?"),
        ("615.8615", "x", r"rover.pos:7: height\(m\) = 'x' is not a number"),
        ("615.8615", "nan", r"rover.pos:7: height\(m\) = nan is not finite"),
        ("44.470302864", "94.470302864", r"rover.pos:7: lat_deg = 94.470302864 is outside"),
        ("204601.250", "204501.250", r"rover.pos:7: t_ns = \d+ goes back by 87750000000 ns"),
        (
            "204601.250",
            "2046o1.250",
            r"rover.pos:7: seconds of the week = '2046o1.250' is not a num",
        ),
        (
            "2436 204601.250",
            "2026/13/15 08:50:01",
            r"rover.pos:7: 2026/13/15 08:50:01 is not a date",
        ),
        (ROWS, "", "holds no solutions, only a header"),
    ],
)
def test_faults_name_file_line_and_remedy(solution, old, new, message):
    with pytest.raises(DriveError, match=message):
        import_rtklib_pos(solution(POS.replace(old, new)))


def test_a_file_without_a_good_solution_is_told(solution):
    with pytest.raises(DriveError, match="holds no usable fix"):
        import_rtklib_pos(solution(POS), worst_quality=0)


def test_gps_weeks_before_the_epoch_are_told(solution):
    with pytest.raises(DriveError, match=r"rover.pos: .* before GPS time"):
        import_rtklib_pos(solution(calendar(POS).replace("2026/", "1979/")))
