"""Newton's method with damping, for a cost that comes as a banded system."""

from typing import Literal, Protocol

import numpy as np

from fgloc.smoother.band import Band, BorderedFactor, Vector
from fgloc.smoother.half import NotPositiveError
from fgloc.smoother.states import Robustness, States

Curvature = Literal["newton", "weights"]
FIRST_DAMPING, MAX_DAMPING = 0.1, 1e10
"""In units of `Cost.damping`; a step that climbs takes ten times the last one's. The first weighs
so little that a step under it may be the last."""
POOR, GOOD = 0.25, 0.75
"""A step that comes down by less than this share of what it promises bends more than its square
tells: the next is damped more. One that comes down by more than the other is damped less."""
NEAR = 0.3
"""Where nearness will do, the last step may promise this share of the cost."""
SURE, SLOW, SHORT_RAD = 0.1, 0.1, 0.01
"""After a step of Newton's that promises this share of the cost, the next is likely the last, and
takes the curvature of covariances. That comes nearer more slowly, so it must leave less, by this
factor; where it has promised more than `FINE`, Newton's is next again. A last step that turns
nothing by more than so many rad does what it promises."""
LEAST = 1e-3
"""The share of its promise that a step leaves at least: one far from the optimum promises so much
that the next ones seem to come near faster than they do."""
FINE = 1e-5
"""Covariances are those of before the last step where that promises no more than this share of the
cost: what it moves is then a few thousandths of what each measurement's noise is. Where nearness
will do, so it does for them."""


class Cost(Protocol):
    """What is minimised: see `Chain`."""

    @property
    def damping(self) -> Vector:
        """What a damping of 1 adds to the curvature of each unknown of a block and the border."""

    def linearize(
        self, states: States, robust: Robustness, curvature: Curvature, band: Band | None = None
    ) -> tuple[float, Band]:
        """The cost and its normal equations, in the place of a band that is no longer needed."""

    def moved(self, states: States, step: Vector) -> States:
        """The states after a step back along a vector."""


class Descent:
    """Steps down one cost, at most so many.

    iterations  how many there were
    converged   whether they were enough
    factor      that of the last step, where it is the one that covariances are taken from
    """

    def __init__(self, cost: Cost, robust: Robustness, most: int) -> None:
        self.cost, self.robust, self.most = cost, robust, most
        self.iterations, self.converged = 0, False
        self.factor: BorderedFactor | None = None

    def run(self, states: States, tolerance: float, share: float = 0.0) -> tuple[States, float]:
        """The states after a step that leaves less than a tolerance, or promises no more than a
        share of the cost; the cost.

        What a step leaves is taken to be as much less than what it promises as that is less than
        what the step before did, within `LEAST`. A step that climbs is tried again from the same
        states: by reweighted least squares if it was Newton's, else damped more. Raises
        NotPositiveError where no damping makes the system definite.
        """
        curvature: Curvature = "newton"
        damping, before = 0.0, 0.0
        value, band = self.cost.linearize(states, self.robust, curvature)
        while True:
            self.iterations += 1
            factor, step, promise, damping = self._step(states, band, curvature, damping)
            trial = self.cost.moved(states, step)
            left = promise * np.clip(promise / before, LEAST, 1.0) if before > 0 else promise
            enough = tolerance * (SLOW if curvature == "weights" else 1.0)
            done = (left <= enough or promise <= share * value) and damping <= FIRST_DAMPING
            if done and np.abs(step.blocks[:, :3]).max() < SHORT_RAD:
                self.converged = True
                fine = share > 0 or promise <= FINE * value
                weighs = self.robust.plain or curvature == "weights"
                self.factor = factor if weighs and fine and damping == 0 else None
                return trial, value - promise
            del factor  # it stands where the next normal equations will
            ends = promise <= (SURE if curvature == "newton" else FINE) * value
            following: Curvature = "weights" if ends else "newton"
            trial_value, band = self.cost.linearize(trial, self.robust, following, band)
            climbs = not trial_value <= value
            before = 0.0 if climbs or damping > 0 else promise
            if not climbs:
                damping = _eased(damping, value - trial_value, promise)
                states, value, curvature = trial, trial_value, following
            if done or self.iterations >= self.most:
                self.converged = done
                return states, value
            if climbs:
                if curvature == "newton":
                    curvature = "weights"
                else:
                    damping = max(10 * damping, FIRST_DAMPING)
                _, band = self.cost.linearize(states, self.robust, curvature, band)

    def _step(
        self, states: States, band: Band, curvature: Curvature, damping: float
    ) -> tuple[BorderedFactor, Vector, float, float]:
        """A step up the gradient by a factor, the decrease that going down it promises, its
        damping."""
        while True:
            try:
                blocks, border = self.cost.damping
                factor = band.factor(Vector(damping * blocks, damping * border))
                step = factor.solve(band.gradient)
                return factor, step, step.dot(band.gradient) / 2, damping
            except NotPositiveError:
                damping = max(10 * damping, FIRST_DAMPING)
                if damping > MAX_DAMPING or not np.isfinite(band.gradient.blocks).all():
                    raise
                _, band = self.cost.linearize(states, self.robust, curvature, band)


def _eased(damping: float, fall: float, promise: float) -> float:
    """The damping after a step down, by how far it came down of what it promised."""
    if fall < POOR * promise:
        return max(10 * damping, FIRST_DAMPING)
    return damping / 10 if fall > GOOD * promise else damping
