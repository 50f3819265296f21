"""The graph of a drive that reads Smart Codes and tells its velocity: whole, or over a fixed lag.

Fixes, where there are any, are not used: like the documented filter it lives on signs alone. Errors
of speed and heading are variables, and a bias of the ranges to each size of sign.
"""

from dataclasses import asdict

import numpy as np

from fgloc.drive import Camera, Drive
from fgloc.errors import DriveError
from fgloc.factors.noise import weight
from fgloc.factors.smart_code import Reading, head_on, head_on_sigma_m, locate
from fgloc.measurements import Array, EnuVelocities, SmartCodeSightings
from fgloc.result import Result
from fgloc.smoother.codes_model import (
    BIASES,
    HEADING,
    SPEED,
    CodeModel,
    CodeSettings,
    Sightings,
    VelocitySteps,
)
from fgloc.smoother.ranges_lag import run_lag
from fgloc.smoother.ranges_solve import covariances
from fgloc.smoother.ranges_start import optimize, with_priors
from fgloc.timing import Instants, seconds_to_ns
from fgloc.trajectory import Trajectory
from fgloc.verdicts import SourceVerdicts, Verdict, counts

SETTINGS = CodeSettings()
START_READS = 10
"""Sightings that the start is the mean of, as in the documented filter."""
UNKNOWN_RAD2, UNKNOWN_M2, DOWN_WEIGHTED = np.pi**2 / 3, 1.0, 0.25


def smooth_codes(
    drive: Drive, lag_s: float | None = None, settings: CodeSettings = SETTINGS
) -> Result:
    """The estimate of a drive that reads Smart Codes; of the camera, on the level.

    Without `lag_s` all of the drive is solved at once; with it each state is given as it was when
    it was the newest, from the tenth sighting on. The road is taken to be at up = 0. Raises
    DriveError where velocities, a camera or ten sightings are missing.
    """
    verdicts = {
        name: SourceVerdicts.of(name, table, Verdict.UNUSED, "no factor in the Smart Code graph")
        for name, table in drive.tables.items()
    }
    model = build(drive, settings, verdicts["smart_codes"])
    verdicts["velocity"].set(slice(None), Verdict.USED)
    states, globals_, _ = optimize(model, _first_path(model), model.prior[0])
    online = run_lag(model, states, globals_, lag_s or float("1e9"))
    if lag_s is None:
        states, globals_, _ = optimize(model, online.last, online.globals_)
        cov, _ = covariances(with_priors(model, states, globals_))
        trajectory = _trajectory(model, states, cov, 0, drive)
    else:
        states, globals_ = online.last, online.globals_
        trajectory = _trajectory(model, online.states, online.cov, online.first, drive)
    _judge(model, states, globals_, verdicts["smart_codes"])
    method = "graph-batch" if lag_s is None else "graph-lag"
    mode = {"mode": "batch"} if lag_s is None else {"mode": "fixed-lag", "lag_s": lag_s}
    summary = {
        "drive": drive.name,
        "method": method,
        "mode": mode["mode"],
        "states": len(trajectory),
        "factors": 3 * len(model.seen.row) + len(model.epochs_ns) - 1,
        "counts": counts(verdicts),
        "origin": asdict(drive.origin),
        "duration_s": float(trajectory.t_ns[-1] - trajectory.t_ns[0]) / 1e9,
        "codes": {
            "speed_scale": float(1 + globals_[SPEED]),
            "heading_error_rad": float(globals_[HEADING]),
            "range_bias_m": globals_[BIASES:].tolist(),
        },
    }
    return Result(trajectory, verdicts, summary, method, causal=lag_s is not None, config=mode)


def build(drive: Drive, settings: CodeSettings, verdicts: SourceVerdicts) -> CodeModel:
    """The model of a drive; each sighting that cannot be part of it gets its verdict."""
    velocity, seen = drive.tables.get("velocity"), drive.tables.get("smart_codes")
    if not isinstance(velocity, EnuVelocities) or not isinstance(seen, SmartCodeSightings):
        raise DriveError(f"drive {drive.name!r} needs both velocity and smart_codes tables")
    if drive.rig.camera is None:
        raise DriveError(f"drive {drive.name!r} has no [rig.camera]; Smart Codes need its geometry")
    epochs_ns = _epochs(velocity, seen, settings)
    sightings = _sightings(drive, drive.rig.camera, seen, velocity, epochs_ns, settings, verdicts)
    if len(sightings.row) < START_READS:
        raise DriveError(
            f"drive {drive.name!r}: {len(sightings.row)} Smart Codes tell a range; the graph "
            f"starts from {START_READS}"
        )
    first_row = np.searchsorted(sightings.epoch, np.arange(len(epochs_ns)))
    return CodeModel(
        epochs_ns, VelocitySteps.of(velocity, epochs_ns), sightings, first_row,
        float(drive.rig.camera.p_veh_cam_m[2]), int(sightings.kind.max()) + 1, settings,
    )  # fmt: skip


def _epochs(velocity: EnuVelocities, seen: SmartCodeSightings, settings: CodeSettings) -> Instants:
    """Even instants from the first sighting to the end of the velocities."""
    step_ns = seconds_to_ns(settings.interval_s)
    first, last = int(seen.t_ns[0]), max(int(velocity.t_ns[-1]), int(seen.t_ns[-1]))
    return first + np.arange((last - first) // step_ns + 2, dtype=np.int64) * step_ns


def _sightings(
    drive: Drive, camera: Camera, seen: SmartCodeSightings, velocity: EnuVelocities,
    epochs_ns: Instants, settings: CodeSettings, verdicts: SourceVerdicts,
) -> Sightings:  # fmt: skip
    signs = [drive.infrastructure.signs[i] for i in seen.sign]
    size_m = np.array([sign.size_m for sign in signs])
    place_m = np.array([sign.p_world_m for sign in signs])
    distances = head_on(seen.height_px, seen.width_px, seen.centre_px, size_m, camera.focal_px,
                        camera.principal_px)  # fmt: skip
    found = locate(distances, place_m[:, 2] - camera.p_veh_cam_m[2], False)
    near = found.status == Reading.TOO_NEAR
    verdicts.set(near, Verdict.UNUSED, Reading.TOO_NEAR.text)
    row = np.flatnonzero(~near)
    sigma = head_on_sigma_m(distances.height_m, size_m, camera.focal_px, settings.size_sigma_px)
    aside = np.arctan((seen.centre_px[:, 0] - camera.principal_px[0]) / camera.focal_px)
    direction = _heading_rad(velocity, seen.t_ns, settings) + camera.yaw_rad - aside
    step_ns = int(epochs_ns[1] - epochs_ns[0])
    epoch = (seen.t_ns - epochs_ns[0]) // step_ns
    _, kind = np.unique(-size_m, return_inverse=True)
    told = np.abs(found.by_head_on[:, 0, 0]) * sigma
    direction_sigma = np.hypot(settings.heading_noise_rad,
                               settings.corner_sigma_px / camera.focal_px)  # fmt: skip
    to_left = np.array([-sign.size_m / 2 * sign.R_world_sign[:, 1] for sign in signs])
    off_px = seen.centre_px[:, 0] - camera.principal_px[0]
    sides = np.arctan((off_px[:, None] + seen.width_px[:, None] * [0.5, -0.5]) / camera.focal_px)
    share = (seen.t_ns - epochs_ns[epoch]) / step_ns
    return Sightings(
        epoch[row], share[row], place_m[row], to_left[row], kind[row],
        found.range_m[row], told[row], direction[row], float(direction_sigma),
        (sides[:, 0] - sides[:, 1])[row], settings.size_sigma_px / camera.focal_px, row,
    )  # fmt: skip


def _heading_rad(velocity: EnuVelocities, t_ns: Instants, settings: CodeSettings) -> Array:
    """Course (M,) from East by the velocities of half an interval about instants (M,)."""
    half_ns = seconds_to_ns(settings.interval_s / 2)
    sums = np.r_[np.zeros((1, 2)), np.cumsum(velocity.v_world_mps[:, :2], axis=0)]
    first = np.searchsorted(velocity.t_ns, t_ns - half_ns, side="left")
    stop = np.maximum(np.searchsorted(velocity.t_ns, t_ns + half_ns, side="right"), first + 1)
    first = np.minimum(first, len(velocity) - 1)
    mean = sums[np.minimum(stop, len(velocity))] - sums[first]
    return np.arctan2(mean[:, 1], mean[:, 0])


def _first_path(model: CodeModel) -> Array:
    """States (n, 2) over the first ten sightings, from where range and direction put the camera."""
    seen, first = model.seen, slice(0, START_READS)
    above = seen.place_m[first, 2] - model.height_m
    level = np.sqrt(np.maximum(seen.range_m[first] ** 2 - above**2, 0))[:, None]
    ray = np.stack([np.cos(seen.direction_rad[first]), np.sin(seen.direction_rad[first])], -1)
    path = [np.mean(seen.place_m[first, :2] - level * ray, axis=0)]
    for k in range(int(seen.epoch[START_READS - 1]) + 1):
        path.append(model.motion.predict(path[-1], model.prior[0], k))
    return np.array(path)


def _trajectory(
    model: CodeModel, states: Array, cov: Array, first: int, drive: Drive
) -> Trajectory:
    """The camera's positions from states (K, 2) with covariances (K, 2, 2)."""
    wide = np.zeros((len(states), 6, 6))
    wide[:, :2, :2] = cov
    wide[:, 2, 2], wide[:, 3:, 3:] = UNKNOWN_M2, UNKNOWN_RAD2 * np.eye(3)
    p_m = np.c_[states, np.full(len(states), model.height_m)]
    t_ns = model.epochs_ns[first : first + len(states)]
    camera = drive.rig.camera
    point = np.zeros(3) if camera is None else camera.p_veh_cam_m
    return Trajectory(t_ns, p_m, cov=wide, p_veh_point_m=point)


def _judge(model: CodeModel, states: Array, globals_: Array, verdicts: SourceVerdicts) -> None:
    """Verdicts on the sightings by what the loss made of them at the end."""
    norm = np.linalg.norm(model.errors(states, globals_, 0, slice(None)).error, axis=1)
    doubted = weight(norm, "cauchy", model.settings.loss_width) < DOWN_WEIGHTED
    verdicts.set(model.seen.row, Verdict.USED)
    verdicts.set(model.seen.row[doubted], Verdict.DOWN_WEIGHTED, "far from what all others say")
