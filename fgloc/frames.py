"""Frames and rotations.

World: local East-North-Up in metres about an `Origin` on WGS84. Vehicle (veh): x forward, y left,
z up (REP 103), origin at the rear axle on the ground unless the drive says otherwise.
`T_target_source` maps source coordinates into target. Rotation vectors are in rad; quaternions
are (x, y, z, w). Functions take one item or any stack of them in the leading axes.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pymap3d
from numpy.typing import ArrayLike, NDArray

from fgloc.arrays import Array
from fgloc.errors import InputError

Datum = Literal["ellipsoid", "msl"]

R_FLU_FRD = np.diag([1.0, -1.0, -1.0])
"""Forward-right-down to forward-left-up, and its own inverse."""

R_ENU_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""North-east-down to east-north-up, and its own inverse."""

LATITUDE_LIMITS_DEG = (-90, 90)
LONGITUDE_LIMITS_DEG = (-180, 360)
HEIGHT_LIMITS_M = (-12_000, 100_000)
"""Places outside these are not on or near the Earth: a unit or an order of columns is wrong."""

_SMALL_RAD = 1e-5
_WGS84_A_M = 6_378_137.0
_WGS84_F = 1 / 298.257223563


@dataclass(frozen=True)
class Origin:
    """Where the world frame touches the Earth: WGS84 degrees, height in m above `datum`."""

    lat_deg: float
    lon_deg: float
    height_m: float
    datum: Datum = "ellipsoid"

    def __post_init__(self) -> None:
        check_geodetic(self.lat_deg, self.lon_deg, self.height_m)

    def to_world(self, lat_deg: ArrayLike, lon_deg: ArrayLike, height_m: ArrayLike) -> Array:
        """Geodetic arrays of shape (...) to ENU metres (..., 3)."""
        enu = pymap3d.geodetic2enu(
            np.asarray(lat_deg, float), np.asarray(lon_deg, float), np.asarray(height_m, float),
            self.lat_deg, self.lon_deg, self.height_m,
        )  # fmt: skip
        return np.stack(enu, axis=-1)

    def to_geodetic(self, p_world_m: ArrayLike) -> Array:
        """ENU metres (..., 3) to (..., 3) of latitude deg, longitude deg, height m."""
        east, north, up = np.moveaxis(np.asarray(p_world_m, float), -1, 0)
        return np.stack(
            pymap3d.enu2geodetic(east, north, up, self.lat_deg, self.lon_deg, self.height_m),
            axis=-1,
        )

    def ecef_to_world(self, p_ecef_m: ArrayLike) -> Array:
        """Earth-centred metres (..., 3) to ENU metres (..., 3)."""
        x, y, z = np.moveaxis(np.asarray(p_ecef_m, float), -1, 0)
        enu = pymap3d.ecef2enu(x, y, z, self.lat_deg, self.lon_deg, self.height_m)
        return np.stack(enu, axis=-1)

    def world_to_ecef(self, p_world_m: ArrayLike) -> Array:
        """ENU metres (..., 3) to Earth-centred metres (..., 3)."""
        east, north, up = np.moveaxis(np.asarray(p_world_m, float), -1, 0)
        ecef = pymap3d.enu2ecef(east, north, up, self.lat_deg, self.lon_deg, self.height_m)
        return np.stack(ecef, axis=-1)

    def gravity_mps2(self) -> float:
        """Normal gravity at the origin: Somigliana's formula with the free-air term (WGS84)."""
        sin2 = np.sin(np.deg2rad(self.lat_deg)) ** 2
        surface = (
            9.7803253359 * (1 + 0.00193185265241 * sin2) / np.sqrt(1 - 0.00669437999013 * sin2)
        )
        return float(surface - 3.086e-6 * self.height_m)


def check_geodetic(lat_deg: float, lon_deg: float, height_m: float) -> None:
    """Raise InputError where the values cannot be a place on or near the Earth."""
    for what, value, (low, high), hint in (
        ("latitude {} deg", lat_deg, LATITUDE_LIMITS_DEG, "; is it swapped with longitude?"),
        ("longitude {} deg", lon_deg, LONGITUDE_LIMITS_DEG, ""),
        ("height {} m", height_m, HEIGHT_LIMITS_M, "; is it in mm or cm?"),
    ):
        if not low <= value <= high:
            raise InputError(f"{what.format(value)} is outside [{low}, {high}]{hint}")


def utm_zone(lat_deg: float, lon_deg: float) -> int:
    """Number of the UTM zone (1-60), with the exceptions of Norway and Svalbard."""
    if 56 <= lat_deg < 64 and 3 <= lon_deg < 12:
        return 32
    if 72 <= lat_deg <= 84 and 0 <= lon_deg < 42:
        return 31 + 2 * int(np.searchsorted([9, 21, 33], lon_deg, side="right"))
    return int((lon_deg + 180) % 360 // 6) + 1


def geodetic_to_utm(lat_deg: ArrayLike, lon_deg: ArrayLike, zone: int) -> Array:
    """UTM easting and northing in m, (..., 2), in the given zone on WGS84.

    Krüger's series to third order in n (Karney 2011, eqs. 7-9 and 35): under 0.1 mm within
    the zone. Southern latitudes carry the false northing of 10,000 km.
    """
    lat = np.deg2rad(np.asarray(lat_deg, float))
    lon = np.deg2rad(np.asarray(lon_deg, float) - (6 * zone - 183))
    radius_m, alpha, _ = _krueger()
    e = np.sqrt(_WGS84_F * (2 - _WGS84_F))
    tau = np.sinh(np.arctanh(np.sin(lat)) - e * np.arctanh(e * np.sin(lat)))
    xi = np.arctan2(tau, np.cos(lon))
    eta = np.arcsinh(np.sin(lon) / np.hypot(tau, np.cos(lon)))
    j = 2 * np.arange(1, 4)
    phase, growth = xi[..., None] * j, eta[..., None] * j
    east = eta + (alpha * np.cos(phase) * np.sinh(growth)).sum(-1)
    north = xi + (alpha * np.sin(phase) * np.cosh(growth)).sum(-1)
    false_north = np.where(np.asarray(lat_deg) < 0, 1e7, 0.0)  # in rad, -5e-324 deg is -0
    return np.stack([500_000 + 0.9996 * radius_m * east,
                     false_north + 0.9996 * radius_m * north], axis=-1)  # fmt: skip


def utm_to_geodetic(easting_northing_m: ArrayLike, zone: int, *, north: bool = True) -> Array:
    """Inverse of `geodetic_to_utm`: (..., 2) in m to (..., 2) of latitude and longitude in deg."""
    easting, northing = np.moveaxis(np.asarray(easting_northing_m, float), -1, 0)
    radius_m, _, beta = _krueger()
    xi = (northing - (0.0 if north else 1e7)) / (0.9996 * radius_m)
    eta = (easting - 500_000) / (0.9996 * radius_m)
    j = 2 * np.arange(1, 4)
    phase, growth = xi[..., None] * j, eta[..., None] * j
    xi = xi - (beta * np.sin(phase) * np.cosh(growth)).sum(-1)
    eta = eta - (beta * np.cos(phase) * np.sinh(growth)).sum(-1)
    chi = np.arcsin(np.sin(xi) / np.cosh(eta))
    n = _WGS84_F / (2 - _WGS84_F)
    delta = np.array([2 * n - 2 / 3 * n**2 - 2 * n**3, 7 / 3 * n**2 - 8 / 5 * n**3, 56 / 15 * n**3])
    lat = chi + (delta * np.sin(chi[..., None] * j)).sum(-1)
    lon = np.arctan2(np.sinh(eta), np.cos(xi))
    return np.stack([np.rad2deg(lat), np.rad2deg(lon) + 6 * zone - 183], axis=-1)


def _krueger() -> tuple[float, Array, Array]:
    """Rectifying radius in m and the forward and inverse coefficients, third order in n."""
    n = _WGS84_F / (2 - _WGS84_F)
    radius_m = _WGS84_A_M / (1 + n) * (1 + n**2 / 4 + n**4 / 64)
    alpha = np.array([n / 2 - 2 / 3 * n**2 + 5 / 16 * n**3, 13 / 48 * n**2 - 3 / 5 * n**3,
                      61 / 240 * n**3])  # fmt: skip
    beta = np.array([n / 2 - 2 / 3 * n**2 + 37 / 96 * n**3, n**2 / 48 + n**3 / 15,
                     17 / 480 * n**3])  # fmt: skip
    return radius_m, alpha, beta


def is_rotation(R: ArrayLike, tolerance: float) -> NDArray[np.bool_]:
    """(...) bool: which of finite (..., 3, 3) turn and do not mirror; R R^T is I to `tolerance`."""
    x, y, z = np.moveaxis(np.asarray(R, float), -2, 0)  # its rows
    products = ((x, x, 1), (y, y, 1), (z, z, 1), (x, y, 0), (x, z, 0), (y, z, 0))
    orthonormal = [np.abs(_dot(a, b) - wanted) <= tolerance for a, b, wanted in products]
    return np.asarray(np.logical_and.reduce(orthonormal) & (_dot(np.cross(x, y), z) > 0))


def _dot(a: Array, b: Array) -> Array:
    """Inner products (...) of vectors (..., 3)."""
    return np.asarray(np.einsum("...i,...i->...", a, b))


def skew(vector: ArrayLike) -> Array:
    """(..., 3) to (..., 3, 3) with skew(a) @ b = a x b."""
    v = np.asarray(vector, float)
    W = np.zeros((*v.shape, 3))
    W[..., 2, 1], W[..., 0, 2], W[..., 1, 0] = v[..., 0], v[..., 1], v[..., 2]
    W[..., 1, 2], W[..., 2, 0], W[..., 0, 1] = -v[..., 0], -v[..., 1], -v[..., 2]
    return W


def exp_so3(rotvec_rad: ArrayLike) -> Array:
    """Rotation vectors (..., 3) to matrices (..., 3, 3): Rodrigues' formula."""
    vector = np.asarray(rotvec_rad, float)
    square = (vector * vector).sum(-1)
    small = square < _SMALL_RAD**2
    angle = np.sqrt(np.where(small, 1.0, square))
    a = np.where(small, 1 - square / 6, np.sin(angle) / angle)
    b = np.where(small, 0.5 - square / 24, (1 - np.cos(angle)) / angle**2)
    return _in_skew(vector, square, a, b)


def log_so3(R: ArrayLike) -> Array:
    """Matrices (..., 3, 3) to rotation vectors (..., 3) of angle at most pi."""
    R = np.asarray(R, float)
    trace = R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2]
    if not (trace > 0).all():  # some turn by more than 120 degrees
        return _log_of_any(R)
    sine_axis = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0],
                          R[..., 1, 0] - R[..., 0, 1]], -1) / 2  # fmt: skip
    sine = np.sqrt((sine_axis * sine_axis).sum(-1))
    small = sine < _SMALL_RAD
    angle = np.arctan2(sine, (trace - 1) / 2)
    return sine_axis * np.where(small, 1.0, angle / np.where(small, 1.0, sine))[..., None]


def _log_of_any(R: Array) -> Array:
    """The same where the sine of the angle may be near 0 and the angle near pi."""
    q = matrix_to_quat_xyzw(R)
    q = np.where(q[..., 3:] < 0, -q, q)
    sine = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, q[..., 3:])
    small = sine < _SMALL_RAD
    return q[..., :3] * np.where(small, 2.0, angle / np.where(small, 1.0, sine))


def pose_cov_to_world(R_world_veh: Array, cov: Array) -> Array:
    """(N, 6, 6) of (rotation, translation) in the vehicle frame to (position, rotation) in ENU."""
    turn = np.zeros((len(R_world_veh), 6, 6))
    turn[:, :3, 3:] = R_world_veh
    turn[:, 3:, :3] = R_world_veh
    return turn @ cov @ turn.swapaxes(-1, -2)


def right_jacobian_so3(rotvec_rad: ArrayLike) -> Array:
    """Jr with Exp(w + d) = Exp(w) Exp(Jr(w) d) to first order, (..., 3) to (..., 3, 3)."""
    vector = np.asarray(rotvec_rad, float)
    square = (vector * vector).sum(-1)
    small = square < 1e-6
    angle = np.sqrt(np.where(small, 1.0, square))
    a = np.where(small, 0.5 - square / 24, (1 - np.cos(angle)) / angle**2)
    b = np.where(small, 1 / 6 - square / 120, (angle - np.sin(angle)) / angle**3)
    return _in_skew(vector, square, -a, b)


def right_jacobian_inverse_so3(rotvec_rad: ArrayLike) -> Array:
    """Inverse of `right_jacobian_so3`: Log(Exp(w) Exp(d)) = w + Jr^-1(w) d to first order."""
    vector = np.asarray(rotvec_rad, float)
    square = (vector * vector).sum(-1)
    small = square < 1e-2
    angle = np.sqrt(np.where(small, 1.0, square))
    b = np.where(
        small, 1 / 12 + square * (1 / 720 + square * (1 / 30240 + square / 1209600)),
        (1 - angle / 2 / np.tan(angle / 2)) / angle**2,
    )  # fmt: skip
    return _in_skew(vector, square, np.full_like(square, 0.5), b)


def _in_skew(vector: Array, square: Array, a: Array, b: Array) -> Array:
    """I + a W + b W^2 of W = skew(vector), which has W^2 = w w' - |w|^2 I.

    Entry by entry: numpy's loops over axes of three take three times longer.
    """
    w = np.moveaxis(vector, -1, 0)
    (x, y, z), (ax, ay, az), (bx, by, bz), diagonal = w, a * w, b * w, 1 - b * square
    entries = (
        (bx * x + diagonal, bx * y - az, bx * z + ay),
        (bx * y + az, by * y + diagonal, by * z - ax),
        (bx * z - ay, by * z + ax, bz * z + diagonal),
    )
    result = np.empty((*vector.shape, 3))
    for i, row in enumerate(entries):
        for j, entry in enumerate(row):
            result[..., i, j] = entry
    return result


def matrix_to_quat_xyzw(R: ArrayLike) -> Array:
    """Matrices (..., 3, 3) to unit quaternions (..., 4) in (x, y, z, w), by Shepperd's method."""
    R = np.asarray(R, float)
    trace = np.trace(R, axis1=-2, axis2=-1)
    diagonal = np.diagonal(R, axis1=-2, axis2=-1)
    squares = np.concatenate([1 + 2 * diagonal - trace[..., None], 1 + trace[..., None]], axis=-1)
    x, y, z, w = (np.sqrt(np.maximum(squares[..., i], 0)) for i in range(4))
    a = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0],
                  R[..., 1, 0] - R[..., 0, 1]], -1)  # fmt: skip
    s = np.stack([R[..., 2, 1] + R[..., 1, 2], R[..., 0, 2] + R[..., 2, 0],
                  R[..., 1, 0] + R[..., 0, 1]], -1)  # fmt: skip
    rows = np.stack(
        [
            np.stack([x * x, s[..., 2], s[..., 1], a[..., 0]], -1),
            np.stack([s[..., 2], y * y, s[..., 0], a[..., 1]], -1),
            np.stack([s[..., 1], s[..., 0], z * z, a[..., 2]], -1),
            np.stack([a[..., 0], a[..., 1], a[..., 2], w * w], -1),
        ],
        axis=-2,
    )
    largest = np.argmax(squares, axis=-1)[..., None, None]
    q = np.take_along_axis(rows, largest, axis=-2)[..., 0, :]
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def quat_to_matrix(q_xyzw: ArrayLike) -> Array:
    """Quaternions (..., 4) in (x, y, z, w), of any length but zero, to matrices (..., 3, 3)."""
    q = np.asarray(q_xyzw, float)
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    W = skew(q[..., :3])
    return np.eye(3) + 2 * q[..., 3, None, None] * W + 2 * (W @ W)


def yaw_of(R_world_veh: ArrayLike) -> Array:
    """Yaw in rad, counter-clockwise from East, of matrices (..., 3, 3)."""
    R = np.asarray(R_world_veh, float)
    return np.arctan2(R[..., 1, 0], R[..., 0, 0])


def yaw_matrix(yaw_rad: ArrayLike) -> Array:
    """Level attitudes (..., 3, 3) of yaws (...) in rad, counter-clockwise from East."""
    yaw = np.asarray(yaw_rad, float)
    return exp_so3(np.stack([np.zeros_like(yaw), np.zeros_like(yaw), yaw], -1))


def wrap_pi(angle_rad: ArrayLike) -> Array:
    """Angles brought into [-pi, pi)."""
    return (np.asarray(angle_rad, float) + np.pi) % (2 * np.pi) - np.pi
