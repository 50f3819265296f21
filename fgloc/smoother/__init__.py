"""The graph, solved three ways: the whole drive, iSAM2 as it grows, iSAM2 over a fixed lag."""

import platform
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from importlib.metadata import PackageNotFoundError, version
from typing import Any, TypeVar

import numpy as np

from fgloc.config import SmoothConfig
from fgloc.drive import Drive
from fgloc.errors import InputError
from fgloc.measurements import NodeDetections, RelativeSightings, UserFixes
from fgloc.post_health import post_health
from fgloc.result import Event, Result
from fgloc.smoother import clocks
from fgloc.smoother.batch import run_batch
from fgloc.smoother.chain import Chain
from fgloc.smoother.model import OBSERVED_YAW_RAD, Model
from fgloc.smoother.post_evidence import likelier, refuse_gtsam
from fgloc.smoother.post_results import post_table
from fgloc.smoother.posts import refuse_search
from fgloc.smoother.roadside import causal_states, roadside
from fgloc.smoother.states import SharedSigmas
from fgloc.sync import plan
from fgloc.verdicts import counts

M = TypeVar("M", bound=Model)
METHODS = {
    "graph-batch": "batch", "graph-incremental": "incremental", "graph-lag": "fixed-lag",
}  # fmt: skip
"""The mode behind each method's name."""
VELOCITY = ":velocity"
"""After a method's name: the same without the IMU, by the drive's velocities."""
STILL_LATE_S, MAX_SHIFTS = 1e-3, 3
"""Stamps are shifted by their estimated lateness until less than this is left of it."""


def methods() -> dict[str, dict[str, Any]]:
    """The graph's methods by name, each with the settings that make it."""
    plain: dict[str, dict[str, Any]] = {name: {"mode": mode} for name, mode in METHODS.items()}
    without_imu = {"motion": {"kind": "constant-velocity"}}
    return plain | {name + VELOCITY: given | without_imu for name, given in plain.items()}


def smooth(drive: Drive, config: SmoothConfig) -> Result:
    """Estimate the drive's trajectory with the graph that suits it, as `config.mode` says.

    A drive with ranges and without fixes takes the planar graph of ranges, one with Smart Codes and
    without an IMU that of codes; both have the modes batch and fixed-lag. Raises InputError for
    another mode there, DriveError where the drive lacks what the graph needs, and SolverError where
    it cannot be solved.
    """
    began = time.perf_counter()
    result = _by_drive(drive, config)
    wall_s = time.perf_counter() - began
    duration_s = result.summary["duration_s"]
    result.summary.update(wall_s=wall_s, realtime_factor=duration_s / wall_s)
    return result


def _by_drive(drive: Drive, config: SmoothConfig) -> Result:
    if (planar := _planar(drive)) is not None:
        _refuse_incremental(drive, config)
        return planar(drive, config.lag_s if config.mode == "fixed-lag" else None)
    if is_cooperative(drive):
        from fgloc.smoother.cooperative import run_cooperative

        return replace(run_cooperative(drive, config), config=_provenance(config))
    if drive.has_vehicle:
        return _batch(drive, config) if config.mode == "batch" else _online(drive, config)
    from fgloc.smoother.posts import smooth_posts

    return smooth_posts(drive, config, _method(config))


def _planar(drive: Drive) -> Callable[[Drive, float | None], Result] | None:
    """The planar graph that a drive takes, if it does."""
    if "ranges" in drive.tables and "gnss" not in drive.tables:
        from fgloc.smoother.ranges import smooth_ranges

        return smooth_ranges
    if "smart_codes" in drive.tables and "imu" not in drive.tables:
        from fgloc.smoother.codes import smooth_codes

        return smooth_codes
    return None


def _refuse_incremental(drive: Drive, config: SmoothConfig) -> None:
    if config.mode == "incremental":
        raise InputError(
            f"drive {drive.name!r} takes a planar graph, which has the modes batch and fixed-lag, "
            "not incremental"
        )


def is_cooperative(drive: Drive) -> bool:
    """Whether a drive is of several road users, seen by nodes, rather than of one car."""
    told = {RelativeSightings.KIND, UserFixes.KIND} & drive.tables.keys()
    others = drive.objects is not None or bool(told)
    return others and NodeDetections.KIND in drive.tables and "imu" not in drive.tables


def _batch(drive: Drive, config: SmoothConfig) -> Result:
    refuse_gtsam(config)
    model = _model(Model, drive, config)
    clocks.refuse_unanchored(config, model.aids, model.plan.motion.kind)
    run = run_batch(model)
    in_force = config
    for _ in range(MAX_SHIFTS):
        if not (np.abs(run.states.late_s) >= STILL_LATE_S).any():
            break
        # The estimate brings what is late back along a straight line: shift the stamps by it, and
        # see what is left. They are then true at other instants, so the epochs are planned anew.
        in_force = clocks.shifted(in_force, run.states.late_s)
        shifted_s = model.shifted_s + run.states.late_s
        model = _model(Model, drive, in_force)
        model.shifted_s = shifted_s
        run = run_batch(model)
    sought: dict[str, Any] = {}
    if config.posts.estimate_mode and model.plan.posts and isinstance(run.solver, Chain):
        model, sought["posts_sought"] = likelier(model, run.solver, run.states, run.robust)
        run = run_batch(model)
    summary = _summary(model, run.factors) | {"iterations": run.iterations, "cost": run.cost}
    summary |= sought
    known = run.yaw_sigma_rad < OBSERVED_YAW_RAD
    summary["yaw_observable_s"] = 0.0 if known else None
    events = [*model.plan.events, *run.events]
    summary |= roadside(model, run.states, run.sigmas)
    if run.posts is not None:
        summary["posts"] = post_health(drive, run.posts)
    if config.clock.estimate:
        found = clocks.shifted(in_force, run.states.late_s)
        summary["clock"] = clocks.summary(found, run.sigmas.late_s)
        start_ns = int(model.t_ns[0])
        events += [Event(start_ns, "clock", one["text"]) for one in summary["clock"].values()]
    verdicts = clocks.stamped_as_read(model.plan.verdicts, drive)
    log, posts = run.log, run.posts
    del run  # a long drive's factor needs more memory than all that follows
    return Result(
        log.trajectory(model), verdicts, summary, summary["method"], causal=False,
        events=_in_order(tuple(events)), config=_provenance(config), posts=posts,
    )  # fmt: skip


def _model(kind: type[M], drive: Drive, config: SmoothConfig) -> M:
    """The model of a drive whose clocks are set right."""
    drive = clocks.on_time(drive, config)
    return kind(drive, plan(drive, config), config)


def _online(drive: Drive, config: SmoothConfig) -> Result:
    from fgloc.smoother.graph import GraphModel
    from fgloc.smoother.online import Online

    clocks.refuse_causal(config)
    refuse_search(config)
    model = _model(GraphModel, drive, config)
    lag_s = config.lag_s if config.mode == "fixed-lag" else None
    online = Online(model, lag_s)
    online.run()
    summary = _summary(model, online.factors)
    survey, sigmas = online.survey()
    states = causal_states(model, online.log, online.posts.x, survey)
    summary |= roadside(model, states, SharedSigmas(survey=sigmas))
    posts = post_table(model, online.posts.x, online.posts.P)
    if posts is not None:
        summary["posts"] = post_health(drive, posts)
    seen = online.yaw_observable_ns
    summary["yaw_observable_s"] = None if seen is None else (seen - int(model.t_ns[0])) / 1e9
    return Result(
        online.log.trajectory(model), clocks.stamped_as_read(model.plan.verdicts, drive), summary,
        summary["method"], causal=True,
        smoothed=online.last.trajectory(model) if online.last else None,
        events=_in_order((*model.plan.events, *online.events)), config=_provenance(config),
        posts=posts,
    )  # fmt: skip


def _summary(model: Model, factors: int) -> dict[str, Any]:
    return {
        "drive": model.drive.name,
        "method": _method(model.config),
        "mode": model.config.mode,
        "duration_s": float(model.t_s[-1]),
        "states": len(model),
        "factors": factors,
        "counts": counts(model.plan.verdicts),
        **({"motion": motion.kind} if (motion := model.plan.motion).is_made_up else {}),
        **({"vehicle": found} if (found := model.car.summary()) else {}),
        "origin": asdict(model.drive.origin),
    }


def _method(config: SmoothConfig) -> str:
    return next(method for method, mode in METHODS.items() if mode == config.mode)


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
