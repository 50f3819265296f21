"""Newton's method with damping, for a cost that comes as a banded system."""

from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from fgloc.config import SolverConfig
from fgloc.measurements import Array
from fgloc.smoother.band import Band, NotPositiveError
from fgloc.smoother.states import States

Curvature = Literal["plain", "newton", "weights"]
FIRST_DAMPING, MAX_DAMPING = 1e-4, 1e10
"""In units of `Cost.damping`; a step that climbs takes ten times the last one's."""
NEAR = 0.1
"""Plain least squares has come near enough where a step promises less than this share of the cost:
from afar every fix is an outlier, and a loss has no curvature to steer by."""


class Cost(Protocol):
    """What is minimised: see `Chain`."""

    @property
    def damping(self) -> Array:
        """What a damping of 1 adds to the curvature of each unknown of a block (d,)."""

    def linearize(
        self, states: States, gated: NDArray[np.bool_], curvature: Curvature
    ) -> tuple[float, Band]:
        """The cost and its normal equations."""

    def moved(self, states: States, step: Array) -> States:
        """The states after a step."""


def descend(
    cost: Cost, states: States, gated: NDArray[np.bool_], solver: SolverConfig
) -> tuple[States, float, int]:
    """The states of least cost, that cost and the iterations.

    First without the loss to come near, then with it. Raises NotPositiveError where no damping
    makes the system definite.
    """
    descent = Descent(cost, gated, solver.max_iterations)
    states, _ = descent.run(states, "plain", 0.0, NEAR)
    states, value = descent.run(states, "newton", solver.cost_tolerance, 0.0)
    return states, value, descent.iterations


class Descent:
    """Steps down one cost, at most so many; `iterations` counts them."""

    def __init__(self, cost: Cost, gated: NDArray[np.bool_], most: int) -> None:
        self.cost, self.gated, self.most = cost, gated, most
        self.iterations = 0

    def run(
        self, states: States, wanted: Curvature, tolerance: float, share: float
    ) -> tuple[States, float]:
        """Go down until a step promises less than a tolerance or a share of the cost.

        A step that climbs is tried again from the same states: by reweighted least squares if it
        was Newton's, else damped more.
        """
        curvature, damping = wanted, 0.0
        value, band = self.cost.linearize(states, self.gated, curvature)
        while True:
            self.iterations += 1
            step, promise, damping = self._step(states, band, curvature, damping)
            trial = self.cost.moved(states, -step)
            done = promise <= max(tolerance, share * value) and damping < FIRST_DAMPING
            trial_value, trial_band = self.cost.linearize(trial, self.gated, wanted)
            climbs = not trial_value <= value
            if not climbs:
                states, value, band = trial, trial_value, trial_band
                curvature, damping = wanted, damping / 10
            if done or self.iterations >= self.most:
                return states, value
            if climbs:
                if curvature == "newton":
                    curvature = "weights"
                else:
                    damping = max(10 * damping, FIRST_DAMPING)
                _, band = self.cost.linearize(states, self.gated, curvature)

    def _step(
        self, states: States, band: Band, curvature: Curvature, damping: float
    ) -> tuple[Array, float, float]:
        """A step up the gradient, the decrease that going down it promises, its damping."""
        while True:
            try:
                step = band.factor(damping * self.cost.damping).solve(band.gradient)
                return step, float((step * band.gradient).sum()) / 2, damping
            except NotPositiveError:
                damping = max(10 * damping, FIRST_DAMPING)
                if damping > MAX_DAMPING or not np.isfinite(band.gradient).all():
                    raise
                _, band = self.cost.linearize(states, self.gated, curvature)
