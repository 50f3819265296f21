"""The page of a comparison: several methods on the same drives, in one HTML file."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from fgloc.evaluation import Metric
from fgloc.evaluation.comparison import MAIN, Comparison, Picture, Row
from fgloc.report.page import Figure, draw, render_page, write_page
from fgloc.report.tables import flat_config, interval, number, shown
from fgloc.report.versus import (
    cdf_in_range,
    cdf_of_methods,
    drives_figure,
    errors_of_methods,
    histogram_of_methods,
    method_style,
    plan_of_methods,
)  # fmt: skip

COLUMNS = {
    "horizontal_p95_m": "95 % below (m)",
    "lateral_rmse_m": "Lateral (m)",
    "longitudinal_rmse_m": "Longitudinal (m)",
    "up_rmse_m": "Vertical (m)",
    "yaw_rmse_rad": "Heading (deg)",
    "anees": "ANEES",
    "scored_share": "Scored",
}
"""The metrics of the page's table beside the main one; compare.json holds all."""
STANDINGS = {
    "horizontal_mean_m": "Mean error (m)",
    "horizontal_std_m": "Standard deviation (m)",
    "horizontal_rmse_m": "RMSE (m)",
    "horizontal_p95_m": "95 % below (m)",
    "lateral_rmse_m": "Lateral (m)",
    "longitudinal_rmse_m": "Longitudinal (m)",
    "anees_horizontal": "ANEES in the plane",
}
"""The columns of the table by condition."""
_SHOWN_ROWS = 200
_BELOW = (
    "Share of instants with a horizontal error below the value on the axis; the dashed line is at "
    "95 %."
)
_DRIVES = "Horizontal RMSE of each method over the instants of the truth that it covers."


def write_comparison_page(path: str | Path, comparison: Comparison) -> None:
    """Write the page as one HTML file that opens offline; InputError where it cannot be written."""
    write_page(path, render(comparison))


def render(comparison: Comparison) -> str:
    """The page as text."""
    return render_page(
        "compare.html.j2", methods=_methods(comparison), against=comparison.against,
        drives=_drives(comparison), score_from_s=comparison.score_from_s,
        overall=_overall_rows(comparison), standings=_standings(comparison),
        standing_columns=list(STANDINGS.values()), figures=list(_figures(comparison)),
        columns=list(COLUMNS.values()), rows=_rows(comparison),
        max_rows=_SHOWN_ROWS, row_count=len(comparison.rows), settings=_settings(comparison),
    )  # fmt: skip


def cell(metric: Metric | None) -> tuple[str, str]:
    """A metric's value and its interval as text, in m or deg; empty where there is none."""
    if metric is None or metric.value is None:
        return "", ""
    return number(metric.value * shown(metric)[0]), interval(metric)


def _methods(comparison: Comparison) -> list[dict[str, str]]:
    """Every method with its colour, and whether it looks ahead."""
    found = []
    for n, name in enumerate(comparison.methods):
        labels = {row.label for row in comparison.of(name)} - {""}
        kind = next(iter(labels), "no result")
        found.append({"name": name, "colour": method_style(n)[0], "kind": kind})
    return found


def _drives(comparison: Comparison) -> str:
    """The drives' names, with how many there were of each."""
    names = [row.drive for row in comparison.of(comparison.against)]
    counts = {name: names.count(name) for name in names}
    told = ", ".join(f"{name} ({n} drives)" if n > 1 else name for name, n in counts.items())
    options = ", ".join(f"{key} = {value}" for key, value in comparison.options.items())
    return f"{told}; {options}" if options else told


def _overall_rows(comparison: Comparison) -> list[dict[str, Any]]:
    """Each method over all drives; empty for one drive, where its rows say all."""
    if comparison.drives < 2:
        return []
    return [
        {
            "method": one.method, "mean": cell(one.mean), "difference": cell(one.difference),
            "n": one.mean.n, "failed": one.failed or "", "wall_s": f"{one.wall_s:.2f}",
        }
        for one in comparison.overall()
    ]  # fmt: skip


def _rows(comparison: Comparison) -> list[dict[str, Any]]:
    return [_row(row) for row in comparison.rows[:_SHOWN_ROWS]]


def _row(row: Row) -> dict[str, Any]:
    return {
        "drive": row.drive, "seed": row.seed, "method": row.method, "kind": row.label,
        "rmse": cell(row.metrics.get(MAIN)),
        "cells": [cell(row.metrics.get(name)) for name in COLUMNS],
        "difference": cell(row.difference), "wall_s": f"{row.wall_s:.2f}", "failed": row.failed,
    }  # fmt: skip


def _figures(comparison: Comparison) -> Iterator[Figure]:
    """What is drawn: over the drives where there are several, then each drive that was kept."""
    if comparison.drives > 2:
        spec = drives_figure(comparison)
        if spec["data"]:
            yield Figure("drives", "Drive by drive", _DRIVES, draw("drives", spec))
    for n, picture in enumerate(comparison.pictures):
        yield from _drawn(picture, comparison.methods, f"-{n}" if n else "")


def _drawn(picture: Picture, methods: tuple[str, ...], suffix: str) -> Iterator[Figure]:
    name = picture.drive if picture.seed is None else f"{picture.drive}, seed {picture.seed}"
    plans = (
        ("plan", "Plan view", plan_of_methods, "Seen from above, both axes at one scale."),
        ("errors", "Errors over time", errors_of_methods,
         "Estimate minus truth. Left, ahead, up and counter-clockwise are positive." + _shades(
             picture)),
        ("cdf", "Distribution of errors", cdf_of_methods, _BELOW),
        ("cdf-near", "Distribution of errors within the range of a node", cdf_in_range, _BELOW),
        ("histogram", "Histogram of errors", histogram_of_methods,
         "How often a horizontal error occurs" + (
             ", within the range of a node." if picture.masks else ".")),
    )  # fmt: skip
    for key, title, make, caption in plans:
        spec = make(picture, methods)
        if spec is not None and spec["data"]:
            yield Figure(key + suffix, f"{title}: {name}", caption, draw(key + suffix, spec))


def _shades(picture: Picture) -> str:
    """What the shading of errors over time means, as far as there is any."""
    near = " Green: within the range of a node." if picture.masks else ""
    out = " Grey: no fix was used, because there was none or it was gated."
    return near + (out if len(picture.outages_ns) else "")


def _standings(comparison: Comparison) -> list[dict[str, Any]]:
    """Each method near a node, elsewhere and on the whole; empty where no drive has nodes."""
    if not any(row.conditions for row in comparison.rows):
        return []
    return [
        {
            "condition": one.condition, "method": one.method, "ratio": cell(one.ratio),
            "n": one.averages[MAIN].n, "cells": [cell(one.averages[name]) for name in STANDINGS],
        }
        for one in comparison.standings()
    ]  # fmt: skip


def _settings(comparison: Comparison) -> list[tuple[str, list[str]]]:
    """Keys in which the methods' configurations differ, with each method's value."""
    configs = [_config(comparison.of(name)) for name in comparison.methods]
    keys = list(dict.fromkeys(key for config in configs for key in config))
    table = [(key, [config.get(key, "") for config in configs]) for key in keys]
    # A baseline without any configuration does not differ: it has none.
    return [(key, values) for key, values in table if len({*values} - {""}) > 1]


def _config(rows: tuple[Row, ...]) -> Mapping[str, str]:
    """The configuration of a method's first run that has one, by dotted keys."""
    config = next((dict(row.config) for row in rows if row.config), {})
    config.pop("versions", None)
    return dict(flat_config(config))
