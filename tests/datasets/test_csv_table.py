"""Strict CSV tables: every bit comes back, every fault is named with its place and remedy."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgloc.datasets import arrow_csv, csv_table
from fgloc.datasets.columns import Group, Layout
from fgloc.datasets.csv_table import format_csv, read_csv, write_csv
from fgloc.datasets.parquet_table import read_table, write_table
from fgloc.errors import DriveError

LAYOUT = Layout(
    (
        Group.of("t_ns"),
        Group((("east_m", "north_m"), ("lat_deg", "lon_deg"))),
        Group.of("v_east_mps", required=False, may_be_empty=True),
    )
)
HEADER = "t_ns,east_m,north_m\n"
INT64 = np.iinfo(np.int64)

stamps = st.integers(INT64.min, INT64.max)
floats = st.floats(allow_nan=False, allow_infinity=False, allow_subnormal=True)
rows = st.lists(st.tuples(stamps, floats, floats, floats), min_size=1, max_size=20)


@pytest.fixture
def csv(tmp_path):
    """Writes a text to a file and gives its path."""

    def write(text: str | bytes) -> Path:
        path = tmp_path / "table.csv"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


def fault(path: Path) -> str:
    """The message that reading the file raises, the folder left out."""
    with pytest.raises(DriveError) as caught:
        read_csv(path, LAYOUT)
    return str(caught.value).replace(f"{path.parent}/", "")


def columns_of(table):
    t, east, north, v = zip(*table, strict=True)
    return {
        "t_ns": np.array(t, np.int64),
        "east_m": np.array(east),
        "north_m": np.array(north),
        "v_east_mps": np.array(v),
    }


@given(rows)
@settings(max_examples=200, deadline=None)
def test_what_is_written_is_read_back_bit_for_bit(tmp_path_factory, table):
    path = tmp_path_factory.getbasetemp() / "any.csv"
    columns = columns_of(table)
    write_csv(path, columns)
    again = read_csv(path, LAYOUT)
    assert list(again) == list(columns)
    for name, values in columns.items():
        assert again[name].dtype == values.dtype
        assert again[name].tobytes() == values.tobytes()
    assert format_csv(again) == path.read_text()
    raw = path.read_bytes()
    by_arrow = arrow_csv.parse(raw, raw.find(b"\n") + 1, list(columns))
    assert all(by_arrow[name].tobytes() == values.tobytes() for name, values in columns.items())


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("number", [0.0, -0.0, 5e-324, -5e-324, 2.2250738585072014e-308,
                                    1.7976931348623157e308, 0.1, 1 / 3])  # fmt: skip
def test_extreme_numbers_and_stamps_survive(tmp_path, suffix, number):
    path = tmp_path / f"table{suffix}"
    extremes = [INT64.min, -1, 2**53 + 1, 1_752_003_244_000_000_001, INT64.max]
    columns = columns_of([(t, number, -number, number) for t in extremes])
    write_table(path, columns)
    again = read_table(path, LAYOUT)
    assert all(again[name].tobytes() == columns[name].tobytes() for name in columns)


def test_the_order_of_columns_is_free(csv):
    table = read_csv(csv("north_m,t_ns,east_m\n3.5,1,2\n"), LAYOUT)
    assert (table["t_ns"][0], table["east_m"][0], table["north_m"][0]) == (1, 2.0, 3.5)


def test_spreadsheet_habits_are_taken(csv):
    table = read_csv(csv(b"\xef\xbb\xbft_ns, east_m, north_m\r\n1, 2, 3\r\n4, 5, 6\r\n"), LAYOUT)
    assert table["t_ns"].tolist() == [1, 4]
    assert table["north_m"].tolist() == [3.0, 6.0]


def test_a_last_line_without_newline_is_taken_when_whole(csv):
    assert read_csv(csv(HEADER + "1,2,3\n4,5,6"), LAYOUT)["north_m"].tolist() == [3.0, 6.0]


@pytest.mark.parametrize("at_once", [1, 7, 64, 1 << 20])
@pytest.mark.parametrize("rows", [1, 3, 50])
@pytest.mark.parametrize("end", ["", "\n", "\r\n"])
def test_it_does_not_matter_in_what_portions_a_file_is_parsed(csv, monkeypatch, at_once, rows, end):
    monkeypatch.setattr(csv_table, "_LARGE", 0)
    monkeypatch.setattr(arrow_csv, "AT_ONCE", at_once)
    monkeypatch.setattr(csv_table, "_parse_loosely", None)
    lines = [f"{10**18 + k},{k},{-k / 7!r}" for k in range(rows)]
    table = read_csv(csv(HEADER + (end or "\n").join(lines) + end), LAYOUT)
    assert table["t_ns"].tolist() == [10**18 + k for k in range(rows)]
    assert table["east_m"].tolist() == [float(k) for k in range(rows)]
    assert table["north_m"].tolist() == [-k / 7 for k in range(rows)]


@pytest.fixture(params=["numpy", "arrow", "arrow, line by line"])
def parser(request, monkeypatch):
    """Numpy reads as it does small files, or every file counts as large and Arrow reads it."""
    if request.param != "numpy":
        monkeypatch.setattr(csv_table, "_LARGE", 0)
    if request.param == "arrow, line by line":
        monkeypatch.setattr(arrow_csv, "AT_ONCE", 1)


@pytest.mark.usefixtures("parser")
@pytest.mark.parametrize("end", ["", "\n", "\r\n"])
def test_each_parser_reads_bit_for_bit(csv, end):
    numbers = [0.1, -0.0, 5e-324, 1.7976931348623157e308, 2.2250738585072014e-308, 1 / 3, -1e22]
    stamps = [INT64.min, 2**53 + 1, 1_752_003_244_000_000_001, INT64.max, 0, -1, 7]
    lines = [f"{t},{x!r},{-x!r}" for t, x in zip(stamps, numbers, strict=True)]
    table = read_csv(csv(HEADER + (end or "\n").join(lines) + end), LAYOUT)
    assert table["t_ns"].tolist() == stamps
    assert table["east_m"].tobytes() == np.array(numbers).tobytes()
    assert table["north_m"].tobytes() == (-np.array(numbers)).tobytes()


@pytest.mark.usefixtures("parser")
@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("1,2,3\n0x4,5,6\n", "table.csv:3: t_ns = '0x4' is not a whole number of nanoseconds"),
        ("1,2,3\n4,0x5,6\n", "table.csv:3: east_m = '0x5' is not a number"),
        ("1,2,3\n4,,6\n", "table.csv:3: east_m = '' is not a number"),
        ('1,2,3\n4,"5",6\n', "table.csv:3: east_m = '\"5\"' is not a number"),
        ("1,2,3\n4,NA,6\n", "table.csv:3: east_m = 'NA' is not a number"),
        ("1,2,3\n4,5,nan\n", "table.csv:3: north_m is nan"),
        ("1,2,3\n4,1e400,6\n", "table.csv:3: east_m is inf"),
        ("1,2,3\n4.0,5,6\n", "table.csv:3: t_ns = '4.0' is not a whole number of nanoseconds"),
        ("1,2,3\n4,5\n", "table.csv:3: 2 cells where the header names 3 columns"),
        ("1,2,3\n4,5,6,7\n", "table.csv:3: 4 cells where the header names 3 columns"),
        ("1,2,3\n\n4,5,6\n", "table.csv:3: the line is blank"),
    ],
)
def test_faults_are_told_alike_by_each_parser(csv, rows, message):
    assert fault(csv(HEADER + rows)).startswith(message)


@pytest.mark.usefixtures("parser")
@pytest.mark.parametrize("cell", ["+1.5", ".5", "5.", "007", "1e400", "inf"])
def test_numbers_are_read_however_they_are_written(csv, cell):
    table = csv(HEADER + f"1,{cell},3\n4,5,6\n")
    if np.isfinite(float(cell)):
        assert read_csv(table, LAYOUT)["east_m"].tolist() == [float(cell), 5.0]
    else:
        assert fault(table).startswith("table.csv:2: east_m is inf")


@pytest.mark.usefixtures("parser")
@pytest.mark.parametrize(
    "cell", ["true", "null", "[1]", '"1"', "{}", "1 2", "-", "NaN1", "0x10", "1_0"]
)
def test_what_is_no_number_is_refused(csv, cell):
    assert fault(csv(HEADER + f"1,2,3\n4,{cell},6\n")) == (
        f"table.csv:3: east_m = {cell!r} is not a number"
    )


def test_an_empty_cell_reads_as_nan_where_a_value_may_be_absent(csv):
    table = read_csv(csv("t_ns,east_m,north_m,v_east_mps\n1,2,3,\n4,5,6,7\n8,9,9,nan\n"), LAYOUT)
    np.testing.assert_array_equal(table["v_east_mps"], [np.nan, 7.0, np.nan])


def test_a_missing_file_is_named(tmp_path):
    assert fault(tmp_path / "nowhere.csv") == "nowhere.csv: no such file"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "table.csv: the file is empty; a line with column names is needed"),
        (HEADER, "table.csv: the table is empty (a header, no rows); delete the file instead"),
        (
            "t_ns,east_km,north_m\n1,2,3\n",
            "table.csv:1: unknown unit 'km' in column 'east_km'; want 'east_m'",
        ),
        (
            "t_s,east_m,north_m\n1,2,3\n",
            "table.csv:1: unknown unit 's' in column 't_s'; want 't_ns'",
        ),
        (
            "t_ns,easting,north_m\n1,2,3\n",
            "table.csv:1: unknown column 'easting'; the nearest valid name is 'east_m'",
        ),
        ("t_ns,east_m\n1,2\n", "table.csv:1: missing column north_m"),
        ("t_ns\n1\n", "table.csv:1: missing column east_m,north_m or lat_deg,lon_deg"),
        (
            "t_ns,east_m,north_m,lat_deg,lon_deg\n1,2,3,4,5\n",
            "table.csv:1: has columns of both east_m,north_m and lat_deg,lon_deg; "
            "keep one of the two",
        ),
        (
            "t_ns,east_m,north_m,east_m\n1,2,3,4\n",
            "table.csv:1: column 'east_m' occurs twice; keep one of them",
        ),
        (
            "1,2,3\n4,5,6\n",
            "table.csv:1: the first line must name the columns, but it holds the value '1'",
        ),
        (HEADER + "1,2,3\n4,abc,6\n", "table.csv:3: east_m = 'abc' is not a number"),
        (HEADER + "1,2,3\n4,,6\n", "table.csv:3: east_m = '' is not a number"),
        (HEADER + "1,2,1_0\n", "table.csv:2: north_m = '1_0' is not a number"),
        (
            HEADER + "1,2,3\n4,5,nan\n",
            "table.csv:3: north_m is nan; a finite number is needed; remove the row or repair it",
        ),
        (
            HEADER + "1,-inf,3\n",
            "table.csv:2: east_m is -inf; a finite number is needed; remove the row or repair it",
        ),
        (
            HEADER + "1,2,3\n4,5\n7,8,9\n",
            "table.csv:3: 2 cells where the header names 3 columns; "
            "is a comma missing or too many?",
        ),
        (
            HEADER + "1,2,3\n4,5",
            "table.csv:3: 2 cells where the header names 3 columns; "
            "the file looks cut off: copy it again",
        ),
        (
            HEADER + "1,2,3\n4,5,1e-",
            "table.csv:3: north_m = '1e-' is not a number; the file looks cut off: copy it again",
        ),
        (HEADER + "1,2,3\n\n4,5,6\n", "table.csv:3: the line is blank; remove it"),
        (
            HEADER + "1.5,2,3\n",
            "table.csv:2: t_ns = '1.5' is not a whole number of nanoseconds; "
            "write it without point or exponent",
        ),
        (
            HEADER + "9223372036854775808,2,3\n",
            "table.csv:2: t_ns = 9223372036854775808 does not fit in 64 bits; "
            "is it finer than nanoseconds?",
        ),
        (
            HEADER.encode() + b"1,2,\xff\n",
            "table.csv: byte 24 is not UTF-8 text; is this a CSV file?",
        ),
    ],
)
def test_each_fault_is_told_with_its_place_and_remedy(csv, text, message):
    assert fault(csv(text)) == message


def test_a_folder_in_place_of_a_file_is_told(tmp_path):
    assert "cannot be read" in fault(tmp_path)


def test_parquet_faults_name_the_row(tmp_path):
    path = tmp_path / "table.parquet"
    columns = columns_of([(1, 2.0, 3.0, 4.0), (5, np.nan, 7.0, 8.0)])
    write_table(path, columns)
    with pytest.raises(DriveError, match=r"table.parquet: row 2: east_m is nan"):
        read_table(path, LAYOUT)


def test_parquet_stamps_must_be_integers(tmp_path):
    import pyarrow
    import pyarrow.parquet

    path = tmp_path / "table.parquet"
    table = pyarrow.table({"t_ns": [1.0], "east_m": [2.0], "north_m": [3.0]})
    pyarrow.parquet.write_table(table, path)
    with pytest.raises(DriveError, match="column t_ns holds double, expected int64"):
        read_table(path, LAYOUT)


def test_a_file_that_is_not_parquet_is_told(tmp_path):
    path = tmp_path / "table.parquet"
    path.write_text(HEADER)
    with pytest.raises(DriveError, match="not a readable Parquet file"):
        read_table(path, LAYOUT)
