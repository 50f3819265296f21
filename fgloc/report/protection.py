"""Protection levels against errors, after the diagrams of the Stanford GPS laboratory.

A protection level is a bound that the estimator would give while driving, when no truth is at
hand: here k claimed sigmas, k from the probability that a Gaussian error stays within. Below the
diagonal the error was larger than the level: misleading. That is what a Gaussian claim comes to on
this drive; a certified integrity bound would have to account for faults, which this does not.
"""

from collections.abc import Iterator
from statistics import NormalDist

import numpy as np

from fgloc.evaluation import Errors
from fgloc.evaluation.requirements import PROFILES
from fgloc.measurements import Array
from fgloc.report.requirements import LABELS
from fgloc.report.scene import Scene
from fgloc.report.style import (
    BLACK,
    ORANGE,
    SOFT,
    VERMILLION,
    Spec,
    axis,
    layout,
    line,
    translucent,
)

RISK = 1e-7
"""The share of errors that a Gaussian claim leaves outside its protection level."""
SIGMAS = NormalDist().inv_cdf(1 - RISK / 2)
"""The level in claimed sigmas: 5.33."""
_SIGMA_OF = {
    "lateral_m": "sigma_lateral_m", "longitudinal_m": "sigma_longitudinal_m",
    "up_m": "sigma_up_m",
}  # fmt: skip
_LINES = ((VERMILLION, "dash", "bottom"), (ORANGE, "dot", "top"))
"""Colour and dash of each road's limit, and which end of its name stands at the line."""
_BINS_PER_DECADE = 12
_SMALLEST_M, _LARGEST_M = 1e-3, 1e4
_SCALE = [[0, "#c6dff0"], [0.5, "#4a9acb"], [1, "#003a5d"]]
_HOVER = "error %{x:.3g} m, level %{y:.3g} m<br>%{customdata:,} instants<extra></extra>"


def protection_panels(scene: Scene) -> dict[str, Spec]:
    """A diagram for each of lateral, longitudinal and vertical that has errors and claims."""
    if scene.errors is None:
        return {}
    found = {column: levels(scene.errors, column) for column in _SIGMA_OF}
    return {
        f"{LABELS[column]}: {_misleading(*pair)}": _panel(column, *pair)
        for column, pair in found.items()
        if len(pair[0])
    }


def levels(e: Errors, column: str) -> tuple[Array, Array]:
    """Absolute errors (N,) and protection levels (N,) in m where both are known."""
    error, level = np.abs(getattr(e, column)), SIGMAS * getattr(e, _SIGMA_OF[column])
    known = np.isfinite(error) & np.isfinite(level)
    return error[known], level[known]


def _misleading(error: Array, level: Array) -> str:
    beyond = int((error > level).sum())
    return f"{beyond:,} of {len(error):,} beyond the level"


def _panel(column: str, error: Array, level: Array) -> Spec:
    """The diagram of one quantity: how many instants fall into each cell, limits, diagonal."""
    limits = {p.name: p.alert[column] for p in PROFILES if column in p.alert}
    edges = _edges(error, level, list(limits.values()))
    low, high = float(edges[0]), float(edges[-1])
    exponents = list(range(round(np.log10(low)), round(np.log10(high)) + 1))
    ticks = {
        "type": "log", "range": [exponents[0], exponents[-1]],
        "tickvals": [10.0**n for n in exponents], "ticktext": [f"{10.0**n:g}" for n in exponents],
    }  # fmt: skip
    shapes, notes = zip(*_limit_lines(limits), strict=True)
    spec = layout(
        330, hovermode="closest", showlegend=False, margin={"l": 52, "r": 10, "t": 8, "b": 46},
        xaxis=axis("error (m)", **ticks), yaxis=axis("protection level (m)", **ticks),
        shapes=[shape for pair in shapes for shape in pair],
        annotations=[*notes, _note("misleading", 0.97, 0.03, "right")],
    )  # fmt: skip
    corner = np.array([low, high, high])
    data = [
        line(corner, np.array([low, low, high]), "misleading", VERMILLION, width=0,
             fill="toself", fillcolor=translucent(VERMILLION, 0.08), hoverinfo="skip"),
        _cells(error, level, edges),
        line(corner[:2], corner[:2], "error as large as the level", BLACK, width=1.2,
             hoverinfo="skip"),
    ]  # fmt: skip
    return {"data": data, "layout": spec}


def _edges(error: Array, level: Array, limits: list[float]) -> Array:
    """Edges of cells over whole decades, from 1 mm to 10 km at most, that hold nearly all."""
    smallest = min(float(np.quantile(error, 0.05)), float(level.min()), *limits)
    smallest = max(smallest, _SMALLEST_M)
    largest = min(max(float(error.max()), float(level.max()), *limits), _LARGEST_M)
    first, last = int(np.floor(np.log10(smallest))), int(np.ceil(np.log10(largest)))
    return 10.0 ** np.linspace(first, last, (last - first) * _BINS_PER_DECADE + 1)


def _cells(error: Array, level: Array, edges: Array) -> Spec:
    """Counts per cell; what lies outside the edges is drawn at the margin."""
    inside = np.nextafter(edges[0], edges[1]), np.nextafter(edges[-1], edges[0])
    counts, _, _ = np.histogram2d(np.clip(level, *inside), np.clip(error, *inside), [edges, edges])
    shade = np.log10(np.where(counts > 0, counts, np.nan))
    return {
        "type": "heatmap", "x": edges, "y": edges, "z": shade, "customdata": counts.astype(int),
        "colorscale": _SCALE, "showscale": False, "hoverongaps": False, "hovertemplate": _HOVER,
        "zmin": 0.0, "zmax": max(float(np.nanmax(shade)), 1.0),
    }  # fmt: skip


def _limit_lines(limits: dict[str, float]) -> Iterator[tuple[list[Spec], Spec]]:
    """For each road a line at the limit along either axis, and its name."""
    for (name, limit), (colour, dash, end) in zip(limits.items(), _LINES, strict=False):
        style = {"color": colour, "width": 1.4, "dash": dash}
        flat = {"xref": "paper", "x0": 0, "x1": 1, "y0": limit, "y1": limit}
        upright = {"yref": "paper", "y0": 0, "y1": 1, "x0": limit, "x1": limit}
        shapes = [{"type": "line", "line": style, **where} for where in (flat, upright)]
        text = f"{name.replace('_', ' ')} {limit:g} m"
        yield shapes, _note(text, 0.02, float(np.log10(limit)), "left") | {
            "yref": "y", "yanchor": end,
        }  # fmt: skip


def _note(text: str, x: float, y: float, anchor: str) -> Spec:
    return {
        "text": text, "xref": "paper", "yref": "paper", "x": x, "y": y, "xanchor": anchor,
        "yanchor": "bottom", "showarrow": False, "font": {"size": 11, "color": SOFT},
        "bgcolor": "rgba(255,255,255,0.6)", "borderpad": 0,
    }  # fmt: skip
