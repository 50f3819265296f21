"""The vehicle's constraints as they arrive: gated, entered, and remembered for a window's regrowth.

Until the yaw is aligned only standstill enters: which way the car points is not known, and what
says that it follows its axis would hold on to a wrong one.
"""

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, K, V, X
from numpy.typing import NDArray

from fgloc.constraints import NON_HOLONOMIC
from fgloc.factors.vehicle import calibration_covariance, read_calibration
from fgloc.measurements import Array
from fgloc.smoother.graph import Factors, GraphModel, State
from fgloc.smoother.online_velocities import OnlineVelocities
from fgloc.smoother.tree import Stamps, WholeTree
from fgloc.timing import Instants
from fgloc.verdicts import Verdict

CALIBRATION_S = 1.0


class OnlineCar:
    """What of the vehicle's constraints is in the tree."""

    def __init__(self, model: GraphModel) -> None:
        self.model, self.car = model, model.car
        keys = np.flatnonzero(self.car.wheel_row >= 0)
        received = np.empty(0, np.int64)
        if self.car.wheels is not None:
            received = self.car.wheels.received_ns[self.car.wheel_row[keys]]
        self._arriving = arrivals(model.t_ns, keys, received, keys)
        told = self.car.velocities
        arriving = arrivals(model.t_ns, told.keys, told.received_ns, told.keys)
        self._velocities = OnlineVelocities(model, arriving)
        self.axes: set[int] = set()
        self._speeds: set[int] = set()
        self._still: set[int] = set()
        self._accepted_s = 0.0
        self._calibration_cov: Array | None = None
        self._calibration_s = 0.0

    def take_in(
        self, j: int, state: State, cov: Array, values: gtsam.Values, tree: WholeTree, *,
        aligned: bool,
    ) -> Factors:  # fmt: skip
        """Factors of what holds at keyframe j and of the wheel speeds that came in by it.

        `state` and `cov` (9, 9), of pose and velocity, are predicted for keyframe j.
        """
        v, cov_v = state.velocity, cov[6:, 6:]
        factors = self._velocities.take_in(j, v, cov_v, values, tree, aligned=aligned)
        if self.car.stands[j] and self.car.still_fits(j, v, cov_v):
            self._still.add(j)
            factors += self.car.still_factors(j)
        if not aligned:
            self._speeds.update(self._arriving[j])
            return factors
        if self.car.in_force[j]:
            self._enter(j)
            R, bias = state.pose.rotation().matrix(), state.bias.vector()
            self.car.note_slip(j, R, v, bias, cov, self._calibration(j, tree))
            self.car.insert(values, j, state.pose, state.velocity, state.bias)
            factors += self.car.axis_factors(j)
        for key in self._arriving[j]:
            if self._fits(key, j, state, cov, tree):
                factors += self.car.wheel_factors(key)
        return factors

    def _calibration(self, j: int, tree: WholeTree) -> Array:
        """The covariance (3, 3) of the calibration, read once in `CALIBRATION_S`: it takes long and
        changes slowly."""
        now_s = float(self.model.t_s[min(j, len(self.model) - 1)])
        if self._calibration_cov is None or now_s - self._calibration_s >= CALIBRATION_S:
            self._calibration_cov = calibration_covariance(tree.covariance([K(0)]))
            self._calibration_s = now_s
        return self._calibration_cov

    def finish(self, values: gtsam.Values, tree: WholeTree, *, aligned: bool) -> Factors:
        """Factors of the speeds and velocities that came in after the last keyframe."""
        end = len(self.model)
        factors = self._velocities.take_in(end, None, None, values, tree, aligned=aligned)
        if not aligned:
            return factors
        late = [k for k in self._arriving[-1] if self._fits(k, end, None, None, tree)]
        return factors + [factor for key in late for factor in self.car.wheel_factors(key)]

    def factors(self, k: int) -> Factors:
        """What a graph over a window holds of keyframe k."""
        factors = self._velocities.factors(k)
        if k in self._still:
            factors += self.car.still_factors(k)
        if k in self.axes:
            factors += self.car.axis_factors(k)
        if k in self.axes and k in self._speeds:
            factors += self.car.wheel_factors(k)
        return factors

    def admit(self, first: int, j: int) -> None:
        """The yaw is known from keyframe `first` on: what has waited for it up to j may enter."""
        for k in range(first, j + 1):
            if self.car.in_force[k]:
                self._enter(k)
        for k in self._speeds & self.axes:
            self.car.verdicts[self.car.wheel_source].set(self.car.wheel_row[k], Verdict.USED)

    def tells_course(self, first: int) -> bool:
        """Whether a velocity since keyframe `first` is fast enough to tell a course."""
        return self._velocities.tells_course(first)

    def read(self, j: int, tree: WholeTree) -> None:
        """Take what all constraints share out of the tree, where keyframe j has changed it."""
        if j in self.axes:
            self.car.found = read_calibration(tree.bias(K(0)))
        self._velocities.read(j, tree)

    def insert_velocities(self, values: gtsam.Values, first: int, n: int) -> None:
        """Put in what the velocities of keyframes first..first + n - 1 add, which are there."""
        self._velocities.insert(values, first, n)

    def stamps(self, first: int, j: int) -> Stamps:
        """The time in s of the variables of keyframes first..j."""
        t_s = self.model.t_s
        own = {
            key: float(t_s[k])
            for k in range(first, j + 1)
            if k in self.axes
            for key in self.car.keys_at(k)
        }
        return own | self._velocities.stamps(first, j)

    def forget(self, before: int) -> None:
        """Drop what lies before a keyframe."""
        self._velocities.forget(before)
        for store in (self.axes, self._speeds, self._still):
            store -= {k for k in store if k < before}

    def _enter(self, k: int) -> None:
        self.axes.add(k)
        if self.car.config.non_holonomic:
            row = self.car.slip_row[k]
            self.car.verdicts[NON_HOLONOMIC].set(row, Verdict.USED)

    def _fits(
        self, key: int, j: int, state: State | None, cov: Array | None, tree: WholeTree
    ) -> bool:
        """Whether a wheel speed is in time and passes the gate; like a fix's, it opens again."""
        model, now_s = self.model, float(self.model.t_s[min(j, len(self.model) - 1)])
        own = self.car.verdicts[self.car.wheel_source]
        if key != j and (key not in self.axes or not tree.holds(X(key))):
            reason = f"{now_s - model.t_s[key]:.2f} s old; its state has left the window"
            own.set(self.car.wheel_row[key], Verdict.LATE, reason)
            return False
        if key != j or state is None or cov is None:
            keys = [X(key), V(key), B(int(model.bias_of[key]))]
            state, cov = State(*tree.estimate(*keys)), tree.covariance(keys)[:9, :9]
        pose, bias = state.pose.rotation().matrix(), state.bias.vector()
        known = self._calibration(j, tree)
        fits = self.car.wheel_fits(key, pose, state.velocity, bias, cov, known)
        waited = model.t_s[key] - self._accepted_s > model.config.gnss.gate_reset_s
        if not (fits or waited):
            return False
        if not fits:
            reason = "no wheel speed accepted for long: the gate opened"
            own.set(self.car.wheel_row[key], Verdict.USED, reason)
        self._speeds.add(key)
        self._accepted_s = float(model.t_s[key])
        return True


def arrivals(
    t_ns: Instants, items: NDArray[np.int64], received_ns: Instants, keys: NDArray[np.int64]
) -> list[list[int]]:
    """For each keyframe, and the end, which items came in since the last, none before its own.

    `keys` are the keyframes at which the items are true.
    """
    order = np.argsort(received_ns, kind="stable")
    step = np.maximum(np.searchsorted(t_ns, received_ns), keys)
    result: list[list[int]] = [[] for _ in range(len(t_ns) + 1)]
    for i in order:
        result[step[i]].append(int(items[i]))
    return result
