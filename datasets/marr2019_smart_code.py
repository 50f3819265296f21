"""Scenario `marr2019/smart-code`: a car with an infrared camera drives up to three Smart Codes.

T. S. Marr, "Utilizing the Infrastructure for Ground Truth Based Localization", thesis, Texas A&M
University, 2019, section 3.3: one code of 22 in and two of 5 in, a camera of 2448 x 2048 pixels at
30 frames a second turned by about 0, 30 or 45 deg, four paths (left, middle and right lane, and
right beside the signs) at about 4.5 m/s, a strobe that lets a code be read only so near.

The thesis does not print what follows, which is chosen: focal length, heights, lane offsets, how
many pixels a cell needs to be read, and the noise of speed and heading.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgloc.datasets.lane_motion import lane_motion
from fgloc.datasets.marr2019_iea import (
    HEADING_BIAS_RAD,
    HZ,
    ORIGIN,
    SPEED_SCALE_SIGMA,
    START_NS,
    VELOCITY_HZ,
    speed_and_heading,
)
from fgloc.datasets.simulator import Motion, instants, stream, truth_of
from fgloc.drive import About, Camera, Drive, Rig, VelocityErrors
from fgloc.errors import InputError, nearest
from fgloc.factors.corners import code_size_px, sign_corners_m
from fgloc.infrastructure import Infrastructure, Sign
from fgloc.measurements import Array, GnssFixes, SmartCodeSightings
from fgloc.timing import Instants, seconds_to_ns

INCH_M = 0.0254
LARGE_M, SMALL_M = 22 * INCH_M, 5 * INCH_M
SPEED_MPS, NORTH_RAD = 4.5, np.pi / 2
RUN_UP_M, RUN_OUT_M = 45.0, 5.0
LANES_M = {"left": 8.0, "middle": 5.0, "right": 2.0, "near": 0.8}
"""How far the camera's path lies to the left of the signs."""

IMAGE_PX, FOCAL_PX, FRAME_HZ = (2448, 2048), 2400.0, 30
P_VEH_CAM_M = (0.5, 0.0, 1.6)
SIGN_HEIGHT_M = 2.1
CELLS, LEAST_CELL_PX, STROBE_M = 11, 1.8, 35.0
"""Cells on a side, how many pixels each needs to be read, and how far the strobe lights a code."""
LATENCY_S = 0.03
FIX_SIGMA_M = (2.0, 2.0, 4.0)
SIGNS = (
    Sign("large", "22a1", np.array([0.0, 0.0, SIGN_HEIGHT_M]), -NORTH_RAD, LARGE_M),
    Sign("small right", "05b2", np.array([0.6, 0.0, SIGN_HEIGHT_M]), -NORTH_RAD, SMALL_M),
    Sign("small left", "05c3", np.array([-0.6, 0.0, SIGN_HEIGHT_M]), -NORTH_RAD, SMALL_M),
)


class _View(NamedTuple):
    """Corners (N, 4, 2) in px, and which rows (N,) can be read."""

    corners_px: Array
    readable: NDArray[np.bool_]


def make_marr2019_smart_code(
    seed: int = 0, path: str = "left", camera_yaw_deg: float = 30.0, corner_sigma_px: float = 0.15,
    quantised: bool = True, corners: bool = False,
) -> Drive:  # fmt: skip
    """The drive of a seed: sightings at 30 Hz, speed and heading at 50 Hz, a fix a second.

    path             left, middle, right or near
    camera_yaw_deg   of the camera to the right, where the signs are
    corner_sigma_px  of each corner, to the side and down
    quantised        whether height and width are whole pixels, as in the thesis
    corners          whether the corners are told too, which the thesis's reader does not

    The fixes are there so that the graph may start; the thesis's filter does not use them. Raises
    InputError for an unknown path, a yaw from 90 deg or a sigma below 0.
    """
    _check(path, camera_yaw_deg, corner_sigma_px)
    motion = smart_code_motion(path)
    camera = Camera(
        FOCAL_PX, np.array(IMAGE_PX) / 2, np.array(P_VEH_CAM_M), -np.deg2rad(camera_yaw_deg)
    )
    tables = {
        "gnss": _fixes(motion.every(HZ), stream(seed, "gnss")),
        "velocity": speed_and_heading(motion.every(HZ // VELOCITY_HZ), stream(seed, "velocity")),
    }
    frames = smart_code_motion(path, FRAME_HZ)
    seen = sightings(frames, camera, corner_sigma_px, quantised, stream(seed, "codes"))
    if not corners:
        seen = replace(seen, corners_px=np.full_like(seen.corners_px, np.nan))
    if len(seen):
        tables["smart_codes"] = seen
    lasting = VelocityErrors(SPEED_SCALE_SIGMA, HEADING_BIAS_RAD)
    rig = Rig(camera=camera, velocity_errors=lasting)
    truth = truth_of(motion.every(HZ // VELOCITY_HZ))
    about = _about(seed, path, camera_yaw_deg, corner_sigma_px, quantised, corners)
    beside = Infrastructure(signs=SIGNS)
    return Drive("marr2019/smart-code", ORIGIN, rig, tables, truth, about, beside)


def smart_code_motion(path: str, rate_hz: int = HZ) -> Motion:
    """The vehicle frame: straight north along one of the paths, past the signs."""
    start = np.array([-LANES_M[path], -RUN_UP_M, 0.0])
    t_ns = instants(START_NS, (RUN_UP_M + RUN_OUT_M) / SPEED_MPS, rate_hz)
    return lane_motion(t_ns, start, NORTH_RAD, SPEED_MPS)


def sightings(
    frames: Motion, camera: Camera, corner_sigma_px: float, quantised: bool,
    rng: np.random.Generator,
) -> SmartCodeSightings:  # fmt: skip
    """What the camera reads of all signs, in the order of time, with corners."""
    parts = []
    for i, sign in enumerate(SIGNS):
        view = _view(frames, camera, sign)
        noise_px = corner_sigma_px * rng.standard_normal(view.corners_px.shape)
        corners = (view.corners_px + noise_px)[view.readable]
        parts.append((frames.t_ns[view.readable], np.full(len(corners), i), corners))
    t_ns, number, corners = (np.concatenate(part) for part in zip(*parts, strict=True))
    order = np.argsort(t_ns, kind="stable")
    t_ns, corners = t_ns[order], corners[order]
    height_px, width_px = code_size_px(corners)
    if quantised:
        height_px, width_px = np.rint(height_px), np.rint(width_px)
    received_ns = t_ns + seconds_to_ns(LATENCY_S)
    return SmartCodeSightings(
        t_ns, received_ns, number[order], height_px, width_px, corners.mean(1), corners
    )


def corners_in_camera(frames: Motion, camera: Camera, sign: Sign) -> Array:
    """A code's corners (N, 4, 3) in m along the camera's axes: right, down, ahead."""
    ray = sign_corners_m(sign) - frames.p_world_m[:, None]
    in_veh = ray @ frames.R_world_veh - camera.p_veh_cam_m
    c, s = np.cos(camera.yaw_rad), np.sin(camera.yaw_rad)
    ahead = in_veh[..., 0] * c + in_veh[..., 1] * s
    right = in_veh[..., 0] * s - in_veh[..., 1] * c
    return np.stack([right, -in_veh[..., 2], ahead], -1)


def _view(frames: Motion, camera: Camera, sign: Sign) -> _View:
    """The code in each image; readable where whole, lit, and each cell has its pixels."""
    local = corners_in_camera(frames, camera, sign)
    depth = local[..., 2]
    px = camera.focal_px * local[..., :2] / np.maximum(depth, 0.1)[..., None] + camera.principal_px
    inside = (depth[..., None] > 0.1) & (px >= 0) & (px < IMAGE_PX)
    height_px, width_px = code_size_px(px)
    fine = np.minimum(height_px, width_px) >= CELLS * LEAST_CELL_PX
    lit = np.linalg.norm(local.mean(1), axis=-1) <= STROBE_M
    return _View(px, inside.all((1, 2)) & fine & lit)


def _fixes(motion: Motion, rng: np.random.Generator) -> GnssFixes:
    n, sigma_m = len(motion), np.array(FIX_SIGMA_M)
    p_world_m = motion.p_world_m + sigma_m * rng.standard_normal((n, 3))
    cov_m2 = np.tile(np.diag(sigma_m**2), (n, 1, 1))
    t_ns: Instants = motion.t_ns
    return GnssFixes(t_ns, t_ns, p_world_m, cov_m2, np.full((n, 3), np.nan))


def _check(path: str, camera_yaw_deg: float, corner_sigma_px: float) -> None:
    if path not in LANES_M:
        raise InputError(
            f"path = {path!r}: the nearest is {nearest(path, LANES_M)!r} "
            f"(there are: {', '.join(LANES_M)})"
        )
    if not abs(camera_yaw_deg) < 90:
        raise InputError(f"camera_yaw_deg = {camera_yaw_deg}: expected an angle below 90 deg")
    if not 0 <= corner_sigma_px < np.inf:
        raise InputError(f"corner_sigma_px = {corner_sigma_px}: expected a number from 0")


def _about(
    seed: int, path: str, yaw_deg: float, sigma_px: float, quantised: bool, corners: bool
) -> About:
    return About(
        title=f"Simulated drive up to three Smart Codes, {path} path, camera at {yaw_deg:g} deg, "
        f"seed {seed}",
        licence="MIT",
        source=f"fgloc scenario marr2019/smart-code, seed {seed}, path {path}, camera_yaw_deg "
        f"{yaw_deg:g}, corner_sigma_px {sigma_px:g}, quantised {str(quantised).lower()}, corners "
        f"{str(corners).lower()}; after T. S. Marr (2019)",
        simulated=True,
    )
