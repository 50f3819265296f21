"""What all figures share: colours, axes, thinning and shaded spans.

A figure is a plain dictionary in Plotly's form (`data`, `layout`), so that the modules that make
figures need not import Plotly, which takes half a second.
"""

import html
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgloc.measurements import Array

Spec = dict[str, Any]

MAX_POINTS = 5000
"""Points of one trace; more are thinned, for no screen shows them and the file would swell."""

# Okabe, Ito, Color Universal Design (2008): told apart with any kind of colour vision.
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
YELLOW, BLUE, VERMILLION, PURPLE = "#F0E442", "#0072B2", "#D55E00", "#CC79A7"
GREY, PALE = "#767676", "#c9ccd1"
INK, SOFT, GRID = "#1f2328", "#57606a", "#e8eaed"

VERDICTS: dict[str, tuple[str, str]] = {
    "used": (SKY, "circle"),
    "down-weighted": (ORANGE, "triangle-up"),
    "gated": (VERMILLION, "x"),
    "late": (PURPLE, "diamond"),
    "duplicate": (YELLOW, "square"),
    "invalid": (BLACK, "cross"),
    "outside": (GREEN, "star"),
    "unused": (PALE, "circle"),
}
"""Colour and marker of each verdict; `verdict_style` gives those of one not listed."""


def verdict_style(verdict: str) -> tuple[str, str]:
    """Colour and marker of a verdict."""
    return VERDICTS.get(verdict, (GREY, "circle"))


def translucent(colour: str, opacity: float) -> str:
    """'#0072B2' as 'rgba(0,114,178,0.2)'."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{opacity})"


def axis(title: str, **more: Any) -> Spec:
    """An axis with the house's grid and ticks."""
    return {
        "title": {"text": title, "standoff": 8}, "gridcolor": GRID, "linecolor": PALE,
        "zeroline": False, "ticks": "outside", "tickcolor": PALE, "automargin": True, **more,
    }  # fmt: skip


def time_axis(span_s: Sequence[float], **more: Any) -> Spec:
    """The time axis, with the same range in every figure so that they can be compared by eye."""
    margin_s = 0.01 * (span_s[1] - span_s[0]) or 0.5
    between = [span_s[0] - margin_s, span_s[1] + margin_s]
    return axis("time since the start (s)", range=between, **more)


def layout(height: int, **more: Any) -> Spec:
    """A layout with the legend in a row above the plot, where it covers no data."""
    return {
        "height": height,
        "autosize": True,
        "margin": {"l": 56, "r": 14, "t": 30, "b": 48},
        "font": {"family": "system-ui, sans-serif", "size": 13, "color": INK},
        "paper_bgcolor": "white",
        "plot_bgcolor": "white",
        "hoverlabel": {"bgcolor": "white", "bordercolor": PALE, "align": "left"},
        "legend": {
            "orientation": "h", "x": 0, "xanchor": "left", "y": 1 + 10 / height,
            "yanchor": "bottom", "itemsizing": "constant",
        },
        **more,
    }  # fmt: skip


def stacked(
    titles: Sequence[str], panel_px: int, span_s: Sequence[float], *, log: bool = False
) -> Spec:
    """A layout of panels one above the other that share the time axis; the first is on top."""
    n, gap = len(titles), 0.035
    share = (1 - gap * (n - 1)) / n
    spec = layout(panel_px * n + 90, hovermode="x unified", hoversubplots="axis")
    spec["xaxis"] = time_axis(span_s, anchor="free", position=0)
    for k, title in enumerate(titles):
        top = 1 - k * (share + gap)
        spec[f"yaxis{k + 1 if k else ''}"] = axis(
            title, domain=[max(top - share, 0.0), top], type="log" if log else "linear",
            anchor="x", tickformat="~g", nticks=6,
        )  # fmt: skip
    if log:
        for key in spec:
            if key.startswith("yaxis"):
                spec[key] |= {"dtick": 1, "exponentformat": "none", "tickformat": None}
    return spec


def y_name(k: int) -> str:
    """Plotly's name of the k-th vertical axis, counted from 0."""
    return f"y{k + 1}" if k else "y"


def line(x: Array, y: Array, name: str, colour: str, **more: Any) -> Spec:
    """A line; `dash` and `width` may be given."""
    style = {"color": colour, "width": more.pop("width", 1.6), "dash": more.pop("dash", "solid")}
    return {
        "type": "scatter", "mode": "lines", "x": x, "y": y, "name": name, "line": style,
        "legendgroup": name, **more,
    }  # fmt: skip


def every(n: int, limit: int = MAX_POINTS) -> NDArray[np.int64]:
    """Evenly spread rows of n, at most `limit` of them, first and last among them."""
    return np.unique(np.linspace(0, max(n - 1, 0), min(n, limit)).round().astype(np.int64))[:n]


def peaks(y: Array, limit: int = MAX_POINTS) -> NDArray[np.int64]:
    """Rows of y (N,), at most `limit`, that keep the smallest and largest of every stretch."""
    if len(y) <= limit:
        return np.arange(len(y))
    width = -(-len(y) // (limit // 2))
    whole = len(y) // width * width
    filled = np.where(np.isfinite(y), y, 0.0)[:whole].reshape(-1, width)
    first = np.arange(0, whole, width)
    rows = [first + filled.argmin(axis=1), first + filled.argmax(axis=1), [len(y) - 1]]
    return np.unique(np.concatenate(rows))


def with_gaps(t_s: Array, *columns: Array, longest_s: float) -> tuple[Array, ...]:
    """The columns with a NaN wherever time jumps by more than `longest_s`, to break the line."""
    jumps = np.flatnonzero(np.diff(t_s) > longest_s) + 1
    return tuple(np.insert(np.asarray(c, float), jumps, np.nan, axis=0) for c in (t_s, *columns))


def band(t_s: Array, half: Array, longest_s: float, colour: str, name: str, **more: Any) -> Spec:
    """The area between -half and +half, in pieces where time jumps or `half` is unknown."""
    known = np.isfinite(half)
    t_s, half = t_s[known], half[known]
    cuts = np.flatnonzero(np.diff(t_s) > longest_s) + 1
    x: list[Array] = []
    y: list[Array] = []
    for t, h in zip(np.split(t_s, cuts), np.split(half, cuts), strict=True):
        x += [t, t[::-1], np.array([np.nan])]
        y += [h, -h[::-1], np.array([np.nan])]
    return {
        "type": "scatter", "mode": "lines", "x": np.concatenate(x), "y": np.concatenate(y),
        "fill": "toself", "fillcolor": translucent(colour, 0.18), "line": {"width": 0},
        "name": name, "legendgroup": name, "hoverinfo": "skip", **more,
    }  # fmt: skip


def shaded(
    spans_s: Iterable[Sequence[float]], colour: str = GREY, opacity: float = 0.14
) -> list[Spec]:
    """Shapes that shade spans of time (K, 2) in s across all panels."""
    return [
        {
            "type": "rect", "xref": "x", "yref": "paper", "x0": float(start), "x1": float(end),
            "y0": 0, "y1": 1, "fillcolor": translucent(colour, opacity), "line": {"width": 0},
            "layer": "below",
        }
        for start, end in spans_s
    ]  # fmt: skip


def hover_text(text: object) -> str:
    """Text of a file or an estimator as Plotly may show it: its markup taken literally."""
    return html.escape(str(text), quote=False)
