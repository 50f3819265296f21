"""CSV tables by Arrow's parser: in a fifth of the time of numpy's, on one processor.

It reads the same numbers to the last bit, but what it thinks of a file that is not as it should be
is for others to say: here such a file is not read.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from fgloc.datasets.columns import Columns, dtype_of
from fgloc.parallel import each

AT_ONCE = 1 << 24
"""Bytes that are parsed at a time, on one processor."""
_HEXADECIMAL = b"x", b"X"


def parse(raw: bytes, start: int, names: list[str]) -> Columns | None:
    """The cells of lines from a byte on, as columns with these names; None where a cell is empty,
    no number or hexadecimal, or a line is blank, too short or too long."""
    if any(raw.find(mark, start) >= 0 for mark in _HEXADECIMAL):
        return None
    import pyarrow
    from pyarrow import csv

    pool = pyarrow.system_memory_pool()  # its own would keep what it has had

    def columns(part: slice) -> Columns:
        lines = pyarrow.py_buffer(memoryview(raw)[part])
        table = csv.read_csv(lines, *_strictly(csv, names), memory_pool=pool)
        return {name: np.array(table.column(name)) for name in names}

    try:
        parts = each(columns, _of_whole_lines(raw, start))
    except pyarrow.ArrowInvalid:
        return None
    pool.release_unused()
    if len(parts) == 1:
        return parts[0]
    return {name: np.concatenate([part.pop(name) for part in parts]) for name in names}


def _of_whole_lines(raw: bytes, start: int) -> Iterator[slice]:
    """Parts of about `AT_ONCE` bytes, from a byte on, that end with a line."""
    while start < len(raw):
        stop = raw.find(b"\n", min(start + AT_ONCE, len(raw))) + 1 or len(raw)
        yield slice(start, stop)
        start = stop


def _strictly(csv: Any, names: list[str]) -> tuple[Any, Any, Any]:
    """Options: no quotes, nothing that stands for an empty cell, and types as we have them; in one
    thread, since others would keep the memory that they have had."""
    types = {name: str(dtype_of(name)) for name in names}
    return (
        csv.ReadOptions(column_names=names, use_threads=False),
        csv.ParseOptions(quote_char=False, ignore_empty_lines=False),
        csv.ConvertOptions(column_types=types, null_values=[]),
    )
