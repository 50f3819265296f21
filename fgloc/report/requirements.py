"""Verdicts on requirements as a reader meets them: rows for the screen and for the page."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from fgloc.evaluation.requirements import (
    ACCURACY,
    ALERT,
    INTEGRITY_PER_H,
    PROFILES,
    Answer,
    Requirement,
)
from fgloc.report.tables import number

LABELS = {
    "lateral_m": "Lateral", "longitudinal_m": "Longitudinal", "up_m": "Vertical",
    "yaw_rad": "Heading",
}  # fmt: skip
TITLES = {name: name.replace("_", " ").capitalize() for name in (p.name for p in PROFILES)}
_CLASSES = {Answer.YES: "yes", Answer.NO: "no", Answer.OPEN: "open"}


def answer_lines(found: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """One line a profile, from what summary.json holds: its name, accuracy, alert limits."""
    return [
        (TITLES[name], _grouped(found[name][ACCURACY]), _grouped(found[name][ALERT]))
        for name in TITLES
        if name in found
    ]


def accuracy_rows(found: Sequence[Requirement]) -> list[dict[str, Any]]:
    """A row for each quantity: its 95 % figure, interval, and the answer for each profile."""
    return [_accuracy_row(rows) for rows in _by_column(found, ACCURACY)]


def alert_rows(found: Sequence[Requirement]) -> list[dict[str, Any]]:
    """A row for each quantity: its largest error and the answer for each profile."""
    return [_alert_row(rows) for rows in _by_column(found, ALERT)]


def excluded_rate(found: Sequence[Requirement]) -> str:
    """What the drive says of the rate of exceedances, as a sentence; empty where nothing."""
    rates = [row for row in found if row.rate_high_per_h is not None]
    if not rates:
        return ""
    hours, rate = rates[0].hours, rates[0].rate_high_per_h or 0.0
    return (
        f"Where no error exceeds the limit, {number(hours, 2)} h of driving exclude, with 95 % "
        f"confidence, only rates above {number(rate, 2)} an hour (the rule of three); for one "
        f"in {1 / INTEGRITY_PER_H:,.0f} hours it would take three times as many."
    )


def _by_column(found: Sequence[Requirement], kind: str) -> list[dict[str, Requirement]]:
    """For each quantity its requirements by profile."""
    rows = [{r.profile: r for r in found if (r.kind, r.column) == (kind, c)} for c in LABELS]
    return [row for row in rows if row]


def _accuracy_row(rows: Mapping[str, Requirement]) -> dict[str, Any]:
    one = next(iter(rows.values()))
    low, high = ("" if end is None else _shown(end, one.column) for end in (one.low, one.high))
    between = f"{low} to {high}" if low and high else f"above {low}" if low else ""
    return _row(rows) | {"interval": between}


def _alert_row(rows: Mapping[str, Requirement]) -> dict[str, Any]:
    made = _row(rows)
    for cell, requirement in zip(made["cells"], _in_order(rows), strict=True):
        if requirement is not None and requirement.beyond:
            cell["more"] = f"{requirement.beyond:,} beyond"
    return made


def _row(rows: Mapping[str, Requirement]) -> dict[str, Any]:
    one = next(iter(rows.values()))
    reasons = {} if one.kind == ALERT and one.rate_high_per_h is not None else {
        row.why: None for row in rows.values() if row.answer == Answer.OPEN
    }  # fmt: skip
    return {
        "label": LABELS[one.column],
        "value": "none" if one.value is None else _shown(one.value, one.column),
        "unit": _unit(one.column), "n": f"{one.n:,}", "n_effective": f"{one.n_effective:,}",
        "cells": [_cell(row) for row in _in_order(rows)], "remark": "; ".join(reasons),
    }  # fmt: skip


def _in_order(rows: Mapping[str, Requirement]) -> list[Requirement | None]:
    return [rows.get(profile) for profile in TITLES]


def _cell(row: Requirement | None) -> dict[str, str]:
    """The answer, how it is coloured and what was asked; empty where nothing is required."""
    if row is None:
        return {"answer": "", "style": "", "limit": "", "more": ""}
    limit = math.degrees(row.limit) if row.column.endswith("_rad") else row.limit
    asked = f"{limit:.2f} {_unit(row.column)}"
    return {"answer": str(row.answer), "style": _CLASSES[row.answer], "limit": asked, "more": ""}


def _shown(value: float, column: str) -> str:
    return number(math.degrees(value) if column.endswith("_rad") else value)


def _unit(column: str) -> str:
    return "deg" if column.endswith("_rad") else "m"


def _grouped(rows: Mapping[str, Mapping[str, Any]]) -> str:
    """'yes: lateral, longitudinal; no: vertical'."""
    groups: dict[str, list[str]] = {}
    for column, row in rows.items():
        groups.setdefault(row["answer"], []).append(LABELS[column].lower())
    order = [str(answer) for answer in Answer if answer in groups]
    return "; ".join(f"{answer}: {', '.join(groups[answer])}" for answer in order)
