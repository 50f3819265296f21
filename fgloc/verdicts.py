"""What became of every measurement: one row each, so that the totals equal what was read."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgloc.measurements import Array, Table
from fgloc.timing import Instants


class Verdict(StrEnum):
    """The possible fates of a measurement."""

    USED = "used"
    DOWN_WEIGHTED = "down-weighted"
    GATED = "gated"
    LATE = "late"
    DUPLICATE = "duplicate"
    INVALID = "invalid"
    OUTSIDE = "outside"
    OTHER = "other object"
    UNUSED = "unused"

    __hash__ = str.__hash__  # a verdict and its text are one key


FATES = tuple(Verdict)


@dataclass(eq=False)
class SourceVerdicts:
    """The verdicts on one source's table, row by row; estimators fill it in place.

    fate       (N,) number of each row's verdict in `FATES`
    why        (N,) number of its reason in `reasons`, which has each text once
    nis        (N,) normalised innovation squared: of the measurement against what was known
               without it (causal runs: before it; batch: all others). NaN where not computed
    dof        (N,) its degrees of freedom, 0 where not computed
    threshold  (N,) the gate in force, NaN where there was none
    """

    source: str
    t_ns: Instants
    received_ns: Instants
    fate: NDArray[np.uint8]
    why: NDArray[np.int32]
    nis: Array
    dof: NDArray[np.int64]
    threshold: Array
    reasons: list[str] = field(default_factory=list)
    _numbers: dict[str, int] = field(default_factory=dict, repr=False)

    @classmethod
    def of(
        cls, source: str, table: Table, verdict: Verdict = Verdict.UNUSED, reason: str = ""
    ) -> "SourceVerdicts":
        """One verdict for all rows of a table, to be refined."""
        return cls.at(source, table.t_ns, table.received_ns, verdict, reason)

    @classmethod
    def at(
        cls, source: str, t_ns: Instants, received_ns: Instants, verdict: Verdict, reason: str = ""
    ) -> "SourceVerdicts":
        """One verdict for all instants of a source, to be refined."""
        n = len(t_ns)
        result = cls(
            source, t_ns, received_ns, np.zeros(n, np.uint8), np.zeros(n, np.int32),
            np.full(n, np.nan), np.zeros(n, np.int64), np.full(n, np.nan),
        )  # fmt: skip
        result.set(slice(None), verdict, reason)
        return result

    def __len__(self) -> int:
        return len(self.t_ns)

    def set(self, rows: Any, verdict: Verdict, reason: str = "") -> None:
        """Give the rows (index, mask or array) a verdict and the reason for it."""
        number = self._numbers.setdefault(reason, len(self.reasons))
        if number == len(self.reasons):
            self.reasons.append(reason)
        self.fate[rows], self.why[rows] = FATES.index(verdict), number

    @property
    def verdict(self) -> NDArray[Any]:
        """(N,) the `Verdict` of each row."""
        return np.array(FATES, object)[self.fate]

    @property
    def reason(self) -> NDArray[Any]:
        """(N,) why, as text; empty where there is nothing to say."""
        return np.array(self.reasons, object)[self.why]

    def gate(self, row: int, nis: float, dof: int, limit: float) -> bool:
        """Whether one row's NIS against a prediction is within the gate `limit`; noted with it."""
        self.nis[row], self.dof[row], self.threshold[row] = nis, dof, limit
        fits = nis <= limit
        reason = "" if fits else "does not fit the prediction"
        self.set(row, Verdict.USED if fits else Verdict.GATED, reason)
        return fits

    def is_(self, *verdicts: Verdict) -> NDArray[np.bool_]:
        """(N,) bool: which rows have one of these verdicts."""
        return np.isin(self.fate, [FATES.index(verdict) for verdict in verdicts])

    def counts(self) -> dict[str, int]:
        """How many rows have each verdict that occurs."""
        numbers = np.bincount(self.fate, minlength=len(FATES)).tolist()
        return {str(fate): n for fate, n in sorted(zip(FATES, numbers, strict=True)) if n}


Verdicts = Mapping[str, SourceVerdicts]
"""Verdicts of all sources, by the source's name."""


def counts(verdicts: Verdicts) -> dict[str, dict[str, int]]:
    """How many rows of each source have each verdict; together as many as were read."""
    return {source: table.counts() for source, table in verdicts.items()}
