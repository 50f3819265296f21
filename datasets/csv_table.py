"""Strict CSV tables of named numeric columns, read and written without losing a bit.

Stamps (columns in `_ns`) are int64 and never pass through a float, which has 53 bits only.
Floats are written as the shortest text that reads back to the same number.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from io import BytesIO
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from numpy.typing import ArrayLike, NDArray
from pydantic_core import to_json

from fgloc.datasets import arrow_csv
from fgloc.datasets.columns import (
    Columns,
    Layout,
    check_header,
    check_values,
    dtype_of,
    is_integer,
)
from fgloc.errors import DriveError
from fgloc.files import read_filled
from fgloc.parallel import portions

_INT64 = np.iinfo(np.int64)
_ROWS_AT_ONCE = 4096
_LARGE = 1 << 20
"""Bytes from which on a file is worth the time that Arrow takes to be imported."""


def read_csv(path: Path, layout: Layout) -> Columns:
    """The columns of a CSV file, in the order of its header, each (N,) with N >= 1.

    Raises DriveError with file, line, column, value and remedy where the file is missing, empty
    or cut off, where its header does not fit `layout`, and where a cell does not hold a number.
    """
    raw = read_filled(path, "; a line with column names is needed")
    names = _header(path, raw)
    check_header(f"{path}:1", names, layout)
    columns = _parse_fast(raw, names)
    if columns is None:  # something is wrong or empty: find out what, cell by cell
        columns = _parse_slowly(path, raw, names, layout)
    check_values(path, columns, layout)
    return columns


def write_csv(path: Path, columns: Mapping[str, ArrayLike]) -> None:
    """Write columns of one length under their names, in the order given."""
    with path.open("wb") as file:
        file.writelines(_formatted(columns))


def format_csv(columns: Mapping[str, ArrayLike]) -> str:
    """The text of a CSV file: a header, one line per row, the last one ended too."""
    return b"".join(_formatted(columns)).decode()


def _formatted(columns: Mapping[str, ArrayLike]) -> Iterator[bytes]:
    """A header, then lines, many at a time."""
    yield (",".join(columns) + "\n").encode()
    yield from _lines([_exact(name, values) for name, values in columns.items()])


def _lines(columns: Sequence[NDArray[Any]]) -> Iterator[bytes]:
    """Columns of whole numbers and of others stand in runs, each of which is written at once."""
    runs = [list(run) for _, run in groupby(columns, key=lambda values: values.dtype)]
    for part in portions(max(map(len, columns)), _ROWS_AT_ONCE):
        texts = [format_rows(np.stack([values[part] for values in run], -1)) for run in runs]
        yield b"\n".join(map(b",".join, zip(*texts, strict=True))) + b"\n"


def format_rows(numbers: NDArray[Any]) -> list[bytes]:
    """The numbers in each row of a table (N, k >= 1), with commas between: the shortest texts that
    read back exactly, as Python's `repr` has them."""
    if np.isfinite(numbers).all():
        text = orjson.dumps(numbers, option=orjson.OPT_SERIALIZE_NUMPY)
    else:  # which orjson has no words for
        text = to_json(numbers.tolist())
    return text[2:-2].split(b"],[") if len(numbers) else []


def _exact(name: str, values: ArrayLike) -> NDArray[Any]:
    return np.asarray(values, dtype_of(name))


def _header(path: Path, raw: bytes) -> list[str]:
    first = re.split(rb"\r\n|\n|\r", BytesIO(raw).readline(), maxsplit=1)[0]
    return [name.strip() for name in _decode(path, first).split(",")]


def _decode(path: Path, raw: bytes) -> str:
    try:
        return raw.decode("utf-8-sig")  # spreadsheets put a byte-order mark in front
    except UnicodeDecodeError as err:
        raise DriveError(
            f"{path}: byte {err.start} is not UTF-8 text; is this a CSV file?"
        ) from err


def _parse_fast(raw: bytes, names: list[str]) -> Columns | None:
    """All cells by Arrow if there are many, or by numpy; None where they are not all numbers."""
    start = raw.find(b"\n") + 1
    if start in (0, len(raw)):
        return None
    if len(raw) >= _LARGE and (columns := arrow_csv.parse(raw, start, names)) is not None:
        return columns
    return _parse_loosely(raw, names)


def _parse_loosely(raw: bytes, names: list[str]) -> Columns | None:
    """All cells by numpy's parser."""
    lines = raw.count(b"\n") + (not raw.endswith(b"\n")) - 1
    dtype = np.dtype([(name, dtype_of(name)) for name in names])
    try:
        table = np.loadtxt(
            BytesIO(raw), dtype, delimiter=",", skiprows=1, comments=None, encoding="utf-8", ndmin=1
        )
    except ValueError:
        return None
    if len(table) != lines:  # the parser passes over blank lines; we do not
        return None
    return {name: np.ascontiguousarray(table[name]) for name in names}


def _parse_slowly(path: Path, raw: bytes, names: list[str], layout: Layout) -> Columns:
    """All cells one by one; raises DriveError at the first that is wrong."""
    lines = re.split(r"\r\n|\n|\r", _decode(path, raw).rstrip())[1:]
    ended = raw.endswith((b"\n", b"\r"))
    rows = [
        _row(f"{path}:{number}", line, names, layout, cut=number == len(lines) + 1 and not ended)
        for number, line in enumerate(lines, start=2)
    ]
    columns = zip(*rows, strict=True) if rows else ([] for _ in names)
    return {name: _exact(name, column) for name, column in zip(names, columns, strict=True)}


def _row(where: str, line: str, names: list[str], layout: Layout, cut: bool) -> list[Any]:
    cells = line.split(",")
    hint = "; the file looks cut off: copy it again" if cut else ""
    if not line.strip():
        raise DriveError(f"{where}: the line is blank; remove it")
    if len(cells) != len(names):
        raise DriveError(
            f"{where}: {len(cells)} cells where the header names {len(names)} columns"
            f"{hint or '; is a comma missing or too many?'}"
        )
    return [
        _cell(where, name, cell.strip(), layout, hint)
        for name, cell in zip(names, cells, strict=True)
    ]


def _cell(where: str, name: str, cell: str, layout: Layout, hint: str) -> Any:
    if is_integer(name):
        return _integer(where, name, cell, hint)
    if not cell and layout.may_be_empty(name):
        return np.nan
    try:
        if "_" in cell or not cell.isascii():  # python takes 1_0; other programs do not
            raise ValueError
        return float(cell)
    except ValueError as err:
        raise DriveError(f"{where}: {name} = {cell!r} is not a number{hint}") from err


def _integer(where: str, name: str, cell: str, hint: str) -> int:
    if not re.fullmatch(r"[+-]?[0-9]+", cell):
        raise DriveError(
            f"{where}: {name} = {cell!r} is not a whole number of nanoseconds{hint}; "
            "write it without point or exponent"
        )
    if not _INT64.min <= int(cell) <= _INT64.max:
        raise DriveError(
            f"{where}: {name} = {cell} does not fit in 64 bits; is it finer than nanoseconds?"
        )
    return int(cell)
