"""From figures and tables to a page: Plotly and Jinja2 enter here and nowhere else."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fgloc.errors import InputError
from fgloc.report.style import Spec

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


def draw(key: str, spec: Spec, **config: Any) -> str:
    """A specification as a piece of HTML; Plotly checks every name and value in it."""
    import plotly.graph_objects as go
    import plotly.io

    return plotly.io.to_html(
        go.Figure(data=spec["data"], layout=spec["layout"]), config=_CONFIG | config,
        full_html=False, include_plotlyjs=False, include_mathjax=False, div_id=f"plot-{key}",
        default_height="auto",
    )  # fmt: skip


def draw_panels(key: str, specs: Mapping[str, Spec]) -> str:
    """Several small plots side by side, one below the other where the screen is narrow.

    Keys are the panels' titles, which must need no escaping.
    """
    panels = (
        f'<div><h3>{title}</h3>{draw(f"{key}-{n}", spec, displayModeBar=False)}</div>'
        for n, (title, spec) in enumerate(specs.items())
    )  # fmt: skip
    return f'<div class="panels">{"".join(panels)}</div>'


def render_page(template: str, **values: Any) -> str:
    """The text of a page from a template of this folder; all values are escaped."""
    import jinja2  # with Plotly 0.5 s to import, which runs without a report need not pay
    from plotly.offline import get_plotlyjs

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("fgloc", "report"), autoescape=True,
        undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters["tie"] = _tie
    return environment.get_template(template).render(plotlyjs=get_plotlyjs(), **values)


def write_page(path: str | Path, page: str) -> None:
    """Write a page's text; raises InputError where the file cannot be written."""
    try:
        Path(path).write_text(page, encoding="utf-8", newline="\n")
    except OSError as err:
        raise InputError(f"{path}: the report cannot be written: {err.strerror}") from err


def _tie(text: str) -> str:
    """A number and its per cent sign kept on one line."""
    return text.replace(" %", "\N{NO-BREAK SPACE}%")
