"""An upright cuboid around a cluster of points, and how well its centre is known.

Khamooshi (2023), section 3.2: "The clustered points are then used for a cuboid fitting. The center
of the fitted cube is assumed to be the center of the vehicle"; how is not told. Here the yaw is
searched over a quarter turn: of those whose rectangle around the points has nearly the shortest
perimeter, the one under which points lie closest to its edges (the closeness criterion of Zhang et
al., "Efficient L-shape fitting for vehicle detection using laser scanners", IV 2017). Closeness
alone is led astray by the arcs that beams draw on a far roof, the perimeter alone is blunt.

A LiDAR sees near faces only, and the rest of a roof where a beam happens to meet it. So a cuboid
that is smaller than a usual car or person is made as large, away from the sensor: its near faces
stay. Where no side tells length from width, the length lies along the line of sight.

Uncertainty from the number of points, as section 3.4.2 suggests it ("the accuracy can be assumed to
be dependent on the number of Lidar points located on the objects"): with n points

    sigma_along^2  = ALONG_M[0]^2  + ALONG_M[1]^2 / n
    sigma_across^2 = ACROSS_M[0]^2 + ACROSS_M[1]^2 / n

along and across the line of sight in plan. n falls with the square of the distance, so the second
terms are Khamooshi's (3.16) where they rule. The constants were fitted to seeds 0 to 7 of the
plain simulated street and to single cars and persons under any yaw;
`tests/benchmarks/perception_lidar.py` holds them against other seeds.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgloc.factors.detection import line_of_sight_cov_m2
from fgloc.measurements import Array

Law = tuple[float, float]

CAR_M = (4.6, 1.85, 1.5)
PERSON_M = (0.5, 0.6, 1.75)
"""Length, width and height of what a LiDAR mostly sees."""
SIDE_M = 2.5
"""What is longer has shown its length."""
YAW_STEP_RAD = np.deg2rad(1.0)
CLOSENESS_M = 0.06
"""Points nearer to an edge than this lie on it: two sigmas of a range."""
PERIMETER_SHARE = 1.05
"""Of the shortest perimeter, up to which a yaw is considered."""
MOST_POINTS = 150
"""That are searched for the yaw, evenly chosen; the rectangle is around all."""

ALONG_M, ACROSS_M = (0.05, 0.65), (0.04, 0.6)
PERSON_ALONG_M, PERSON_ACROSS_M = (0.05, 0.1), (0.03, 0.15)


@dataclass(frozen=True, eq=False)
class Fit:
    """A cuboid: centre (3,), length, width and height (3,), yaw, in the axes of its points; whether
    its shape is a person's, and how much was added to what its points show, across the line of
    sight."""

    centre_m: Array
    size_m: Array
    yaw_rad: float
    person: bool
    aside_m: float


def fit_cuboid(points_m: Array, sensor_m: Array, ground_m: float, person_m: float) -> Fit:
    """The cuboid of a cluster of points (N, 3), N from 1, on the ground.

    sensor_m  (3,) place of the sensor in the same axes
    ground_m  z of the ground
    person_m  a cluster that is nowhere longer is a person
    """
    plan_m = points_m[:, :2]
    top_m = float(points_m[:, 2].max()) - ground_m
    yaw_rad = best_yaw(plan_m)
    low, high = _limits(plan_m, yaw_rad)
    person = float((high - low).max()) <= person_m
    usual_m = PERSON_M if person else CAR_M
    eye = sensor_m[:2] @ _axes(yaw_rad)
    if _length_is_second(low, high, eye):
        yaw_rad += np.pi / 2
        low, high = _limits(plan_m, yaw_rad)
        eye = sensor_m[:2] @ _axes(yaw_rad)
    shown = high - low
    low, high = _extended(low, high, eye, np.array(usual_m[:2]))
    sight = (low + high) / 2 - eye
    aside_m = float((high - low - shown) @ np.abs(sight[::-1]) / np.linalg.norm(sight))
    height_m = max(top_m, usual_m[2])
    middle = _axes(yaw_rad) @ (low + high) / 2
    centre_m = np.array([*middle, ground_m + height_m / 2])
    yaw_rad = (yaw_rad + np.pi / 2) % np.pi - np.pi / 2
    return Fit(centre_m, np.array([*(high - low), height_m]), yaw_rad, person, aside_m)


def best_yaw(plan_m: Array) -> float:
    """The yaw from 0 to pi/2 of the rectangle that fits points (N, 2) best."""
    some = plan_m[:: -(-len(plan_m) // MOST_POINTS)]
    yaws = np.arange(0.0, np.pi / 2, YAW_STEP_RAD)
    turned = _axes(yaws).swapaxes(1, 2) @ some.T
    low, high = turned.min(-1, keepdims=True), turned.max(-1, keepdims=True)
    away = np.minimum(turned - low, high - turned).min(1)
    closeness = (1 / np.maximum(away, CLOSENESS_M)).sum(-1)
    perimeter = (high - low).sum((1, 2))
    closeness[perimeter > PERIMETER_SHARE * perimeter.min()] = 0.0
    return float(yaws[np.argmax(closeness)])


def _axes(yaw_rad: ArrayLike) -> Array:
    """(..., 2, 2) with the directions along and across yaws (...) as columns."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)


def _limits(plan_m: Array, yaw_rad: float) -> tuple[Array, Array]:
    turned = plan_m @ _axes(yaw_rad)
    return turned.min(0), turned.max(0)


def _length_is_second(low: Array, high: Array, eye: Array) -> bool:
    """Whether the length lies across the yaw: the longer side where one shows it, else the one
    along the line of sight."""
    extent = high - low
    if extent.max() > SIDE_M:
        return bool(extent[1] > extent[0])
    sight = np.abs((low + high) / 2 - eye)
    return bool(sight[1] > sight[0])


def _extended(low: Array, high: Array, eye: Array, least: Array) -> tuple[Array, Array]:
    """Limits at least so far apart: the nearer to the eye stays, both move where it is between."""
    missing = np.maximum(least - (high - low), 0.0)
    lower_share = np.select([eye < low, eye > high], [0.0, 1.0], 0.5)
    return low - lower_share * missing, high + (1 - lower_share) * missing


def centre_cov_m2(
    centre_m: Array, sensor_m: Array, points: NDArray[np.int64], person: NDArray[np.bool_]
) -> Array:
    """(N, 2, 2) covariance of centres in plan, by the law above.

    centre_m  (N, 3), sensor_m (3,)
    points    (N,) on each object
    person    (N,) bool: which are persons
    """

    def sigma_m(car: Law, of_person: Law) -> Array:
        base, each = np.where(person, np.reshape(of_person, (2, 1)), np.reshape(car, (2, 1)))
        return np.asarray(np.sqrt(base**2 + each**2 / points))

    return line_of_sight_cov_m2(
        (centre_m - sensor_m)[:, :2], sigma_m(ALONG_M, PERSON_ALONG_M),
        sigma_m(ACROSS_M, PERSON_ACROSS_M),
    )  # fmt: skip
