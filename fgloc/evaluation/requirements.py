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


def judge_requirements(errors: Errors) -> tuple[Requirement, ...]:
    """Every requirement of every profile: 95 % accuracy first, then the alert limits."""
    return tuple(
        judge_one(errors, profile.name, kind, column, limit)
        for profile in PROFILES
        for kind, limits in ((ACCURACY, profile.accuracy95), (ALERT, profile.alert))
        for column, limit in limits.items()
    )


def judge_one(e: Errors, profile: str, kind: str, column: str, limit: float) -> Requirement:
    """One requirement; where it cannot be judged, `why` says the reason."""
    x = np.abs(getattr(e, column))
    known = np.isfinite(x)
    named: dict[str, Any] = {"profile": profile, "kind": kind, "column": column, "limit": limit}
    if not known.any():
        why = "no truth row could be scored" if len(e) == 0 else e.why.get(column, "")
        return Requirement(answer=Answer.OPEN, why=why, **named)
    judged = (_accuracy if kind == ACCURACY else _alert)(x[known], e.t_ns[known], limit)
    if column == "yaw_rad" and e.course_based:
        why = "the truth has no attitude; its course is not the heading, and noisy"
        judged |= {"answer": Answer.OPEN, "why": why}
    return Requirement(**named, **judged)


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


def _accuracy(x: Array, t_ns: Instants, limit: float) -> dict[str, Any]:
    """The 95 % figure with its interval, and which side of the limit that lies on."""
    n = max(int(effective_samples(x)), 1)
    low, high = quantile_interval(x, n)
    answer, why = Answer.OPEN, f"worth {n:,} independent errors, too few for a bound"
    if low is not None and low > limit:
        answer, why = Answer.NO, "the lower confidence limit is above"
    elif high is not None and high <= limit:
        answer, why = Answer.YES, "the upper confidence limit is below"
    elif high is not None:
        why = "the limit lies inside the confidence interval"
    return {
        "answer": answer, "why": why, "value": float(np.quantile(x, SHARE)), "low": low,
        "high": high, "n": len(x), "n_effective": n, "beyond": int((x > limit).sum()),
        "hours": _hours(t_ns),
    }  # fmt: skip


def _alert(x: Array, t_ns: Instants, limit: float) -> dict[str, Any]:
    """Whether an error exceeds the limit; if none does, what rate of exceedances is excluded."""
    beyond, hours = int((x > limit).sum()), _hours(t_ns)
    found = {
        "value": float(x.max()), "n": len(x), "n_effective": max(int(effective_samples(x)), 1),
        "beyond": beyond, "hours": hours,
    }  # fmt: skip
    if beyond:
        return found | {"answer": Answer.NO, "why": f"{beyond:,} of {len(x):,} errors exceed it"}
    # No event in so many hours: the 'rule of three', about 3 / hours at 95 %.
    rate = -math.log(1 - CONFIDENCE) / hours if hours > 0 else None
    excluded = "" if rate is None else f", so less than {rate:.2g} an hour"
    asked = f"asked is one in {1 / INTEGRITY_PER_H:,.0f} h"
    why = f"none exceeds it in {hours:.2g} h{excluded}; {asked}"
    return found | {"answer": Answer.OPEN, "why": why, "rate_high_per_h": rate}


def _hours(t_ns: Instants) -> float:
    """Time that the scored instants cover; what is left out between them does not count."""
    steps_s = np.diff(t_ns) / NS_PER_S
    return float(steps_s[steps_s <= MAX_GAP_S].sum()) / 3600


def _binomial_cdf(n: int, p: float) -> Array:
    """Probabilities (n + 1,) of at most 0, 1, .. n successes in n trials."""
    k = np.arange(n)
    steps = np.log((n - k) / (k + 1)) + math.log(p / (1 - p))
    return np.cumsum(np.exp(n * math.log1p(-p) + np.concatenate([[0.0], np.cumsum(steps)])))
