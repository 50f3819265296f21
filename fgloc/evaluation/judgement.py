"""A whole result held against the truth: errors, metrics with outages included, requirements."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from fgloc.evaluation.against_truth import Errors, errors
from fgloc.evaluation.gaps import Spans, gnss_outages
from fgloc.evaluation.metric import Metric
from fgloc.evaluation.requirements import Requirement, judge_requirements
from fgloc.evaluation.scoring import score_errors
from fgloc.parallel import each
from fgloc.result import Result
from fgloc.timing import seconds_to_ns
from fgloc.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Judgement:
    """What the truth says of a trajectory: a row of errors per instant, the named metrics, and
    whether it meets the requirements of automated driving."""

    errors: Errors
    metrics: dict[str, Metric]
    requirements: tuple[Requirement, ...] = ()


def judge(
    result: Result, truth: Trajectory, *, score_from_s: float = 0.0, smoothed: bool = False
) -> Judgement:
    """Judge a result's trajectory, or the smoothed one that a causal method gave beside it.

    Truth earlier than `score_from_s` after the estimate's first state is left out. Raises
    InputError where the two tell of different points and neither has an attitude.
    """
    estimate = result.trajectory
    if smoothed and result.smoothed is not None:
        estimate = result.smoothed
    return judge_trajectory(
        estimate, truth, score_from_s=score_from_s, outages=gnss_outages(result)
    )


def judge_trajectory(
    estimate: Trajectory,
    truth: Trajectory,
    *,
    score_from_s: float = 0.0,
    outages: Spans | None = None,
) -> Judgement:
    """The same of a trajectory alone; with `outages` (K, 2) there are metrics of these."""
    start_ns = int(estimate.t_ns[0]) + seconds_to_ns(score_from_s) if len(estimate) else None
    found = errors(estimate, truth, score_from_ns=start_ns)
    tell: list[Callable[[Errors], Any]] = [
        partial(score_errors, outages=outages),
        judge_requirements,
    ]
    metrics, requirements = each(lambda told: told(found), tell)
    return Judgement(found, metrics, requirements)
