"""The same drives through several methods: a row for each, and differences paired in time."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from fgloc.drive import Drive
from fgloc.errors import FglocError, InputError
from fgloc.evaluation.against_truth import Errors
from fgloc.evaluation.bootstrap import paired_difference
from fgloc.evaluation.judgement import judge
from fgloc.evaluation.metric import Metric
from fgloc.evaluation.posts import score_posts
from fgloc.evaluation.requirements import Requirement, as_dict
from fgloc.result import Result
from fgloc.trajectory import Trajectory

MOST_PICTURES = 4
"""Of so many drives, the first, the trajectories are kept: of a hundred they fill the memory."""
MAIN = "horizontal_rmse_m"
"""The metric that methods are compared by over several drives."""


@dataclass(frozen=True)
class Method:
    """A name, and the function that makes a result of a drive."""

    name: str
    run: Callable[[Drive], Result]


@dataclass(frozen=True)
class Row:
    """One method on one drive.

    metrics       by name; empty where the drive has no truth or the method failed
    requirements  of automated driving, likewise
    summary       what the method says of its run; `config` what was in force
    wall_s        time that the method took
    difference    horizontal RMSE minus that of the first method at the same instants, with its
                  interval; below zero is better. None for the first method and without truth
    failed        why there is no result, else empty
    """

    drive: str
    seed: int | None
    method: str
    causal: bool | None = None
    metrics: Mapping[str, Metric] = field(default_factory=dict)
    requirements: tuple[Requirement, ...] = ()
    summary: Mapping[str, Any] = field(default_factory=dict)
    config: Mapping[str, Any] = field(default_factory=dict)
    wall_s: float = 0.0
    difference: Metric | None = None
    failed: str = ""

    @property
    def label(self) -> str:
        """Whether the method looks ahead; empty where it failed."""
        return "" if self.causal is None else "causal" if self.causal else "smoothed"

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "drive": self.drive, "seed": self.seed, "method": self.method, "causal": self.causal,
            "metrics": {name: metric.to_dict() for name, metric in self.metrics.items()},
            "requirements": as_dict(self.requirements) if self.requirements else {},
            "summary": dict(self.summary), "config": dict(self.config), "wall_s": self.wall_s,
            "difference": None if self.difference is None else self.difference.to_dict(),
            "failed": self.failed,
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class Picture:
    """What can be drawn of a drive: its truth, and trajectory and errors of each method."""

    drive: str
    seed: int | None
    start_ns: int
    truth: Trajectory | None
    runs: Mapping[str, tuple[Trajectory, Errors | None]]


@dataclass(frozen=True)
class Overall:
    """One method over several drives.

    mean        of the horizontal RMSE over `n` drives, with a Student-t interval
    difference  mean over the drives of what the rows say of the difference to the first method
    wall_s      time spent; `failed` how many drives it failed on
    """

    method: str
    mean: Metric
    difference: Metric | None
    wall_s: float
    failed: int

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        difference = None if self.difference is None else self.difference.to_dict()
        return {
            "method": self.method, MAIN: self.mean.to_dict(), "difference": difference,
            "wall_s": self.wall_s, "failed": self.failed,
        }  # fmt: skip


@dataclass(frozen=True)
class Comparison:
    """The table of a comparison: rows by drive, then method; `against` is the first method."""

    methods: tuple[str, ...]
    rows: tuple[Row, ...]
    score_from_s: float = 0.0
    pictures: tuple[Picture, ...] = ()

    @property
    def against(self) -> str:
        """The method that the differences are taken from."""
        return self.methods[0]

    @property
    def drives(self) -> int:
        """How many drives there were, each seed of a scenario one."""
        return len(self.rows) // len(self.methods)

    def of(self, method: str) -> tuple[Row, ...]:
        """A method's rows, in the order of the drives."""
        return self.rows[self.methods.index(method) :: len(self.methods)]

    def overall(self) -> list[Overall]:
        """Each method over all drives."""
        return [self._overall(method) for method in self.methods]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "methods": list(self.methods), "against": self.against,
            "score_from_s": self.score_from_s, "drives": self.drives,
            "overall": [one.to_dict() for one in self.overall()],
            "rows": [row.to_dict() for row in self.rows],
        }  # fmt: skip

    def _overall(self, method: str) -> Overall:
        rows = self.of(method)
        wall_s = sum(row.wall_s for row in rows)
        mean = _mean([row.metrics.get(MAIN) for row in rows])
        if mean.low is not None:
            mean = replace(mean, low=max(mean.low, 0.0))  # no RMSE is below zero
        difference = None if method == self.against else _mean([row.difference for row in rows])
        return Overall(method, mean, difference, wall_s, sum(bool(r.failed) for r in rows))


def compare_methods(
    drives: Iterable[tuple[Drive, int | None]], methods: Sequence[Method], score_from_s: float
) -> Comparison:
    """Every drive, with the seed it was made with, through every method."""
    if not methods:
        raise InputError("no methods to compare; give at least one, e.g. graph-batch")
    names = [method.name for method in methods]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"method {twice!r} is there twice; give each a label of its own")
    rows: list[Row] = []
    pictures: list[Picture] = []
    for drive, seed in drives:
        found, picture = _one_drive(drive, seed, methods, score_from_s)
        rows += found
        pictures += [picture] if len(pictures) < MOST_PICTURES else []
    return Comparison(tuple(names), tuple(rows), score_from_s, tuple(pictures))


def _one_drive(
    drive: Drive, seed: int | None, methods: Sequence[Method], score_from_s: float
) -> tuple[list[Row], Picture]:
    """The methods on one drive; the first one's errors are what the others are held against."""
    rows: list[Row] = []
    runs: dict[str, tuple[Trajectory, Errors | None]] = {}
    first: Errors | None = None
    for method in methods:
        row, run = _row(drive, seed, method, score_from_s, first)
        if run is not None:
            runs[method.name] = run
            first = run[1] if not rows else first
        rows.append(row)
    return rows, Picture(drive.name, seed, drive.start_ns, drive.truth, runs)


def _row(
    drive: Drive, seed: int | None, method: Method, score_from_s: float, first: Errors | None
) -> tuple[Row, tuple[Trajectory, Errors | None] | None]:
    """A method's row and its run. Where it fails, others may still do: the row says why."""
    began = time.perf_counter()
    try:
        result = method.run(drive)
        wall_s = time.perf_counter() - began
        judged = None
        if drive.truth is not None:
            judged = judge(result, drive.truth, score_from_s=score_from_s)
    except FglocError as err:
        wall_s = time.perf_counter() - began
        return Row(drive.name, seed, method.name, wall_s=wall_s, failed=str(err)), None
    known: dict[str, Any] = {"summary": result.summary, "config": result.config, "wall_s": wall_s}
    known["metrics"] = score_posts(result.posts, drive, score_from_s=score_from_s)
    if judged is not None:
        known["metrics"] |= judged.metrics
        known["requirements"] = judged.requirements
        known["difference"] = None if first is None else _difference(judged.errors, first)
    row = Row(drive.name, seed, method.name, result.causal, **known)
    return row, (result.trajectory, None if judged is None else judged.errors)


def _difference(errors: Errors, first: Errors) -> Metric:
    try:
        return paired_difference(errors, first)
    except InputError as err:
        return Metric(None, "m", why=str(err))


def _mean(metrics: Sequence[Metric | None]) -> Metric:
    """The mean over drives that have a value, with its Student-t interval from two drives on."""
    x = np.array([m.value for m in metrics if m is not None and m.value is not None])
    if len(x) == 0:
        return Metric(None, "m", why="no drive has a value")
    mean, low, high = float(x.mean()), None, None
    if len(x) > 1:
        from scipy.special import stdtrit  # 0.3 s to import

        half = float(stdtrit(len(x) - 1, 0.975) * x.std(ddof=1) / np.sqrt(len(x)))
        low, high = mean - half, mean + half
    return Metric(mean, "m", "lower", len(x), low, high)
