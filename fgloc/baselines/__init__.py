"""Documented filters and other yardsticks that the graph is held against, by name.

Each algorithm is a file of its own and is imported when it is used.
"""

import importlib
import time
from collections.abc import Callable

from fgloc.drive import Drive
from fgloc.errors import InputError, nearest
from fgloc.result import Result

__all__ = ["RAW", "available", "check", "run"]

_METHODS: dict[str, str] = {
    "marr2019-iea": "marr2019_iea.run",
    "marr2019-iea:10hz": "marr2019_iea.run_10_hz",
    "marr2019-smart-code": "marr2019_smart_code.run",
    "marr2019-smart-code:all-signs": "marr2019_smart_code.run_all_signs",
    "marr2019-smart-code:plain-start": "marr2019_smart_code.run_plain_start",
}
"""Module and function of each method: from a drive to its result, `summary` without wall time."""

RAW = "raw:"
"""What the name of a source alone begins with: raw:gnss."""


def available() -> list[str]:
    """The names of all methods."""
    return [*_METHODS, f"{RAW}gnss"]


def check(method: str, others: tuple[str, ...] = ()) -> None:
    """Raise InputError, naming the nearest method and all others, where there is none so named.

    `others` are methods that are valid where this is asked. Whether a drive has the source that
    follows `raw:` is for `run` to say.
    """
    if method.startswith(RAW) or method in _METHODS:
        return
    valid = [*others, *available()]
    kind = "method" if others else "baseline"
    raise InputError(
        f"no {kind} named {method!r}; the nearest is {nearest(method, valid)!r} "
        f"(there are: {', '.join(valid)})"
    )


def run(drive: Drive, method: str) -> Result:
    """One method's estimate of a drive; its wall time is in the summary.

    Raises InputError for an unknown method, DriveError where the drive lacks what it needs.
    """
    check(method)
    estimate = _method(method)
    began = time.perf_counter()
    result = estimate(drive)
    wall_s = time.perf_counter() - began
    duration_s = float(result.summary["duration_s"])
    result.summary.update(wall_s=wall_s, realtime_factor=duration_s / wall_s)
    return result


def _method(name: str) -> Callable[[Drive], Result]:
    """The function behind a method's name."""
    if name.startswith(RAW):
        from fgloc.baselines.raw import run_raw

        return lambda drive: run_raw(drive, name.removeprefix(RAW))
    module, _, function = _METHODS[name].partition(".")
    found: Callable[[Drive], Result] = getattr(
        importlib.import_module(f"fgloc.baselines.{module}"), function
    )
    return found
