"""Which columns a table file may have, and the check of a header against that.

Units and frames stand in the column names, so a wrong unit is found in the header.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgloc.errors import DriveError, nearest

Columns = dict[str, NDArray[Any]]
"""Columns of one table by name, all of one length: int64 where `is_integer` says so."""

WHOLE = frozenset({
    "node", "object_id", "kind", "track_id", "sign", "anchor", "run", "user_id", "frame", "camera",
})  # fmt: skip
"""Columns of whole numbers that are no instants."""


@dataclass(frozen=True)
class Group:
    """Columns that come together, in one of the alternative ways to say the same thing."""

    alternatives: tuple[tuple[str, ...], ...]
    required: bool = True
    may_be_empty: bool = False

    @classmethod
    def of(cls, *names: str, required: bool = True, may_be_empty: bool = False) -> "Group":
        """A group with one way of writing it."""
        return cls((names,), required, may_be_empty)

    def present(self, names: Iterable[str]) -> list[tuple[str, ...]]:
        """The alternatives of which at least one column is there."""
        there = set(names)
        return [columns for columns in self.alternatives if there & set(columns)]


@dataclass(frozen=True)
class Layout:
    """The columns of one kind of table; `ignored` ones are derived from others when written."""

    groups: tuple[Group, ...]
    ignored: tuple[str, ...] = field(default=())

    @property
    def names(self) -> list[str]:
        """Every column that is understood."""
        known = [name for g in self.groups for columns in g.alternatives for name in columns]
        return [*known, *self.ignored]

    def may_be_empty(self, name: str) -> bool:
        """Whether a cell of this column may be left empty, which reads as NaN."""
        return name in self.ignored or any(
            group.may_be_empty and any(name in columns for columns in group.alternatives)
            for group in self.groups
        )


def is_integer(name: str) -> bool:
    """Whether a column holds int64, of nanoseconds or of numbers that name, rather than floats."""
    return name.endswith("_ns") or name in WHOLE


def dtype_of(name: str) -> np.dtype[Any]:
    """int64 or float64, whichever a column of this name holds."""
    return np.dtype(np.int64 if is_integer(name) else np.float64)


def place(path: Path, row: int) -> str:
    """Where a person finds row `row` (counted from 0): the line of a CSV, the row of a Parquet."""
    return f"{path}: row {row + 1}" if path.suffix == ".parquet" else f"{path}:{row + 2}"


def check_header(where: str, names: Sequence[str], layout: Layout) -> None:
    """Raise DriveError naming an unknown, missing or doubled column and what was expected."""
    _check_names(where, names, layout)
    for group in layout.groups:
        _check_group(where, names, group)


def _check_names(where: str, names: Sequence[str], layout: Layout) -> None:
    valid = layout.names
    seen: set[str] = set()
    for name in names:
        if name not in valid:
            raise DriveError(f"{where}: {_unknown(name, valid)}")
        if name in seen:
            raise DriveError(f"{where}: column {name!r} occurs twice; keep one of them")
        seen.add(name)


def _unknown(name: str, valid: Sequence[str]) -> str:
    if _looks_like_number(name):
        return f"the first line must name the columns, but it holds the value {name!r}"
    stem, _, unit = name.rpartition("_")
    same_stem = [v for v in valid if v.rpartition("_")[0] == stem and stem]
    if same_stem:
        return f"unknown unit {unit!r} in column {name!r}; want {same_stem[0]!r}"
    return f"unknown column {name!r}; the nearest valid name is {nearest(name, valid)!r}"


def _looks_like_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _check_group(where: str, names: Sequence[str], group: Group) -> None:
    present = group.present(names)
    if not present and not group.required:
        return
    if not present:
        ways = " or ".join(",".join(columns) for columns in group.alternatives)
        raise DriveError(f"{where}: missing column {ways}")
    if len(present) > 1:
        both = " and ".join(",".join(columns) for columns in present)
        raise DriveError(f"{where}: has columns of both {both}; keep one of the two")
    missing = [name for name in present[0] if name not in names]
    if missing:
        raise DriveError(f"{where}: missing column {','.join(missing)}")


def check_values(path: Path, columns: Columns, layout: Layout) -> None:
    """Raise DriveError at the first NaN or infinity where a number is needed, or if no row is."""
    if not len(next(iter(columns.values()))):
        raise DriveError(f"{path}: the table is empty (a header, no rows); delete the file instead")
    for name, values in columns.items():
        if is_integer(name) or name in layout.ignored:
            continue
        bad = np.isinf(values) if layout.may_be_empty(name) else ~np.isfinite(values)
        if bad.any():
            row = int(np.argmax(bad))
            raise DriveError(
                f"{place(path, row)}: {name} is {values[row]}; "
                "a finite number is needed; remove the row or repair it"
            )


def check_pairs(path: Path, columns: Columns, names: tuple[str, str]) -> None:
    """Raise DriveError at the first row of which one of two columns is empty and the other not."""
    value, sigma = names
    alone = np.isnan(columns[value]) != np.isnan(columns[sigma])
    if alone.any():
        row = int(np.argmax(alone))
        raise DriveError(
            f"{place(path, row)}: of {value} and {sigma} one is empty; give both or neither"
        )


def check_positive(
    path: Path, columns: Columns, names: tuple[str, ...], what: str = "a standard deviation"
) -> None:
    """Raise DriveError at the first row in which one of some columns is not above 0."""
    for name in names:
        bad = columns[name] <= 0
        if bad.any():
            row = int(np.argmax(bad))
            raise DriveError(
                f"{place(path, row)}: {name} = {columns[name][row]}; {what} must be above 0"
            )


def check_known(path: Path, columns: Columns, name: str, have: int) -> None:
    """Raise DriveError at the first row whose number points to none of the `have` entries of
    drive.toml that are called `name`."""
    numbers = columns[name]
    unknown = (numbers < 0) | (numbers >= have)
    if unknown.any():
        row = int(np.argmax(unknown))
        raise DriveError(
            f"{place(path, row)}: {name} = {numbers[row]}, but drive.toml has {have} "
            f"[[{name}]], counted from 0; add it there or remove the row"
        )
