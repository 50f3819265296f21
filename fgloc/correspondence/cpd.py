"""Rigid coherent point drift between a node's objects and the car's.

Khamooshi (2023), section 4.2.3, Algorithm 4.2, after Myronenko and Song, Point set registration:
coherent point drift (2010).

| thesis | here |
|---|---|
| p^G, data points | `p_world_m` (N, 2) |
| p^rel, centroids of the mixture | `p_veh_m` (M + 1, 2), 0 among them |
| w, weight of the uniform distribution | `W` |
| sigma^2 | `variance_m2` |
| C_mn | `posterior` (M + 1, N) |
"""

import math

import numpy as np

from fgloc.correspondence.icp import EPS_M, GATE_M, J_MAX, STILL
from fgloc.correspondence.rigid import (
    IDENTITY,
    Correspondence,
    Rigid,
    check_points,
    fit,
    mutual_nearest,
    plain,
    squared_distances,
    wrapped,
)
from fgloc.measurements import Array

W = 0.1
"""Not printed; a tenth of the broadcast objects are taken for outliers."""
_LEAST_VARIANCE_M2 = 1e-4  # points without noise would divide by 0


def cpd(
    p_world_m: Array,
    p_veh_m: Array,
    start: Rigid = IDENTITY,
    *,
    printed: bool = False,
    sigma_m: float | None = None,
    gate_m: float = GATE_M,
) -> Correspondence:
    """Match the car's points (M, 2) to a node's (N, 2), from a first guess of the car's pose.

    printed  the variance of the mixture stays as it began, and each step moves points twice
    sigma_m  the mixture's first sigma; without one, the spread of all pairs, as in the thesis. A
             warm start is lost in that spread: give it the error that the guess may have
    Raises InputError where the points are not finite or not of two columns.
    """
    world, veh = check_points("p_world_m", p_world_m), check_points("p_veh_m", p_veh_m)
    if not len(world) or not len(veh):
        return plain(start, np.empty((0, 2), np.int64), 0)
    pose, step = start, start
    squares = squared_distances(pose.apply(veh), world)
    variance = float(squares.mean()) / 2 if sigma_m is None else sigma_m**2
    for j in range(1, J_MAX + 1):
        # Differs from the paper (mended form): points that have moved are not moved once more.
        seen_from = step.after(pose) if printed and j > 1 else pose
        posterior = _posterior(squared_distances(seen_from.apply(veh), world), variance)
        found = _registration(posterior, world, veh)
        step = found.after(_inverse(pose))
        pose = found
        squares = squared_distances(pose.apply(veh), world)
        if not printed:
            variance = max(float((posterior * squares).sum() / (2 * posterior.sum())),
                           _LEAST_VARIANCE_M2)  # fmt: skip
        still = max(abs(wrapped(step.yaw_rad)), *np.abs(step.t_m)) < STILL
        if np.sqrt(squares.min(0)).mean() < EPS_M or (still and not printed):
            break
    pairs = mutual_nearest(squares)
    return plain(pose, pairs[np.sqrt(squares[pairs[:, 0], pairs[:, 1]]) < gate_m], j)


def _posterior(squares_m2: Array, variance_m2: float) -> Array:
    """(M, N) that a centroid made a point. Eq. (4.4), with 1 / (M + 1) for the 1 / M of (4.2)."""
    M, N = squares_m2.shape
    likelihood = np.exp(-squares_m2 / (2 * variance_m2))
    outlier = 2 * math.pi * variance_m2 * W / (1 - W) * M / N
    # Differs from the paper: the sum goes over the centroids; `outlier` is the part of M + 1.
    return likelihood / (likelihood.sum(0) + outlier)


def _registration(posterior: Array, world: Array, veh: Array) -> Rigid:
    """The motion that minimises Eq. (4.8): every pair, weighted by its posterior."""
    m, n = np.indices(posterior.shape).reshape(2, -1)
    return fit(veh[m], world[n], posterior.ravel())


def _inverse(pose: Rigid) -> Rigid:
    turned = Rigid(-pose.yaw_rad, np.zeros(2))
    return Rigid(-pose.yaw_rad, -turned.apply(pose.t_m[None])[0])
