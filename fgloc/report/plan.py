"""The plan view: truth, estimate, fixes by verdict, and ellipses of what the estimate claims."""

import numpy as np

from fgloc.evaluation import chi2_quantile
from fgloc.measurements import Array
from fgloc.report.scene import Scene, longest_step_s
from fgloc.report.style import (
    BLACK,
    BLUE,
    GREEN,
    MAX_POINTS,
    PURPLE,
    Spec,
    axis,
    every,
    hover_text,
    layout,
    line,
    translucent,
    verdict_style,
    with_gaps,
)  # fmt: skip
from fgloc.trajectory import Trajectory
from fgloc.verdicts import Verdict

ELLIPSES = 40
HOVER = "%{fullData.name}<br>t = %{customdata:.2f} s<br>E %{x:.2f} m, N %{y:.2f} m<extra></extra>"
_FIX_HOVER = "%{text}<br>E %{x:.2f} m, N %{y:.2f} m<extra></extra>"


def plan_figure(scene: Scene) -> Spec:
    """East against north at one scale. Fixes lie underneath, what was rejected stands out."""
    data = _fixes(scene)
    truth = scene.drive.truth
    if truth is not None and len(truth):
        data.append(_path(scene, truth, "truth", BLACK, width=3.0, dash="solid"))
    if len(scene.estimate):
        data += _ellipses(scene.estimate)
        data.append(_path(scene, scene.estimate, "estimate", BLUE, width=1.8, dash="solid"))
    if scene.smoothed is not None and len(scene.smoothed):
        data.append(
            _path(scene, scene.smoothed, "smoothed afterwards", PURPLE, width=1.8, dash="dash")
        )
    return {
        "data": data,
        "layout": map_layout(),
    }


def map_layout() -> Spec:
    """Of a picture from above: both axes in m, at one scale."""
    return layout(
        560, hovermode="closest", dragmode="pan",
        xaxis=axis("east (m)", tickformat="~g"),
        yaxis=axis("north (m)", tickformat="~g", scaleanchor="x", scaleratio=1),
    )  # fmt: skip


def ellipse_outlines(
    trajectory: Trajectory, rows: Array | np.ndarray, probability: float = 0.95, points: int = 37
) -> Array:
    """Outlines (K, points, 2) of the horizontal ellipses that hold this share of a Gaussian."""
    if trajectory.cov is None:
        return np.zeros((0, points, 2))
    values, vectors = np.linalg.eigh(trajectory.cov[rows, :2, :2])
    radius = np.sqrt(np.maximum(values, 0.0) * float(chi2_quantile(probability, 2)))
    angle = np.linspace(0, 2 * np.pi, points)
    circle = np.stack([np.cos(angle), np.sin(angle)], -1)
    shapes = np.einsum("kij,kj,pj->kpi", vectors, radius, circle)
    return trajectory.p_world_m[rows, None, :2] + shapes


def _path(scene: Scene, of: Trajectory, name: str, colour: str, *, width: float, dash: str) -> Spec:
    of = of.take(every(len(of)))
    t_s = scene.seconds(of.t_ns)
    t, east, north = with_gaps(t_s, *of.p_world_m[:, :2].T, longest_s=longest_step_s(of.t_ns))
    return line(
        east, north, name, colour, width=width, dash=dash, customdata=t, hovertemplate=HOVER
    )


def _ellipses(estimate: Trajectory) -> list[Spec]:
    """One trace of ellipses, spread evenly along the way rather than over time."""
    if estimate.cov is None:
        return []
    step = np.linalg.norm(np.diff(estimate.p_world_m[:, :2], axis=0), axis=-1)
    way = np.concatenate([[0.0], np.cumsum(step)])
    rows = np.unique(np.searchsorted(way, np.linspace(0, way[-1], ELLIPSES)).clip(0, len(way) - 1))
    outlines = ellipse_outlines(estimate, rows)
    pen_up = np.full((len(outlines), 1, 2), np.nan)
    east, north = np.concatenate([outlines, pen_up], axis=1).reshape(-1, 2).T
    return [line(east, north, "95 % ellipse", translucent(GREEN, 0.9), width=1.2, hoverinfo="skip")]


def _fixes(scene: Scene) -> list[Spec]:
    """One trace of fixes for each verdict that occurs; without verdicts, one for all."""
    found = scene.fixes()
    if found is None:
        return []
    table, verdicts = found
    p, t_s = table.p_world_ant_m, scene.seconds(table.t_ns)
    if verdicts is None:
        return [_markers(p, t_s, np.arange(len(table)), "fixes", np.full(len(table), ""))]
    names, reason = verdicts.verdict.astype(str), verdicts.reason
    order = [v for v in map(str, Verdict) if (names == v).any()]
    order.sort(key=lambda name: name != Verdict.USED)
    return [_markers(p, t_s, np.flatnonzero(names == v), v, reason) for v in order]


def _markers(p: Array, t_s: Array, rows: np.ndarray, verdict: str, reason: np.ndarray) -> Spec:
    colour, symbol = verdict_style("used" if verdict == "fixes" else verdict)
    rows = rows[every(len(rows), MAX_POINTS)]
    name = verdict if verdict == "fixes" else f"fix {verdict}"
    text = [
        f"{name}<br>t = {t_s[row]:.2f} s"
        + (f"<br>{hover_text(reason[row])}" if reason[row] else "")
        for row in rows
    ]
    plain = verdict in ("fixes", Verdict.USED, Verdict.UNUSED)
    return {
        "type": "scatter", "mode": "markers", "x": p[rows, 0], "y": p[rows, 1], "name": name,
        "text": text, "hovertemplate": _FIX_HOVER,
        "marker": {"color": colour, "symbol": symbol, "size": 5 if plain else 8,
                   "opacity": 0.55 if plain else 0.9},
    }  # fmt: skip
