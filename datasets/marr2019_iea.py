"""Scenario `marr2019/iea`: two roadside cameras find a car on 200 m of road.

T. S. Marr, "Utilizing the Infrastructure for Ground Truth Based Localization", thesis, Texas A&M
University, 2019, section 2.5: two cameras about 10 m up along 200 m, a car that changes lanes
heading south. Cameras know no model: a calibration drive with a differential GPS pairs box
centres with places, and inverse distance weighting turns new centres into detections.

The thesis does not print what follows, which is chosen so that errors grow over distance as its
figure 2.9 has them: image, focal length, places and tilt of the cameras, noise of the boxes, the
lanes, all rates, and the noise of what the car knows by itself.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc.datasets.lane_motion import LaneChange, lane_motion
from fgloc.datasets.road_camera import PostCamera, box_centres
from fgloc.datasets.simulator import Motion, instants, stream, truth_of
from fgloc.drive import About, Drive, GnssBias, Rig, VelocityErrors
from fgloc.errors import InputError
from fgloc.frames import Origin
from fgloc.infrastructure import Infrastructure, Node
from fgloc.measurements import VEHICLE, Array, EnuVelocities, GnssFixes, NodeDetections
from fgloc.perception.idw import POWER, Calibration, IdwMap
from fgloc.perception.map_error import ErrorMap
from fgloc.timing import Instants, seconds_to_ns

START_NS = 1_546_300_800 * 1_000_000_000
ORIGIN = Origin(30.638, -96.478, 60.0)
ROAD_M, SPEED_MPS, SOUTH_RAD = 200.0, 10.0, -np.pi / 2
RANGE_M = 250.0
"""To the end of the road from either post: what is far is for the covariance to tell."""
LANE_M = 3.6
LANES_EAST_M = (0.0, LANE_M)
CHANGES = 3
CHANGE_S = (2.5, 4.0)

CAMERAS = tuple(
    PostCamera((8.0, north_m, 10.0), SOUTH_RAD, np.deg2rad(12), 1400.0, (1920, 1080))
    for north_m in (215.0, 115.0)
)
EDGE_SIGMA_PX = 1.0
SEEN_CHANCE = 0.95
LATENCY_S = 0.05
SURVEY_SIGMA_M = 0.02
CALIBRATION_PASSES = 12
WEAVE_EAST_M, WEAVE_S, WEAVE_SPEED = (LANES_EAST_M[0] - 1.5, LANES_EAST_M[1] + 1.5), 3.5, (0.7, 1.1)

HZ, VELOCITY_HZ, DETECTION_HZ, GNSS_HZ = 100, 50, 10, 1
GNSS_SIGMA_ENU_M, GNSS_BIAS = (1.0, 1.0, 2.0), GnssBias(1.5, 60.0)
SPEED_SCALE_SIGMA, SPEED_SIGMA_MPS = 0.01, 0.05
HEADING_BIAS_RAD, HEADING_SIGMA_RAD = np.deg2rad(0.5), np.deg2rad(0.5)
P_VEH_ANT_M = (1.2, 0.0, 1.5)
"""The antenna; the calibration drive's was there too, so it is what the cameras find."""


@dataclass(frozen=True, eq=False)
class Seen:
    """One camera's box centres (M, 2) in px, and the instants (M,) of its frames."""

    row: NDArray[np.int64]
    u_px: Array


def make_marr2019_iea(
    seed: int = 0, calibration_passes: int = CALIBRATION_PASSES, power: float = POWER
) -> Drive:
    """The drive of a seed: fixes at 1 Hz, speed and heading at 50 Hz, detections at 10 Hz.

    `calibration_passes` is how often the calibration drive went by, `power` the map's p. Raises
    InputError for fewer passes than two, or a power that is not above 1.
    """
    motion = iea_motion(seed)
    rig = Rig(
        np.array(P_VEH_ANT_M), p_veh_box_m=np.array(P_VEH_ANT_M), gnss_bias=GNSS_BIAS,
        velocity_errors=VelocityErrors(SPEED_SCALE_SIGMA, HEADING_BIAS_RAD),
    )  # fmt: skip
    nodes = tuple(
        Node(f"mssp{i + 1}", np.array(camera.p_world_m), range_m=RANGE_M)
        for i, camera in enumerate(CAMERAS)
    )
    detections, refused = _detections(motion, nodes, seed, calibration_passes, power)
    tables = {
        "gnss": biased_fixes(motion.every(HZ // GNSS_HZ), rig, stream(seed, "gnss")),
        "velocity": speed_and_heading(motion.every(HZ // VELOCITY_HZ), stream(seed, "velocity")),
        "detections": detections,
    }
    truth = truth_of(motion.every(HZ // VELOCITY_HZ))
    about = _about(seed, calibration_passes, power, refused)
    return Drive("marr2019/iea", ORIGIN, rig, tables, truth, about, Infrastructure(nodes))


def iea_motion(seed: int) -> Motion:
    """The vehicle frame at 100 Hz: down the road, from lane to lane and back."""
    rng = stream(seed, "motion")
    duration_s = ROAD_M / SPEED_MPS
    lane, changes = int(rng.integers(2)), []
    start = np.array([LANES_EAST_M[lane], ROAD_M, 0.0])
    for i in range(CHANGES):
        room_s = duration_s / CHANGES
        length_s = rng.uniform(*CHANGE_S)
        begin_s = i * room_s + rng.uniform(0, room_s - length_s)
        # Heading south, the left is in the east.
        changes.append(LaneChange(begin_s, length_s, LANE_M * (1 - 2 * lane)))
        lane = 1 - lane
    t_ns = instants(START_NS, duration_s, HZ)
    return lane_motion(t_ns, start, SOUTH_RAD, SPEED_MPS, changes)


def calibration_set(seed: int, camera: int, passes: int) -> Calibration:
    """What the calibration drive gave for a camera: as many passes, each weaving its own way over
    both lanes, so that errors left out one by one are those of a drive in between.

    Raises InputError for fewer passes than two, of which one could not judge the other.
    """
    if passes < 2:
        raise InputError(f"calibration_passes = {passes}: expected a whole number from 2")
    rng = stream(seed, f"calibration {camera}")
    u_px, p_world_m, run = [], [], []
    for i in range(passes):
        motion = _weave(rng)
        u, seen = box_centres(CAMERAS[camera], motion, EDGE_SIGMA_PX, rng)
        p = (motion.p_world_m + motion.R_world_veh @ P_VEH_ANT_M)[:, :2]
        u_px.append(u[seen])
        p_world_m.append(p[seen] + SURVEY_SIGMA_M * rng.standard_normal((seen.sum(), 2)))
        run.append(np.full(seen.sum(), i))
    return Calibration(*(np.concatenate(parts) for parts in (u_px, p_world_m, run)))


def _weave(rng: np.random.Generator) -> Motion:
    """One pass of the calibration drive at the cameras' rate, from before the first post on."""
    speed_mps = SPEED_MPS * rng.uniform(*WEAVE_SPEED)
    duration_s = (ROAD_M + 40.0) / speed_mps
    begins_s = np.arange(0, duration_s - WEAVE_S, WEAVE_S) + rng.uniform(-WEAVE_S / 2, 0)
    east_m = rng.uniform(*WEAVE_EAST_M, len(begins_s) + 1)
    start = np.array([east_m[0], ROAD_M + 20.0, 0.0])
    changes = [
        LaneChange(t_s, WEAVE_S, left_m)
        for t_s, left_m in zip(begins_s, np.diff(east_m), strict=True)
    ]
    t_ns = instants(START_NS, duration_s, DETECTION_HZ)
    return lane_motion(t_ns, start, SOUTH_RAD, speed_mps, changes)


def box_sightings(seed: int, camera: int, motion: Motion) -> Seen:
    """The frames of a motion in which a camera has a box around the car, and their centres."""
    rng = stream(seed, f"boxes {camera}")
    u_px, seen = box_centres(CAMERAS[camera], motion, EDGE_SIGMA_PX, rng)
    seen &= rng.random(len(motion)) < SEEN_CHANCE
    return Seen(np.flatnonzero(seen), u_px[seen])


def _detections(
    motion: Motion, nodes: tuple[Node, ...], seed: int, passes: int, power: float
) -> tuple[NodeDetections, int]:
    """Detections of all cameras in the order of time, and how many the maps refused."""
    frames = motion.every(HZ // DETECTION_HZ)
    columns, refused = [], 0
    for i, node in enumerate(nodes):
        calibration = calibration_set(seed, i, passes)
        one, seen = IdwMap(calibration, power), box_sightings(seed, i, frames)
        errors = ErrorMap.of(lambda some: IdwMap(some, power), calibration)
        inside = one.inside(seen.u_px)
        refused += int((~inside).sum())
        u_px = seen.u_px[inside]
        p_node_m = node.from_world(one.place(u_px))
        cov = node.R_world_node.T @ errors.covariance_m2(u_px)
        columns.append((frames.t_ns[seen.row[inside]], np.full(len(u_px), i), p_node_m,
                        cov @ node.R_world_node))  # fmt: skip
    t_ns, node_number, p_node_m, cov = (np.concatenate(c) for c in zip(*columns, strict=True))
    order = np.argsort(t_ns, kind="stable")
    t_ns = t_ns[order]
    return NodeDetections(
        t_ns, t_ns + seconds_to_ns(LATENCY_S), node_number[order], np.ones_like(t_ns),
        np.full(len(t_ns), VEHICLE), p_node_m[order], cov[order],
    ), refused  # fmt: skip


def biased_fixes(motion: Motion, rig: Rig, rng: np.random.Generator) -> GnssFixes:
    """Fixes of the antenna: white noise, and the slow error that the rig states."""
    n, sigma_m = len(motion), np.array(GNSS_SIGMA_ENU_M)
    white_m = sigma_m * rng.standard_normal((n, 3))
    slow_m = slow_error(rig.gnss_bias or GNSS_BIAS, motion.t_ns, rng)
    p_world_ant_m = motion.p_world_m + motion.R_world_veh @ rig.p_veh_ant_m
    cov_m2 = np.tile(np.diag(sigma_m**2), (n, 1, 1))
    return GnssFixes(
        motion.t_ns, motion.t_ns, p_world_ant_m + white_m + slow_m, cov_m2, np.full((n, 3), np.nan)
    )


def slow_error(bias: GnssBias, t_ns: Instants, rng: np.random.Generator) -> Array:
    """(N, 3) in m: a stationary first-order Gauss-Markov process, each axis alike."""
    dt_s = float(t_ns[1] - t_ns[0]) / 1e9
    keep = np.exp(-dt_s / bias.tau_s)
    slow = bias.sigma_m * rng.standard_normal((len(t_ns), 3))
    for k in range(1, len(slow)):
        slow[k] = keep * slow[k - 1] + np.sqrt(1 - keep**2) * slow[k]
    return slow


def speed_and_heading(motion: Motion, rng: np.random.Generator) -> EnuVelocities:
    """What the car knows of its velocity: a speed with a constant scale error, along a heading
    with a constant error, both noisy. The stated sigma is of the noise, on either axis.
    """
    n = len(motion)
    scale = 1 + SPEED_SCALE_SIGMA * rng.standard_normal()
    turned = HEADING_BIAS_RAD * rng.standard_normal()
    v = motion.v_world_mps
    speed = np.hypot(v[:, 0], v[:, 1]) * scale + SPEED_SIGMA_MPS * rng.standard_normal(n)
    heading = np.arctan2(v[:, 1], v[:, 0]) + turned + HEADING_SIGMA_RAD * rng.standard_normal(n)
    told = np.stack([speed * np.cos(heading), speed * np.sin(heading), np.zeros(n)], -1)
    sigma_mps = np.maximum(SPEED_SIGMA_MPS, HEADING_SIGMA_RAD * speed)
    return EnuVelocities(motion.t_ns, motion.t_ns, told, sigma_mps)


def _about(seed: int, passes: int, power: float, refused: int) -> About:
    return About(
        title=f"Simulated drive past two roadside cameras, seed {seed}; {refused} boxes lay outside"
        " of the calibrated image and give no detection",
        licence="MIT",
        source=f"fgloc scenario marr2019/iea, seed {seed}, calibration_passes {passes}, "
        f"power {power:g}; after T. S. Marr (2019)",
        simulated=True,
    )
