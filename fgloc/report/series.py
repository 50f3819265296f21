"""Figures over time: errors or claims, NIS, and what became of each measurement."""

import numpy as np

from fgloc.measurements import Array
from fgloc.report.scene import Scene, longest_step_s
from fgloc.report.style import (
    BLACK,
    BLUE,
    MAX_POINTS,
    Spec,
    axis,
    band,
    every,
    hover_text,
    layout,
    line,
    peaks,
    shaded,
    stacked,
    time_axis,
    verdict_style,
    with_gaps,
    y_name,
)  # fmt: skip
from fgloc.verdicts import SourceVerdicts, Verdict

_ERRORS = (
    ("lateral (m)", "lateral_m", "sigma_lateral_m", 1.0),
    ("longitudinal (m)", "longitudinal_m", "sigma_longitudinal_m", 1.0),
    ("up (m)", "up_m", "sigma_up_m", 1.0),
    ("heading (deg)", "yaw_rad", "sigma_yaw_rad", 180 / np.pi),
)
_PANEL_PX = 165
_MIN_NIS = 1e-3


def error_figure(scene: Scene) -> Spec | None:
    """Errors over time, one panel each, with the band of two claimed sigmas."""
    e = scene.errors
    if e is None:
        return None
    panels = [row for row in _ERRORS if np.isfinite(getattr(e, row[1])).any()]
    spec = stacked([title for title, *_ in panels], _PANEL_PX, scene.span_s)
    t_s, longest_s = scene.seconds(e.t_ns), longest_step_s(e.t_ns)
    data = []
    for k, (_, column, sigma, factor) in enumerate(panels):
        y, s = getattr(e, column) * factor, getattr(e, sigma) * factor
        data += _error_panel(t_s, y, s, longest_s, k)
        spec[f"yaxis{k + 1 if k else ''}"]["range"] = _error_range(y, s)
    return {"data": data, "layout": spec | {"shapes": shaded(scene.outages_s)}}


def _error_panel(t_s: Array, y: Array, sigma: Array, longest_s: float, k: int) -> list[Spec]:
    where = {"yaxis": y_name(k), "showlegend": k == 0}
    traces = []
    if np.isfinite(sigma).any():
        rows = every(len(t_s), MAX_POINTS // 2)
        gap_s = max(longest_s, 3 * (t_s[-1] - t_s[0]) / len(rows))
        traces.append(band(t_s[rows], 2 * sigma[rows], gap_s, BLUE, "claimed ±2 sigma", **where))
    rows = peaks(y)
    x, y = with_gaps(t_s[rows], y[rows], longest_s=longest_s)
    return [*traces, line(x, y, "error", BLACK, width=1.2, hovertemplate="%{y:.3f}", **where)]


def _error_range(y: Array, sigma: Array) -> list[float] | None:
    """Symmetric, with room for all errors; a far wider claim may leave the panel."""
    largest = float(np.nanmax(np.abs(y)))
    claim = 2 * float(np.nanquantile(sigma, 0.95)) if np.isfinite(sigma).any() else 0.0
    half = 1.1 * max(largest, min(claim, 5 * largest))
    return [-half, half] if half > 0 else None


def sigma_figure(scene: Scene) -> Spec | None:
    """What the estimate claims of itself over time, for drives without truth."""
    of = scene.estimate
    if of.cov is None or len(of) == 0:
        return None
    sigma = np.sqrt(np.diagonal(of.cov, axis1=-2, axis2=-1))
    columns = {"east (m)": sigma[:, 0], "north (m)": sigma[:, 1], "up (m)": sigma[:, 2]}
    if of.R_world_veh is not None:
        along, across = of.sigma_along_across_m()
        columns = {
            "lateral (m)": across, "longitudinal (m)": along, "up (m)": sigma[:, 2],
            "heading (deg)": np.rad2deg(sigma[:, 5]),
        }  # fmt: skip
    spec = stacked(list(columns), _PANEL_PX, scene.span_s)
    data = []
    for k, y in enumerate(columns.values()):
        rows = peaks(y)
        x, y = with_gaps(
            scene.seconds(of.t_ns)[rows], y[rows], longest_s=longest_step_s(of.t_ns[rows])
        )
        data.append(
            line(x, y, "claimed sigma", BLUE, yaxis=y_name(k), showlegend=False,
                 hovertemplate="%{y:.3f}")
        )  # fmt: skip
        spec[f"yaxis{k + 1 if k else ''}"]["rangemode"] = "tozero"
    return {"data": data, "layout": spec | {"shapes": shaded(scene.outages_s)}}


def nis_figure(scene: Scene) -> Spec | None:
    """NIS of each source over time on a logarithmic axis, with its gate and its expected mean."""
    sources = [v for v in scene.result.verdicts.values() if np.isfinite(v.nis).any()]
    if not sources:
        return None
    spec = stacked([f"{hover_text(v.source)} NIS" for v in sources], 190, scene.span_s, log=True)
    spec["hovermode"] = "closest"
    seen: set[str] = set()
    data = [t for k, v in enumerate(sources) for t in _nis_panel(scene, v, k, seen)]
    return {"data": data, "layout": spec | {"shapes": shaded(scene.outages_s)}}


def _nis_panel(scene: Scene, v: SourceVerdicts, k: int, seen: set[str]) -> list[Spec]:
    """Markers by verdict and two lines; `seen` holds the names that the legend has already."""
    t_s, names, known = scene.seconds(v.t_ns), v.verdict.astype(str), np.isfinite(v.nis)
    reason, traces = v.reason, []
    for name in np.unique(names[known]):
        rows = np.flatnonzero(known & (names == name))
        rows = rows[peaks(v.nis[rows], MAX_POINTS // 2)]
        text = [f"{name}<br>{hover_text(reason[r])}" if reason[r] else name for r in rows]
        trace = _verdict_markers(t_s[rows], np.maximum(v.nis[rows], _MIN_NIS), str(name), text)
        traces.append(
            trace | {"hovertemplate": "t = %{x:.2f} s, NIS %{y:.3g}<br>%{text}<extra></extra>"}
        )
    order = np.argsort(v.t_ns, kind="stable")
    for label, y, dash in (("gate", v.threshold, "dash"), ("mean if consistent", v.dof, "dot")):
        rows = order[(np.isfinite(y) & (y > 0) & known)[order]]
        rows = rows[every(len(rows), MAX_POINTS // 2)]
        if len(rows):
            traces.append(
                line(t_s[rows], y[rows].astype(float), label, BLACK, dash=dash, width=1.2)
            )
    for trace in traces:
        trace |= {"yaxis": y_name(k), "showlegend": trace["name"] not in seen}
        seen.add(trace["name"])
    return traces


def _verdict_markers(x: Array, y: Array, name: str, text: list[str]) -> Spec:
    colour, symbol = verdict_style(name)
    size = 4 if name == Verdict.USED else 8
    return {
        "type": "scatter", "mode": "markers", "x": x, "y": y, "name": name, "legendgroup": name,
        "text": text, "marker": {"color": colour, "symbol": symbol, "size": size},
    }  # fmt: skip


def timeline_figure(scene: Scene) -> Spec | None:
    """A row of strokes per source, one stroke per measurement in the colour of its verdict."""
    sources = [v for v in scene.result.verdicts.values() if len(v)]
    if not sources:
        return None
    data: list[Spec] = []
    seen: set[str] = set()
    for row, v in enumerate(sources):
        names, t_s = v.verdict.astype(str), scene.seconds(v.t_ns)
        # What was used is drawn first, so that what was not lies on top.
        for name in sorted(np.unique(names), key=lambda n: n != Verdict.USED):
            data.append(_strokes(t_s, np.flatnonzero(names == name), v, row, name))
            data[-1]["showlegend"] = name not in seen
            seen.add(name)
    spec = layout(
        46 * len(sources) + 110, hovermode="closest", shapes=shaded(scene.outages_s),
        xaxis=time_axis(scene.span_s),
        yaxis=axis("", tickvals=list(range(len(sources))), range=[len(sources) - 0.4, -0.6],
                   ticktext=[hover_text(v.source) for v in sources], showgrid=False),
    )  # fmt: skip
    return {"data": data, "layout": spec}


def _strokes(t_s: Array, rows: np.ndarray, v: SourceVerdicts, row: int, name: str) -> Spec:
    rows = rows[every(len(rows), MAX_POINTS // 2)]
    colour, _ = verdict_style(name)
    text = [f"{name}: {hover_text(r)}" if r else name for r in v.reason[rows]]
    return {
        "type": "scatter", "mode": "markers", "x": t_s[rows], "y": np.full(len(rows), float(row)),
        "name": name, "legendgroup": name, "text": text,
        "hovertemplate": "t = %{x:.2f} s<br>%{text}<extra></extra>",
        "marker": {"symbol": "line-ns-open", "color": colour, "size": 20,
                   "line": {"width": 1.5, "color": colour}},
    }  # fmt: skip
