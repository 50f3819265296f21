"""The node's scenarios of Khamooshi (2023), section 3.8: one car, seen by cameras and LiDARs.

Each sensor of a node is a `Node` of its own, `node-1/camera` beside `node-1/lidar`, because each
has a noise of its own, and all measure at 10 Hz. The noise grows with the slant range, Eq. (3.16);
its constants are those with which the best of camera and LiDAR of node 1 has on average the error
that the thesis reports of its measurements, 0.33 m in x and 0.29 m in y.
"""

import math

import numpy as np

from fgloc.datasets.simulator import stream
from fgloc.drive import About, Drive, Rig
from fgloc.frames import Origin, yaw_matrix
from fgloc.infrastructure import Infrastructure, Node
from fgloc.measurements import (
    VEHICLE,
    Array,
    EnuVelocities,
    GnssFixes,
    NodeDetections,
    Odometry,
    Table,
)
from fgloc.timing import NS_PER_S, Instants
from fgloc.trajectory import Trajectory

START_NS = 1_760_000_000 * NS_PER_S
ORIGIN = Origin(43.4723, -80.5449, 330.0)
RATE_HZ = 10
SPEED_MPS = 10.0
NODES_M = ((-10.0, 17.0, 10.0), (10.0, -5.0, 10.0))
FROM_M = (-10.2, 17.4)
DURATION_S = 4.0
"""Not printed: past node 2, which is 30 m from the start."""
CAMERA_A = (2.5e-4, 1.9e-4)
LIDAR_A = (7.1e-4, 5.4e-4)
"""(3.16) a_n in x and in y of each sensor; the ratio of the two is not printed."""
GNSS_SIGMA_M = (1.0, 1.0, 0.8)
VELOCITY_SIGMA_MPS = 0.03
YAW_RATE_SIGMA_RADPS = 0.004  # not printed: 0.247 deg of attitude, between two samples at 10 Hz

_STRAIGHT_M, _RADIUS_M = 20.0, 20.0  # not printed


def make_constant_velocity(seed: int = 0) -> Drive:
    """Scenario 1: 10 m/s from node 1 towards node 2 and past it.

    Raises InputError for a seed below 0.
    """
    t_s = np.arange(int(DURATION_S * RATE_HZ) + 1) / RATE_HZ
    ahead = np.subtract(NODES_M[1], NODES_M[0])[:2]
    yaw = np.full(len(t_s), math.atan2(ahead[1], ahead[0]))
    place = FROM_M + SPEED_MPS * t_s[:, None] * ahead / np.linalg.norm(ahead)
    return _drive("constant-velocity", seed, t_s, place, yaw, NODES_M, gnss=False)


def make_right_turn(seed: int = 0) -> Drive:
    """Scenario 2: a right turn at 10 m/s, one node, and the car's GNSS/INS.

    Raises InputError for a seed below 0.
    """
    length_m = 2 * _STRAIGHT_M + _RADIUS_M * math.pi / 2
    t_s = np.arange(int(length_m / SPEED_MPS * RATE_HZ) + 1) / RATE_HZ
    along = SPEED_MPS * t_s
    turned = np.clip((along - _STRAIGHT_M) / _RADIUS_M, 0, math.pi / 2)
    after = np.maximum(along - _STRAIGHT_M - _RADIUS_M * math.pi / 2, 0)
    east = np.minimum(along, _STRAIGHT_M) + _RADIUS_M * np.sin(turned)
    north = -_RADIUS_M * (1 - np.cos(turned)) - after
    place = FROM_M + np.stack([east, north], -1)
    return _drive("right-turn", seed, t_s, place, -turned, NODES_M[:1], gnss=True)


def _drive(
    name: str, seed: int, t_s: Array, place: Array, yaw: Array,
    nodes_m: tuple[tuple[float, ...], ...], *, gnss: bool,
) -> Drive:  # fmt: skip
    t_ns = START_NS + np.round(t_s * NS_PER_S).astype(np.int64)
    nodes, variances = _sensors(nodes_m)
    p = np.column_stack([place, np.zeros(len(place))])
    v = SPEED_MPS * np.stack([np.cos(yaw), np.sin(yaw), np.zeros(len(yaw))], -1)
    truth = Trajectory(t_ns, p, yaw_matrix(yaw), v)
    tables: dict[str, Table] = {
        "detections": _detections(t_ns, place, nodes, variances, stream(seed, "detections")),
        "odometry": _odometry(t_ns, yaw, stream(seed, "odometry")),
    }
    if gnss:
        tables |= _gnss(t_ns, p, v, stream(seed, "gnss"))
    about = About(
        title=f"Khamooshi (2023), section 3.8, {name}, seed {seed}", licence="MIT",
        source=f"fgloc scenario khamooshi2023/{name}, seed {seed}", simulated=True,
    )  # fmt: skip
    return Drive(
        f"khamooshi2023/{name}", ORIGIN, Rig(), tables, truth, about, Infrastructure(nodes)
    )


def _sensors(nodes_m: tuple[tuple[float, ...], ...]) -> tuple[tuple[Node, ...], Array]:
    """A `Node` for each sensor, and the constants of its noise (S, 2)."""
    nodes = tuple(
        Node(f"node-{i}/{sensor}", np.array(place))
        for i, place in enumerate(nodes_m, 1)
        for sensor in ("camera", "lidar")
    )
    return nodes, np.array([CAMERA_A, LIDAR_A] * len(nodes_m))


def _detections(
    t_ns: Instants, place: Array, nodes: tuple[Node, ...], a: Array, rng: np.random.Generator
) -> NodeDetections:
    """Each sensor at each instant, with the covariance that the sensor has there."""
    N, S = len(t_ns), len(nodes)
    from_node = place[:, None] - np.array([node.p_world_m[:2] for node in nodes])
    slant2 = (from_node**2).sum(-1) + np.array([node.p_world_m[2] for node in nodes]) ** 2
    variance = a * slant2[..., None]  # (N, S, 2), Eq. (3.16)
    seen = from_node + np.sqrt(variance) * rng.standard_normal((N, S, 2))
    cov = variance.reshape(-1, 2)[:, :, None] * np.eye(2)
    at = np.repeat(t_ns, S)
    zeros = np.zeros(N * S, np.int64)
    return NodeDetections(
        at, at, np.tile(np.arange(S), N), zeros, zeros + VEHICLE, seen.reshape(-1, 2), cov
    )


def _odometry(t_ns: Instants, yaw: Array, rng: np.random.Generator) -> Odometry:
    n = len(t_ns)
    rate = np.gradient(np.unwrap(yaw), 1 / RATE_HZ)
    return Odometry(
        t_ns, t_ns, SPEED_MPS + VELOCITY_SIGMA_MPS * rng.standard_normal(n),
        rate + YAW_RATE_SIGMA_RADPS * rng.standard_normal(n),
        np.full(n, VELOCITY_SIGMA_MPS), np.full(n, YAW_RATE_SIGMA_RADPS),
    )  # fmt: skip


def _gnss(t_ns: Instants, p: Array, v: Array, rng: np.random.Generator) -> dict[str, Table]:
    """Fixes and velocities of the car's GNSS/INS."""
    n, sigma = len(t_ns), np.array(GNSS_SIGMA_M)
    fixes = p + sigma * rng.standard_normal((n, 3))
    speed = v + VELOCITY_SIGMA_MPS * rng.standard_normal((n, 3))
    cov = np.tile(np.diag(sigma**2), (n, 1, 1))
    nothing = np.full((n, 3), np.nan)
    return {
        "gnss": GnssFixes(t_ns, t_ns, fixes, cov, nothing),
        "velocity": EnuVelocities(t_ns, t_ns, speed, np.full(n, VELOCITY_SIGMA_MPS)),
    }
