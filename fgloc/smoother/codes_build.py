"""From a drive that reads Smart Codes to its planar graph: which sighting ties what, and how well.

A sighting with corners is taken by these, one without by height, width and middle.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgloc.constraints import LEAST_ERROR
from fgloc.drive import Camera, Drive
from fgloc.errors import DriveError
from fgloc.factors.corners import sign_corners_m, whitening
from fgloc.factors.smart_code import Reading, head_on, head_on_sigma_m, locate
from fgloc.infrastructure import Sign
from fgloc.measurements import Array, EnuVelocities, SmartCodeSightings
from fgloc.smoother.codes_model import CodeModel, CodeSettings, VelocitySteps
from fgloc.smoother.codes_sightings import BIASES, ByCorners, BySize, Rows
from fgloc.timing import Instants, seconds_to_ns
from fgloc.verdicts import SourceVerdicts, Verdict

START_READS = 10
"""Sightings that the start is the mean of, as in the documented filter."""
SLOWEST_MPS = 0.1
"""Velocities below this tell no course."""


class _Seen(NamedTuple):
    """All sightings (M,) with what their signs, and how the camera is turned, make of them: range
    in m with sigma, direction from East of the camera's axis with sigma and of the ray, in rad."""

    table: SmartCodeSightings
    camera: Camera
    signs: list[Sign]
    size_m: Array
    place_m: Array
    range_m: Array
    sigma_m: Array
    axis_rad: Array
    axis_sigma_rad: Array
    direction_rad: Array
    too_near: NDArray[np.bool_]


def build(drive: Drive, settings: CodeSettings, verdicts: SourceVerdicts) -> CodeModel:
    """The model of a drive; each sighting that cannot be part of it gets its verdict.

    Raises DriveError where velocities, a camera or ten sightings are missing.
    """
    velocity, table = drive.tables.get("velocity"), drive.tables.get("smart_codes")
    if not isinstance(velocity, EnuVelocities) or not isinstance(table, SmartCodeSightings):
        raise DriveError(f"drive {drive.name!r} needs both velocity and smart_codes tables")
    if drive.rig.camera is None:
        raise DriveError(f"drive {drive.name!r} has no [rig.camera]; Smart Codes need its geometry")
    epochs_ns = _epochs(velocity, table, settings)
    seen = _seen(drive, drive.rig.camera, table, velocity, settings)
    whole = table.has_corners
    verdicts.set(seen.too_near & ~whole, Verdict.UNUSED, Reading.TOO_NEAR.text)
    used = np.flatnonzero(whole | ~seen.too_near)
    if len(used) < START_READS:
        raise DriveError(
            f"drive {drive.name!r}: {len(used)} Smart Codes tell a range; the graph "
            f"starts from {START_READS}"
        )
    height_m = float(drive.rig.camera.p_veh_cam_m[2])
    first = used[:START_READS]
    by_size, biases = _rows(used[~whole[used]], seen, epochs_ns, BIASES)
    by_corners, sides = _rows(used[whole[used]], seen, epochs_ns, BIASES + biases)
    sightings = (_by_size(seen, by_size, settings), _by_corners(seen, by_corners, settings))
    return CodeModel(
        epochs_ns, VelocitySteps.of(velocity, epochs_ns),
        tuple(one for one in sightings if len(one.at.row)), height_m, biases, sides,
        _start(seen, first, height_m),
        int((table.t_ns[first[-1]] - epochs_ns[0]) // (epochs_ns[1] - epochs_ns[0])),
        _stated(drive, settings),
    )  # fmt: skip


def _stated(drive: Drive, settings: CodeSettings) -> CodeSettings:
    """The settings with what the drive itself says of the velocities' lasting errors."""
    stated = drive.rig.velocity_errors
    if stated is None:
        return settings
    speed, heading = (
        max(sigma, LEAST_ERROR) for sigma in (stated.scale_sigma, stated.heading_sigma_rad)
    )
    return replace(settings, speed_sigma=speed, heading_sigma_rad=heading)


def _epochs(velocity: EnuVelocities, seen: SmartCodeSightings, settings: CodeSettings) -> Instants:
    """Even instants from the first sighting to the end of the velocities."""
    step_ns = seconds_to_ns(settings.interval_s)
    first, last = int(seen.t_ns[0]), max(int(velocity.t_ns[-1]), int(seen.t_ns[-1]))
    return first + np.arange((last - first) // step_ns + 2, dtype=np.int64) * step_ns


def _seen(
    drive: Drive, camera: Camera, table: SmartCodeSightings, velocity: EnuVelocities,
    settings: CodeSettings,
) -> _Seen:  # fmt: skip
    signs = [drive.infrastructure.signs[i] for i in table.sign]
    size_m = np.array([sign.size_m for sign in signs])
    place_m = np.array([sign.p_world_m for sign in signs])
    distances = head_on(table.height_px, table.width_px, table.centre_px, size_m, camera.focal_px,
                        camera.principal_px)  # fmt: skip
    found = locate(distances, place_m[:, 2] - camera.p_veh_cam_m[2], False)
    sigma = head_on_sigma_m(distances.height_m, size_m, camera.focal_px, settings.size_sigma_px)
    aside = np.arctan((table.centre_px[:, 0] - camera.principal_px[0]) / camera.focal_px)
    course, course_sigma = _course(velocity, table.t_ns, settings)
    axis = course + camera.yaw_rad
    return _Seen(
        table, camera, signs, size_m, place_m, found.range_m,
        np.abs(found.by_head_on[:, 0, 0]) * sigma, axis, course_sigma, axis - aside,
        found.status == Reading.TOO_NEAR,
    )  # fmt: skip


def _rows(
    row: NDArray[np.int64], seen: _Seen, epochs_ns: Instants, globals_from: int
) -> tuple[Rows, int]:
    """Where some rows of the table stand among the epochs, and how many sizes of sign they show,
    the largest first: each has one of the globals from a number on."""
    step_ns = int(epochs_ns[1] - epochs_ns[0])
    t_ns = seen.table.t_ns[row]
    epoch = (t_ns - epochs_ns[0]) // step_ns
    share = (t_ns - epochs_ns[epoch]) / step_ns
    sizes, kind = np.unique(-seen.size_m[row], return_inverse=True)
    first = np.searchsorted(epoch, np.arange(len(epochs_ns)))
    return Rows(epoch, share, globals_from + kind, row, first), len(sizes)


def _by_size(seen: _Seen, at: Rows, settings: CodeSettings) -> BySize:
    row, camera = at.row, seen.camera
    to_left = [-sign.size_m / 2 * sign.R_world_sign[:, 1] for sign in seen.signs]
    off_px = seen.table.centre_px[:, 0] - camera.principal_px[0]
    sides = np.arctan(
        (off_px[:, None] + seen.table.width_px[:, None] * [0.5, -0.5]) / camera.focal_px
    )
    direction_sigma = np.hypot(seen.axis_sigma_rad[row], settings.corner_sigma_px / camera.focal_px)
    return BySize(
        at, seen.place_m[row], np.array(to_left)[row], seen.range_m[row], seen.sigma_m[row],
        seen.direction_rad[row], direction_sigma, (sides[:, 0] - sides[:, 1])[row],
        settings.size_sigma_px / camera.focal_px, settings.loss_width,
    )  # fmt: skip


def _by_corners(seen: _Seen, at: Rows, settings: CodeSettings) -> ByCorners:
    row, camera = at.row, seen.camera
    px, principal = seen.table.corners_px[row], camera.principal_px
    world = np.array([sign_corners_m(seen.signs[i]) for i in row]).reshape(-1, 4, 3)
    root = whitening(
        px, camera.focal_px, principal, settings.corner_sigma_px, seen.axis_sigma_rad[row]
    )
    return ByCorners(
        at, world, px, seen.axis_rad[row], root, camera.focal_px, principal,
        settings.corner_loss_width,
    )  # fmt: skip


def _course(velocity: EnuVelocities, t_ns: Instants, settings: CodeSettings) -> tuple[Array, Array]:
    """Course (M,) from East by the velocities of half an interval about instants (M,), and its
    standard deviation (M,) in rad.

    Sightings close to each other share velocities and with them an error, which is not new each
    time: the variance of each is so much larger that the mean over all of them errs as it does.
    """
    half_ns = seconds_to_ns(settings.interval_s / 2)
    sums = np.r_[np.zeros((1, 2)), np.cumsum(velocity.v_world_mps[:, :2], axis=0)]
    first = np.searchsorted(velocity.t_ns, t_ns - half_ns, side="left")
    stop = np.maximum(np.searchsorted(velocity.t_ns, t_ns + half_ns, side="right"), first + 1)
    first = np.minimum(first, len(velocity) - 1)
    count = np.minimum(stop, len(velocity)) - first
    mean = (sums[first + count] - sums[first]) / count[:, None]
    speed = np.maximum(np.hypot(mean[:, 0], mean[:, 1]), SLOWEST_MPS)
    sigma = velocity.sigma_mps[first] / speed * np.sqrt(_sharing(t_ns, settings.interval_s) / count)
    return np.arctan2(mean[:, 1], mean[:, 0]), sigma


def _sharing(t_ns: Instants, width_s: float) -> Array:
    """(M,) of windows of a width about instants (M,): the sum of the parts that all the windows
    have in common with each, which is 1 for one that stands alone."""
    t_s, i = (t_ns - t_ns[0]) / 1e9, np.arange(len(t_ns))
    sums = np.r_[0.0, np.cumsum(t_s)]
    first, stop = np.searchsorted(t_s, t_s - width_s), np.searchsorted(t_s, t_s + width_s)
    late_s = (i - first) * t_s - (sums[i] - sums[first])
    early_s = sums[stop] - sums[i] - (stop - i) * t_s
    return np.asarray(stop - first - (late_s + early_s) / width_s)


def _start(seen: _Seen, first: NDArray[np.int64], height_m: float) -> Array:
    """(2,) where range and direction of the first sightings put the camera, in the mean.

    The told direction leaves one of the two sides on which a square, or a width, could be seen so.
    """
    above = seen.place_m[first, 2] - height_m
    level = np.sqrt(np.maximum(seen.range_m[first] ** 2 - above**2, 0))[:, None]
    ray = np.stack([np.cos(seen.direction_rad[first]), np.sin(seen.direction_rad[first])], -1)
    return np.asarray(np.mean(seen.place_m[first, :2] - level * ray, axis=0))
