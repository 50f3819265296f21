"""Normal equations of the range graph: a banded Cholesky of the states, the globals beside it."""

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from fgloc.errors import SolverError
from fgloc.measurements import Array
from fgloc.smoother.ranges_model import Blocks


def step(blocks: Blocks, damping: float = 0.0) -> tuple[Array, Array]:
    """The change of states (N, m) and globals (G,) that solves the equations.

    `damping` adds so much of the diagonal (Levenberg-Marquardt). Raises SolverError where they
    have no solution.
    """
    n, m = blocks.gradient.shape
    factor = _banded(blocks, damping)
    tied = blocks.tied.reshape(n * m, -1)
    solved = cho_solve_banded((factor, True), np.c_[blocks.gradient.ravel(), tied])
    from_gradient, from_tied = solved[:, 0], solved[:, 1:]
    schur = blocks.globals_ - tied.T @ from_tied
    d_globals = -np.linalg.solve(schur, blocks.gradient_globals - tied.T @ from_gradient)
    d_states = -from_gradient - from_tied @ d_globals
    return d_states.reshape(n, m), d_globals


def covariances(blocks: Blocks) -> tuple[Array, Array]:
    """Marginal covariances of each state (N, m, m) and of the globals (G, G)."""
    n, m = blocks.gradient.shape
    tied = blocks.tied.reshape(n * m, -1)
    from_tied = cho_solve_banded((_banded(blocks, 0.0), True), tied)
    cov_globals = np.linalg.inv(blocks.globals_ - tied.T @ from_tied)
    spread = from_tied.reshape(n, m, -1)
    own = _inverse_diagonal(blocks)
    return own + spread @ cov_globals @ spread.swapaxes(-1, -2), cov_globals


def newest_covariance(blocks: Blocks) -> Array:
    """Marginal covariance (m, m) of the last state."""
    n, m = blocks.gradient.shape
    tied, last = blocks.tied.reshape(n * m, -1), np.zeros((n * m, m))
    last[-m:] = np.eye(m)
    solved = cho_solve_banded((_banded(blocks, 0.0), True), np.c_[last, tied])
    own, spread = solved[-m:, :m], solved[-m:, m:]
    schur = blocks.globals_ - tied.T @ solved[:, m:]
    return np.asarray(own + spread @ np.linalg.solve(schur, spread.T))


def marginal_prior(blocks: Blocks) -> tuple[Array, Array]:
    """What a window of two states says of the second and the globals once the first is gone:
    information (m + G, m + G) and gradient (m + G,)."""
    m = blocks.gradient.shape[1]
    kept = np.block([
        [blocks.diagonal[1], blocks.tied[1]], [blocks.tied[1].T, blocks.globals_]
    ])  # fmt: skip
    across = np.c_[blocks.beside[0], blocks.tied[0]]
    gone = np.linalg.solve(blocks.diagonal[0], np.c_[across, blocks.gradient[0]])
    gradient = np.r_[blocks.gradient[1], blocks.gradient_globals] - across.T @ gone[:, -1]
    return kept - across.T @ gone[:, : m + len(blocks.gradient_globals)], gradient


def _banded(blocks: Blocks, damping: float) -> Array:
    """Cholesky factor of the states' part, in the lower form of scipy."""
    n, m = blocks.gradient.shape
    band = np.zeros((2 * m, n * m))
    for row in range(m):
        for column in range(m):
            if row >= column:
                band[row - column, column::m] = blocks.diagonal[:, row, column]
            band[m + row - column, column : (n - 1) * m : m] = blocks.beside[:, column, row]
    band[0] *= 1 + damping
    try:
        return np.asarray(cholesky_banded(band, lower=True, check_finite=False))
    except np.linalg.LinAlgError as err:
        raise SolverError(
            "the range graph is undetermined: too few ranges, or from too few anchors"
        ) from err


def _inverse_diagonal(blocks: Blocks) -> Array:
    """(N, m, m) diagonal blocks of the inverse of the states' part: what comes from before, what
    comes from after, and what is known at the state itself."""
    n = len(blocks.diagonal)
    before, after = blocks.diagonal.copy(), blocks.diagonal.copy()
    for k in range(1, n):
        beside = blocks.beside[k - 1]
        before[k] -= beside.T @ np.linalg.solve(before[k - 1], beside)
    for k in range(n - 2, -1, -1):
        beside = blocks.beside[k]
        after[k] -= beside @ np.linalg.solve(after[k + 1], beside.T)
    return np.asarray(np.linalg.inv(before + after - blocks.diagonal))
