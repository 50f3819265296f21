"""The extended Kalman filter behind a track: an upright cuboid that moves over the ground.

Lee et al. (2021), section III-B: an EKF whose state holds the centre, the dimensions and the
velocity of the object; the equations are not printed. Many at once, x (T, 9) and P (T, 9, 9):

    x[0:3]  centre along the node's level axes, m     x[5:8]  length, width, height, m
    x[3:5]  velocity along the node's x and y, m/s    x[8]    yaw of the length, rad, modulo pi

A sensor sees the near side of an object; how far it reaches behind is known from earlier views, or
from its class. So what is measured is not the centre but a point on the near side, and the size in
the state carries it to the centre:

- a LiDAR's cuboid: the corner or side towards the sensor, the extents that were seen, the top, and
  the foot, which stands on the ground; an extent shorter than the track's may be cut off, so its
  sigma is at least what is missing
- a camera's box: its edges, where the outermost corners are; or a place on the ground, of the near
  side or of the centre
- the class: the size of its kind; a fast vehicle: it drives along its length
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgloc.measurements import PEDESTRIAN, VEHICLE, Array
from fgloc.perception.boxes import Cuboids, upright_corners
from fgloc.perception.cuboid_fit import CAR_M, PERSON_M
from fgloc.perception.ground import Sightings, depth_m, kind_size_m
from fgloc.perception.heads import Camera
from fgloc.perception.settings import PlaceConfig, TrackConfig

D = 9
P_, V_, S_, YAW = slice(0, 3), slice(3, 5), slice(5, 8), 8
FOOT_SIGMA_M = 0.1
"""How level the ground is under an object."""
LEAST_SIZE_M = 0.2
OPEN_SIGMA = 1e3
"""Of what is not known at all, in m, m/s or rad."""
LONG_RATIO = 1.4
"""A cuboid whose length was seen and is so many times its width shows a yaw."""
ALIKE_RAD = np.pi / 12
"""Sides of a cuboid and a track that are turned by less are the same sides."""
SURE_SHARE = 0.3
"""A velocity whose sigma is below this share of it has a course."""
STEP = 1e-4
"""Of numerical differences, m and rad."""
SIDE_SHARE = 0.3
"""A side that is seen at a smaller sine is taken for partly hidden in proportion."""


class Belief(NamedTuple):
    """States (T, 9) and covariances (T, 9, 9)."""

    x: Array
    P: Array

    def at(self, rows: NDArray[np.int64]) -> "Belief":
        """The states of some rows."""
        return Belief(self.x[rows], self.P[rows])

    @property
    def cuboids(self) -> tuple[Array, Array, Array]:
        """Centres (T, 3), sizes (T, 3) and yaws (T,), as `cuboid_iou` takes them."""
        return self.x[:, P_], self.x[:, S_], self.x[:, YAW]


class Measured(NamedTuple):
    """Innovations (T, m), their Jacobians (T, m, 9) by the state, and noise (T, m, m)."""

    error: Array
    H: Array
    R: Array

    def nis(self, belief: Belief) -> Array:
        """(T,) squared innovations by their covariance."""
        S = self.H @ belief.P @ self.H.swapaxes(1, 2) + self.R
        return np.asarray((self.error * np.linalg.solve(S, self.error[..., None])[..., 0]).sum(-1))


def predict(belief: Belief, dt_s: float, kind: NDArray[np.int64], config: TrackConfig) -> Belief:
    """So many seconds on: the velocity stays but for white acceleration."""
    F = np.eye(D)
    F[0, 3] = F[1, 4] = dt_s
    slow = kind == PEDESTRIAN
    push = np.where(
        slow, config.pedestrian_accel_mps2_per_sqrt_hz, config.vehicle_accel_mps2_per_sqrt_hz
    )
    Q = np.zeros((len(kind), D, D))
    for p, v in ((0, 3), (1, 4)):
        Q[:, p, p], Q[:, v, v] = push**2 * dt_s**3 / 3, push**2 * dt_s
        Q[:, p, v] = Q[:, v, p] = push**2 * dt_s**2 / 2
    walks = [config.size_walk_m_per_sqrt_s] * 3 + [config.yaw_walk_rad_per_sqrt_s]
    Q[:, range(5, D), range(5, D)] = np.square(walks) * dt_s
    return Belief(belief.x @ F.T, F @ belief.P @ F.T + Q)


def update(belief: Belief, seen: Measured) -> Belief:
    """Each state by its own measurement; Joseph's form. Sizes stay above 0.2 m."""
    x, P = belief
    PHt = P @ seen.H.swapaxes(1, 2)
    gain = np.linalg.solve(seen.H @ PHt + seen.R, PHt.swapaxes(1, 2)).swapaxes(1, 2)
    x = x + (gain @ seen.error[..., None])[..., 0]
    x[:, S_] = np.maximum(x[:, S_], LEAST_SIZE_M)
    rest = np.eye(D) - gain @ seen.H
    P = rest @ P @ rest.swapaxes(1, 2) + gain @ seen.R @ gain.swapaxes(1, 2)
    return Belief(x, (P + P.swapaxes(1, 2)) / 2)


def forget_place(belief: Belief) -> Belief:
    """The same shapes where nothing is known of the place: updated with measurements, this is what
    they alone say of it."""
    P = belief.P.copy()
    P[:, :2, :], P[:, :, :2] = 0, 0
    P[:, [0, 1], [0, 1]] = OPEN_SIGMA**2
    return Belief(belief.x.copy(), P)


def by_cuboid(
    belief: Belief, seen: Cuboids, sensor_m: Array, ground_m: float, config: TrackConfig
) -> Measured:
    """A cuboid (T,) for each state, of a LiDAR at sensor_m (3,) in the node's axes."""
    x = belief.x
    assumed = was_assumed(seen.size_m)
    turned = _wrapped(seen.yaw_rad - x[:, YAW])
    off_yaw = _quarter(turned)
    swapped = (np.abs(turned) > np.pi / 4)[:, None]
    extent, shown = (
        np.where(swapped, column[:, 1::-1], column[:, :2]) for column in (seen.size_m, ~assumed)
    )
    shown &= (np.abs(off_yaw) < ALIKE_RAD)[:, None]
    told = ~assumed[:, 0] & (seen.size_m[:, 0] > LONG_RATIO * seen.size_m[:, 1])
    arm, aspect = _near_arm(x[:, :2], x[:, 5:7], x[:, YAW], sensor_m)
    seen_arm, _ = _near_arm(seen.centre_m[:, :2], seen.size_m[:, :2], seen.yaw_rad, sensor_m)
    foot, top = (x[:, 2] + sign * x[:, 7] / 2 for sign in (-1, 1))
    seen_top = seen.centre_m[:, 2] + seen.size_m[:, 2] / 2
    lacks = np.column_stack([extent - x[:, 5:7], seen_top - top])
    error = np.column_stack([
        seen.centre_m[:, :2] + seen_arm - x[:, :2] - arm, lacks, ground_m - foot,
        np.where(told, off_yaw, 0),
    ])  # fmt: skip
    H = np.zeros((len(x), 7, D))
    H[:, [0, 1, 2, 3, 4, 5, 6], [0, 1, 5, 6, 2, 2, YAW]] = 1
    H[:, :2, 5:7] = _axes(x[:, YAW]) * aspect[:, None, :] / 2
    H[:, :2, YAW] = np.where(told[:, None], _across(arm), 0)
    H[:, 4, 7], H[:, 5, 7] = 0.5, -0.5
    R = np.zeros((len(x), 7, 7))
    R[:, :2, :2] = seen.cov_m2
    sure = np.column_stack([shown, ~assumed[:, 2]])
    hidden = np.where(sure, np.minimum(lacks, 0), OPEN_SIGMA)
    R[:, [2, 3, 4], [2, 3, 4]] = config.extent_sigma_m**2 + hidden**2
    R[:, 5, 5] = FOOT_SIGMA_M**2
    R[:, 6, 6] = np.where(told, config.yaw_sigma_rad, OPEN_SIGMA) ** 2
    return Measured(error, H, R)


def was_assumed(size_m: Array) -> NDArray[np.bool_]:
    """(N, 3) bool: which lengths, widths and heights of cuboids were not seen: they are exactly the
    usual ones, to which `cuboid_fit` completes what it sees."""
    usual = np.array([CAR_M, PERSON_M])
    return np.asarray(np.isclose(size_m[:, None], usual, rtol=0, atol=1e-6).any(1))


def by_sighting(belief: Belief, seen: Sightings, camera_m: Array) -> Measured:
    """A sighting (T,) for each state, of a camera at camera_m (3,) in the node's axes."""
    x = belief.x
    arm = x[:, :2] - camera_m[:2]
    far = np.linalg.norm(arm, axis=-1)[:, None]
    along = arm / far
    across = _across(along)
    turn = x[:, YAW] - np.arctan2(along[:, 1], along[:, 0])
    c, s = np.cos(turn), np.sin(turn)
    depth = (np.abs(c) * x[:, 5] + np.abs(s) * x[:, 6])[:, None]
    by_turn = (-np.sign(c) * s * x[:, 5] + np.sign(s) * c * x[:, 6])[:, None]
    half = seen.share[:, None] / 2
    # The point is p - half depth along: moved across, the line of sight turns by 1 / far.
    H = np.zeros((len(x), 2, D))
    moved = half * (across * depth - along * by_turn) / far
    H[:, :, :2] = np.eye(2) - moved[:, :, None] * across[:, None, :]
    H[:, :, 5], H[:, :, 6] = -half * along * np.abs([c, s])[..., None]
    H[:, :, YAW] = -half * along * by_turn
    return Measured(seen.p_node_m - (x[:, :2] - half * along * depth), H, seen.cov_m2)


def by_box(
    belief: Belief, box_px: Array, camera: Camera, ground_m: float, place: PlaceConfig
) -> Measured:
    """A box (T, 4) for each state, whole in the image of a calibrated camera: its edges are the
    outermost corners of the cuboid, and its foot is on the ground. Differentiated numerically, for
    the lens may distort."""
    x = belief.x
    steps = np.concatenate([np.zeros((1, D)), STEP * np.eye(D), -STEP * np.eye(D)])
    edges = outline(camera, (x[:, None] + steps).reshape(-1, D)).reshape(len(x), -1, 4)
    H = np.zeros((len(x), 5, D))
    H[:, :4] = (edges[:, 1 : D + 1] - edges[:, D + 1 :]).swapaxes(1, 2) / (2 * STEP)
    H[:, 4, 2], H[:, 4, 7] = 1, -0.5
    error = np.column_stack([box_px - edges[:, 0], ground_m - x[:, 2] + x[:, 7] / 2])
    size_px = np.tile(box_px[:, 2:] - box_px[:, :2], 2)
    edge_px = np.hypot(place.sigma_px, place.sigma_share * size_px)
    sigma = np.column_stack([edge_px, np.full(len(x), FOOT_SIGMA_M)])
    return Measured(error, H, sigma[:, :, None] ** 2 * np.eye(5))


def outline(camera: Camera, x: Array) -> Array:
    """Edges (T, 4) of the boxes around the cuboids of states (T, 9) in an image, which they may
    exceed; NaN where a corner lies behind the camera."""
    corners_m = upright_corners(*Belief(x, np.empty(0)).cuboids)
    pixels = camera.project(corners_m.reshape(-1, 3)).reshape(-1, 8, 2)
    return np.concatenate([pixels.min(1), pixels.max(1)], 1)


def by_kind(belief: Belief, kind: NDArray[np.int64]) -> Measured:
    """The size of its kind, for each state."""
    size, sigma = kind_size_m(kind)
    H = np.zeros((len(kind), 3, D))
    H[:, range(3), range(5, 8)] = 1
    return Measured(size - belief.x[:, S_], H, sigma[:, :, None] ** 2 * np.eye(3))


def along_course(belief: Belief, kind: NDArray[np.int64], config: TrackConfig) -> Belief:
    """Fast vehicles drive along their length; one that seems to drive sideways has its length and
    width exchanged first, which is the same cuboid."""
    vx, vy = belief.x[:, V_].T
    speed = np.hypot(vx, vy)
    sigma = np.sqrt(np.trace(belief.P[:, V_, V_], axis1=1, axis2=2))
    fast = (speed > config.course_from_mps) & (sigma < SURE_SHARE * speed) & (kind == VEHICLE)
    if not fast.any():
        return belief
    rows = np.flatnonzero(fast)
    course = np.arctan2(vy, vx)[rows]
    some = belief.at(rows)
    sideways = np.abs(_wrapped(course - some.x[:, YAW])) > np.pi / 4
    some = _quarter_turn(some, np.flatnonzero(sideways))
    speed2 = (some.x[:, V_] ** 2).sum(-1)
    H = np.zeros((len(rows), 1, D))
    H[:, 0, 3], H[:, 0, 4] = some.x[:, 4] / speed2, -some.x[:, 3] / speed2
    H[:, 0, YAW] = 1
    error = _wrapped(course - some.x[:, YAW])[:, None]
    R = np.full((len(rows), 1, 1), config.course_sigma_rad**2)
    some = update(some, Measured(error, H, R))
    x, P = belief.x.copy(), belief.P.copy()
    x[rows], P[rows] = some
    return Belief(x, P)


def born_of_cuboids(seen: Cuboids, ground_m: float, config: TrackConfig) -> Belief:
    """States of cuboids (N,) that no track explains; what may be hidden of them is left open."""
    n = len(seen)
    x, P = np.zeros((n, D)), np.zeros((n, D, D))
    top = seen.centre_m[:, 2] + seen.size_m[:, 2] / 2
    height = np.maximum(top - ground_m, LEAST_SIZE_M)
    x[:, :2], x[:, 2] = seen.centre_m[:, :2], ground_m + height / 2
    x[:, 5:7], x[:, 7], x[:, YAW] = seen.size_m[:, :2], height, seen.yaw_rad
    x[:, S_] = np.maximum(x[:, S_], LEAST_SIZE_M)
    P[:, :2, :2] = seen.cov_m2
    sigma_yaw = np.where(was_assumed(seen.size_m)[:, 0], np.pi / 4, 2 * config.yaw_sigma_rad)
    P[:, range(2, D), range(2, D)] = np.square(_birth_sigmas(config))
    P[:, YAW, YAW] = sigma_yaw**2
    return Belief(x, P)


def born_of_sightings(
    seen: Sightings, kind: NDArray[np.int64], camera_m: Array, ground_m: float, config: TrackConfig
) -> Belief:
    """States of sightings (N,) that no track explains, with the size of their kind; the width of a
    box tells how they are turned, but not to which side."""
    n = len(seen.p_node_m)
    size, sigma = kind_size_m(kind)
    arm = seen.p_node_m - camera_m[:2]
    along = arm / np.linalg.norm(arm, axis=-1, keepdims=True)
    depth, turn = depth_m(seen.width_m, size)
    shift = seen.share[:, None] * along / 2
    x, P = np.zeros((n, D)), np.zeros((n, D, D))
    x[:, :2] = seen.p_node_m + shift * depth[:, None]
    x[:, 2], x[:, S_] = ground_m + size[:, 2] / 2, size
    x[:, YAW] = np.arctan2(along[:, 1], along[:, 0]) + turn
    P[:, range(2, D), range(2, D)] = np.square(_birth_sigmas(config))
    P[:, range(5, 8), range(5, 8)] = sigma**2
    P[:, YAW, YAW] = (np.pi / 4) ** 2
    spread = shift * (size[:, 0] - size[:, 1])[:, None] / 2
    P[:, :2, :2] = seen.cov_m2 + spread[:, :, None] * spread[:, None, :]
    return Belief(x, P)


def _birth_sigmas(config: TrackConfig) -> list[float]:
    """From the height of the centre on: velocity, size and yaw."""
    return [0.3, *[config.birth_speed_mps] * 2, 1.5, 0.7, 0.3, np.pi / 4]


def _axes(yaw: Array) -> Array:
    """(T, 2, 2) whose columns are ahead and left of the length."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s], [s, c]]).transpose(2, 0, 1)


def _near_arm(p_m: Array, size: Array, yaw: Array, sensor_m: Array) -> tuple[Array, Array]:
    """From the centres (T, 2) of rectangles to the corner that faces the sensor (T, 2), and which
    end and side that is (T, 2): 1 ahead or left, -1 rear or right; less, towards the middle, where
    a side is seen so aslant that both its ends show."""
    arm = sensor_m[:2] - p_m
    toward = arm / np.linalg.norm(arm, axis=-1, keepdims=True)
    facing = (toward[:, None, :] @ _axes(yaw))[:, 0]
    aspect = np.asarray(np.clip(facing / SIDE_SHARE, -1, 1))
    return _turned(aspect * size / 2, yaw), aspect


def _turned(local: Array, yaw: Array) -> Array:
    """(T, 2) vectors along the length and the width, along the node's axes."""
    return np.asarray((_axes(yaw) @ local[..., None])[..., 0])


def _across(v: Array) -> Array:
    """(T, 2) vectors turned to the left: by how much they move when their yaw grows."""
    return np.stack([-v[:, 1], v[:, 0]], -1)


def _wrapped(angle: Array) -> Array:
    """Angles modulo pi, in [-pi/2, pi/2)."""
    return np.asarray((angle + np.pi / 2) % np.pi - np.pi / 2)


def _quarter(angle: Array) -> Array:
    """Angles modulo pi/2, in [-pi/4, pi/4): a cuboid may call its width a length."""
    return np.asarray((angle + np.pi / 4) % (np.pi / 2) - np.pi / 4)


def _quarter_turn(belief: Belief, rows: NDArray[np.int64]) -> Belief:
    """The same cuboids with the yaw of what was their width."""
    if not len(rows):
        return belief
    order = [0, 1, 2, 3, 4, 6, 5, 7, 8]
    x, P = belief.x.copy(), belief.P.copy()
    x[rows] = x[rows][:, order]
    x[rows, YAW] += np.pi / 2
    P[rows] = P[rows][:, order][:, :, order]
    return Belief(x, P)
