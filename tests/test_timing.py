"""Time: leap seconds to the second, stamps to the nanosecond."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fgloc.errors import InputError
from fgloc.timing import (
    GPS_EPOCH_UNIX_S,
    LEAP_TABLE_EXPIRES_UNIX_S,
    NS_PER_S,
    WEEK_S,
    decimal_to_ns,
    elapsed_s,
    gps_minus_utc_s,
    gps_to_utc_ns,
    gps_week_to_ns,
    iso_utc,
    ns_to_decimal,
    seconds_to_ns,
    tai_to_utc_ns,
    utc_to_gps_ns,
    utc_to_tai_ns,
)

INT64 = st.integers(-(2**63), 2**63 - 1)
LEAPS = (  # the second from which GPS - UTC holds, from the list of IERS Bulletin C
    ("1980-01-06", 0), ("1981-07-01", 1), ("1982-07-01", 2), ("1983-07-01", 3), ("1985-07-01", 4),
    ("1988-01-01", 5), ("1990-01-01", 6), ("1991-01-01", 7), ("1992-07-01", 8), ("1993-07-01", 9),
    ("1994-07-01", 10), ("1996-01-01", 11), ("1997-07-01", 12), ("1999-01-01", 13),
    ("2006-01-01", 14), ("2009-01-01", 15), ("2012-07-01", 16), ("2015-07-01", 17),
    ("2017-01-01", 18),
)  # fmt: skip


def unix_s(date: str) -> int:
    return int(np.datetime64(date, "s").astype(np.int64))


@pytest.mark.parametrize(("date", "offset_s"), LEAPS)
def test_a_leap_second_counts_from_its_midnight_on(date, offset_s):
    assert gps_minus_utc_s(unix_s(date)) == offset_s


@pytest.mark.parametrize(("date", "offset_s"), LEAPS[1:])
def test_a_leap_second_does_not_count_a_second_too_early(date, offset_s):
    assert gps_minus_utc_s(unix_s(date) - 1) == offset_s - 1


def test_no_gps_time_before_its_epoch():
    with pytest.raises(InputError, match="before GPS time began"):
        gps_minus_utc_s(GPS_EPOCH_UNIX_S - 1)


def test_week_2374_begins_eighteen_seconds_before_its_sunday_in_utc():
    (t_ns,) = gps_week_to_ns(2374, [0.0])
    assert iso_utc(int(t_ns)) == "2025-07-05T23:59:42.000Z"


def test_gps_time_begins_with_posix_second_315964800():
    assert gps_week_to_ns(0, 0.0) == GPS_EPOCH_UNIX_S * NS_PER_S


@pytest.mark.parametrize(("date", "offset_s"), LEAPS[1:])
def test_gps_stamps_around_a_leap_second_lie_on_their_own_side_of_it(date, offset_s):
    week, sow_s = divmod(unix_s(date) + offset_s - GPS_EPOCH_UNIX_S, WEEK_S)
    assert gps_week_to_ns(week, sow_s) == unix_s(date) * NS_PER_S
    # One GPS second earlier is the leap second itself, 23:59:60, which POSIX gives no number of
    # its own; two earlier is 23:59:59.
    assert gps_week_to_ns(week, sow_s - 2.0) == (unix_s(date) - 1) * NS_PER_S


SINCE_GPS = st.integers(GPS_EPOCH_UNIX_S * NS_PER_S, 2**62)


@pytest.mark.parametrize(
    ("utc", "gps_s", "tai_s"),
    [
        ("1980-01-06T00:00:00", 0, 315_964_819),
        ("2016-12-31T23:59:59", 1_167_264_016, 1_483_228_835),
        ("2017-01-01T00:00:00", 1_167_264_018, 1_483_228_837),
        ("2025-07-08T19:34:04", 1_436_038_462, 1_752_003_281),
    ],
)
def test_known_instants_on_all_three_scales(utc, gps_s, tai_s):
    posix_ns = int(np.datetime64(utc, "ns").astype(np.int64))
    assert utc_to_gps_ns(posix_ns) == gps_s * NS_PER_S
    assert utc_to_tai_ns(posix_ns) == tai_s * NS_PER_S
    assert gps_to_utc_ns(gps_s * NS_PER_S) == posix_ns
    assert tai_to_utc_ns(tai_s * NS_PER_S) == posix_ns


def test_the_leap_second_of_2016_has_the_numbers_of_the_second_after_it():
    inside, after = 1_167_264_017_250_000_000, 1_167_264_018_250_000_000
    assert gps_to_utc_ns(inside) == gps_to_utc_ns(after) == 1_483_228_800_250_000_000


@given(SINCE_GPS)
def test_utc_to_gps_or_tai_and_back_is_the_same_instant(t_ns):
    assert gps_to_utc_ns(utc_to_gps_ns(t_ns)) == t_ns
    assert tai_to_utc_ns(utc_to_tai_ns(t_ns)) == t_ns


@given(SINCE_GPS)
def test_tai_is_nineteen_seconds_ahead_of_gps_always(t_ns):
    assert utc_to_tai_ns(t_ns) - utc_to_gps_ns(t_ns) == (GPS_EPOCH_UNIX_S + 19) * NS_PER_S


@pytest.mark.parametrize(
    ("convert", "stamp"),
    [(gps_to_utc_ns, -1), (utc_to_gps_ns, GPS_EPOCH_UNIX_S * NS_PER_S - 1),
     (tai_to_utc_ns, 0), (utc_to_tai_ns, 0)],
)  # fmt: skip
def test_no_conversion_before_the_table_begins(convert, stamp):
    with pytest.raises(InputError, match=r"ns lies before .* began \(1980-01-06\)"):
        convert([stamp])


def test_stamps_that_are_floats_are_refused():
    with pytest.raises(InputError, match="float64: give whole nanoseconds"):
        gps_to_utc_ns([1e9])


def test_the_table_of_leap_seconds_says_until_when_it_holds():
    assert unix_s("2026-06-28") == LEAP_TABLE_EXPIRES_UNIX_S


def test_seconds_of_week_with_six_decimals_are_exact_to_the_nanosecond():
    t_ns = gps_week_to_ns(2374, [604_799.999999, 243_262.000001])
    assert (t_ns % NS_PER_S).tolist() == [999_999_000, 1_000]


@given(INT64)
def test_decimal_seconds_and_back_is_the_same_instant(t_ns):
    assert decimal_to_ns(ns_to_decimal(t_ns)) == t_ns


@pytest.mark.parametrize(
    ("t_ns", "text"),
    [
        (1_751_900_000_123_456_789, "1751900000.123456789"),
        (0, "0.000000000"),
        (-1, "-0.000000001"),
        (-1_500_000_000, "-1.500000000"),
    ],
)
def test_nanoseconds_are_written_as_decimal_seconds(t_ns, text):
    assert ns_to_decimal(t_ns) == text


@pytest.mark.parametrize(
    ("text", "t_ns"),
    [("1", 10**9), ("+1.5", 1_500_000_000), ("-.25", -250_000_000), ("7.", 7 * 10**9),
     (" 0.1\n", 10**8), ("-0.000000001", -1)],
)  # fmt: skip
def test_any_plain_decimal_is_read(text, t_ns):
    assert decimal_to_ns(text) == t_ns


@pytest.mark.parametrize(
    "text",
    ["", ".", "-", "1_0", "1.0_1", "1e9", "1.0000000001", "nan", "1.-5", "1.5.2", "0x1", "- 1",
     "\u0661", "1,5"],
)  # fmt: skip
def test_what_is_no_plain_decimal_is_refused(text):
    with pytest.raises(ValueError, match="not a decimal number of seconds"):
        decimal_to_ns(text)


def test_durations_are_subtracted_before_they_become_floats():
    start_ns = 1_751_900_000_123_456_789
    assert elapsed_s([start_ns + 1], start_ns).tolist() == [1e-9]


def test_a_duration_is_rounded_to_the_nearest_nanosecond():
    assert [seconds_to_ns(s) for s in (0.1, 2.5e-9, -1.0)] == [100_000_000, 2, -1_000_000_000]


@given(INT64)
def test_iso_text_is_numpys_to_the_millisecond(t_ns):
    expected = np.datetime64(t_ns // 1_000_000, "ms")
    assert iso_utc(t_ns) == f"{expected}Z"
