"""Lee et al. (2021), sections III-C to III-E: the filter itself; `lee2021_ekf` has the symbols."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fgloc.baselines.lee2021_sync import Late, Synchronised
from fgloc.factors.detection import LEE2021_ACROSS_M, lee2021_sigma_m
from fgloc.measurements import Array
from fgloc.timing import seconds_to_ns

STEP_S = 0.1
"""Delta t of Table II, for which R is given; over other times R grows with the time."""
UNSEEN, BEYOND, FAR, SECOND, TAKEN = range(5)
"""What became of a candidate or a fix; a row that was in several has the best of their fates."""


@dataclass(frozen=True)
class Lee2021:
    """Parameters of the method; the first three are those of Table II.

    gps_sigma_m          of x and y
    node_sigma_across_m  of a candidate in y; (19) is its sigma in x
    threshold_m          fixes and candidates farther from the prediction are left out
    correlation          of the errors in x and y. Differs from the paper: (5) and (7) print 1,
                         which makes Q singular. Two such updates leave no covariance at all; the
                         state is where two lines cross, and they are parallel at 11.4 and 16.1 m
                         from a node

    Not in the paper:

    process_sigma_m  R is its square, in x and y, for each step of 0.1 s; by the sweep in
                     tests/benchmarks/lee2021_sweep.py: what velocities of 0.2 m/s make of it
    floor_m          least sigma of a candidate in x, because (19) is zero at 13.76 m: no better
                     than in y
    restart_s        after so long without an accepted fix the filter starts anew from the next
                     one: a gate that rejects everything would never recover
    late             `as-stamped`: a detection counts as true at its stamp however late it arrives,
                     as in the paper, which was computed afterwards; `on-arrival`: as true when it
                     was received, which is what such a filter can do on the road

    The detection range is that of each node of the drive, `Node.range_m`.
    """

    gps_sigma_m: tuple[float, float] = (0.8, 2.0)
    node_sigma_across_m: float = LEE2021_ACROSS_M
    threshold_m: float = 5.0
    correlation: float = 0.0
    process_sigma_m: float = 0.02
    floor_m: float = 0.3
    restart_s: float = 5.0
    late: Late = "as-stamped"


LEE2021 = Lee2021()
PRINTED = Lee2021(correlation=1.0, floor_m=0.01)
"""Equations (5), (7) and (19) to the letter, but for the zero of the last."""


@dataclass(frozen=True, eq=False)
class Belief:
    """The state: East and North (2,) in m with covariance (2, 2) in m^2."""

    x_m: Array
    cov_m2: Array

    def predicted(self, v_mps: Array, dt_s: float, process_sigma_m: float) -> "Belief":
        """Moved with a velocity (2,) for dt seconds."""
        x = self.x_m + v_mps * dt_s  # Eq. (1), (2)
        R = process_sigma_m**2 * dt_s / STEP_S * np.eye(2)
        return Belief(x, self.cov_m2 + R)  # Eq. (3), G is the identity

    def updated(self, z_m: Array, Q: Array) -> tuple["Belief", float]:
        """Corrected by a position (2,) with covariance (2, 2), and the NIS of the innovation."""
        v = z_m - self.x_m  # Eq. (8), (13)
        S = self.cov_m2 + Q  # Eq. (9), (14), H is the identity
        K = np.linalg.solve(S, self.cov_m2).T  # Eq. (10), (15)
        x = self.x_m + K @ v  # Eq. (11), (16)
        cov = (np.eye(2) - K) @ self.cov_m2  # Eq. (12), (17)
        return Belief(x, (cov + cov.T) / 2), float(v @ np.linalg.solve(S, v))


def gps_cov_m2(p: Lee2021 = LEE2021) -> Array:
    """Q of a fix, (2, 2)."""
    return _cov(*p.gps_sigma_m, p.correlation)  # Eq. (5)


def node_cov_m2(distance_m: float, p: Lee2021 = LEE2021) -> Array:
    """Q of a candidate at a distance from its node, (2, 2)."""
    sigma_x_m = float(lee2021_sigma_m(distance_m, p.floor_m))  # Eq. (19)
    return _cov(sigma_x_m, p.node_sigma_across_m, p.correlation)  # Eq. (7)


def _cov(sigma_x_m: float, sigma_y_m: float, correlation: float) -> Array:
    off = correlation * sigma_x_m * sigma_y_m
    return np.array([[sigma_x_m**2, off], [off, sigma_y_m**2]])


@dataclass(frozen=True, eq=False)
class Fates:
    """What became of n fixes or candidates.

    fate   (n,) one of `UNSEEN` to `TAKEN`
    far_m  (n,) distance from the prediction
    nis    (n,) of those that were taken, else NaN
    """

    fate: NDArray[np.int64]
    far_m: Array
    nis: Array

    @classmethod
    def unseen(cls, n: int) -> "Fates":
        """Nothing has become of them yet."""
        return cls(np.full(n, UNSEEN), np.full(n, np.nan), np.full(n, np.nan))


@dataclass(eq=False)
class Filter:
    """The filter on synchronised data; `run` gives the belief after each stamp."""

    data: Synchronised
    parameters: Lee2021 = LEE2021
    restarts: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.fixes = Fates.unseen(len(self.data.t_ns))
        self.candidates = Fates.unseen(len(self.data.seen.epoch))
        self._accepted_ns = int(self.data.t_ns[0])

    def run(self) -> list[Belief]:
        """From the first fix on, which the filter starts with."""
        first = self._started(0)
        beliefs = [self._with_node(0, first, first)]
        for k in range(1, len(self.data.t_ns)):
            beliefs.append(self._step(k, beliefs[-1]))
        return beliefs

    def _step(self, k: int, belief: Belief) -> Belief:
        """Prediction, then the fix, then the candidate that is nearest to the prediction."""
        d = self.data
        dt_s = float(d.t_ns[k] - d.t_ns[k - 1]) / 1e9
        predicted = belief.predicted(d.v_mps[k - 1, :2], dt_s, self.parameters.process_sigma_m)
        far_m = float(np.linalg.norm(d.fix_m[k] - predicted.x_m))
        self.fixes.far_m[k], self.fixes.fate[k] = far_m, FAR
        if far_m <= self.parameters.threshold_m:
            return self._with_node(k, predicted, self._with_fix(k, predicted))
        if d.t_ns[k] - self._accepted_ns > seconds_to_ns(self.parameters.restart_s):
            self.restarts.append(k)
            anew = self._started(k)
            return self._with_node(k, anew, anew)
        return self._with_node(k, predicted, predicted)

    def _with_fix(self, k: int, predicted: Belief) -> Belief:
        belief, nis = predicted.updated(self.data.fix_m[k], gps_cov_m2(self.parameters))
        self.fixes.nis[k], self.fixes.fate[k] = nis, TAKEN
        self._accepted_ns = int(self.data.t_ns[k])
        return belief

    def _started(self, k: int) -> Belief:
        """The belief that a fix alone gives."""
        self._accepted_ns = int(self.data.t_ns[k])
        self.fixes.fate[k] = TAKEN
        return Belief(self.data.fix_m[k], gps_cov_m2(self.parameters))

    def _with_node(self, k: int, predicted: Belief, belief: Belief) -> Belief:
        """The belief after the candidate nearest to the prediction, where one is near enough."""
        here, all_seen, own = self.data.seen_at(k), self.data.seen, self.candidates
        far_m = np.linalg.norm(all_seen.p_world_m[here] - predicted.x_m, axis=-1)
        beyond = ~all_seen.in_range[here]
        fits = ~beyond & (far_m <= self.parameters.threshold_m)
        own.far_m[here] = far_m
        own.fate[here] = np.where(fits, SECOND, np.where(beyond, BEYOND, FAR))
        if not fits.any():
            return belief
        best = here.start + int(np.argmin(np.where(fits, far_m, np.inf)))
        Q = node_cov_m2(float(all_seen.distance_m[best]), self.parameters)
        belief, own.nis[best] = belief.updated(all_seen.p_world_m[best], Q)
        own.fate[best] = TAKEN
        return belief
