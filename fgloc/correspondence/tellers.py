"""Road users that say where they are, and which of the objects of a node they are.

Each is followed by a Kalman filter with the state [place, velocity, slow error of its fixes, slow
error of the nodes], all East and North. In one frame of a node everybody is one object at most and
every object one of them: the assignment with the least sum of NIS holds, with the node's number as
a second witness, since two cars in a row are nearer to each other than their fixes are to them.
"""

import math

import numpy as np
from numpy.typing import NDArray

from fgloc.chi_square import chi2_quantile
from fgloc.drive import GnssBias
from fgloc.measurements import Array

GATE = chi2_quantile(0.9999, 2)
"""Of a sighting, and of what it says itself. The state's own noise opens it again in seconds."""
ACCEL_DENSITY = 3.0
"""Root of the spectral density of the acceleration, m/s^2 per sqrt(Hz), as the graph has it."""
FIRST_SIGMA_MPS = 30.0
_NOBODY = 1e3  # above any cost that passes the gate
_I2 = np.eye(2)
_FIX = np.asarray(np.kron([1.0, 0, 1, 0], _I2), np.float64)
_SEEN = np.asarray(np.kron([1.0, 0, 0, 1], _I2), np.float64)


class Teller:
    """One road user that says where it is; begins with its first fix."""

    def __init__(
        self, t_ns: int, fix_m: Array, R_m2: Array, own: GnssBias | None, nodes: GnssBias | None
    ) -> None:
        self.t_ns = t_ns
        self.slow = (own, nodes)
        spread = [0.0 if bias is None else bias.sigma_m**2 for bias in self.slow]
        self.x = np.concatenate([fix_m, np.zeros(6)])
        self.P = np.kron(np.diag([0.0, FIRST_SIGMA_MPS**2, *spread]), _I2)
        self.P[:2, :2] = R_m2 + spread[0] * _I2
        self.P[:2, 4:6] = self.P[4:6, :2] = -spread[0] * _I2

    def predict(self, t_ns: int) -> None:
        """To a later instant: constant velocity, slow errors that forget themselves."""
        dt_s, self.t_ns = (t_ns - self.t_ns) / 1e9, t_ns
        f, q = np.eye(4), np.zeros((4, 4))
        f[0, 1] = dt_s
        q[:2, :2] = ACCEL_DENSITY**2 * np.array([[dt_s**3 / 3, dt_s**2 / 2], [dt_s**2 / 2, dt_s]])
        for at, bias in enumerate(self.slow, start=2):
            if bias is not None:
                f[at, at] = math.exp(-dt_s / bias.tau_s)
                q[at, at] = bias.sigma_m**2 * (1 - f[at, at] ** 2)
        F = np.kron(f, _I2)
        self.x, self.P = F @ self.x, F @ self.P @ F.T + np.kron(q, _I2)

    def fixed(self, z_m: Array, R_m2: Array) -> bool:
        """It says where it is; whether that can be."""
        gap, S = z_m - _FIX @ self.x, _FIX @ self.P @ _FIX.T + R_m2
        fits = float(gap @ np.linalg.solve(S, gap)) <= GATE
        if fits:
            self._update(z_m, R_m2, _FIX)
        return fits

    def seen(self, z_m: Array, R_m2: Array) -> None:
        """A node sees it."""
        self._update(z_m, R_m2, _SEEN)

    def nis(self, z_m: Array, R_m2: Array) -> Array:
        """(n,) of sightings (n, 2) of a node with covariances (n, 2, 2)."""
        gap = z_m - _SEEN @ self.x
        return np.asarray(
            np.einsum("ni,nij,nj->n", gap, np.linalg.inv(_SEEN @ self.P @ _SEEN.T + R_m2), gap)
        )

    def _update(self, z_m: Array, R_m2: Array, H: Array) -> None:
        K = np.linalg.solve(H @ self.P @ H.T + R_m2, H @ self.P).T
        self.x = self.x + K @ (z_m - H @ self.x)
        A = np.eye(8) - K @ H
        self.P = A @ self.P @ A.T + K @ R_m2 @ K.T


class Tellers:
    """All that say where they are, by track."""

    def __init__(self) -> None:
        self.known: dict[int, Teller] = {}
        self._share: dict[tuple[int, int, int], tuple[int, int]] = {}

    def told(
        self, track: int, t_ns: int, fix_m: Array, R_m2: Array,
        own: GnssBias | None, nodes: GnssBias | None,
    ) -> bool:  # fmt: skip
        """A track says where it is; whether that can be. Slow errors matter where it begins."""
        if track not in self.known:
            self.known[track] = Teller(t_ns, fix_m, R_m2, own, nodes)
            return True
        self.known[track].predict(t_ns)
        return self.known[track].fixed(fix_m, R_m2)

    def claim(
        self, t_ns: int, node: int, number: NDArray[np.int64], z_m: Array, R_m2: Array
    ) -> NDArray[np.int64]:
        """The tracks (n,) of the objects of one frame of a node; -1 where it is nobody of these."""
        from scipy.optimize import linear_sum_assignment

        tracks = sorted(self.known)
        claimed = np.full(len(number), -1)
        if not tracks or not len(number):
            return claimed
        cost = np.empty((len(tracks), len(number)))
        for a, track in enumerate(tracks):
            self.known[track].predict(t_ns)
            nis = self.known[track].nis(z_m, R_m2)
            raised = nis + [self._doubt(track, node, int(one)) for one in number]
            cost[a] = np.where(nis <= GATE, raised, _NOBODY)
        for a, i in zip(*linear_sum_assignment(cost), strict=True):
            if cost[a, i] < _NOBODY:
                claimed[i] = tracks[a]
                self.known[tracks[a]].seen(z_m[i], R_m2[i])
        for a, i in np.argwhere(cost < _NOBODY).tolist():
            self._note(tracks[a], node, int(number[i]), hit=claimed[i] == tracks[a])
        return claimed

    def _doubt(self, track: int, node: int, number: int) -> float:
        """-2 ln of the share of frames in which a number was this one, by Laplace's rule."""
        hits, frames = self._share.get((track, node, number), (0, 0))
        return -2 * math.log((hits + 1) / (frames + 2))

    def _note(self, track: int, node: int, number: int, *, hit: bool) -> None:
        hits, frames = self._share.get((track, node, number), (0, 0))
        if number >= 0:
            self._share[track, node, number] = (hits + hit, frames + 1)
