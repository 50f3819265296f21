"""How errors are distributed, and how they grow while GNSS is out."""

import numpy as np

from fgloc.evaluation import Errors, error_growth
from fgloc.measurements import Array
from fgloc.report.scene import Scene
from fgloc.report.style import (
    BLUE,
    GREEN,
    ORANGE,
    PALE,
    VERMILLION,
    Spec,
    axis,
    layout,
    line,
    peaks,
)  # fmt: skip
from fgloc.timing import NS_PER_S

_QUANTILES = 500
_CURVES = 30


def cdf_figure(scene: Scene) -> Spec | None:
    """Share of the truth's instants with an error below x."""
    e = scene.errors
    if e is None:
        return None
    curves = (
        ("horizontal", e.horizontal_m, BLUE, "solid"),
        ("lateral", np.abs(e.lateral_m), GREEN, "dash"),
        ("longitudinal", np.abs(e.longitudinal_m), ORANGE, "dot"),
    )
    data = [
        cdf_line(x[np.isfinite(x)], name, colour, dash)
        for name, x, colour, dash in curves
        if np.isfinite(x).any()
    ]
    return {"data": data, "layout": cdf_layout("error (m)")}


def cdf_layout(title: str) -> Spec:
    """Axes of a distribution, with a line at 95 %."""
    return layout(
        340, hovermode="x unified", xaxis=axis(title, rangemode="tozero"),
        yaxis=axis("share of instants", range=[0, 1.02], tickformat=".0%"),
        shapes=[{"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": 0.95, "y1": 0.95,
                 "line": {"color": PALE, "width": 1, "dash": "dash"}}],
    )  # fmt: skip


def cdf_line(x: Array, name: str, colour: str, dash: str) -> Spec:
    """Share of values (N,) below x, as a curve of quantiles."""
    share = np.linspace(0, 1, min(len(x), _QUANTILES) + 1)
    return line(
        np.quantile(x, share), share, name, colour, dash=dash, width=2.0, hovertemplate="%{y:.1%}"
    )


def growth_figure(scene: Scene) -> Spec | None:
    """Horizontal error against time since the outage began: each outage, and the mean of all."""
    e = scene.errors
    if e is None or len(scene.outages_ns) == 0:
        return None
    growth = error_growth(e, scene.outages_ns)
    known = np.isfinite(growth.bin_mean_m)
    if not known.any():
        return None
    data = _curves(e, growth.span_ns[growth.n > 0][:_CURVES])
    middle = (growth.bin_s[:-1] + growth.bin_s[1:]) / 2
    data.append(
        line(middle[known], growth.bin_mean_m[known], "mean of all", VERMILLION, width=2.5,
             mode="lines+markers", customdata=growth.bin_outages[known],
             hovertemplate="%{x:.1f} s: %{y:.2f} m<br>outages that last so long: %{customdata}"
                           "<extra></extra>")
    )  # fmt: skip
    spec = layout(
        320, hovermode="closest", yaxis=axis("horizontal error (m)", rangemode="tozero"),
        xaxis=axis("time since the last fix (s)", rangemode="tozero"),
    )  # fmt: skip
    return {"data": data, "layout": spec}


def _curves(e: Errors, spans: np.ndarray) -> list[Spec]:
    traces = []
    for k, (start, end) in enumerate(spans):
        rows = np.flatnonzero((e.t_ns > start) & (e.t_ns < end))
        rows = rows[peaks(e.horizontal_m[rows], 300)]
        traces.append(
            line((e.t_ns[rows] - start) / NS_PER_S, e.horizontal_m[rows], "one outage", "#9aa0a6",
                 width=1.0, showlegend=k == 0, hoverinfo="skip")
        )  # fmt: skip
    return traces
