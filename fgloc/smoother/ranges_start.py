"""Where a drive with ranges starts: many guesses, each fitted, the cheapest taken."""

import numpy as np

from fgloc.measurements import Array
from fgloc.smoother.ranges_model import Blocks, OdometrySteps, RangeModel, WindowModel
from fgloc.smoother.ranges_solve import step

REACH_M, GRID_M, PLACES, HEADINGS = 80.0, 2.0, 4, 8
START_S, START_WAY_M = 5.0, 15.0
"""The start is sought in so much time, and with odometry in so much way: a heading shows then."""
FIRST_TRIES, KEPT = 8, 4
"""Iterations of each guess, and how many of the cheapest then go on."""
ITERATIONS, SETTLED = 40, 1e-6


def start(model: RangeModel) -> tuple[Array, Array]:
    """States (N, m) of the drive's first part, and the globals (G,), from the best guess."""
    n = _first_part(model)
    globals_, _ = model.prior
    tried = [optimize(model, guess, globals_, FIRST_TRIES) for guess in _guesses(model, n)]
    best = sorted(tried, key=lambda fit: fit[2])[:KEPT]
    fits = [optimize(model, states, found) for states, found, _ in best]
    states, globals_, _ = min(fits, key=lambda fit: fit[2])
    return states, globals_


def optimize(
    model: WindowModel, states: Array, globals_: Array, iterations: int = ITERATIONS
) -> tuple[Array, Array, float]:
    """States (N, m) and globals (G,) that cost least, from the first epoch on, and what they cost:
    Levenberg-Marquardt."""
    damping, blocks = 1e-3, with_priors(model, states, globals_)
    for _ in range(iterations):
        d_states, d_globals = step(blocks, damping)
        moved = with_priors(model, states + d_states, globals_ + d_globals)
        if moved.cost > blocks.cost:
            damping *= 10
            if damping > 1e6:
                break
            continue
        gain = blocks.cost - moved.cost
        states, globals_, blocks = states + d_states, globals_ + d_globals, moved
        damping = max(damping / 10, 1e-9)
        if gain < SETTLED * (1 + blocks.cost):
            break
    return states, globals_, blocks.cost


def with_priors(model: WindowModel, states: Array, globals_: Array) -> Blocks:
    """The whole drive's equations, with what is known beforehand."""
    blocks = model.linearize(states, globals_, 0)
    mean, sigma = model.prior
    blocks.globals_ += np.diag(sigma**-2.0)
    blocks.gradient_globals += (globals_ - mean) / sigma**2
    blocks.cost += float((((globals_ - mean) / sigma) ** 2).sum() / 2)
    blocks.diagonal[0] += np.eye(states.shape[1]) / model.start_sigma**2
    return blocks


def _first_part(model: RangeModel) -> int:
    """How many epochs the start is sought in."""
    n = int(START_S / model.settings.interval_s) + 2
    if isinstance(model.motion, OdometrySteps):
        way_m = np.cumsum(np.abs(model.motion.way_m))
        n = max(n, int(np.searchsorted(way_m, START_WAY_M)) + 2)
    return min(n, len(model.epochs_ns))


def _guesses(model: RangeModel, n: int) -> list[Array]:
    """Paths (n, m) from the likeliest places, in all directions where there is odometry."""
    globals_, _ = model.prior
    paths = []
    for place in _places(model):
        turns = np.arange(HEADINGS) * 2 * np.pi / HEADINGS if model.motion.size == 3 else [0.0]
        for yaw in turns:
            first = np.r_[place, yaw] if model.motion.size == 3 else np.r_[place, 0.0, 0.0]
            path = [first]
            for k in range(n - 1):
                path.append(model.motion.predict(path[-1], globals_, k))
            paths.append(np.array(path))
    return paths


def _places(model: RangeModel) -> Array:
    """(P, 2) places that fit the ranges of the first seconds best, apart from each other."""
    rows = slice(0, max(int(model.first_row[min(int(START_S / model.settings.interval_s),
                                                len(model.epochs_ns) - 1)]), 8))  # fmt: skip
    if isinstance(model.motion, OdometrySteps):
        rows = slice(0, 8)
    anchors, range_m = model.place_m[rows, :2], model.ranges.range_m[rows]
    side = np.arange(-REACH_M, REACH_M + GRID_M, GRID_M)
    grid = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2) + model.place_m[:, :2].mean(0)
    off = np.linalg.norm(grid[:, None] - anchors, axis=-1) - range_m
    order = np.argsort(np.abs(off).mean(1))
    taken: list[Array] = []
    for place in grid[order]:
        if all(np.linalg.norm(place - other) > 2 * GRID_M for other in taken):
            taken.append(place)
        if len(taken) == PLACES:
            break
    return np.array(taken)
