"""Scenario `khamooshi2023/sway-drive`: a car rounds an oval beside a node whose post sways.

Not a scenario of the thesis, which stops at the pose of the node; it shows what sway does to a car.
The oval passes the node at 5 m and leads 65 m away from it, to either side. The car has GNSS of a
stated sigma at 10 Hz and an IMU; the node sees the middle of its box, at the height of the ground,
ten times a second, as a camera (on the ground, through the pose that is believed) or as a LiDAR
(rigidly, with its height), and a pose estimator watches the post as in `khamooshi2023/sway-low`,
under gusts. Other cars with RTK may round the oval as well and say where they are; the node sees
them and numbers them as it likes.
"""

from typing import TypeVar

import numpy as np

from fgloc import frames
from fgloc.datasets.khamooshi2023_sway import (
    LOW,
    MOTION_HZ,
    NODE,
    ORIGIN,
    START_NS,
    check_duration,
    simulate_poses,
    simulate_sway,
)
from fgloc.datasets.simulator import (
    Motion,
    instants,
    simulate_gnss,
    simulate_imu,
    stream,
    truth_of,
)
from fgloc.drive import About, Drive, ImuNoise, Rig
from fgloc.errors import InputError
from fgloc.factors.sway import Sensor, reported
from fgloc.infrastructure import Infrastructure, Node
from fgloc.measurements import LEFT_OUT, VEHICLE, Array, NodeDetections, Table, UserFixes
from fgloc.posts import PostStates
from fgloc.timing import Instants, elapsed_s

NAME = "khamooshi2023/sway-drive"
SEEN_HZ, IMU_HZ, GNSS_HZ, TRUTH_HZ = 10, 100, 10, 20
HALF_LENGTH_M, HALF_WIDTH_M, MIDDLE_M, TURN_RADPS = 65.0, 15.0, 20.0, 0.15
"""The oval: half axes to the East and North, how far to the North of the node its middle is, and
how fast the car goes round; its speed is 2 to 10 m/s."""
BOX_SIGMA_M, PIXEL_SIGMA_RAD, RANGE_SIGMA_M = 0.10, 2 / 1144, 0.03
"""Of a box's centre, of a camera's ray (two pixels of the thesis's focal length), of a range."""
TILT_NOISE = 10.0
"""The pose estimator's angles err by about 1 mrad, a pixel of the camera."""
RIG = Rig(
    p_veh_ant_m=np.array([1.3, 0.0, 1.5]), p_veh_box_m=np.array([1.3, 0.0, 0.0]),
    imu_noise=ImuNoise(2e-3, 2e-4, 2e-4, 4e-6, 0.1, 0.005),
)  # fmt: skip
RTK_SIGMA_M, RTK_SIGMA_UP_M = 0.02, 0.03
MOST_USERS, FIRST_USER = 5, 100
_SENSORS = ("camera", "lidar")
AnyTable = TypeVar("AnyTable", bound=Table)


def make_sway_drive(
    seed: int = 0, duration_s: float = 84.0, sensor: str = "camera", gnss_sigma_m: float = 1.0,
    sways: bool = True, poses: bool = True, users: int = 0, heights: bool = True,
) -> Drive:  # fmt: skip
    """The drive of a seed; truth of the rear axle at 20 Hz with attitude and velocity.

    sensor        camera or lidar
    gnss_sigma_m  of the fixes, East and North; twice that up
    sways         without, the post stands still and all else is as it was, noise included
    poses         without, nobody watches the post: the detections alone tell of it
    users         how many other cars say where they are, to two centimetres
    heights       whether a LiDAR, and then the other cars too, tell heights; a camera tells none

    Raises InputError for options that cannot be.
    """
    check_duration(duration_s)
    kind = _sensor(sensor)
    if users not in range(MOST_USERS + 1):
        raise InputError(f"users = {users}: expected 0 to {MOST_USERS} other cars")
    if not (np.isfinite(gnss_sigma_m) and gnss_sigma_m > 0):
        raise InputError(f"gnss_sigma_m = {gnss_sigma_m}: expected metres above 0")
    node = Node(NODE.name, NODE.p_world_m, sensor=kind)
    t_ns = instants(START_NS, duration_s, MOTION_HZ)
    post, sway, _ = simulate_sway(LOW, "kaimal", t_ns, stream(seed, "load"))
    if not sways:
        sway = PostStates.truth(t_ns, 0, *np.zeros((3, len(t_ns), 2)))
    motion = oval_motion(instants(START_NS, duration_s, IMU_HZ), 0.0)
    heights = heights and kind == "lidar"
    tables: dict[str, Table] = {
        "gnss": simulate_gnss(
            motion.every(IMU_HZ // GNSS_HZ), RIG, np.array([1, 1, 2]) * gnss_sigma_m,
            stream(seed, "gnss"),
        ),
        "imu": simulate_imu(motion, RIG, ORIGIN.gravity_mps2(), stream(seed, "imu")),
        "detections": simulate_detections(
            motion, node, sway, stream(seed, "detections"),
            rng_up=stream(seed, "heights") if heights else None,
        ),
    }  # fmt: skip
    if poses:
        rng = stream(seed, "poses")
        tables["node_poses"] = simulate_poses(sway, LOW, post, TILT_NOISE, rng)
    if users:
        seen, tables["users"] = _others(users, node, sway, t_ns, seed, heights=heights)
        tables["detections"] = _merged(tables["detections"], *seen)
    about = About(
        f"Simulated drive past a {kind} on a swaying post, seed {seed}", "MIT",
        f"fgloc scenario {NAME}, seed {seed}, duration_s {duration_s:g}, sensor {kind}", True,
    )  # fmt: skip
    truth = truth_of(motion.every(IMU_HZ // TRUTH_HZ))
    beside = Infrastructure((node,), (post,))
    return Drive(NAME, ORIGIN, RIG, tables, truth, about, beside, post_truth=sway)


def _others(
    users: int, node: Node, sway: PostStates, t_ns: Instants, seed: int, *, heights: bool
) -> tuple[list[NodeDetections], UserFixes]:
    """What the node sees of other cars, spread over the oval, and where these say that they are."""
    every_ns = t_ns[:: MOTION_HZ // IMU_HZ]
    seen, told = [], []
    for number in range(1, users + 1):
        rng = stream(seed, f"rtk {number}")
        rng_up = stream(seed, f"heights {number}") if heights else None
        motion = oval_motion(every_ns, 2 * np.pi * number / (users + 1))
        seen.append(simulate_detections(motion, node, sway, rng, number, rng_up))
        told.append(_rtk(motion.every(IMU_HZ // GNSS_HZ), FIRST_USER + number, rng, rng_up))
    return seen, _merged(*told)


def _rtk(
    at: Motion, user: int, rng: np.random.Generator, rng_up: np.random.Generator | None
) -> UserFixes:
    """Where a car says that the middle of its box is, with white noise; its height if `rng_up`."""
    box_m = at.p_world_m + at.R_world_veh @ RIG.p_veh_box_m
    fixes_m = box_m[:, :2] + RTK_SIGMA_M * rng.standard_normal((len(at), 2))
    cov = np.tile(RTK_SIGMA_M**2 * np.eye(2), (len(at), 1, 1))
    up = _noisy(box_m[:, 2], np.full(len(at), RTK_SIGMA_UP_M), rng_up)
    return UserFixes(at.t_ns, at.t_ns, np.full(len(at), user), fixes_m, cov, *up)


def _noisy(up_m: Array, sigma_m: Array, rng: np.random.Generator | None) -> tuple[Array, Array]:
    """Heights (N,) with white noise and its sigmas; NaN without random numbers: not told."""
    if rng is None:
        return LEFT_OUT, LEFT_OUT
    return up_m + sigma_m * rng.standard_normal(len(up_m)), sigma_m


def _merged(*tables: AnyTable) -> AnyTable:
    """The rows of all tables in order of time."""
    columns = {name: np.concatenate([getattr(one, name) for one in tables])
               for name in vars(tables[0])}  # fmt: skip
    order = np.argsort(columns["t_ns"], kind="stable")
    return type(tables[0])(**{name: column[order] for name, column in columns.items()})


def _sensor(name: str) -> Sensor:
    if name not in _SENSORS:
        raise InputError(f"sensor = {name!r}: expected one of {', '.join(_SENSORS)}")
    return "camera" if name == "camera" else "lidar"


def oval_motion(t_ns: Instants, phase_rad: float) -> Motion:
    """Counter-clockwise round the oval, from a place on it; closed formulas of time."""
    angle = phase_rad + TURN_RADPS * elapsed_s(t_ns, START_NS)
    sin, cos = np.sin(angle), np.cos(angle)
    half, w, level = np.array([HALF_LENGTH_M, HALF_WIDTH_M]), TURN_RADPS, np.zeros(len(angle))
    v = w * half * np.stack([-sin, cos], -1)
    a = -(w**2) * half * np.stack([cos, sin], -1)
    jerk = -(w**2) * v
    speed2 = (v**2).sum(-1)
    rate = (v[:, 0] * a[:, 1] - v[:, 1] * a[:, 0]) / speed2
    rate_dot = (v[:, 0] * jerk[:, 1] - v[:, 1] * jerk[:, 0]) / speed2
    rate_dot -= 2 * rate * (v * a).sum(-1) / speed2
    p = np.column_stack([HALF_LENGTH_M * cos, MIDDLE_M + HALF_WIDTH_M * sin, level])
    return Motion(
        t_ns, p, np.column_stack([v, level]), np.column_stack([a, level]),
        frames.yaw_matrix(np.arctan2(v[:, 1], v[:, 0])), np.column_stack([level, level, rate]),
        np.column_stack([level, level, rate_dot]),
    )  # fmt: skip


def simulate_detections(
    motion: Motion, node: Node, sway: PostStates, rng: np.random.Generator, object_id: int = 0,
    rng_up: np.random.Generator | None = None,
) -> NodeDetections:  # fmt: skip
    """What the node reports of the box of a car, ten times a second, with white noise.

    `motion` is at `IMU_HZ` and `sway` at `MOTION_HZ`, from one instant on. A camera errs along its
    ray, the more the further it reaches. Heights, which only a LiDAR tells, have random numbers of
    their own, and are not told without.
    """
    at = motion.every(IMU_HZ // SEEN_HZ)
    swung = sway.take(slice(None, None, MOTION_HZ // SEEN_HZ))
    box_m = at.p_world_m + at.R_world_veh @ RIG.p_veh_box_m
    height_m = float(node.p_world_m[2])
    q_m = np.column_stack([node.from_world(box_m[:, :2]), box_m[:, 2] - height_m])
    moved = np.concatenate([swung.p_node_m, swung.tilt_rad], -1)
    place = reported(q_m, moved, node.sensor)[0]
    seen = place[:, :2]
    cov = detection_cov(seen, height_m, node.sensor)
    noise = np.einsum("nij,nj->ni", np.linalg.cholesky(cov), rng.standard_normal(seen.shape))
    up = _noisy(place[:, 2], height_sigma_m(seen, height_m), rng_up)
    first, number, kind = (np.full(len(seen), value) for value in (0, object_id, VEHICLE))
    return NodeDetections(at.t_ns, at.t_ns, first, number, kind, seen + noise, cov, *up)


def detection_cov(seen_m: Array, height_m: float, sensor: Sensor) -> Array:
    """Covariance (N, 2, 2) that the node states of what it reports at (N, 2), in its axes."""
    range_m = np.linalg.norm(seen_m, axis=-1)
    along = seen_m / np.maximum(range_m, 1e-9)[:, None]
    sigma_m = np.full(len(seen_m), RANGE_SIGMA_M)
    if sensor == "camera":
        sigma_m = PIXEL_SIGMA_RAD * height_m * (1 + (range_m / height_m) ** 2)
    ray = along[:, :, None] * along[:, None, :] * sigma_m[:, None, None] ** 2
    return np.asarray(BOX_SIGMA_M**2 * np.eye(2) + ray)


def height_sigma_m(seen_m: Array, height_m: float) -> Array:
    """Sigma (N,) of the height that a LiDAR tells of boxes at (N, 2), so far below it: that of the
    box, and the part of the range's that goes down."""
    slant_m = np.hypot(np.linalg.norm(seen_m, axis=-1), height_m)
    return np.hypot(BOX_SIGMA_M, RANGE_SIGMA_M * height_m / slant_m)
