"""How roadside nodes are doing: `nodes.csv` and a table of the report, a row for each node.

What every run can tell comes from the drive, how its rows arrived; the rest from the summary of a
run that followed the nodes and their posts.
"""

from collections.abc import Mapping
from typing import Any

from fgloc.drive import Drive
from fgloc.measurements import NodeDetections
from fgloc.post_health import arrival

ABSENT_S = 1.0
"""A node that reports nothing for longer sees nobody: no frame was dropped."""
COLUMNS = {
    "node": "name",
    "detections": "rows of the drive",
    "rate_hz": "instants with detections in a second",
    "drop_rate": "share of the instants that the rate lets expect, but for absences",
    "latency_s": "median time from an instant to its arrival",
    "clock_late_s": "how late its stamps are, where that is estimated or set",
    "frames": "frames with a candidate for the car",
    "car_seen": "frames from which the car was taken",
    "nis_mean": "of these; 2, or 3 with heights, where the node claims what it holds",
    "survey_east_m": "estimated error of the survey, with a sigma, where the drive says it has one",
    "survey_north_m": "the same",
    "survey_yaw_rad": "the same",
    "survey_up_m": "the same, where the node tells heights",
    "sigma_survey_east_m": "",
    "sigma_survey_north_m": "",
    "sigma_survey_yaw_rad": "",
    "sigma_survey_up_m": "",
    "residual_east_m": "shift and turn of the node that would fit what it saw still better",
    "residual_north_m": "the same",
    "residual_yaw_rad": "the same",
    "slow_error_rms_m": "of the slow error, where it has one",
    "sway_rms_m": "displacement of its post, its length in plan",
    "sway_largest_m": "the same",
    "sway_strongest_hz": "where the spectrum of the sway is highest",
    "frequency_hz": "natural, of the post: as sought in the drive, or else as stated",
    "sigma_frequency_hz": "where it was sought",
    "damping": "ratio, likewise",
    "sigma_damping": "",
    "poses": "poses of the node in the drive",
    "poses_latency_s": "",
    "poses_missing_share": "of what their rate lets expect",
}
"""Columns of `nodes.csv` and what they are."""


def node_rows(drive: Drive, summary: Mapping[str, Any]) -> list[dict[str, Any]]:
    """A row for each node of a drive, of columns of `COLUMNS`; what is not known is left out."""
    return [
        {"node": node.name, **_arrived(drive, i, summary), **_found(node.name, summary),
         **_sway(node.name, summary)}
        for i, node in enumerate(drive.infrastructure.nodes)
    ]  # fmt: skip


def format_nodes(rows: list[dict[str, Any]]) -> str:
    """The text of `nodes.csv`; a cell is empty where nothing is known."""
    lines = (",".join(_cell(row.get(name)) for name in COLUMNS) for row in rows)
    return "\n".join([",".join(COLUMNS), *lines]) + "\n"


def _arrived(drive: Drive, node: int, summary: Mapping[str, Any]) -> dict[str, Any]:
    """How the detections of a node came in."""
    clock = (summary.get("clock") or {}).get("nodes")
    late = {"clock_late_s": clock["late_s"]} if clock else {}
    seen = drive.tables.get(NodeDetections.KIND)
    own = seen.take(seen.node == node) if isinstance(seen, NodeDetections) else ()
    if not isinstance(own, NodeDetections) or not len(own):
        return {"detections": 0}
    told = arrival(own, "detections", ABSENT_S)
    return {"drop_rate": told.pop("missing_share"), **told, **late}


def _found(name: str, summary: Mapping[str, Any]) -> dict[str, Any]:
    """What a run found of the node: what it saw, its survey, its slow error."""
    told = dict(summary.get("nodes", {}).get(name, {}))
    off = [told.pop(f"survey_off_{part}", None) for part in ("m", "rad", "up_m")]
    for prefix, key in (("", "value"), ("sigma_", "sigma")):
        values = [value for one in off if one for value in one[key]]
        names = [f"{prefix}survey_{part}" for part in ("east_m", "north_m", "yaw_rad", "up_m")]
        told |= dict(zip(names, values, strict=False))
    return {key: value for key, value in told.items() if key in COLUMNS}


def _sway(name: str, summary: Mapping[str, Any]) -> dict[str, Any]:
    """What a run found of the node's post."""
    told = summary.get("posts", {}).get(name, {})
    renamed = {"rms_m": "sway_rms_m", "largest_m": "sway_largest_m",
               "strongest_hz": "sway_strongest_hz", "latency_s": "poses_latency_s",
               "missing_share": "poses_missing_share"}  # fmt: skip
    row = {renamed.get(key, key): value for key, value in told.items() if key != "rate_hz"}
    for key, of in summary.get("posts_sought", {}).get(name, {}).items():
        if key in COLUMNS:
            row |= {key: of["value"], f"sigma_{key}": of["value"] * of["relative_error"]}
    return row


def _cell(value: Any) -> str:
    if value is None or value != value:
        return ""
    text = str(value)
    return '"' + text.replace('"', '""') + '"' if set(text) & set(',"\r\n') else text
