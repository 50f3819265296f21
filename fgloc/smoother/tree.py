"""iSAM2 behind one small face, whole or over a fixed lag."""

import math
from collections.abc import Iterable
from typing import NamedTuple, SupportsFloat, SupportsIndex, SupportsInt

import gtsam
import numpy as np

from fgloc.factors.detection import SURVEY
from fgloc.measurements import Array

Stamps = dict[SupportsInt | SupportsIndex, SupportsFloat | SupportsIndex]
"""Times in s by the key of a variable; GTSAM's own type."""

WILDFIRE = 0.01
"""Changes of the linear solution below this are not passed on down the tree."""


class Thresholds(NamedTuple):
    """How far a pose may turn (rad) and move (m) before it is relinearised."""

    turn_rad: float
    move_m: float


OTHER_THRESHOLD = 0.1
"""For what enters linearly or nearly so: velocities (m/s), biases and antenna points (m)."""
NEVER = 1e9
"""For posts, places of other road users and errors of velocities, all of whose factors are
linear."""
MOUNTING_THRESHOLD = 10.0
"""For the mounting, which is kept in mrad."""


def parameters(factorization: str, thresholds: Thresholds | None) -> gtsam.ISAM2Params:
    """iSAM2's settings; without thresholds everything is relinearised at every update."""
    params = gtsam.ISAM2Params()
    step = gtsam.ISAM2GaussNewtonParams()
    if thresholds is None:
        params.setRelinearizeThreshold(0.0)
        step.setWildfireThreshold(0.0)
    else:
        sizes = gtsam.ISAM2ThresholdMap()
        for letter in "xy":
            sizes.insert((letter, np.repeat(thresholds, 3)))
        sizes.insert(("k", np.repeat([OTHER_THRESHOLD, MOUNTING_THRESHOLD], 3)))
        for letter, size in (
            ("v", 3),
            ("b", 6),
            ("a", 3),
            ("c", 3),
            ("l", 3),
            ("w", 3),
            ("z", 3),
            ("s", SURVEY),
            ("t", 3),
        ):
            sizes.insert((letter, np.full(size, OTHER_THRESHOLD)))
        for letter, size in (("p", 6), ("u", 3), ("m", 2)):
            sizes.insert((letter, np.full(size, NEVER)))
        params.setRelinearizeThreshold(sizes)
        params.enablePartialRelinearizationCheck = True
        step.setWildfireThreshold(WILDFIRE)
    params.relinearizeSkip = 1
    params.findUnusedFactorSlots = True
    params.setFactorization(factorization.upper())
    params.setOptimizationParams(step)
    return params


class WholeTree:
    """iSAM2 over everything so far."""

    def __init__(self, factorization: str, thresholds: Thresholds | None) -> None:
        self.factorization = factorization
        self.isam = gtsam.ISAM2(parameters(factorization, thresholds))
        self._solver: gtsam.ISAM2 | gtsam.IncrementalFixedLagSmoother = self.isam

    def update(
        self,
        factors: Iterable[gtsam.NonlinearFactor],
        values: gtsam.Values,
        stamps: Stamps,
    ) -> None:
        """Add factors and the first values of new variables.

        `stamps` gives the time in s of each new variable, and a newer one to those that later
        factors will still touch. Raises RuntimeError where the system is indeterminate.
        """
        self.isam.update(as_graph(factors), values)

    def iterate(self) -> None:
        """One more iteration on what is there."""
        self._solver.update()

    def estimate(self, pose_key: int, velocity_key: int, bias_key: int) -> tuple[
        gtsam.Pose3, Array, gtsam.imuBias.ConstantBias
    ]:  # fmt: skip
        """The present values of one keyframe."""
        tree = self._solver
        return (tree.calculateEstimatePose3(pose_key), tree.calculateEstimateVector(velocity_key),
                tree.calculateEstimateConstantBias(bias_key))  # fmt: skip

    def pose(self, key: int) -> gtsam.Pose3:
        """The present value of a pose."""
        return self._solver.calculateEstimatePose3(key)

    def vector(self, key: int) -> Array:
        """The present value of a vector."""
        return self._solver.calculateEstimateVector(key)

    def bias(self, key: int) -> gtsam.imuBias.ConstantBias:
        """The present value of a bias, or of what is kept as one."""
        return self._solver.calculateEstimateConstantBias(key)

    def covariance(self, keys: list[int]) -> Array:
        """Joint covariance of some variables in the order given."""
        if len(keys) == 1:
            return self.isam.marginalCovariance(keys[0])
        return self.isam.jointMarginalCovariance(keys).fullMatrix()

    def holds(self, key: int) -> bool:
        """Whether a variable can still be measured."""
        return bool(self.isam.valueExists(key))


class FixedLagTree(WholeTree):
    """iSAM2 over at least the last `lag_s` seconds; what is older is marginalised.

    States leave in groups of `group_s`, which should divide the lag. The update in which one leaves
    solves all the window again, and in an order in which the newest state, whose covariance is
    asked for, does not come last.
    """

    def __init__(
        self, factorization: str, thresholds: Thresholds | None, lag_s: float, group_s: float
    ) -> None:
        self.factorization, self._group_s = factorization, group_s
        self._solver = self._lag = gtsam.IncrementalFixedLagSmoother(
            lag_s, parameters(factorization, thresholds)
        )
        self.isam = self._lag.getISAM2()

    def update(
        self,
        factors: Iterable[gtsam.NonlinearFactor],
        values: gtsam.Values,
        stamps: Stamps,
    ) -> None:
        """As of the whole tree; what is older than the newest stamp by the lag is marginalised."""
        apart_s = self._group_s
        grouped = {key: math.ceil(float(t_s) / apart_s) * apart_s for key, t_s in stamps.items()}
        self._lag.update(as_graph(factors), values, grouped)

    def shorten(self, lag_s: float) -> None:
        """Change the lag; what is older leaves at the next update."""
        self._lag.setSmootherLag(lag_s)


def relinearized(tree: WholeTree, rounds: int = 30, tolerance: float = 1e-7) -> WholeTree:
    """A whole tree of the same factors, all variables relinearised until none moves further.

    The tolerance is on the largest change of any variable: rad, m, m/s, or a bias's units.
    """
    fresh = WholeTree("qr", None)
    graph = gtsam.NonlinearFactorGraph(tree.isam.getFactorsUnsafe())
    fresh.isam.update(graph, tree.isam.calculateBestEstimate())
    for _ in range(rounds):
        before = fresh.isam.calculateBestEstimate()
        fresh.isam.update()
        change = before.localCoordinates(fresh.isam.calculateBestEstimate())
        if max(np.abs(change.at(key)).max() for key in before.keys()) < tolerance:  # noqa: SIM118
            break
    return fresh


def as_graph(factors: Iterable[gtsam.NonlinearFactor]) -> gtsam.NonlinearFactorGraph:
    """Factors as a graph, in their order."""
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.add(factor)
    return graph
