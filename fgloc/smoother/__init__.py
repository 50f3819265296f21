"""The graph, solved three ways: the whole drive, iSAM2 as it grows, iSAM2 over a fixed lag."""

import platform
import time
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from fgloc.config import SmoothConfig
from fgloc.drive import Drive
from fgloc.result import Event, Result
from fgloc.smoother.batch import run_batch
from fgloc.smoother.model import OBSERVED_YAW_RAD, Model
from fgloc.sync import Plan, plan
from fgloc.verdicts import counts

METHODS = {
    "graph-batch": "batch", "graph-incremental": "incremental", "graph-lag": "fixed-lag",
}  # fmt: skip
"""The mode behind each method's name."""


def smooth(drive: Drive, config: SmoothConfig) -> Result:
    """Estimate the drive's trajectory with the graph, as `config.mode` says.

    Raises DriveError where the drive lacks what the graph needs, and SolverError where it cannot
    be solved.
    """
    began = time.perf_counter()
    planned = plan(drive, config)
    run = _batch if config.mode == "batch" else _online
    result = run(drive, planned, config)
    wall_s = time.perf_counter() - began
    keyframes = planned.epochs.t_ns[planned.epochs.keyframes]
    duration_s = float(keyframes[-1] - keyframes[0]) / 1e9
    result.summary.update(wall_s=wall_s, realtime_factor=duration_s / wall_s, duration_s=duration_s)
    return result


def _batch(drive: Drive, planned: Plan, config: SmoothConfig) -> Result:
    model = Model(drive, planned, config)
    run = run_batch(model)
    summary = _summary(model, run.factors) | {"iterations": run.iterations, "cost": run.cost}
    known = run.yaw_sigma_rad < OBSERVED_YAW_RAD
    summary["yaw_observable_s"] = 0.0 if known else None
    events = _in_order((*model.plan.events, *run.events))
    return Result(
        run.log.trajectory(model), model.plan.verdicts, summary, summary["method"],
        causal=False, events=events, config=_provenance(model.config),
    )  # fmt: skip


def _online(drive: Drive, planned: Plan, config: SmoothConfig) -> Result:
    from fgloc.smoother.graph import GraphModel
    from fgloc.smoother.online import Online

    model = GraphModel(drive, planned, config)
    lag_s = config.lag_s if config.mode == "fixed-lag" else None
    online = Online(model, lag_s)
    online.run()
    summary = _summary(model, online.factors)
    seen = online.yaw_observable_ns
    summary["yaw_observable_s"] = None if seen is None else (seen - int(model.t_ns[0])) / 1e9
    return Result(
        online.log.trajectory(model), model.plan.verdicts, summary,
        summary["method"], causal=True,
        smoothed=online.last.trajectory(model) if online.last else None,
        events=_in_order((*model.plan.events, *online.events)), config=_provenance(config),
    )  # fmt: skip


def _summary(model: Model, factors: int) -> dict[str, Any]:
    return {
        "drive": model.drive.name,
        "method": next(m for m, mode in METHODS.items() if mode == model.config.mode),
        "mode": model.config.mode,
        "states": len(model),
        "factors": factors,
        "counts": counts(model.plan.verdicts),
        "origin": asdict(model.drive.origin),
    }


def _provenance(config: SmoothConfig) -> dict[str, Any]:
    """The configuration in force and the versions it ran with."""
    names = ("fgloc", "gtsam", "numpy")
    return {**config.model_dump(exclude_none=True), "versions": {
        "python": platform.python_version(), **{name: _version(name) for name in names},
    }}  # fmt: skip


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


def _in_order(events: tuple[Event, ...]) -> tuple[Event, ...]:
    return tuple(sorted(events, key=lambda event: event.t_ns))
