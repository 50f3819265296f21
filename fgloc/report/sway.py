"""Figures of posts: how they sway, and at which frequencies."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from fgloc.measurements import Array
from fgloc.node_health import COLUMNS, node_rows
from fgloc.post_health import LEAST_ROWS, amplitudes_m
from fgloc.posts import PostStates
from fgloc.report.scene import Scene
from fgloc.report.style import (
    BLACK,
    BLUE,
    VERMILLION,
    Spec,
    axis,
    hover_text,
    layout,
    line,
    peaks,
    stacked,
    y_name,
)
from fgloc.report.tables import number

_PANEL_PX = 190
_MOST_POSTS = 3
_AXES = ("x", "y")
_FASTEST_HZ = 20.0


def sway_figure(scene: Scene) -> Spec | None:
    """Displacement of each post over time along its node's axes, with the truth where there is."""
    posts = scene.result.posts
    if posts is None:
        return None
    nodes = np.unique(posts.node).tolist()[:_MOST_POSTS]
    panels = [(node, k) for node in nodes for k in range(2)]
    titles = [f"{_name(scene, node)} {_AXES[k]} (mm)" for node, k in panels]
    data = []
    for panel, (node, k) in enumerate(panels):
        for states, name, colour in _told(scene, posts, node):
            y = 1000 * states.p_node_m[:, k]
            rows = peaks(y)
            data.append(line(scene.seconds(states.t_ns)[rows], y[rows], name, colour, width=1.2,
                             yaxis=y_name(panel), showlegend=panel == 0,
                             hovertemplate="%{y:.1f}"))  # fmt: skip
    return {"data": data, "layout": stacked(titles, _PANEL_PX, scene.span_s)}


def sway_spectrum_figure(scene: Scene) -> Spec | None:
    """Amplitude of the displacement along both axes over frequency, one line for each post."""
    posts = scene.result.posts
    if posts is None:
        return None
    data = []
    for node in np.unique(posts.node).tolist()[:_MOST_POSTS]:
        for states, name, colour in _told(scene, posts, node):
            if len(states) < LEAST_ROWS:
                continue
            frequency_hz, amplitude_mm = _spectrum(states)
            title = f"{_name(scene, node)}, {name}"
            data.append(line(frequency_hz, amplitude_mm, title, colour, width=1.2,
                             hovertemplate="%{x:.2f} Hz: %{y:.2f} mm"))  # fmt: skip
    spec = layout(340, hovermode="closest", xaxis=axis("frequency (Hz)"),
                  yaxis=axis("amplitude (mm)", type="log"))  # fmt: skip
    return {"data": data, "layout": spec}


def health_rows(scene: Scene) -> list[dict[str, str]]:
    """A row for each node, as in `nodes.csv`: numbers as text, empty where nothing is known; a
    number with a sigma has it beside it."""
    return [_shown(row) for row in node_rows(scene.drive, scene.result.summary)]


def _shown(row: Mapping[str, Any]) -> dict[str, str]:
    values = {key: row.get(key) for key in COLUMNS if key != "node"}
    texts = {key: "" if value is None else number(value) for key, value in values.items()}
    for key in texts:
        if sigma := texts.get(f"sigma_{key}"):
            texts[key] += f" ± {sigma}"
    return {"name": row["node"], **texts}


def _told(scene: Scene, posts: PostStates, node: int) -> list[tuple[PostStates, str, str]]:
    """The truth of a node's post where there is one, and the estimate."""
    truth = scene.drive.post_truth
    known = [] if truth is None or not len(truth.of(node)) else [(truth.of(node), "truth", BLACK)]
    return [*known, (posts.of(node), "estimate", VERMILLION if known else BLUE)]


def _spectrum(states: PostStates) -> tuple[Array, Array]:
    """Frequencies and amplitudes in mm, both axes together."""
    frequency_hz, amplitude_m = amplitudes_m(states)
    shown = frequency_hz < _FASTEST_HZ
    return frequency_hz[shown], 1000 * np.linalg.norm(amplitude_m[shown], axis=1)


def _name(scene: Scene, node: int) -> str:
    return hover_text(scene.drive.infrastructure.nodes[node].name)
