"""The report of one run: a single HTML file that needs no network.

`write_report` gathers the drive, the result and its errors into a `Scene`; each figure is a plain
specification made from it, which `page` draws.
"""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from fgloc.drive import Drive
from fgloc.evaluation import Errors, Metric, judge_requirements
from fgloc.evaluation.requirements import INTEGRITY_PER_H, SOURCE
from fgloc.report import requirements, tables
from fgloc.report.page import Figure, draw, draw_panels, render_page, write_page
from fgloc.report.plan import plan_figure
from fgloc.report.protection import RISK, SIGMAS, protection_panels
from fgloc.report.scene import Scene, scene
from fgloc.report.series import error_figure, nis_figure, sigma_figure, timeline_figure
from fgloc.report.spread import cdf_figure, growth_figure
from fgloc.report.style import MAX_POINTS, Spec
from fgloc.report.sway import health_rows, sway_figure, sway_spectrum_figure
from fgloc.result import Result
from fgloc.timing import iso_utc

__all__ = ["write_report"]


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
    write_page(path, render(scene(drive, result, errors), scores))


def render(of: Scene, scores: Mapping[str, Metric] | None) -> str:
    """The page as text."""
    order, counts = tables.count_rows(of)
    config = dict(of.result.config)
    versions = config.pop("versions", {})
    return render_page(
        "report.html.j2", drive=of.drive, result=of.result, facts=_facts(of),
        tiles=tables.tiles(of, scores),
        nodes=health_rows(of),
        figures=list(_figures(of)), metrics=tables.metric_rows(scores or {}),
        has_truth=of.drive.truth is not None or of.drive.post_truth is not None,
        has_errors=of.errors is not None or of.result.posts is not None,
        verdicts=order, counts=counts, outages=tables.outage_rows(of),
        outage_count=len(of.outages_s), events=tables.event_rows(of),
        event_count=len(of.result.events), max_rows=tables.MAX_ROWS,
        config=list(tables.flat_config(config)), versions=versions.items(),
        **_requirements(of),
    )  # fmt: skip


def _requirements(of: Scene) -> dict[str, Any]:
    """What the page says of requirements; empty tables where there are no errors."""
    found = () if of.errors is None else judge_requirements(of.errors)
    return {
        "profiles": list(requirements.TITLES.values()),
        "accuracy": requirements.accuracy_rows(found), "alert": requirements.alert_rows(found),
        "excluded_rate": requirements.excluded_rate(found), "requirements_source": SOURCE,
        "integrity_hours": 1 / INTEGRITY_PER_H,
    }  # fmt: skip


def _facts(of: Scene) -> list[tuple[str, str]]:
    """The lines of the header: what was driven, when, and how it was estimated."""
    about, summary, states = of.drive.about, of.result.summary, of.result.states_ns
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
            yield Figure(key, title, caption(of), draw(key, spec))
    panels = protection_panels(of)
    if panels:
        html = draw_panels("protection", panels)
        yield Figure("protection", "Protection levels", _PROTECTION_CAPTION, html)


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


_PROTECTION_CAPTION = (
    f"How large an error the estimate would have warned of, against the error there was. The "
    f"protection level is {SIGMAS:.2f} claimed sigmas: a Gaussian error exceeds it once in "
    f"{1 / RISK:,.0f} times. The darker a cell, the more instants fall into it; below the "
    "diagonal the error was larger than the level. Lines are the alert limits: above one the "
    "system would have said that it is not available; right of one and below it a limit was "
    "exceeded unwarned. The sigmas are Gaussian claims of the estimate, of which a drive tests "
    "only the bulk: this is no certified bound of integrity, and a level that holds here may "
    "fail in rarer conditions. What lies outside the axes is drawn at their ends."
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
    (
        "sway",
        "Sway of the posts",
        sway_figure,
        lambda of: "Displacement of the node along its level axes, against where it was surveyed.",
    ),
    (
        "sway-spectrum",
        "Frequencies of the sway",
        sway_spectrum_figure,
        lambda of: (
            "Amplitude of the displacement, both axes together, under a Hann window. An estimate "
            "ends at half the rate of its poses; what is faster appears below, at another "
            "frequency."
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
