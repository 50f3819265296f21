"""A result as a folder of files: trajectories, the verdict on every measurement, the summary."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from pydantic_core import to_json

from fgloc.datasets.csv_table import format_rows
from fgloc.drive import Drive
from fgloc.errors import InputError
from fgloc.evaluation import Judgement, check_points, judge, requirements, score_posts
from fgloc.evaluation.comparison import Comparison
from fgloc.evaluation.metric import Metric
from fgloc.evaluation.objects import score_objects
from fgloc.frames import Origin
from fgloc.measurements import Array
from fgloc.node_health import format_nodes, node_rows
from fgloc.parallel import each, portions
from fgloc.posts import PostStates
from fgloc.result import Event, Result
from fgloc.timing import NS_PER_S
from fgloc.trajectory import Trajectory
from fgloc.verdicts import FATES, SourceVerdicts, Verdicts

TRAJECTORY, SMOOTHED = "trajectory", "trajectory_smoothed"
SUMMARY, VERDICTS, CONFIG, REPORT = "summary.json", "verdicts.csv", "config.toml", "report.html"
OBJECTS = "objects.csv"
COMPARISON, POSTS, NODES = "compare.json", "posts.csv", "nodes.csv"
VERDICT_COLUMNS = (
    "source", "t_ns", "received_ns", "verdict", "nis", "dof", "threshold", "reason",
)  # fmt: skip
_ROWS_AT_ONCE = 8192
POST_COLUMNS = {
    "x_m": ("p_node_m", 0), "vx_mps": ("v_node_mps", 0), "y_m": ("p_node_m", 1),
    "vy_mps": ("v_node_mps", 1), "roll_rad": ("tilt_rad", 0), "pitch_rad": ("tilt_rad", 1),
    "sigma_x_m": ("sigma_p_m", 0), "sigma_vx_mps": ("sigma_v_mps", 0),
    "sigma_y_m": ("sigma_p_m", 1), "sigma_vy_mps": ("sigma_v_mps", 1),
    "sigma_roll_rad": ("sigma_tilt_rad", 0), "sigma_pitch_rad": ("sigma_tilt_rad", 1),
}  # fmt: skip
"""Columns of `posts.csv` after node and time, each from a column of the table."""
_SUFFIXES = ("tum", "csv", "geojson")
ALSO = ("gpx", "kml")
"""Formats of the trajectory that are written where they are asked for."""
FILES = (
    *(f"{stem}.{suffix}" for stem in (TRAJECTORY, SMOOTHED) for suffix in (*_SUFFIXES, *ALSO)),
    SUMMARY, VERDICTS, CONFIG, REPORT, OBJECTS, POSTS, NODES,
)  # fmt: skip
"""Everything that a result folder may hold; these are replaced when it is written again."""


def check_folder(folder: Path) -> None:
    """Raise InputError where results cannot or should not go: a file, or a drive's folder."""
    from fgloc.datasets.drive_folder import is_drive_folder

    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; results go into a folder: give another name")
    if is_drive_folder(folder):
        raise InputError(f"{folder}: is a drive folder; choose another folder for the results")


def check_file(path: Path, *, overwrite: bool) -> None:
    """Raise InputError where a file of our own cannot or should not go."""
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give the name of a file")
    if path.exists() and not overwrite:
        raise InputError(f"{path}: is there already; give another name or --overwrite")


def write_file(path: Path, text: str) -> None:
    """Write a file, and make its folder where that is missing; InputError where it cannot be."""
    with _writing(path.parent):
        _write_text(path, text)


def write_result(
    folder: Path,
    drive: Drive,
    result: Result,
    *,
    score_from_s: float = 0.0,
    report: bool = True,
    also: Sequence[str] = (),
) -> dict[str, Any]:
    """Write every file of a result and give back what `summary.json` holds.

    `also` names formats of `ALSO` in which the trajectory is written besides.

    The folder is made where it is missing; files of an older result in it are replaced. Raises
    InputError where it cannot be written or holds a drive.
    """
    check_folder(folder)
    if drive.truth is not None:
        check_points(result.trajectory, drive.truth)  # before older files go
    with _writing(folder):
        _clear(folder)
        # Numpy judges while tables become text: these two wait for each other little.
        judged, _ = each(lambda part: part(), [
            lambda: _judged(drive, result, score_from_s),
            lambda: _write_tables(folder, drive, result, also),
        ])  # fmt: skip
        summary = summarize(drive, result, judged, score_from_s)
        _write_text(folder / CONFIG, format_config(drive, result))
        if report:
            _write_report(folder / REPORT, drive, result, judged)
        _write_text(folder / SUMMARY, format_json(summary))
    return summary


def _judged(drive: Drive, result: Result, score_from_s: float) -> Judgement | None:
    """What the drive's truth says of a result; None where it has none."""
    if drive.truth is None:
        return None
    return judge(result, drive.truth, score_from_s=score_from_s)


def _write_tables(folder: Path, drive: Drive, result: Result, also: Sequence[str]) -> None:
    """Write the files of a result that do not depend on the truth."""
    if len(result.trajectory):
        _write_trajectory(folder, TRAJECTORY, result.trajectory, drive, also)
    if result.posts is not None:
        _write_text(folder / POSTS, format_posts(result.posts, drive))
    if drive.infrastructure.nodes:
        _write_text(folder / NODES, format_nodes(node_rows(drive, result.summary)))
    if result.smoothed is not None:
        _write_trajectory(folder, SMOOTHED, result.smoothed, drive, also)
    with (folder / VERDICTS).open("wb") as file:
        file.writelines(_verdict_lines(result.verdicts))
    if result.objects is not None:
        from fgloc.datasets.object_tracks import write_tracks

        write_tracks(folder / OBJECTS, result.objects)


def write_scores(folder: Path, summary: Mapping[str, Any]) -> None:
    """Write the summary of scores alone; files of an older result in the folder are taken away."""
    check_folder(folder)
    with _writing(folder):
        _clear(folder)
        _write_text(folder / SUMMARY, format_json(summary))


def write_comparison(folder: Path, comparison: Comparison, *, report: bool = True) -> None:
    """Write `compare.json` and the page of a comparison; older results in the folder are replaced.

    Raises InputError where the folder cannot be written or holds a drive.
    """
    check_folder(folder)
    with _writing(folder):
        _clear(folder)
        _write_text(folder / COMPARISON, format_json(comparison.to_dict()))
        if report:
            from fgloc.report.comparison_page import write_comparison_page

            write_comparison_page(folder / REPORT, comparison)


def read_summary(path: Path) -> dict[str, Any]:
    """The content of a `summary.json`; InputError where it is missing or no such file."""
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as err:
        raise InputError(
            f"{path}: no such file; a result folder, as fgloc smooth writes it, has one"
        ) from err
    except (OSError, ValueError) as err:
        raise InputError(f"{path}: is not readable as JSON: {err}") from err
    if not isinstance(values, dict):
        raise InputError(f"{path}: holds no summary of a result")
    return values


def read_result_trajectory(path: Path) -> Trajectory:
    """A trajectory file; one of a result folder tells of the point that the summary there names.

    All others are of the vehicle's origin. Raises DriveError where the file is missing or wrong.
    """
    from fgloc.datasets.trajectory_files import read_trajectory

    trajectory = read_trajectory(path)
    of_result = path.stem in (TRAJECTORY, SMOOTHED) and (path.parent / SUMMARY).is_file()
    summary = read_summary(path.parent / SUMMARY) if of_result else {}
    if "p_veh_point_m" not in summary:
        return trajectory
    R = trajectory.R_world_veh if summary.get("attitude") else None  # TUM always has one
    return replace(trajectory, R_world_veh=R, p_veh_point_m=np.array(summary["p_veh_point_m"]))


def summarize(
    drive: Drive, result: Result, judged: Judgement | None, score_from_s: float = 0.0
) -> dict[str, Any]:
    """What `summary.json` holds: plain values, with null for what is not a finite number."""
    config = result.config
    summary = {
        **result.summary,
        "causal": result.causal,
        "start_ns": drive.start_ns,
        "p_veh_point_m": result.trajectory.p_veh_point_m,
        "attitude": result.trajectory.R_world_veh is not None,
        "seed": config.get("seed"),
        "versions": config.get("versions", {}),
        "about": vars(drive.about),
        "origin": vars(drive.origin),
        "events": [_event(event, drive.start_ns) for event in result.events],
    }
    metrics = score_posts(result.posts, drive, score_from_s=score_from_s)
    if judged is not None:
        metrics |= judged.metrics
        summary["requirements"] = requirements.as_dict(judged.requirements)
    if drive.objects is not None and result.objects is not None:
        metrics |= score_objects(result.objects, drive.objects, drive.start_ns, score_from_s)
    if metrics:
        summary |= {"score_from_s": score_from_s, "metrics": _plain(metrics)}
    if drive.truth is not None and result.smoothed is not None:
        smoothed = judge(result, drive.truth, score_from_s=score_from_s, smoothed=True)
        summary["smoothed_metrics"] = _plain(smoothed.metrics)
        summary["smoothed_requirements"] = requirements.as_dict(smoothed.requirements)
    clean: dict[str, Any] = jsonable(summary)
    return clean


def format_verdicts(verdicts: Verdicts) -> str:
    """The text of `verdicts.csv`: one row per measurement, source by source; NaN is left empty."""
    return b"".join(_verdict_lines(verdicts)).decode()


def format_posts(posts: PostStates, drive: Drive) -> str:
    """The text of `posts.csv`: the node's name, then the state; a sigma that is not told is empty.

    Displacements in m along the node's level axes, velocities, roll and pitch in rad.
    """
    names = [node.name for node in drive.infrastructure.nodes]
    columns: list[Array] = [getattr(posts, name)[:, k] for name, k in POST_COLUMNS.values()]
    numbers = np.stack(columns, -1).tolist()
    lines = (
        f"{_cell(names[node])},{t},{','.join(map(_number, row))}\n"
        for node, t, row in zip(posts.node.tolist(), posts.t_ns.tolist(), numbers, strict=True)
    )
    return ",".join(["node", "t_ns", *POST_COLUMNS]) + "\n" + "".join(lines)


def format_config(drive: Drive, result: Result) -> str:
    """The text of `config.toml`: what was in force, fit to be given to `--config` again."""
    import tomli_w

    config = dict(result.config)
    versions = ", ".join(f"{name} {text}" for name, text in config.pop("versions", {}).items())
    about = f" ({drive.about.source})" if drive.about.source else ""
    remarks = [
        f"What was in force: method {result.method}",
        f"Drive: {drive.name}{about}",
        f"Versions: {versions}" if versions else "",
    ]
    head = "".join(f"# {' '.join(remark.split())}\n" for remark in remarks if remark)
    return f"{head}\n{tomli_w.dumps(config)}" if config else head


def format_json(values: Mapping[str, Any]) -> str:
    """JSON text of plain values; what is not a finite number becomes null."""
    return json.dumps(jsonable(values), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def jsonable(value: Any) -> Any:
    """Numpy's values as Python's, and NaN and infinity, which JSON does not know, as None."""
    if isinstance(value, Mapping):
        return {str(key): jsonable(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return jsonable(value.tolist())
    if isinstance(value, list | tuple):
        return [jsonable(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


@contextmanager
def _writing(folder: Path) -> Iterator[None]:
    """Make the folder; a file that cannot be written is the user's to mend."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    except OSError as err:
        raise InputError(f"{err.filename or folder}: cannot be written: {err.strerror}") from err


def _clear(folder: Path) -> None:
    """Take away what an older result left, so that no file of it stands among the new ones."""
    for name in (*FILES, COMPARISON):
        (folder / name).unlink(missing_ok=True)


def _write_trajectory(
    folder: Path, stem: str, trajectory: Trajectory, drive: Drive, also: Sequence[str]
) -> None:
    from fgloc.datasets import trajectory_files as files
    from fgloc.datasets.map_files import write_map

    origin: Origin = drive.origin
    files.write_tum(folder / f"{stem}.tum", trajectory)
    files.write_trajectory_csv(folder / f"{stem}.csv", trajectory)
    files.write_geojson(folder / f"{stem}.geojson", trajectory, origin, truth=drive.truth)
    for suffix in also:
        write_map(folder / f"{stem}.{suffix}", trajectory, origin, name=f"{drive.name} {stem}")


def _write_report(path: Path, drive: Drive, result: Result, judged: Judgement | None) -> None:
    from fgloc.report import write_report

    scores, errors = (judged.metrics, judged.errors) if judged else (None, None)
    write_report(path, drive=drive, result=result, scores=scores, errors=errors)


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8", newline="\n")


def _event(event: Event, start_ns: int) -> dict[str, Any]:
    t_s = (event.t_ns - start_ns) / NS_PER_S
    return {"t_ns": event.t_ns, "t_s": t_s, "kind": event.kind, "text": event.text}


def _plain(metrics: Mapping[str, Metric]) -> dict[str, Any]:
    return {name: metric.to_dict() for name, metric in metrics.items()}


def _verdict_lines(verdicts: Verdicts) -> Iterator[bytes]:
    """The lines of `verdicts.csv`, many at a time."""
    yield (",".join(VERDICT_COLUMNS) + "\n").encode()
    for table in verdicts.values():
        for part in portions(len(table), _ROWS_AT_ONCE):
            yield from _verdict_rows(table, part)


def _verdict_rows(table: SourceVerdicts, part: slice) -> Iterator[bytes]:
    """Lines of some rows of a source: beginning and end are made once for each run of rows that
    have all but times and NIS in common."""
    times = format_rows(np.stack([table.t_ns[part], table.received_ns[part]], -1))
    fates, whys, dofs = table.fate[part], table.why[part], table.dof[part]
    limits, nis = table.threshold[part], table.nis[part]
    told = [] if np.isnan(nis).all() else _numbers(nis)
    begin = f"{_cell(table.source)},".encode()
    common = fates, whys, dofs, np.where(np.isnan(limits), -1.0, limits)
    changes = np.any([column[1:] != column[:-1] for column in common], 0)
    for first, stop in pairwise([0, *(np.flatnonzero(changes) + 1).tolist(), len(nis)]):
        middle, reason = f",{FATES[fates[first]]},".encode(), _cell(table.reasons[whys[first]])
        end = f",{dofs[first]},{_number(limits[first])},{reason}\n".encode()
        lines = times[first:stop]
        if told:
            lines = list(map(middle.join, zip(lines, told[first:stop], strict=True)))
        else:
            end = middle + end
        yield begin + (end + begin).join(lines) + end


def _numbers(values: Array) -> list[bytes]:
    """The shortest exact text of each of some numbers (n,); empty for NaN."""
    text = to_json(values.tolist())[1:-1]
    return text.replace(b"NaN", b"").replace(b"Infinity", b"inf").split(b",")


def _number(value: float) -> str:
    """The shortest exact text, empty for NaN."""
    return "" if np.isnan(value) else repr(float(value))


def _cell(text: str) -> str:
    """A CSV cell, quoted where it has to be."""
    text = str(text)
    return '"' + text.replace('"', '""') + '"' if set(text) & set(',"\r\n') else text
