"""What happened to each measurement around a moment, read back from a result folder."""

import csv
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fgloc.errors import InputError
from fgloc.outputs import SUMMARY, TRAJECTORY, VERDICT_COLUMNS, VERDICTS, read_summary
from fgloc.timing import NS_PER_S
from fgloc.trajectory import Trajectory

MOST_ROWS = 20
"""A source with more rows than this around the moment is counted instead of listed."""


@dataclass(frozen=True)
class Judged:
    """One measurement: its time since the drive's start, its verdict, and the reason.

    `nis` and `threshold` are None where there was none; `delay_s` is how late it arrived.
    """

    source: str
    t_s: float
    delay_s: float
    verdict: str
    nis: float | None
    dof: int
    threshold: float | None
    reason: str


@dataclass(frozen=True)
class Explanation:
    """The measurements within `window_s` of the moment `t_s`, and what surrounds them.

    listed  the measurements of sparse sources, in order of time
    counted for each dense source, how often each (verdict, reason) occurs
    sigmas  standard deviations of the trajectory there, by name; empty outside its time
    events  what the method reported in the window: (seconds, kind, text)
    """

    t_s: float
    window_s: float
    method: str
    listed: tuple[Judged, ...]
    counted: dict[str, dict[tuple[str, str], int]]
    sigmas: dict[str, float]
    events: tuple[tuple[float, str, str], ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        counted = {
            source: [{"verdict": v, "reason": why, "n": n} for (v, why), n in groups.items()]
            for source, groups in self.counted.items()
        }
        events = [{"t_s": t, "kind": kind, "text": text} for t, kind, text in self.events]
        return {
            "t_s": self.t_s, "window_s": self.window_s, "method": self.method,
            "listed": [vars(row) for row in self.listed], "counted": counted,
            "sigmas": self.sigmas, "events": events,
        }  # fmt: skip


def explain(folder: str | Path, t_s: float, *, window_s: float = 2.0) -> Explanation:
    """Explain a moment, `t_s` seconds after the drive's start, from the files of a result.

    Raises InputError where the folder holds no result or the moment lies outside the drive.
    """
    folder = Path(folder)
    summary = _summary(folder / SUMMARY)
    start_ns = int(summary["start_ns"])
    rows = _rows(folder / VERDICTS, start_ns)
    first_s, last_s = min(r.t_s for r in rows), max(r.t_s for r in rows)
    if not first_s <= t_s <= last_s:
        raise InputError(
            f"t = {t_s:g} s lies outside the drive, which lasts from {first_s:g} to {last_s:g} s"
        )
    near = [row for row in rows if abs(row.t_s - t_s) <= window_s]
    sizes = Counter(row.source for row in near)
    dense = {source for source, n in sizes.items() if n > MOST_ROWS}
    listed = sorted((row for row in near if row.source not in dense), key=lambda row: row.t_s)
    events = [(float(e["t_s"]), str(e["kind"]), str(e["text"])) for e in summary["events"]]
    return Explanation(
        t_s, window_s, str(summary["method"]), tuple(listed),
        {s: dict(Counter((r.verdict, r.reason) for r in near if r.source == s))
         for s in sorted(dense)},
        _sigmas(folder / f"{TRAJECTORY}.csv", start_ns + round(t_s * NS_PER_S)),
        tuple(event for event in events if abs(event[0] - t_s) <= window_s),
    )  # fmt: skip


def _summary(path: Path) -> dict[str, Any]:
    values = read_summary(path)
    missing = [key for key in ("start_ns", "events", "method") if key not in values]
    if missing:
        raise InputError(f"{path}: has no {', '.join(missing)}; is it of fgloc smooth?")
    return values


def _rows(path: Path, start_ns: int) -> list[Judged]:
    """All rows of a `verdicts.csv`."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.reader(file)
            if tuple(next(reader, ())) != VERDICT_COLUMNS:
                raise InputError(f"{path}:1: expected the columns {','.join(VERDICT_COLUMNS)}")
            rows = [_row(path, reader.line_num, cells, start_ns) for cells in reader]
    except OSError as err:
        raise InputError(f"{path}: cannot be read: {err.strerror}") from err
    if not rows:
        raise InputError(f"{path}: has no rows, so there is nothing to explain")
    return rows


def _row(path: Path, line: int, cells: list[str], start_ns: int) -> Judged:
    try:
        source, t, received, verdict, nis, dof, threshold, reason = cells
        return Judged(
            source, (int(t) - start_ns) / NS_PER_S, (int(received) - int(t)) / NS_PER_S, verdict,
            float(nis) if nis else None, int(dof), float(threshold) if threshold else None, reason,
        )  # fmt: skip
    except ValueError as err:
        raise InputError(f"{path}:{line}: is not a row of verdicts: {err}") from err


def _sigmas(path: Path, t_ns: int) -> dict[str, float]:
    """Standard deviations of the trajectory at an instant, none outside its time."""
    from fgloc.datasets.trajectory_files import read_trajectory_csv

    trajectory = read_trajectory_csv(path)
    if trajectory.cov is None or not trajectory.covers([t_ns])[0]:
        return {}
    at: Trajectory = trajectory.at([t_ns])
    assert at.cov is not None  # since the trajectory has one
    sigma = np.sqrt(np.maximum(np.diagonal(at.cov[0]), 0.0))
    if at.R_world_veh is None:
        return dict(zip(("east_m", "north_m", "up_m"), map(float, sigma), strict=False))
    along, across = at.sigma_along_across_m()
    return {
        "longitudinal_m": float(along[0]), "lateral_m": float(across[0]), "up_m": float(sigma[2]),
        "yaw_rad": float(sigma[5]),
    }  # fmt: skip
