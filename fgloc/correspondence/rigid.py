"""Rigid motions of the plane, their least-squares fit, and what a matching gives back."""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from fgloc.errors import InputError
from fgloc.measurements import Array

Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Rigid:
    """p_world = R(yaw) p_veh + t: the car's heading in rad and its position (2,) in m."""

    yaw_rad: float
    t_m: Array

    def apply(self, p_veh_m: Array) -> Array:
        """Points (N, 2) of the car's axes in world axes."""
        return p_veh_m @ rotation(self.yaw_rad).T + self.t_m

    def after(self, first: "Rigid") -> "Rigid":
        """The motion that does `first` and then this one."""
        return Rigid(wrapped(self.yaw_rad + first.yaw_rad), self.apply(first.t_m[None])[0])


IDENTITY = Rigid(0.0, np.zeros(2))
"""The first guess of Khamooshi (2023) where there is no last step."""


class Status(StrEnum):
    """What a matching can say."""

    MATCHED = "matched"
    AMBIGUOUS = "ambiguous"
    NONE = "none"


@dataclass(frozen=True, eq=False)
class Correspondence:
    """What was found: the car's pose, who is who, and how sure.

    pose         of the car in the world; of little worth where the status is not `MATCHED`
    pairs        (K, 2) index among the car's points, index among the node's: what is claimed
    likely       (L, 2) further pairs, more likely right than not, that are not claimed
    probability  (K + L,) that each pair is right, of `pairs` and then of `likely`; NaN where the
                 method has none
    iterations   of the method, or hypotheses that were looked at
    """

    status: Status
    pose: Rigid
    pairs: Index
    likely: Index
    probability: Array
    iterations: int


def check_points(name: str, points_m: Array) -> Array:
    """Points as (N, 2) floats; InputError where the shape is another or a number is not finite."""
    points = np.asarray(points_m, float)
    if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
        raise InputError(f"{name}: expected finite points of shape (N, 2), not {points.shape}")
    return points


def rotation(yaw_rad: float) -> Array:
    """(2, 2), counter-clockwise."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[c, -s], [s, c]])


def wrapped(angle_rad: float) -> float:
    """The same angle from -pi to pi."""
    return math.remainder(angle_rad, 2 * math.pi)


def fit(p_veh_m: Array, p_world_m: Array, weight: Array | None = None) -> Rigid:
    """The rigid motion that carries points (N, 2) closest to others (N, 2).

    In the plane the rotation U C V' of the singular value decomposition, with its determinant kept
    at 1, is the angle of a sum of products: the same optimum without the decomposition.
    """
    w = np.ones(len(p_veh_m)) if weight is None else weight
    total = max(float(w.sum()), 1e-300)
    mean_veh, mean_world = w @ p_veh_m / total, w @ p_world_m / total
    a, b = p_veh_m - mean_veh, p_world_m - mean_world
    along = float(w @ (a * b).sum(-1))
    across = float(w @ (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    yaw = math.atan2(across, along)
    return Rigid(yaw, mean_world - rotation(yaw) @ mean_veh)


def mutual_nearest(cost: Array) -> Index:
    """(K, 2) row and column of each entry that is the least of both its row and its column."""
    if cost.size == 0:
        return np.empty((0, 2), np.int64)
    column = cost.argmin(1)
    rows = np.flatnonzero(cost.argmin(0)[column] == np.arange(len(cost)))
    return np.stack([rows, column[rows]], -1)


def squared_distances(a_m: Array, b_m: Array) -> Array:
    """(N, M) of all points (N, 2) to all points (M, 2), m^2."""
    d = a_m[:, None] - b_m[None]
    return np.einsum("nmi,nmi->nm", d, d)


def plain(pose: Rigid, pairs: Index, iterations: int) -> Correspondence:
    """The answer of a method that knows no probabilities."""
    status = Status.MATCHED if len(pairs) else Status.NONE
    none = np.empty((0, 2), np.int64)
    return Correspondence(status, pose, pairs, none, np.full(len(pairs), np.nan), iterations)
