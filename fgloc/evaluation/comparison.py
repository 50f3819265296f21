"""The same drives through several methods: a row for each, and differences paired in time."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fgloc.drive import Drive
from fgloc.errors import FglocError, InputError
from fgloc.evaluation.against_truth import Errors
from fgloc.evaluation.bootstrap import paired_difference, paired_means, paired_ratio
from fgloc.evaluation.conditions import Mask, conditions, under
from fgloc.evaluation.gaps import Spans, gnss_outages, used_fixes_ns
from fgloc.evaluation.judgement import judge
from fgloc.evaluation.metric import Metric
from fgloc.evaluation.overall import (
    AVERAGED,
    MAIN,
    WHOLE,
    Overall,
    Scores,
    Standing,
    average,
    plain,
    ratio_over_drives,
)
from fgloc.evaluation.posts import score_posts
from fgloc.evaluation.requirements import Requirement, as_dict
from fgloc.evaluation.scoring import score_errors
from fgloc.infrastructure import Node
from fgloc.result import Result
from fgloc.trajectory import Trajectory

MOST_PICTURES = 4
"""Of so many drives, the first, the trajectories are kept: of a hundred they fill the memory."""


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
    ratio         mean horizontal error over that of the first method, likewise; below one is better
    means         the two that it is of
    conditions    the scores under each condition of the drive, see `conditions`
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
    ratio: Metric | None = None
    means: tuple[float, float] | None = None
    conditions: Mapping[str, Scores] = field(default_factory=dict)
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
            "difference": plain(self.difference), "ratio": plain(self.ratio),
            "conditions": {name: one.to_dict() for name, one in self.conditions.items()},
            "failed": self.failed,
        }  # fmt: skip

    def under(self, condition: str) -> Scores:
        """The scores under a condition, or over the whole drive."""
        if condition == WHOLE:
            return Scores(self.metrics, self.difference, self.ratio, self.means)
        return self.conditions.get(condition, Scores({}))


@dataclass(frozen=True, eq=False)
class Picture:
    """What can be drawn of a drive: its truth, and trajectory and errors of each method.

    masks       which rows of the truth fulfil each condition of the drive
    outages_ns  (K, 2) without a fix that the first method that uses fixes took
    nodes       beside the road
    """

    drive: str
    seed: int | None
    start_ns: int
    truth: Trajectory | None
    runs: Mapping[str, tuple[Trajectory, Errors | None]]
    masks: Mapping[str, Mask] = field(default_factory=dict)
    outages_ns: Spans = field(default_factory=lambda: np.zeros((0, 2), np.int64))
    nodes: tuple[Node, ...] = ()


@dataclass(frozen=True)
class Comparison:
    """The table of a comparison: rows by drive, then method; `against` is the first method, and
    `options` are those that scenarios were made with, the seed aside."""

    methods: tuple[str, ...]
    rows: tuple[Row, ...]
    score_from_s: float = 0.0
    pictures: tuple[Picture, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)

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
            "options": dict(self.options),
            "overall": [one.to_dict() for one in self.overall()],
            "standings": [one.to_dict() for one in self.standings()],
            "rows": [row.to_dict() for row in self.rows],
        }  # fmt: skip

    def standings(self) -> list[Standing]:
        """Each method over all drives under each condition that any drive has, and as a whole.

        A condition under which no method can be scored is left out: a drive may lie all in range.
        """
        names = [WHOLE, *dict.fromkeys(name for row in self.rows for name in row.conditions)]
        found = {name: [self._standing(name, method) for method in self.methods] for name in names}
        return [
            standing
            for name, of_all in found.items()
            if name == WHOLE or any(x.n for one in of_all for x in one.averages.values())
            for standing in of_all
        ]

    def _standing(self, condition: str, method: str) -> Standing:
        own = [row.under(condition) for row in self.of(method)]
        averages = {
            name: average([scores.metrics.get(name) for scores in own]) for name in AVERAGED
        }
        ratio = None if method == self.against else ratio_over_drives(own)
        return Standing(condition, method, averages, ratio)

    def _overall(self, method: str) -> Overall:
        rows = self.of(method)
        mean = average([row.metrics.get(MAIN) for row in rows])
        difference = average([row.difference for row in rows], signed=True)
        return Overall(
            method, mean, None if method == self.against else difference,
            sum(row.wall_s for row in rows), sum(bool(row.failed) for row in rows),
        )  # fmt: skip


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
    outages_ns: Spans | None = None
    masks, first = conditions(drive), None
    for method in methods:
        row, result, errors = _row(drive, seed, method, score_from_s, masks, first)
        if result is not None:
            runs[method.name] = result.trajectory, errors
            first = errors if not rows else first
            if outages_ns is None and len(used_fixes_ns(result.verdicts)):
                outages_ns = gnss_outages(result)
        rows.append(row)
    none = np.zeros((0, 2), np.int64)
    nodes = drive.infrastructure.nodes
    return rows, Picture(drive.name, seed, drive.start_ns, drive.truth, runs, masks,
                         none if outages_ns is None else outages_ns, nodes)  # fmt: skip


def _row(
    drive: Drive, seed: int | None, method: Method, score_from_s: float,
    masks: Mapping[str, Mask], first: Errors | None,
) -> tuple[Row, Result | None, Errors | None]:  # fmt: skip
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
        return Row(drive.name, seed, method.name, wall_s=wall_s, failed=str(err)), None, None
    known: dict[str, Any] = {"summary": result.summary, "config": result.config, "wall_s": wall_s}
    known["metrics"] = score_posts(result.posts, drive, score_from_s=score_from_s)
    if judged is not None and drive.truth is not None:
        known["metrics"] |= judged.metrics
        known["requirements"] = judged.requirements
        known |= _against(judged.errors, first)
        known["conditions"] = {
            name: _scores(judged.errors, first, drive.truth, mask) for name, mask in masks.items()
        }
    row = Row(drive.name, seed, method.name, result.causal, **known)
    return row, result, None if judged is None else judged.errors


def _scores(errors: Errors, first: Errors | None, truth: Trajectory, mask: Mask) -> Scores:
    """Under one condition."""
    own = under(errors, truth, mask)
    other = None if first is None else under(first, truth, mask)
    return Scores(score_errors(own), **_against(own, other))


def _against(errors: Errors, first: Errors | None) -> dict[str, Any]:
    """Difference and ratio to the errors of the first method."""
    if first is None:
        return {}
    try:
        return {
            "difference": paired_difference(errors, first), "ratio": paired_ratio(errors, first),
            "means": paired_means(errors, first),
        }  # fmt: skip
    except InputError as err:
        return {"difference": Metric(None, "m", why=str(err)),
                "ratio": Metric(None, "1", why=str(err))}  # fmt: skip
