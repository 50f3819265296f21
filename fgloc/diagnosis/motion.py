"""How the fixes say the vehicle moved, and what another sensor says of the same seconds.

Straight lines fitted to positions over a few seconds give velocities that noise of metres does not
hide. The integrals of another sensor go through the same lines at the same instants, so both sides
are smoothed alike, and what differs between them is not the smoothing.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from fgloc.arrays import Array, finite_rows
from fgloc.diagnosis.finding import robust_sigma
from fgloc.diagnosis.gnss import strays
from fgloc.drive import Drive
from fgloc.frames import wrap_pi
from fgloc.measurements import GnssFixes, ImuSamples
from fgloc.timing import Instants, elapsed_s

STEP_S = 1.0
HALF_WINDOW_S = 2.0
"""Five fixes at 1 Hz; a corner of a street takes about as long."""
SLOWEST_MPS = 3.0
"""Below this a course from fixes of a metre says little."""
SHARED = 2 * HALF_WINDOW_S / STEP_S
"""So many neighbouring steps tell of the same seconds, and count as one."""
FEWEST_STEPS = 20
LONGEST_M = 10.0
"""From the rear axle to the bumper of a bus; a lever arm in cm or mm is far longer."""
_SPARSEST_S = 2.5  # fixes further apart tell nothing of single turns
_MOST_HZ = 10.0
_USUAL_SIGMA_M = 5.0  # of a receiver without corrections
_INTERVALS = 2.25  # to either side: four or five fixes, wherever the knot lies between them


@dataclass(frozen=True, eq=False)
class Motion:
    """Velocities of the antenna at K knots on whole steps of time, from the fixes alone.

    start_ns   instant from which seconds count: the first fix
    fix_s      (F,) times of the fixes that were used
    p_m        (F, 3) their positions, ENU
    knot_s     (K,) times of the knots
    v_mps      (K, 3) velocity there, ENU, smoothed over `half_s` to either side
    sound      (K,) bool: whether fixes lie evenly around the knot
    half_s     half the length of the fitted lines
    """

    start_ns: int
    fix_s: Array
    p_m: Array
    knot_s: Array
    v_mps: Array
    sound: NDArray[np.bool_]
    half_s: float

    @classmethod
    def of(cls, drive: Drive) -> Self | None:
        """The motion of a drive, or None where its fixes are too few or too sparse to tell."""
        gnss = drive.tables.get("gnss")
        if not isinstance(gnss, GnssFixes) or len(gnss) < FEWEST_STEPS:
            return None
        start_ns = int(gnss.t_ns[0])
        fix_s, p_m = _thinned(gnss, start_ns)
        if len(fix_s) < FEWEST_STEPS or np.median(np.diff(fix_s)) > _SPARSEST_S:
            return None
        half_s = max(HALF_WINDOW_S, _INTERVALS * float(np.median(np.diff(fix_s))))
        knot_s = np.unique(np.round(fix_s / STEP_S)) * STEP_S
        v_mps, sound = slopes(fix_s, p_m, knot_s, half_s)
        return cls(start_ns, fix_s, p_m, knot_s, v_mps, sound, half_s)

    @cached_property
    def speed_mps(self) -> Array:
        """(K,) horizontal speed at the knots."""
        return np.hypot(self.v_mps[:, 0], self.v_mps[:, 1])

    @cached_property
    def steps(self) -> NDArray[np.int64]:
        """(S,) knots from which a step leads to the next one while the vehicle moves."""
        moves = self.sound & (self.speed_mps > SLOWEST_MPS)
        next_to = np.diff(self.knot_s) < 1.5 * STEP_S
        return np.flatnonzero(moves[1:] & moves[:-1] & next_to)

    @cached_property
    def turn_rad(self) -> Array:
        """(S,) change of the course over each step, to the left."""
        course = np.arctan2(self.v_mps[:, 1], self.v_mps[:, 0])
        return wrap_pi(course[self.steps + 1] - course[self.steps])

    @cached_property
    def push_mps(self) -> Array:
        """(S, 2) change of the velocity over each step, along the course and to its left."""
        before, after = self.v_mps[self.steps, :2], self.v_mps[self.steps + 1, :2]
        mean = (before + after) / 2
        along = mean / np.linalg.norm(mean, axis=-1, keepdims=True)
        change = after - before
        left = along[:, 0] * change[:, 1] - along[:, 1] * change[:, 0]
        return np.stack([(along * change).sum(-1), left], -1)

    def smoothed(self, signal: "Signal", lag_s: float = 0.0) -> Array:
        """(K, m) integral of a signal, smoothed at the knots as the velocities are.

        The signal is read `lag_s` after the fixes' stamps.
        """
        return slopes(self.fix_s, signal.at(self.fix_s + lag_s), self.knot_s, self.half_s)[0]

    def change(self, signal: "Signal", lag_s: float = 0.0) -> Array:
        """(S, m) smoothed integral of a signal over each step."""
        smooth = self.smoothed(signal, lag_s)
        return smooth[self.steps + 1] - smooth[self.steps]

    def covered(self, signal: "Signal", lag_s: float = 0.0) -> NDArray[np.bool_]:
        """(S,) bool: steps over all of which there are samples of the signal."""
        first = self.knot_s[self.steps] + lag_s - self.half_s
        last = self.knot_s[self.steps + 1] + lag_s + self.half_s
        return (first >= signal.t_s[0]) & (last <= signal.t_s[-1])


@dataclass(frozen=True, eq=False)
class Signal:
    """A rate of change (N, m), kept as its second integral, at times (N,) in s."""

    t_s: Array
    twice: Array

    @classmethod
    def of_rate(cls, t_ns: Instants, rate: Array, start_ns: int) -> Self:
        """From samples of the rate itself; seconds count from `start_ns`."""
        return cls.of_level(t_ns, integral(elapsed_s(t_ns, start_ns), rate), start_ns)

    @classmethod
    def of_level(cls, t_ns: Instants, level: Array, start_ns: int) -> Self:
        """From samples of what changes, such as a speed."""
        t_s = elapsed_s(t_ns, start_ns)
        return cls(t_s, integral(t_s, level))

    def at(self, t_s: Array) -> Array:
        """(M, m) second integral at times (M,)."""
        return np.stack([np.interp(t_s, self.t_s, column) for column in self.twice.T], -1)


def inertial(drive: Drive, start_ns: int) -> Signal | None:
    """Yaw rate, forward and leftward specific force (N, 3) in vehicle axes, less their medians."""
    imu = drive.tables.get("imu")
    if not isinstance(imu, ImuSamples):
        return None
    finite = finite_rows(imu.accel_mps2, imu.gyro_radps)
    if finite.sum() < 2:
        return None
    R_veh_imu = drive.rig.T_veh_imu[:3, :3]
    accel = imu.accel_mps2[finite] @ R_veh_imu.T
    yaw_rate = imu.gyro_radps[finite] @ R_veh_imu[2]
    rate = np.column_stack([yaw_rate, accel[:, :2]])
    return Signal.of_rate(imu.t_ns[finite], rate - np.median(rate, axis=0), start_ns)


def slopes(
    t_s: Array, values: Array, at_s: Array, half_s: float
) -> tuple[Array, NDArray[np.bool_]]:
    """Slopes (K, m) of lines fitted to values (F, m) within `half_s` of the times (K,).

    The second result (K,) tells where four values or more lie evenly to both sides.
    """
    first = np.searchsorted(t_s, at_s - half_s - 1e-6)
    count = np.searchsorted(t_s, at_s + half_s + 1e-6) - first
    rows = first[:, None] + np.arange(max(int(count.max(initial=1)), 1))
    weight = (np.arange(rows.shape[1]) < count[:, None]).astype(float)
    rows = np.minimum(rows, len(t_s) - 1)
    n = np.maximum(count, 1)[:, None]
    x = (t_s[rows] - at_s[:, None]) * weight
    mean = x.sum(-1, keepdims=True) / n
    x = (x - mean) * weight
    spread = (x**2).sum(-1)
    middle = values[rows[:, :1]]
    slope = np.einsum("kw,kwm->km", x, values[rows] - middle) / np.maximum(spread, 1e-9)[:, None]
    wide = spread > 0.15 * half_s**2 * n[:, 0]
    return slope, np.asarray(wide & (np.abs(mean[:, 0]) < 0.15 * half_s) & (count >= 4))


def integral(t_s: Array, rate: Array) -> Array:
    """(N, m) integral from the first sample on, by the trapezoid rule."""
    steps = (rate[1:] + rate[:-1]) / 2 * np.diff(t_s)[:, None]
    return np.concatenate([np.zeros_like(rate[:1]), np.cumsum(steps, axis=0)])


def fit(A: Array, y: Array) -> tuple[Array, Array]:
    """Least squares (m,) with sigmas (m,); rows beyond four robust sigmas are left out.

    Rows are steps of a `Motion`.
    """
    keep = np.ones(len(y), bool)
    for _ in range(3):
        solution = np.linalg.lstsq(A[keep], y[keep], rcond=None)[0]
        residual = y - A @ solution
        sigma = robust_sigma(residual[keep])
        keep = np.abs(residual) <= max(4 * sigma, 1e-12)
    cov = np.linalg.pinv(A[keep].T @ A[keep]) * residual[keep].var() * SHARED
    return np.asarray(solution, float), np.asarray(np.sqrt(np.diag(cov)), float)


def _thinned(gnss: GnssFixes, start_ns: int) -> tuple[Array, Array]:
    """Times and positions of finite fixes, without strays and no more than needed."""
    finite = np.flatnonzero(np.isfinite(gnss.p_world_ant_m).all(-1))
    slot = ((gnss.t_ns[finite] - start_ns) // round(1e9 / _MOST_HZ)).astype(np.int64)
    once = finite[np.unique(slot, return_index=True)[1]]
    t_s, p_m = elapsed_s(gnss.t_ns[once], start_ns), gnss.p_world_ant_m[once]
    stray = strays(t_s, p_m[:, :2], _USUAL_SIGMA_M)
    return np.delete(t_s, stray), np.delete(p_m, stray, axis=0)
