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
    "covariance-intersection": "covariance_intersection.run",
    "khamooshi2023-ckf": "khamooshi2023_ckf.run",
    "khamooshi2023-ckf:bicycle": "khamooshi2023_ckf.run_bicycle",
    "khamooshi2023-ckf:free": "khamooshi2023_ckf.run_free",
    "khamooshi2023-ckf:hard": "khamooshi2023_ckf.run_hard",
    "khamooshi2023-ckf:soft": "khamooshi2023_ckf.run_soft",
    "khamooshi2023-ckf:sensors": "khamooshi2023_ckf.run_sensors",
    "khamooshi2023-kcf": "khamooshi2023_kcf.run",
    "khamooshi2023-kcf:nodes": "khamooshi2023_kcf.run_nodes",
    "khamooshi2023-kcf:onboard": "khamooshi2023_kcf.run_onboard",
    "lee2021-ekf": "lee2021_ekf.run",
    "lee2021-ekf:on-arrival": "lee2021_ekf.run_on_arrival",
    "lee2021-ekf:printed": "lee2021_ekf.run_printed",
    "eskf": "eskf.run",
    "eskf:velocity": "eskf.run_by_velocity",
    "khamooshi2023-uio": "khamooshi2023_uio.run_kinematic",
    "khamooshi2023-uio-printed": "khamooshi2023_uio.run_printed",
    "sway-kf": "sway_kf.run_sway_kf",
    "raw:node_poses": "raw_poses.run_raw_poses",
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
    return [*_METHODS, f"{RAW}gnss", f"{RAW}detections"]


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
    if name.startswith(RAW) and name not in _METHODS:
        from fgloc.baselines.raw import run_raw

        return lambda drive: run_raw(drive, name.removeprefix(RAW))
    module, _, function = _METHODS[name].partition(".")
    found: Callable[[Drive], Result] = getattr(
        importlib.import_module(f"fgloc.baselines.{module}"), function
    )
    return found
