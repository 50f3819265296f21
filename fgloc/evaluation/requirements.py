"""Is the estimate good enough to drive by? Verdicts on the requirements of automated driving.

Reid, Houts, Cammarata, Mills, Agarwal, Vora, Pandey, Localization Requirements for Autonomous
Vehicles (2019). For each kind of road they give alert limits, which an error may exceed once in
10^8 hours, and the accuracy that 95 % of errors must keep for that.

A drive answers the two very differently. The 95 % figure is a quantile: a 'yes' needs its upper
confidence limit below what is required, a 'no' its lower one above. Of the alert limits no drive
of minutes can say yes: one error beyond is a 'no', else the answer stays open, with the rate of
exceedances that the drive does exclude. The truth's own errors count as the estimate's.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from fgloc.evaluation.against_truth import MAX_GAP_S, Errors
from fgloc.evaluation.consistency import effective_samples
from fgloc.measurements import Array
from fgloc.parallel import each
from fgloc.timing import NS_PER_S, Instants

SOURCE = "Reid et al. (2019), Localization Requirements for Autonomous Vehicles"
CONFIDENCE = 0.95
"""Of the interval of the 95 % figure, and of the bound on the rate of exceedances."""
SHARE = 0.95
"""The share of errors that the accuracy requirement is about."""
INTEGRITY_PER_H = 1e-8
"""How often an hour an error may exceed the alert limit."""
ACCURACY, ALERT = "accuracy95", "alert"


class Answer(StrEnum):
    """What a drive says of a requirement."""

    YES = "yes"
    NO = "no"
    OPEN = "not enough data"


@dataclass(frozen=True)
class Profile:
    """What one kind of road requires: by column of `Errors`, in m and rad."""

    name: str
    accuracy95: Mapping[str, float]
    alert: Mapping[str, float]


PROFILES = (
    Profile(
        "freeway",
        {"lateral_m": 0.20, "longitudinal_m": 0.48, "up_m": 0.43, "yaw_rad": math.radians(0.51)},
        {"lateral_m": 0.57, "longitudinal_m": 1.40, "up_m": 1.30, "yaw_rad": math.radians(1.5)},
    ),
    Profile(
        "local_street",
        {"lateral_m": 0.10, "longitudinal_m": 0.10, "yaw_rad": math.radians(0.17)},
        {"lateral_m": 0.29, "longitudinal_m": 0.29, "yaw_rad": math.radians(0.5)},
    ),
)
"""Their requirements. Of attitude the heading is judged; roll and pitch are not."""


@dataclass(frozen=True)
class Requirement:
    """One requirement and what the drive says of it.

    kind         'accuracy95' or 'alert'
    column       of `Errors`: lateral_m, longitudinal_m, up_m or yaw_rad
    limit        what is required, m or rad
    value        the 95 % figure, or the largest error; None where nothing could be scored
    low, high    confidence interval of the 95 % figure; None where the errors are too few
    n            scored errors; `n_effective` independent ones that they are worth
    beyond       how many of them exceed the limit
    hours        scored time; `rate_high_per_h` what bounds the rate of exceedances where there
                 was none (alert limits only)
    why          the reason for the answer
    """

    profile: str
    kind: str
    column: str
    limit: float
    answer: Answer
    why: str
    value: float | None = None
    low: float | None = None
    high: float | None = None
    n: int = 0
    n_effective: int = 0
    beyond: int = 0
    hours: float = 0.0
    rate_high_per_h: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON: what names it left out, what is not known as well."""
        values = asdict(self) | {"answer": str(self.answer)}
        names = ("profile", "kind", "column")
        return {k: v for k, v in values.items() if k not in names and v is not None}


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a column of errors says, whatever is required of it.

    x            (N,) absolute errors, m or rad; `n_effective` independent ones they are worth
    low, high    interval of their 95 % figure `p95`
    hours        scored time
    """

    x: Array
    n_effective: int
    p95: float
    low: float | None
    high: float | None
    hours: float


def judge_requirements(errors: Errors) -> tuple[Requirement, ...]:
    """Every requirement of every profile; one that cannot be judged says why."""
    columns = list(PROFILES[0].accuracy95)
    found = each(lambda column: _evidence(errors, column), columns)
    evidence = dict(zip(columns, found, strict=True))
    return tuple(
        _judge_one(errors, evidence[column], profile.name, kind, column, limit)
        for profile in PROFILES
        for kind, limits in ((ACCURACY, profile.accuracy95), (ALERT, profile.alert))
        for column, limit in limits.items()
    )


def _judge_one(
    e: Errors, found: Evidence | None, profile: str, kind: str, column: str, limit: float
) -> Requirement:
    named: dict[str, Any] = {"profile": profile, "kind": kind, "column": column, "limit": limit}
    if found is None:
        why = "no truth row could be scored" if len(e) == 0 else e.why.get(column, "")
        return Requirement(answer=Answer.OPEN, why=why, **named)
    judged = (_accuracy if kind == ACCURACY else _alert)(found, limit)
    if column == "yaw_rad" and e.course_based:
        why = "the truth has no attitude; its course is not the heading, and noisy"
        judged |= {"answer": Answer.OPEN, "why": why}
    return Requirement(
        n=len(found.x), n_effective=found.n_effective, beyond=int((found.x > limit).sum()),
        hours=found.hours, **named, **judged,
    )  # fmt: skip


def quantile_interval(
    x: Array, n_effective: int, share: float = SHARE, confidence: float = CONFIDENCE
) -> tuple[float | None, float | None]:
    """Interval of a quantile of errors (N,) that are worth `n_effective` independent ones.

    By order statistics, whatever the distribution: how many of n independent errors lie below
    the quantile is binomial. An end is None where so few errors cannot give it: for the upper
    end of the 95 % figure it takes 72. A bootstrap would give one from any number, since it
    draws only from what was seen.
    """
    tail = (1 - confidence) / 2
    cdf = _binomial_cdf(n_effective, share)
    lower = int(np.searchsorted(cdf, tail, side="right"))
    upper = int(np.searchsorted(cdf, 1 - tail)) + 1
    ends = [rank / n_effective if 1 <= rank <= n_effective else None for rank in (lower, upper)]
    low, high = (
        None if at is None else float(np.quantile(x, at, method="inverted_cdf")) for at in ends
    )
    return low, high


def as_dict(found: tuple[Requirement, ...]) -> dict[str, Any]:
    """What summary.json holds: profile, kind, column; and what the numbers rest on."""
    plain: dict[str, Any] = {
        "source": SOURCE, "confidence": CONFIDENCE, "integrity_per_h": INTEGRITY_PER_H,
    }  # fmt: skip
    for row in found:
        kinds = plain.setdefault(row.profile, {})
        kinds.setdefault(row.kind, {})[row.column] = row.to_dict()
    return plain


def _evidence(e: Errors, column: str) -> Evidence | None:
    """Of a column of errors; None where nothing in it is known."""
    x = np.abs(getattr(e, column))
    known = np.isfinite(x)
    if not known.any():
        return None
    x, n = x[known], max(int(effective_samples(x[known])), 1)
    p95 = float(np.quantile(x, SHARE))
    return Evidence(x, n, p95, *quantile_interval(x, n), _hours(e.t_ns[known]))


def _accuracy(found: Evidence, limit: float) -> dict[str, Any]:
    """Which side of the limit the interval of the 95 % figure lies on."""
    answer, why = Answer.OPEN, "the limit lies inside the confidence interval"
    if found.low is not None and found.low > limit:
        answer, why = Answer.NO, "the lower confidence limit is above"
    elif found.high is None:
        why = f"worth {found.n_effective:,} independent errors, too few for a bound"
    elif found.high <= limit:
        answer, why = Answer.YES, "the upper confidence limit is below"
    return {
        "answer": answer, "why": why, "value": found.p95, "low": found.low, "high": found.high,
    }  # fmt: skip


def _alert(found: Evidence, limit: float) -> dict[str, Any]:
    """Whether an error exceeds the limit; if none does, what rate of exceedances is excluded."""
    beyond, n, value = int((found.x > limit).sum()), len(found.x), float(found.x.max())
    if beyond:
        why = f"{beyond:,} of {n:,} errors exceed it"
        return {"answer": Answer.NO, "why": why, "value": value}
    # No event in so many hours: the 'rule of three', about 3 / hours at 95 %.
    rate = -math.log(1 - CONFIDENCE) / found.hours if found.hours > 0 else None
    excluded = "" if rate is None else f", so less than {rate:.2g} an hour"
    asked = f"asked is one in {1 / INTEGRITY_PER_H:,.0f} h"
    why = f"none exceeds it in {found.hours:.2g} h{excluded}; {asked}"
    return {"answer": Answer.OPEN, "why": why, "value": value, "rate_high_per_h": rate}


def _hours(t_ns: Instants) -> float:
    """Time that the scored instants cover; what is left out between them does not count."""
    steps_s = np.diff(t_ns) / NS_PER_S
    longest_s = max(MAX_GAP_S, 1.5 * float(np.median(steps_s))) if len(steps_s) else 0.0
    return float(steps_s[steps_s <= longest_s].sum()) / 3600


def _binomial_cdf(n: int, p: float) -> Array:
    """Probabilities (n + 1,) of at most 0, 1, .. n successes in n trials."""
    k = np.arange(n)
    steps = np.log((n - k) / (k + 1)) + math.log(p / (1 - p))
    return np.cumsum(np.exp(n * math.log1p(-p) + np.concatenate([[0.0], np.cumsum(steps)])))
