"""The same drives through several methods: a row for each, and differences paired in time."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from fgloc.drive import Drive
from fgloc.errors import FglocError, InputError
from fgloc.evaluation import Errors, Metric, judge, paired_difference
from fgloc.result import Result


@dataclass(frozen=True)
class Method:
    """A name, and the function that makes a result of a drive."""

    name: str
    run: Callable[[Drive], Result]


@dataclass(frozen=True)
class Row:
    """One method on one drive.

    metrics     by name; empty where the drive has no truth or the method failed
    summary     what the method says of its run
    difference  horizontal RMSE minus that of the first method at the same instants, with its
                interval; below zero is better. None for the first method and without truth
    failed      why there is no result, else empty
    """

    drive: str
    seed: int | None
    method: str
    causal: bool | None = None
    metrics: dict[str, Metric] = field(default_factory=dict)
    summary: dict[str, Any] = field(default_factory=dict)
    difference: Metric | None = None
    failed: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "drive": self.drive, "seed": self.seed, "method": self.method, "causal": self.causal,
            "metrics": {name: metric.to_dict() for name, metric in self.metrics.items()},
            "summary": self.summary,
            "difference": None if self.difference is None else self.difference.to_dict(),
            "failed": self.failed,
        }  # fmt: skip


@dataclass(frozen=True)
class Comparison:
    """The table of a comparison: rows by drive, then method; `against` is the first method."""

    methods: tuple[str, ...]
    rows: tuple[Row, ...]

    @property
    def against(self) -> str:
        """The method that the differences are taken from."""
        return self.methods[0]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        rows = [row.to_dict() for row in self.rows]
        return {"methods": list(self.methods), "against": self.against, "rows": rows}


def compare_methods(
    drives: Iterable[tuple[Drive, int | None]], methods: Sequence[Method], score_from_s: float
) -> Comparison:
    """Every drive, with the seed it was made with, through every method."""
    if not methods:
        raise InputError("no methods to compare; give at least one, e.g. graph-batch")
    rows = [row for drive, seed in drives for row in _rows(drive, seed, methods, score_from_s)]
    return Comparison(tuple(method.name for method in methods), tuple(rows))


def _rows(
    drive: Drive, seed: int | None, methods: Sequence[Method], score_from_s: float
) -> list[Row]:
    """The methods on one drive; the first one's errors are what the others are held against."""
    rows: list[Row] = []
    first: Errors | None = None
    for method in methods:
        row, errors = _row(drive, seed, method, score_from_s, first)
        first = errors if not rows else first
        rows.append(row)
    return rows


def _row(
    drive: Drive, seed: int | None, method: Method, score_from_s: float, first: Errors | None
) -> tuple[Row, Errors | None]:
    """A method's row and its errors. Where it fails, others may still do: the row says why."""
    try:
        result = method.run(drive)
        judged = None
        if drive.truth is not None:
            judged = judge(result, drive.truth, score_from_s=score_from_s)
    except FglocError as err:
        return Row(drive.name, seed, method.name, failed=str(err)), None
    if judged is None:
        return Row(drive.name, seed, method.name, result.causal, summary=result.summary), None
    difference = None if first is None else _difference(judged.errors, first)
    row = Row(drive.name, seed, method.name, result.causal, judged.metrics, result.summary,
              difference)  # fmt: skip
    return row, judged.errors


def _difference(errors: Errors, first: Errors) -> Metric:
    try:
        return paired_difference(errors, first)
    except InputError as err:
        return Metric(None, "m", why=str(err))
