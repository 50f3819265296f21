"""Numbers as a reader meets them: names, units, intervals, and rows of the report's tables."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fgloc.evaluation import Metric, error_growth
from fgloc.report.scene import Scene
from fgloc.verdicts import Verdict

LABELS = {
    "horizontal_rmse_m": "Horizontal RMSE",
    "horizontal_mean_m": "Horizontal error, mean",
    "horizontal_std_m": "Horizontal error, standard deviation",
    "horizontal_p95_m": "Horizontal error, 95 % below",
    "horizontal_max_m": "Horizontal error, largest",
    "up_rmse_m": "Vertical RMSE",
    "lateral_rmse_m": "Lateral RMSE",
    "lateral_mean_abs_m": "Lateral error, mean absolute",
    "lateral_std_abs_m": "Lateral error, standard deviation of the absolute",
    "longitudinal_rmse_m": "Longitudinal RMSE",
    "longitudinal_mean_abs_m": "Longitudinal error, mean absolute",
    "longitudinal_std_abs_m": "Longitudinal error, standard deviation of the absolute",
    "yaw_rmse_rad": "Heading RMSE",
    "anees": "ANEES, divided by its dimension",
    "anees_band_low": "ANEES band of a consistent estimator, from",
    "anees_band_high": "ANEES band of a consistent estimator, to",
    "anees_pose": "ANEES of the pose",
    "anees_position": "ANEES of the position",
    "anees_horizontal": "ANEES in the plane",
    "coverage95": "Truth inside the 95 % ellipsoid",
    "scored_share": "Truth that was scored",
    "outage_count": "GNSS outages",
    "outage_rmse_m": "Horizontal RMSE in outages",
    "outage_end_mean_m": "Error at the end of an outage, mean",
    "outage_end_max_m": "Error at the end of an outage, largest",
}
_TILES = (
    ("horizontal_rmse_m", "horizontal RMSE"),
    ("horizontal_p95_m", "95 % of errors below"),
    ("lateral_rmse_m", "lateral RMSE"),
    ("longitudinal_rmse_m", "longitudinal RMSE"),
    ("yaw_rmse_rad", "heading RMSE"),
    ("anees", "ANEES (1 is consistent)"),
    ("coverage95", "truth inside 95 % ellipsoid"),
)
MAX_ROWS = 200


@dataclass(frozen=True)
class Tile:
    """A key number: value and unit, what it is, and a line in small print."""

    value: str
    unit: str
    label: str
    small: str = ""


def number(value: float, digits: int = 3) -> str:
    """Significant digits without an exponent where that stays short: 0.0123, 1.23, 12,346."""
    if value == 0 or not math.isfinite(value):
        return "0" if value == 0 else str(value)
    decimals = digits - 1 - math.floor(math.log10(abs(value)))
    if not -6 <= -decimals <= 5:
        return f"{value:.{digits - 1}e}"
    return f"{value:,.{max(decimals, 0)}f}"


def shown(metric: Metric) -> tuple[float, str]:
    """Factor and unit to show a metric in: headings in degrees, bare numbers without a unit."""
    if metric.unit == "rad":
        return 180 / math.pi, "deg"
    return 1.0, "" if metric.unit == "1" else metric.unit


def interval(metric: Metric) -> str:
    """'1.20 to 1.45', or nothing."""
    if metric.low is None or metric.high is None:
        return ""
    factor, _ = shown(metric)
    return f"{number(metric.low * factor)} to {number(metric.high * factor)}"


def metric_rows(scores: Mapping[str, Metric]) -> list[dict[str, Any]]:
    """Rows of the table of metrics."""
    rows = []
    for name, metric in scores.items():
        factor, unit = shown(metric)
        value = "none" if metric.value is None else number(metric.value * factor)
        if name.endswith("_count") and metric.value is not None:
            value = f"{metric.value:,.0f}"
        target = "" if metric.target is None else f" {metric.target:g}"
        better = "" if metric.better == "neither" else metric.better.replace("target", "near")
        rows.append({
            "name": name, "label": LABELS.get(name, name), "value": value, "unit": unit,
            "interval": interval(metric), "n": f"{metric.n:,}" if metric.n else "",
            "better": better + target, "remark": metric.why or metric.note,
        })  # fmt: skip
    return rows


def tiles(scene: Scene, scores: Mapping[str, Metric] | None) -> list[Tile]:
    """The key numbers: errors where there is truth, else what the estimate claims."""
    found = [(label, m) for key, label in _TILES if (m := (scores or {}).get(key)) is not None]
    made = [_metric_tile(label, m) for label, m in found if m.value is not None]
    return (made or _claim_tiles(scene)) + _run_tiles(scene)


def _metric_tile(label: str, metric: Metric) -> Tile:
    factor, unit = shown(metric)
    between = interval(metric)
    value = number((metric.value or 0.0) * factor)
    return Tile(value, unit, label, f"95 %: {between}" if between else "")


def _claim_tiles(scene: Scene) -> list[Tile]:
    of = scene.estimate
    if of.cov is None or len(of) == 0:
        return []
    sigma = np.sqrt(np.median(np.diagonal(of.cov, axis1=-2, axis2=-1), axis=0))
    flat = float(np.hypot(sigma[0], sigma[1]))
    found = [Tile(number(flat), "m", "claimed horizontal sigma", "median; there is no truth")]
    if of.R_world_veh is not None:
        found.append(Tile(number(math.degrees(sigma[5])), "deg", "claimed heading sigma", "median"))
    return found


def _run_tiles(scene: Scene) -> list[Tile]:
    counts = [v.counts() for v in scene.result.verdicts.values()]
    total = sum(sum(c.values()) for c in counts)
    used = sum(c.get(Verdict.USED, 0) + c.get(Verdict.DOWN_WEIGHTED, 0) for c in counts)
    found = []
    if total:
        found.append(Tile(number(100 * used / total), "%", "measurements used", f"of {total:,}"))
    if isinstance(factor := scene.result.summary.get("realtime_factor"), int | float) and factor:
        found.append(Tile(number(float(factor)), "\N{MULTIPLICATION SIGN}", "real-time speed"))
    return found


def count_rows(scene: Scene) -> tuple[list[str], list[dict[str, Any]]]:
    """Verdicts that occur, and one row of counts per source with its total."""
    counts = {source: v.counts() for source, v in scene.result.verdicts.items()}
    seen = {name for c in counts.values() for name in c}
    order = [v for v in map(str, Verdict) if v in seen] + sorted(seen - set(map(str, Verdict)))
    return order, [
        {"source": source, "numbers": [f"{c.get(v, 0):,}" if c.get(v) else "" for v in order],
         "total": f"{sum(c.values()):,}"}
        for source, c in counts.items()
    ]  # fmt: skip


def outage_rows(scene: Scene) -> list[dict[str, str]]:
    """One row per outage; the errors are left empty where there is no truth inside."""
    if scene.errors is None:
        return [
            {
                "start": f"{a:.1f}",
                "length": f"{b - a:.1f}",
                "n": "",
                "rmse": "",
                "end": "",
                "at": "",
            }
            for a, b in scene.outages_s[:MAX_ROWS]
        ]
    g = error_growth(scene.errors, scene.outages_ns)
    return [
        {
            "start": f"{scene.outages_s[k, 0]:.1f}", "length": f"{g.length_s[k]:.1f}",
            "n": f"{g.n[k]:,}", "rmse": number(g.rmse_m[k]) if g.n[k] else "",
            "end": number(g.end_m[k]) if g.n[k] else "",
            "at": f"{g.end_since_s[k]:.1f}" if g.n[k] else "",
        }
        for k in range(min(len(g.n), MAX_ROWS))
    ]  # fmt: skip


def event_rows(scene: Scene) -> list[dict[str, str]]:
    """Events with their time in seconds since the start."""
    return [
        {"t": f"{float(scene.seconds(event.t_ns)):.2f}", "kind": event.kind, "text": event.text}
        for event in scene.result.events[:MAX_ROWS]
    ]


def flat_config(config: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Dotted keys and values as text."""
    for key, value in config.items():
        if isinstance(value, Mapping):
            yield from flat_config(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", "not set" if value is None else str(value)
