"""Figures of several methods on one drive, and of several drives: a colour for each method."""

from collections.abc import Iterator

import numpy as np

from fgloc.evaluation.comparison import MAIN, Comparison, Picture
from fgloc.evaluation.conditions import IN_RANGE, spans, under
from fgloc.measurements import Array
from fgloc.report.plan import HOVER, map_layout
from fgloc.report.scene import at_truths_point, longest_step_s
from fgloc.report.spread import cdf_layout, cdf_line
from fgloc.report.style import (
    BLACK,
    BLUE,
    GREEN,
    MAX_POINTS,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    Spec,
    axis,
    every,
    hover_text,
    layout,
    line,
    peaks,
    shaded,
    stacked,
    with_gaps,
    y_name,
)  # fmt: skip
from fgloc.timing import elapsed_s
from fgloc.trajectory import Trajectory

_COLOURS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY)
_DASHES = ("solid", "dash", "dot")
_MARKERS = ("circle", "diamond", "square", "triangle-up", "x", "cross")
_COLUMNS = (
    ("horizontal (m)", "horizontal_m", 1.0),
    ("lateral (m)", "lateral_m", 1.0),
    ("longitudinal (m)", "longitudinal_m", 1.0),
    ("up (m)", "up_m", 1.0),
    ("heading (deg)", "yaw_rad", 180 / np.pi),
)
_PANEL_PX = 150
BINS = 40
"""Of the histogram, up to where 99.5 % of the errors of every method lie."""


def method_style(number: int) -> tuple[str, str]:
    """Colour and dash of the n-th method, counted from 0; the first has the plainest."""
    return _COLOURS[number % len(_COLOURS)], _DASHES[number // len(_COLOURS) % len(_DASHES)]


def plan_of_methods(picture: Picture, methods: tuple[str, ...]) -> Spec:
    """Truth and every method's path from above, at one scale."""
    data = []
    if picture.truth is not None and len(picture.truth):
        data.append(_path(picture, picture.truth, "truth", (BLACK, "solid"), width=3.0))
    for n, method in enumerate(methods):
        if method in picture.runs:
            at = at_truths_point(picture.runs[method][0], picture.truth)
            data.append(_path(picture, at, method, method_style(n)))
    if picture.nodes:
        data.append(_nodes(picture))
    return {
        "data": data,
        "layout": map_layout(),
    }


def errors_of_methods(picture: Picture, methods: tuple[str, ...]) -> Spec | None:
    """Errors over time, a panel for each quantity that any method has, a line for each method."""
    found = {m: e for m, (_, e) in picture.runs.items() if e is not None and len(e)}
    panels = [p for p in _COLUMNS if any(_known(getattr(e, p[1])) for e in found.values())]
    if not panels:
        return None
    ends = [float(elapsed_s(e.t_ns[-1], picture.start_ns)) for e in found.values()]
    spec = stacked([title for title, *_ in panels], _PANEL_PX, (0.0, max(ends)))
    data = []
    for k, (_, column, factor) in enumerate(panels):
        for n, method in enumerate(methods):
            if method in found and _known(y := getattr(found[method], column) * factor):
                t_s = elapsed_s(found[method].t_ns, picture.start_ns)
                data.append(_error_line(t_s, y, method, n, k))
    return {"data": data, "layout": spec | {"shapes": _shades(picture)}}


def cdf_of_methods(picture: Picture, methods: tuple[str, ...]) -> Spec:
    """Share of instants with a horizontal error below x, a curve for each method."""
    data = [
        cdf_line(x, hover_text(method), *method_style(n))
        for n, method, x in _horizontal(picture, methods, None)
    ]
    return {"data": data, "layout": cdf_layout("horizontal error (m)")}


def cdf_in_range(picture: Picture, methods: tuple[str, ...]) -> Spec | None:
    """The same within the range of a node; None where there is none."""
    if IN_RANGE not in picture.masks:
        return None
    data = [
        cdf_line(x, hover_text(method), *method_style(n))
        for n, method, x in _horizontal(picture, methods, IN_RANGE)
    ]
    return {"data": data, "layout": cdf_layout("horizontal error (m)")}


def histogram_of_methods(picture: Picture, methods: tuple[str, ...]) -> Spec:
    """How often a horizontal error occurs, near a node where there is one: Lee et al. (2021),
    Fig. 8."""
    condition = IN_RANGE if IN_RANGE in picture.masks else None
    found = list(_horizontal(picture, methods, condition))
    top = max((float(np.quantile(x, 0.995)) for _, _, x in found), default=1.0) or 1.0
    edges = np.linspace(0, top, BINS + 1)
    data = []
    for n, method, x in found:
        colour, dash = method_style(n)
        steps = line(
            edges,
            _step_heights(x, edges),
            hover_text(method),
            colour,
            dash=dash,
            width=1.8,
            hovertemplate="%{y:.1%}",
        )
        steps["line"]["shape"] = "hv"
        data.append(steps)
    spec = layout(
        340, hovermode="x unified", xaxis=axis("horizontal error (m)", rangemode="tozero"),
        yaxis=axis("share of instants", rangemode="tozero", tickformat=".0%"),
    )  # fmt: skip
    return {"data": data, "layout": spec}


def _step_heights(x: Array, edges: Array) -> Array:
    """Share of values (N,) in each bin, the last repeated: a step line has as many points as
    edges."""
    share = np.histogram(x, edges)[0] / len(x)
    return np.append(share, share[-1:])


def _horizontal(
    picture: Picture, methods: tuple[str, ...], condition: str | None
) -> Iterator[tuple[int, str, Array]]:
    """Number, name and horizontal errors (N,) of each method that has any under a condition."""
    for n, method in enumerate(methods):
        errors = picture.runs[method][1] if method in picture.runs else None
        if errors is None or picture.truth is None:
            continue
        if condition is not None:
            errors = under(errors, picture.truth, picture.masks[condition])
        if len(errors):
            yield n, method, errors.horizontal_m


def _shades(picture: Picture) -> list[Spec]:
    """Green within the range of a node, grey without fixes."""
    shapes = shaded(elapsed_s(picture.outages_ns, picture.start_ns))
    if picture.truth is not None and IN_RANGE in picture.masks:
        near = spans(picture.truth, picture.masks[IN_RANGE])
        shapes += shaded(elapsed_s(near, picture.start_ns), GREEN, 0.10)
    return shapes


def drives_figure(comparison: Comparison) -> Spec:
    """Horizontal RMSE of each drive, a marker for each method."""
    data = [_markers(comparison, method, n) for n, method in enumerate(comparison.methods)]
    ticks = {"tickvals": list(range(comparison.drives)), "ticktext": drive_names(comparison)}
    spec = layout(
        360, hovermode="x unified", xaxis=axis("drive", **ticks),
        yaxis=axis("horizontal RMSE (m)", rangemode="tozero"),
    )  # fmt: skip
    return {"data": [trace for trace in data if len(trace["x"])], "layout": spec}


def drive_names(comparison: Comparison) -> list[str]:
    """The drives as they may be shown, each with the seed it was made with."""
    rows = comparison.of(comparison.against)
    return [
        hover_text(r.drive if r.seed is None else f"{r.drive}, seed {r.seed}") for r in rows
    ]  # fmt: skip


def _markers(comparison: Comparison, method: str, number: int) -> Spec:
    found = [row.metrics.get(MAIN) for row in comparison.of(method)]
    known = {k: m.value for k, m in enumerate(found) if m is not None and m.value is not None}
    return {
        "type": "scatter", "mode": "markers", "x": list(known), "y": list(known.values()),
        "name": hover_text(method), "hovertemplate": "%{y:.3f} m",
        "marker": {"color": method_style(number)[0], "size": 8,
                   "symbol": _MARKERS[number % len(_MARKERS)]},
    }  # fmt: skip


def _path(
    picture: Picture, of: Trajectory, name: str, style: tuple[str, str], *, width: float = 1.8
) -> Spec:
    of = of.take(every(len(of)))
    t_s, longest_s = elapsed_s(of.t_ns, picture.start_ns), longest_step_s(of.t_ns)
    t, east, north = with_gaps(t_s, *of.p_world_m[:, :2].T, longest_s=longest_s)
    colour, dash = style
    return line(
        east, north, hover_text(name), colour, width=width, dash=dash, customdata=t,
        hovertemplate=HOVER,
    )  # fmt: skip


def _nodes(picture: Picture) -> Spec:
    place = np.array([node.p_world_m for node in picture.nodes])
    return {
        "type": "scatter", "mode": "markers", "x": place[:, 0], "y": place[:, 1], "name": "node",
        "text": [hover_text(node.name) for node in picture.nodes],
        "hovertemplate": "%{text}<extra></extra>",
        "marker": {"color": BLACK, "symbol": "triangle-up", "size": 12},
    }  # fmt: skip


def _error_line(t_s: Array, y: Array, method: str, number: int, panel: int) -> Spec:
    rows = peaks(y, MAX_POINTS // 2)
    gap_s = max(1.5, 3 * (t_s[-1] - t_s[0]) / len(rows))
    x, y = with_gaps(t_s[rows], y[rows], longest_s=gap_s)
    colour, dash = method_style(number)
    return line(
        x, y, hover_text(method), colour, dash=dash, width=1.3, hovertemplate="%{y:.3f}",
        yaxis=y_name(panel), showlegend=panel == 0,
    )  # fmt: skip


def _known(y: Array) -> bool:
    return bool(np.isfinite(y).any())
