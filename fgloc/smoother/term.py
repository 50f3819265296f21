"""The form in which factors are told: blocks of unknowns, a border that the drive shares, terms."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgloc.arrays import Array, finite_rows
from fgloc.errors import SolverError
from fgloc.factors import noise
from fgloc.parallel import each, portions
from fgloc.smoother.model import Model

POSE, VELOCITY, BIAS = np.arange(6), np.arange(6, 9), np.arange(9, 15)
STATE, FULL = np.arange(9), np.arange(15)
AT_ONCE = 5000
"""So many matrices are inverted at a time."""


class Term(NamedTuple):
    """M factors of one kind: whitened errors (M, m) and Jacobians (M, m, q).

    blocks  (M,) the keyframe that each begins at
    at      the unknowns it depends on, counted from that keyframe's first; what the Jacobian has
            beyond them is by the shared unknowns
    loss    that lies on it, from a whitened error of `width` on
    """

    blocks: NDArray[np.int64]
    at: NDArray[np.int64]
    error: Array
    jacobian: Array
    loss: noise.Loss = "none"
    width: float = np.inf


class Step(NamedTuple):
    """M steps x_j+1 - phi x_j of unknowns `at` (q,) from some blocks j to the next: what they miss
    zero by (M, q), under sigmas (M, q); phi is (M,)."""

    blocks: NDArray[np.int64]
    at: NDArray[np.int64]
    phi: Array
    change: Array
    sigma: Array

    @property
    def cost(self) -> float:
        """Half the sum of squares."""
        return float(np.square(self.change / self.sigma).sum()) / 2


class Border(NamedTuple):
    """Where the unknowns that the whole drive shares stand: how late stamps are, the car's
    calibration, the centre of its box, what its velocities are off, and what the survey of each
    source, by number, is off: in the plane, and in space where nodes tell heights."""

    late: slice
    car: slice
    offset: slice
    velocity: slice
    survey: dict[int, slice]

    @classmethod
    def of(cls, model: Model) -> "Border":
        """Those of a model."""
        late = slice(0, len(model.shifted_s))
        car = slice(late.stop, late.stop + 3 * model.car.acts)
        free = any(source.point_sigma_m for source in model.sources)
        offset = slice(car.stop, car.stop + 3 * free)
        erring = model.car.velocities.err
        velocity = slice(offset.stop, offset.stop + 2 * erring)
        surveyed = [s for s, source in enumerate(model.sources) if source.surveyed]
        n = model.survey_size
        survey = {s: slice(velocity.stop + n * i, velocity.stop + n * i + n)
                  for i, s in enumerate(surveyed)}  # fmt: skip
        return cls(late, car, offset, velocity, survey)

    @property
    def size(self) -> int:
        """How many unknowns there are."""
        ends = (self.velocity.stop, *(at.stop for at in self.survey.values()))
        return int(max(ends))

    def by(self, at: slice | NDArray[np.int64], jacobian: Array) -> Array:
        """Jacobians (n, m, q) by some of the shared unknowns among those by all of them. One by
        the sum of several, (n, m, 1), is that by each."""
        full = np.zeros((*jacobian.shape[:2], self.size))
        full[:, :, at] = jacobian
        return full


def whitening(model: Model, cov: Array, keys: NDArray[np.int64]) -> Array:
    """W (m, r, r) with W cov W' = I; SolverError names the keyframe where there is none."""
    W = np.empty_like(cov, np.float64)

    def fill(part: slice) -> None:
        W[part] = noise.whitening(cov[part])

    each(fill, portions(len(cov), AT_ONCE))
    if not np.isfinite(W).all():
        j = int(keys[np.argmin(finite_rows(W))])
        raise SolverError(
            f"the measurements at keyframe {j}, t = {model.t_s[j]:.2f} s, are out of all "
            "bounds: a covariance cannot be computed from them"
        )
    return W


def whitened(W: Array, error: Array) -> Array:
    """W (m, r, r) times errors (m, r)."""
    return np.einsum("nij,nj->ni", W, error)
