"""Several objects in one Kalman filter: [x, y, vx, vy] of each, constant velocity.

Khamooshi (2023), section 4.4, (4.9) to (4.17). All filters of section 4 predict with this model and
take sightings as information, y = H' R^-1 z and S = H' R^-1 H.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc.correspondence.epochs import Epoch
from fgloc.correspondence.rigid import rotation
from fgloc.measurements import Array

ACCEL_DENSITY = 3.0
"""Root of the spectral density of the white noise on acceleration, m/s^2 per sqrt(Hz); not printed.
The scenarios accelerate by up to 10 m/s^2."""
FIRST_SIGMA_M, FIRST_SIGMA_MPS = 1e3, 30.0
"""Of a track before its first sighting. Differs from the paper: P_0 = I needs a velocity that
nobody has measured."""


@dataclass(frozen=True, eq=False)
class Belief:
    """State (4K,), covariance (4K, 4K) and which of the K tracks were seen yet (K,)."""

    x: Array
    P: Array
    born: NDArray[np.bool_]

    @classmethod
    def unborn(cls, tracks: int) -> "Belief":
        """Of tracks that nobody has seen."""
        P = np.diag(np.tile([FIRST_SIGMA_M**2] * 2 + [FIRST_SIGMA_MPS**2] * 2, tracks))
        return cls(np.zeros(4 * tracks), P, np.zeros(tracks, bool))

    @property
    def index(self) -> NDArray[np.int64]:
        """Rows of the state of all born tracks."""
        return np.flatnonzero(np.repeat(self.born, 4))

    def predicted(self, dt_s: float) -> "Belief":
        """One step later; tracks that nobody has seen stay as they are."""
        F, Q = model(dt_s, len(self.born))
        unborn = np.repeat(~self.born, 4)
        F[unborn] = np.eye(len(F))[unborn]
        Q[unborn] = 0
        return Belief(F @ self.x, F @ self.P @ F.T + Q, self.born)

    def updated(self, information: "Information", pull: Array | None = None) -> "Belief":
        """With what was measured: M = (P^-1 + S)^-1, x + M (y - S x) + `pull`. Algorithm 4.3.

        Differs from the paper: it prints y for S in M.
        """
        born = self.born | information.seen
        rows = np.flatnonzero(np.repeat(born, 4))
        block = np.ix_(rows, rows)
        S, x, P = information.S[block], self.x[rows], self.P[block]
        M = np.linalg.solve(np.eye(len(rows)) + P @ S, P)
        M = (M + M.T) / 2
        x_all, P_all = self.x.copy(), self.P.copy()
        x_all[rows] = x + M @ (information.y[rows] - S @ x)
        if pull is not None:
            x_all += pull
        P_all[block] = M
        return Belief(x_all, P_all, born)


@dataclass(frozen=True, eq=False)
class Information:
    """y (4K,) and S (4K, 4K) of measurements, and which tracks they place in the world (K,)."""

    y: Array
    S: Array
    seen: NDArray[np.bool_]

    @classmethod
    def nothing(cls, tracks: int) -> "Information":
        """Of no measurement."""
        return cls(np.zeros(4 * tracks), np.zeros((4 * tracks,) * 2), np.zeros(tracks, bool))

    def __add__(self, other: "Information") -> "Information":
        """Of both. Eq. (4.15)."""
        return Information(self.y + other.y, self.S + other.S, self.seen | other.seen)


def model(dt_s: float, tracks: int) -> tuple[Array, Array]:
    """F and Q (4K, 4K): constant velocity, white noise on the acceleration, exact over a step."""
    f = np.eye(4)
    f[:2, 2:] = dt_s * np.eye(2)
    q = np.kron([[dt_s**3 / 3, dt_s**2 / 2], [dt_s**2 / 2, dt_s]], np.eye(2)) * ACCEL_DENSITY**2
    every = np.eye(tracks)
    return np.asarray(np.kron(every, f)), np.asarray(np.kron(every, q))


def of_node(epoch: Epoch, node: int, tracks: int) -> Information:
    """What one node sees: positions in the world. Eq. (4.10) to (4.12)."""
    found = Information.nothing(tracks)
    for i in np.flatnonzero(epoch.node == node):
        _place(found, int(epoch.track[i]), epoch.z_m[i], epoch.R_m2[i])
    return found


def of_car(epoch: Epoch, ego: int, tracks: int) -> Information:
    """What the car measures: its own place, and others relative to it. Eq. (4.13), (4.14).

    With it comes what other road users tell the car of their places.
    What it sees in its axes is turned by its heading, whose variance is added.
    """
    found = Information.nothing(tracks)
    if epoch.fix_m is not None and epoch.fix_R_m2 is not None:
        _place(found, ego, epoch.fix_m, epoch.fix_R_m2)
    for track, z, R_m2 in zip(epoch.told, epoch.told_m, epoch.told_R_m2, strict=True):
        _place(found, int(track), z, R_m2)
    if not math.isfinite(epoch.yaw_rad):
        return found
    R = rotation(epoch.yaw_rad)
    for track, z, cov in zip(epoch.seen, epoch.seen_m, epoch.seen_R_m2, strict=True):
        ray = R @ z
        turned = np.array([-ray[1], ray[0]])
        W = np.linalg.inv(R @ cov @ R.T + epoch.yaw_var * np.outer(turned, turned))
        H = np.zeros((2, 4 * tracks))
        H[:, 4 * ego : 4 * ego + 2] = -np.eye(2)
        H[:, 4 * track : 4 * track + 2] = np.eye(2)
        found.y[:] += H.T @ W @ ray
        found.S[:] += H.T @ W @ H
        found.seen[[track, ego]] = True  # the car too: without a place of its own it is anywhere
    return found


def _place(found: Information, track: int, z: Array, R: Array) -> None:
    W = np.linalg.inv(R)
    at = slice(4 * track, 4 * track + 2)
    found.y[at] += W @ z
    found.S[at, at] += W
    found.seen[track] = True
