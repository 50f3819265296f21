"""The report of one run: a single HTML file that needs no network.

`write_report` gathers the drive, the result and its errors into a `Scene`; each figure is a plain
specification made from it; Plotly and Jinja2 enter here and nowhere else.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fgloc.drive import Drive
from fgloc.errors import InputError
from fgloc.evaluation import Errors, Metric
from fgloc.report import tables
from fgloc.report.plan import plan_figure
from fgloc.report.scene import Scene, scene
from fgloc.report.series import error_figure, nis_figure, sigma_figure, timeline_figure
from fgloc.report.spread import cdf_figure, growth_figure
from fgloc.report.style import MAX_POINTS, Spec
from fgloc.result import Result
from fgloc.timing import iso_utc

__all__ = ["write_report"]

_CONFIG = {
    "displaylogo": False,
    "responsive": True,
    "showSendToCloud": False,
    "plotlyServerURL": "",
    "scrollZoom": False,
    "modeBarButtonsToRemove": ["select2d", "lasso2d", "autoScale2d"],
}


@dataclass(frozen=True)
class Figure:
    """A figure on the page: `caption` tells what is seen, `html` draws it."""

    key: str
    title: str
    caption: str
    html: str


def write_report(
    path: str | Path,
    *,
    drive: Drive,
    result: Result,
    scores: Mapping[str, Metric] | None,
    errors: Errors | None,
) -> None:
    """Write the report of a result as one HTML file of about 5 MB, which opens offline.

    Without truth (`scores` and `errors` None) it shows what the estimate claims of itself. Names
    and reasons from files are escaped. Raises InputError where the file cannot be written.
    """
    page = render(scene(drive, result, errors), scores)
    try:
        Path(path).write_text(page, encoding="utf-8", newline="\n")
    except OSError as err:
        raise InputError(f"{path}: the report cannot be written: {err.strerror}") from err


def render(of: Scene, scores: Mapping[str, Metric] | None) -> str:
    """The page as text."""
    import jinja2  # with Plotly 0.5 s to import, which runs without a report need not pay
    from plotly.offline import get_plotlyjs

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("fgloc", "report"), autoescape=True,
        undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters["tie"] = _tie
    order, counts = tables.count_rows(of)
    config = dict(of.result.config)
    versions = config.pop("versions", {})
    return environment.get_template("report.html.j2").render(
        drive=of.drive, result=of.result, facts=_facts(of), tiles=tables.tiles(of, scores),
        figures=list(_figures(of)), metrics=tables.metric_rows(scores or {}),
        has_truth=of.drive.truth is not None, has_errors=of.errors is not None,
        verdicts=order, counts=counts, outages=tables.outage_rows(of),
        outage_count=len(of.outages_s), events=tables.event_rows(of),
        event_count=len(of.result.events), max_rows=tables.MAX_ROWS,
        config=list(tables.flat_config(config)), versions=versions.items(),
        plotlyjs=get_plotlyjs(),
    )  # fmt: skip


def _tie(text: str) -> str:
    """A number and its per cent sign kept on one line."""
    return text.replace(" %", "\N{NO-BREAK SPACE}%")


def _facts(of: Scene) -> list[tuple[str, str]]:
    """The lines of the header: what was driven, when, and how it was estimated."""
    about, summary, states = of.drive.about, of.result.summary, of.result.trajectory.t_ns
    lookahead = (
        "causal: each state as it was known at its own time"
        if of.result.causal
        else "smoothed: each state draws on the whole drive"
    )
    duration_s = (int(states[-1]) - int(states[0])) / 1e9 if len(states) else 0.0
    facts = [
        ("Method", f"{of.result.method} ({lookahead})"),
        ("Duration", f"{duration_s:,.1f} s, {len(states):,} states written"),
        ("Start", iso_utc(of.start_ns)),
        ("Data", "simulated" if about.simulated else about.source),
        ("Licence", about.licence),
        ("Solved in", f"{summary['wall_s']:.2f} s" if _is_number(summary.get("wall_s")) else ""),
    ]
    return [(name, text) for name, text in facts if text]


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _figures(of: Scene) -> Iterator[Figure]:
    """The figures that this run has data for, in the order of the page."""
    for key, title, make, caption in _PLAN_OF_PAGE:
        spec = make(of)
        if spec is not None and spec["data"]:
            yield Figure(key, title, caption(of), _draw(key, spec))


def _draw(key: str, spec: Spec) -> str:
    """A specification as a piece of HTML; Plotly checks every name and value in it."""
    import plotly.graph_objects as go
    import plotly.io

    return plotly.io.to_html(
        go.Figure(data=spec["data"], layout=spec["layout"]), config=_CONFIG, full_html=False,
        include_plotlyjs=False, include_mathjax=False, div_id=f"plot-{key}", default_height="auto",
    )  # fmt: skip


def _plan_caption(of: Scene) -> str:
    x, y, z = (f"{value:g}" for value in of.estimate.p_veh_point_m)
    parts = [
        f"Seen from above, both axes at one scale; drawn is the vehicle's point ({x}, {y}, {z}) m."
    ]
    if of.estimate.cov is not None:
        parts.append("The ellipses hold 95 % of the estimate's claimed horizontal error.")
    if of.fixes() is not None:
        parts.append("Fixes are antenna positions; point at one for its time and the reason.")
    return " ".join(parts) + _thinned(len(of.estimate))


def _error_caption(of: Scene) -> str:
    e = of.errors
    assert e is not None  # the caption is asked for only where there is a figure
    text = "Estimate minus truth. Left, ahead, up and counter-clockwise are positive."
    if e.course_based:
        text += " The truth has no attitude; its course gives the directions."
    hidden = [name for name in ("lateral_m", "longitudinal_m", "yaw_rad") if _all_nan(e, name)]
    text += "".join(f" No {name.rsplit('_', 1)[0]} error: {e.why[name]}." for name in hidden)
    left_out = "; ".join(f"{n:,} rows {reason}" for reason, n in e.left_out.items())
    text += f" Truth left out: {left_out}." if left_out else ""
    return text + _shading(of) + _thinned(len(e), "; the largest and smallest are kept")


def _all_nan(e: Errors, column: str) -> bool:
    values = getattr(e, column)
    return bool((values != values).all())  # NaN alone differs from itself


def _sigma_caption(of: Scene) -> str:
    if of.errors is not None:
        return ""
    return (
        "What the estimate claims of itself, one standard deviation; there is no truth to hold it "
        "against." + _shading(of)
    )


def _nis_caption(of: Scene) -> str:
    return (
        "Normalised innovation squared: how far a measurement lay from what was expected, in units "
        "of its claimed uncertainty. A consistent source scatters about the dotted line; the "
        "dashed line is the gate." + _shading(of)
    )


def _shading(of: Scene) -> str:
    return " GNSS outages are shaded." if len(of.outages_s) else ""


def _thinned(n: int, more: str = "") -> str:
    return f" Thinned from {n:,} to {MAX_POINTS:,} points{more}." if n > MAX_POINTS else ""


_PLAN_OF_PAGE: tuple[
    tuple[str, str, Callable[[Scene], Spec | None], Callable[[Scene], str]], ...
] = (
    ("plan", "Plan view", plan_figure, _plan_caption),
    ("errors", "Errors over time", error_figure, _error_caption),
    (
        "sigmas",
        "Claimed uncertainty over time",
        lambda of: None if of.errors is not None else sigma_figure(of),
        _sigma_caption,
    ),
    (
        "cdf",
        "Distribution of errors",
        cdf_figure,
        lambda of: (
            "Share of the truth's instants with an error below the value on the axis; the "
            "dashed line is at 95 %."
        ),
    ),
    (
        "growth",
        "Error growth in GNSS outages",
        growth_figure,
        lambda of: (
            "Horizontal error since the last fix before each outage. Grey: single outages; "
            "red: their mean, over those that last so long."
        ),
    ),
    ("nis", "Normalised innovations", nis_figure, _nis_caption),
    (
        "timeline",
        "What became of each measurement",
        timeline_figure,
        lambda of: (
            "One stroke per measurement in the colour of its verdict; dense sources are "
            "thinned, the table below counts all." + _shading(of)
        ),
    ),
)
