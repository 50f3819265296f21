"""A post that sways: its state, how it moves under the wind, and what pose estimates say of it.

Khamooshi (2023), Eqs. (3.17) to (3.28). Along each of the node's level axes the tip is an
oscillator that a load drives, and the load forgets itself (Ornstein-Uhlenbeck):

    x'' = -w^2 x - 2 xi w x' + a,   a' = -a / tau + n,   E[a^2] = s^2

State of a post (6,): x, x', a along the node's x axis, then the same along y; a is the load over
the modal mass, m/s^2. Sampling is exact for any step, by matrix exponentials. The tip tilts with
its displacement: where it moves to +x it leans to +x, a positive turn about y (pitch); where it
moves to +y, a negative one about x (roll).

# Differs from the paper: it has no model of the load, observes around it, and gives both angles the
sign of the displacement; here roll and pitch turn right-handed about the node's x and y axes.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fgloc.factors.linear import linear_factor
from fgloc.infrastructure import Post
from fgloc.measurements import Array

if TYPE_CHECKING:
    import gtsam

POSITION, VELOCITY, LOAD = [0, 3], [1, 4], [2, 5]
"""Where the state has displacement, velocity and load, each along x and y."""

ROUNDING = np.array([1e-5, 1e-4, 1e-2])
"""Sigmas of displacement, velocity and load (m, m/s, m/s^2) that each step of a graph may lose."""

_LONG, _NODES = 5.0, 24
"""A step is long where the fastest part of the motion turns by more rad; below, so many nodes are
exact to rounding."""


class Step(NamedTuple):
    """How a state goes on: x(t + dt) = transition x(t) + noise of covariance `noise`."""

    transition: Array
    noise: Array


def oscillator(frequency_hz: float, damping: float) -> Array:
    """The matrix (2, 2) of displacement and velocity. # Eq. (3.23)"""
    w = 2 * np.pi * frequency_hz
    return np.array([[0.0, 1.0], [-(w**2), -2 * damping * w]])


def sampled(A: Array, density: Array, dt_s: float) -> Step:
    """x' = A x + white noise of this spectral density (n, n), A stable, exactly over `dt_s`.

    The noise is the integral of e^(As) density e^(A's): by Gauss's quadrature over a short step,
    which keeps it positive however short, and over a long one as what the spread of all times
    lacks after the step.
    """
    from scipy.linalg import expm

    transition = expm(A * dt_s)
    if np.abs(np.linalg.eigvals(A)).max() * dt_s > _LONG:
        spread = _spread(A, density)
        return Step(transition, _even(spread - transition @ spread @ transition.T))
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    grown = expm(A * (dt_s * (nodes + 1) / 2)[:, None, None])
    parts = (dt_s * weights / 2)[:, None, None] * (grown @ density @ grown.swapaxes(-1, -2))
    return Step(transition, _even(parts.sum(0)))


def white_load_step(frequency_hz: float, damping: float, density_m2ps3: float, dt_s: float) -> Step:
    """One axis without a load in its state: white wind acceleration of a density, (m/s^2)^2 / Hz
    (two-sided), as noise of displacement and velocity (2, 2)."""
    return sampled(oscillator(frequency_hz, damping), np.diag([0.0, density_m2ps3]), dt_s)


def axis_step(post: Post, dt_s: float) -> Step:
    """One axis with its load, (3, 3)."""
    return _axis_step(*_numbers(post), float(dt_s))


def axis_spread(post: Post) -> Array:
    """Covariance (3, 3) of one axis that the wind has driven for long."""
    return _spread(*_axis(*_numbers(post)))


def post_step(post: Post, dt_s: float) -> Step:
    """Both axes, (6, 6)."""
    return Step(*(_twice(part) for part in axis_step(post, dt_s)))


def whitened_steps(post: Post, dt_s: Array) -> tuple[Array, Array]:
    """Blocks (m, 6, 6) of the later state and of the earlier one for steps of (m,) s, with noise
    of one.

    A graph may have states that are microseconds apart; there the wind does so little that a
    solver of finite precision would lose it, so a noise of `ROUNDING` is added.
    """
    steps_s, which = np.unique(dt_s, return_inverse=True)
    transition, noise = _axis_steps(*_axis(*_numbers(post)), steps_s)
    root = np.linalg.inv(np.linalg.cholesky(noise + np.diag(ROUNDING) ** 2))
    return _twice(root)[which], -_twice(root @ transition)[which]


def post_spread(post: Post) -> Array:
    """Both axes, (6, 6)."""
    return _twice(axis_spread(post))


def tilt_rad(p_node_m: Array, tip_slope_per_m: float) -> Array:
    """Roll and pitch (N, 2) of a tip displaced by (N, 2). # Eq. (3.19), bent"""
    return tip_slope_per_m * np.stack([-p_node_m[:, 1], p_node_m[:, 0]], -1)


def pose_jacobian(tip_slope_per_m: float) -> Array:
    """(4, 6): displacement x, y, roll and pitch by the state. # Eq. (3.28), in rad and m"""
    J = np.zeros((4, 6))
    J[[0, 1], POSITION] = 1.0
    J[2, POSITION[1]], J[3, POSITION[0]] = -tip_slope_per_m, tip_slope_per_m
    return J


def pose_residual(states: Array, p_node_m: Array, tilt: Array, tip_slope_per_m: float) -> Array:
    """Predicted minus measured (N, 4): displacement (N, 2) m, roll and pitch (N, 2) rad.

    The Jacobian by the state is `pose_jacobian` for every row.
    """
    return states @ pose_jacobian(tip_slope_per_m).T - np.concatenate([p_node_m, tilt], -1)


def rest_factor(key: int, post: Post) -> gtsam.LinearContainerFactor:
    """What is known of the first state: the wind has blown for long."""
    root = np.linalg.inv(np.linalg.cholesky(post_spread(post)))
    return linear_factor({key: root}, np.zeros(6))


def sway_factor(key: int, later_key: int, post: Post, dt_s: float) -> gtsam.LinearContainerFactor:
    """The native factor between two states of a post, `dt_s` > 0 apart."""
    after, before = _whitened_step(post, float(dt_s))
    return linear_factor({key: before, later_key: after}, np.zeros(6))


def pose_factor(
    key: int, told: Array, sigmas: Array, tip_slope_per_m: float
) -> gtsam.LinearContainerFactor:
    """The native factor of `pose_residual`; `told` and `sigmas` (4,), NaN where nothing is told."""
    known = np.isfinite(told)
    J = pose_jacobian(tip_slope_per_m)[known] / sigmas[known, None]
    return linear_factor({key: J}, told[known] / sigmas[known])


def _numbers(post: Post) -> tuple[float, float, float, float]:
    """What the motion depends on: frequency, damping, load over modal mass, its memory."""
    sigma_mps2 = post.load_sigma_n / post.modal_mass_kg
    return post.frequency_hz, post.damping, sigma_mps2, post.load_tau_s


def _axis(
    frequency_hz: float, damping: float, sigma_mps2: float, tau_s: float
) -> tuple[Array, Array]:
    A = np.zeros((3, 3))
    A[:2, :2] = oscillator(frequency_hz, damping)
    A[1, 2], A[2, 2] = 1.0, -1 / tau_s
    return A, np.diag([0.0, 0.0, 2 * sigma_mps2**2 / tau_s])


@lru_cache(maxsize=1024)
def _axis_step(
    frequency_hz: float, damping: float, sigma_mps2: float, tau_s: float, dt_s: float
) -> Step:
    return sampled(*_axis(frequency_hz, damping, sigma_mps2, tau_s), dt_s)


def _axis_steps(A: Array, density: Array, dt_s: Array) -> Step:
    """`sampled` for many steps (m,) at once: transitions and noises (m, n, n).

    By the eigenvectors of A, which are distinct where it swings and has a damping below 1.
    """
    values, V = np.linalg.eig(A)
    back = np.linalg.inv(V)

    def grown(t_s: Array) -> Array:
        return np.asarray((V * np.exp(values * t_s[..., None])[..., None, :]) @ back).real

    transition = grown(dt_s)
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    within = grown(dt_s[:, None] * (nodes + 1) / 2)
    shares = dt_s[:, None] * weights / 2
    short = np.einsum("tk,tkij,jl,tkml->tim", shares, within, density, within, optimize=True)
    spread = _spread(A, density)
    long = spread - transition @ spread @ transition.swapaxes(-1, -2)
    is_long = np.abs(values).max() * dt_s > _LONG
    noise = np.where(is_long[:, None, None], long, short)
    return Step(transition, (noise + noise.swapaxes(-1, -2)) / 2)


def _spread(A: Array, density: Array) -> Array:
    """Covariance of x' = A x + noise that has gone on for long."""
    from scipy.linalg import solve_continuous_lyapunov

    return _even(solve_continuous_lyapunov(A, -density))


def _even(covariance: Array) -> Array:
    """Without the asymmetry of rounding."""
    return (covariance + covariance.T) / 2


def _whitened_step(post: Post, dt_s: float) -> tuple[Array, Array]:
    """Blocks (6, 6) of the later state and of the earlier one, with noise of one."""
    transition, noise = axis_step(post, dt_s)
    root = np.linalg.inv(np.linalg.cholesky(noise))
    return _twice(root), -_twice(root @ transition)


def _twice(block: Array) -> Array:
    """The same for either axis; of blocks (..., 3, 3)."""
    both = np.zeros((*block.shape[:-2], 6, 6))
    both[..., :3, :3] = both[..., 3:, 3:] = block
    return both
