"""What a check found, and how findings speak of rows and numbers."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from fgloc.measurements import Table
from fgloc.timing import elapsed_s

Severity = Literal["fault", "warning", "remark"]
SEVERITIES: tuple[Severity, ...] = ("fault", "warning", "remark")
"""Worst first. A fault ruins the result or is refused; a warning makes it worse, or its sigmas
wrong; a remark is good to know, and there is nothing to repair."""

MEDIAN_SIGMAS = 0.6745
"""Median absolute value of zero-mean Gaussian values, in their sigmas."""
_MOST_ROWS = 3


@dataclass(frozen=True)
class Finding:
    """One thing that a check found in a drive.

    severity  'fault', 'warning' or 'remark'
    check     short name of the kind of finding, the same from run to run
    source    the table that it is about, 'rig', 'truth' or 'drive'
    what      the finding with its numbers; rows count from 0, seconds from the table's first row
    remedy    what to do about it
    """

    severity: Severity
    check: str
    source: str
    what: str
    remedy: str

    def to_dict(self) -> dict[str, str]:
        """The fields by name."""
        return dict(vars(self))


def fault(check: str, source: str, what: str, remedy: str) -> Finding:
    """A finding that ruins the result."""
    return Finding("fault", check, source, what, remedy)


def warning(check: str, source: str, what: str, remedy: str) -> Finding:
    """A finding that makes the result worse."""
    return Finding("warning", check, source, what, remedy)


def remark(check: str, source: str, what: str, remedy: str) -> Finding:
    """A finding that needs no repair."""
    return Finding("remark", check, source, what, remedy)


def rows_of(table: Table, rows: ArrayLike) -> str:
    """Rows (M,) of a table as 'rows 3, 7, 9 and 12 more, the first at 0.30 s'."""
    found = np.atleast_1d(np.asarray(rows, int))
    shown = ", ".join(str(row) for row in found[:_MOST_ROWS])
    more = f" and {len(found) - _MOST_ROWS:,} more" if len(found) > _MOST_ROWS else ""
    at_s = float(elapsed_s(table.t_ns[found[0]], int(table.t_ns[0])))
    first = "the first " if len(found) > 1 else ""
    return f"row{'s' if len(found) > 1 else ''} {shown}{more}, {first}at {at_s:,.2f} s"


def robust_sigma(values: ArrayLike) -> float:
    """Standard deviation that the median absolute value of zero-mean Gaussian values implies."""
    return float(np.median(np.abs(values))) / MEDIAN_SIGMAS
