"""Logs of NMEA-0183 sentences."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fgloc.datasets.nmea import import_nmea
from fgloc.datasets.nmea_sentences import Sentence, angle_deg, checksum_of, parse
from fgloc.errors import DriveError, InputError
from fgloc.timing import iso_utc


def log(*bodies: str) -> str:
    return "".join(f"${body}*{checksum_of(body)}\r\n" for body in bodies)


def gga(time="193404.25", lat="4005.7980,N", lon="10508.8469,W", quality=4, hdop="0.8",
        heights="1600.0,M,-17.0,M", talker="GN") -> str:  # fmt: skip
    return f"{talker}GGA,{time},{lat},{lon},{quality},12,{hdop},{heights},,"


def rmc(time="193404.25", date="080725", status="A") -> str:
    return f"GNRMC,{time},{status},4005.7980,N,10508.8469,W,0.1,90.0,{date},,,A"


@pytest.fixture
def file(tmp_path):
    def write(text: str):
        path = tmp_path / "log.nmea"
        path.write_bytes(text.encode("latin-1"))
        return path

    return write


def imported(file, *bodies: str, **options):
    return import_nmea(file(log(*bodies)), **options)


def stamps(drive) -> list[str]:
    return [iso_utc(int(t)) for t in drive.gnss.t_ns]


def test_the_checksum_is_that_of_a_manual():
    body = "GPGGA,092725.00,4717.11399,N,00833.91590,E,1,08,1.01,499.6,M,48.0,M,,"
    assert checksum_of(body) == "5B"


def test_a_fix_lies_above_the_ellipsoid_on_its_day(file):
    drive = imported(file, gga(), rmc())
    assert stamps(drive) == ["2025-07-08T19:34:04.250Z"]
    assert drive.origin.lat_deg == pytest.approx(40 + 5.798 / 60, abs=1e-12)
    assert drive.origin.lon_deg == pytest.approx(-105 - 8.8469 / 60, abs=1e-12)
    assert (drive.origin.height_m, drive.origin.datum) == (1583.0, "ellipsoid")
    assert drive.about.source == "log.nmea; sentences not used: none; no rows were left out"


def test_midnight_may_pass_before_the_next_rmc(file):
    drive = imported(file, gga("235959.50"), rmc("235959.50"), gga("000000.00"), gga("000000.50"),
                     rmc("000000.50", "090725"))  # fmt: skip
    assert stamps(drive) == [
        "2025-07-08T23:59:59.500Z", "2025-07-09T00:00:00.000Z", "2025-07-09T00:00:00.500Z",
    ]  # fmt: skip


def test_a_log_without_rmc_needs_the_day_of_its_first_fix(file):
    bodies = gga("235959.50"), gga("000000.50")
    with pytest.raises(DriveError, match="no valid RMC sentence tells the date; give it: --set"):
        imported(file, *bodies, rmc(status="V"))
    assert stamps(imported(file, *bodies, date="2024-02-28")) == [
        "2024-02-28T23:59:59.500Z", "2024-02-29T00:00:00.500Z",
    ]  # fmt: skip
    with pytest.raises(DriveError, match="option date: tomorrow 00:00:00 is not a date"):
        imported(file, *bodies, date="tomorrow")


def test_years_from_eighty_on_are_of_the_last_century(file):
    assert stamps(imported(file, gga(), rmc(date="311299")))[0].startswith("1999-12-31")


def test_the_error_ellipse_is_turned_from_north_over_east(file):
    gst = "GNGST,193404.25,1,5,3,30,4.5,3.5,7"
    (cov,) = imported(file, gga(), rmc(), gst).gnss.cov_world_m2
    root3 = np.sqrt(3)
    np.testing.assert_allclose(cov, [[13, 4 * root3, 0], [4 * root3, 21, 0], [0, 0, 49]])


def test_without_an_ellipse_latitude_is_north_and_longitude_east(file):
    (cov,) = imported(file, gga(), rmc(), "GNGST,193404.25,1,,,,2,3,4").gnss.cov_world_m2
    np.testing.assert_allclose(cov, np.diag([9.0, 4.0, 16.0]))


def test_without_gst_of_the_same_time_hdop_decides(file):
    other = "GNGST,193404.00,1,,,,2,3,4", "GNGST,193404.25,,,,,,,"
    (cov,) = imported(file, gga(hdop="2"), rmc(), *other, uere_m=5.0).gnss.cov_world_m2
    np.testing.assert_allclose(cov, np.diag([50.0, 50.0, 225.0]))


def test_without_any_separation_heights_stay_above_mean_sea_level(file):
    origin = imported(file, gga(heights="1600.0,M,,M"), rmc()).origin
    assert (origin.height_m, origin.datum) == (1600.0, "msl")


def test_all_that_is_not_used_is_counted(file):
    bodies = (
        rmc(), gga(), gga("193404.50", quality=0), gga("193404.60", quality=6),
        gga("193404.75", lat=",", lon=","),
        gga("193405.00", heights="1600.0,M,,M"), gga("193405.25", hdop=""),
        gga("193405.50"), "GNHDT,93.1,T", "GPGSV,1,1,00", "GPGSV,1,1,00",
    )  # fmt: skip
    text = log(*bodies).replace("193405.50", "193405.60") + "\x00\xff garbage\r\n$GPGGA,no star\r\n"
    drive = import_nmea(file(text))
    assert len(drive.gnss) == 1
    assert drive.about.source == (
        "log.nmea; sentences not used: GSV (2), HDT (1); left out: lines with a wrong or no "
        "checksum (3), GGA without a valid fix (3), GGA without a geoid separation (1), "
        "fixes whose covariance is not positive definite (1)"
    )


@pytest.mark.parametrize(
    ("bodies", "message"),
    [
        (
            (rmc(), gga(lat="4065.0,N")),
            r"log.nmea:2: GGA latitude = 4065.0,N is not degrees and minut",
        ),
        ((rmc(), gga(lat="4005.0,X")), r"log.nmea:2: GGA latitude = 4005.0,X .* with N or S"),
        ((rmc(), gga(lat="9905.0,N")), r"log.nmea:2: lat_deg = 99.08\d+ is outside"),
        ((rmc(), gga(lon="1o508.0,W")), r"log.nmea:2: GGA longitude = '1o508.0' is not a number"),
        (
            (rmc(), gga(time="253404.25")),
            r"log.nmea:2: 1970-01-01 25:34:04.25 is not a date and time",
        ),
        ((rmc(), gga(time="")), r"log.nmea:2: GGA time = '' is not hhmmss.ss"),
        ((rmc(), gga(time="193461.00")), r"log.nmea:2: 1970-01-01 19:34:61.00 is not a date"),
        ((rmc(date="8725"), gga()), r"log.nmea:1: RMC date = '8725' is not ddmmyy"),
        ((rmc(date="320725"), gga()), r"log.nmea:1: 2025-07-32 00:00:00 is not a date"),
        ((rmc(), gga(hdop="low")), r"log.nmea:2: GGA HDOP = 'low' is not a number"),
        ((rmc(), gga("193405.00"), gga()), r"log.nmea:3: t_ns = \d+ goes back by 750000000 ns"),
        ((rmc(), gga(quality=0)), r"log.nmea: holds no usable fix"),
        ((rmc(),), r"no GGA sentence with a right checksum in 1 lines"),
    ],
)
def test_faults_name_line_field_and_remedy(file, bodies, message):
    with pytest.raises(DriveError, match=message):
        imported(file, *bodies)


def test_a_range_error_of_zero_is_refused(file):
    with pytest.raises(InputError, match=r"uere_m = 0.0: a standard deviation above 0 m"):
        imported(file, gga(), rmc(), uere_m=0.0)


@given(st.text())
def test_no_text_makes_the_parser_stumble(tmp_path_factory, text):
    found = parse(tmp_path_factory.getbasetemp(), 1, text)
    assert found is None or checksum_of(text.rpartition("$")[2].partition("*")[0])


@given(st.floats(0, 89.999), st.sampled_from("NS"))
def test_degrees_and_minutes_are_read_back(tmp_path_factory, angle, hemisphere):
    degrees, minutes = int(angle), (angle - int(angle)) * 60
    fields = ("", f"{degrees:02d}{minutes:08.5f}", hemisphere)
    sentence = Sentence(tmp_path_factory.getbasetemp(), 1, "GGA", fields)
    if not fields[1].endswith("60.00000"):
        sign = 1 if hemisphere == "N" else -1
        assert angle_deg(sentence, 2, "latitude", "NS") == pytest.approx(sign * angle, abs=1e-7)
