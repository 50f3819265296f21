"""Whether the Kalman-Consensus Filter sees everything and stays stable, checked with numbers.

Khamooshi (2023), (4.19) and (4.21) to (4.25), after Olfati-Saber, Kalman-consensus filter:
optimality, stability, and performance (2009).
"""

import math
from collections.abc import Sequence

import numpy as np

from fgloc.baselines.joint import Belief, Information, model
from fgloc.measurements import Array


def gamma(P: Array, dt_s: float) -> float:
    """eps / (norm(P) + 1) with eps the time step. Algorithm 4.3.

    Differs from the paper: norm(P) is the Frobenius norm, tr(P' P)^(1/2), not its power -1.
    """
    return dt_s / (float(np.linalg.norm(P)) + 1)


def rank_of(S: Array, F: Array, steps: int = 4) -> int:
    """Rank of the observability matrix (4.19) of measurements with information S, over steps."""
    values, vectors = np.linalg.eigh(S)
    H = vectors[:, values > 1e-12 * max(float(values.max(initial=0)), 1e-300)].T
    rows = [H]
    for _ in range(steps - 1):
        rows.append(rows[-1] @ F)
    return int(np.linalg.matrix_rank(np.concatenate(rows))) if len(H) else 0


def gamma_star(
    agents: Sequence[tuple[Belief, Information]], dt_s: float, laplacian: Array
) -> float:
    """The bound (4.25) below which consensus is stable, for all agents of a network together.

    agents  prediction of each with what it measures itself; the tracks that all have seen count
    Differs from the paper: lambda_max stands below the line (the least of a Laplacian is 0 and the
    bound infinite), the Laplacian is L kron I, and Lambda = M^-1 - F' (F M F' + W)^-1 F, of
    which the thesis leaves out a factor M^-1.
    """
    common = np.logical_and.reduce([belief.born for belief, _ in agents])
    rows = np.flatnonzero(np.repeat(common, 4))
    if not len(rows):
        return math.nan
    F, Q = (matrix[np.ix_(rows, rows)] for matrix in model(dt_s, len(common)))
    least, blocks = [], []
    for belief, information in agents:
        P, S = belief.P[np.ix_(rows, rows)], information.S[np.ix_(rows, rows)]
        M = np.linalg.solve(np.eye(len(rows)) + P @ S, P)
        W = Q + P @ S @ P
        spread = F @ M @ F.T + W  # B, Eq. (4.24)
        Lambda = np.linalg.inv(M) - F.T @ np.linalg.solve(spread, F)
        least.append(float(np.linalg.eigvalsh((Lambda + Lambda.T) / 2)[0]))
        blocks.append(spread)
    L = np.kron(laplacian, np.eye(len(rows)))
    B = np.zeros_like(L)
    for i, block in enumerate(blocks):
        at = slice(i * len(rows), (i + 1) * len(rows))
        B[at, at] = block
    F_all = np.kron(np.eye(len(agents)), F)
    below = F_all.T @ L @ B @ L @ F_all
    top = float(np.linalg.eigvalsh((below + below.T) / 2)[-1])
    return math.sqrt(max(min(least), 0.0) / top) if top > 0 else math.inf


def star(agents: int) -> Array:
    """Laplacian of a network in which all others are joined to the first."""
    L = np.zeros((agents, agents))
    L[0, 0] = agents - 1
    for i in range(1, agents):
        L[i, i], L[0, i], L[i, 0] = 1, -1, -1
    return L
