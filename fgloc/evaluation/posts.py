"""Estimated states of posts held against the truth: `posts.{node}.*`, in mm and mrad."""

import numpy as np

from fgloc.drive import Drive
from fgloc.evaluation.metric import Metric
from fgloc.measurements import Array
from fgloc.posts import PostStates
from fgloc.timing import NS_PER_S, elapsed_s, seconds_to_ns

MAX_GAP_S = 0.5
"""States further apart than this say nothing of the time between them."""
_PARTS = (
    ("p_node_m", ("x", "y"), "mm"), ("tilt_rad", ("roll", "pitch"), "mrad"),
    ("v_node_mps", ("vx", "vy"), "mmps"),
)  # fmt: skip
_UNITS = {"mm": "mm", "mrad": "mrad", "mmps": "mm/s"}


def score_posts(
    posts: PostStates | None, drive: Drive, *, score_from_s: float = 0.0
) -> dict[str, Metric]:
    """Metrics of every post that both the estimate and the truth tell of; none without either.

    Of x, y, roll, pitch and the velocities: RMSE and largest error at the estimate's instants, the
    truth interpolated to them. `between_rmse_mm` is of the displacement at the truth's instants,
    the estimate interpolated with its velocities: what is too fast for its samples shows there.
    `anees` and `coverage95` are of x and y against the claimed sigmas.
    """
    if posts is None or drive.post_truth is None or not len(posts):
        return {}
    start_ns = int(posts.t_ns[0]) + seconds_to_ns(score_from_s)
    found: dict[str, Metric] = {}
    for node in np.unique(posts.node).tolist():
        name = drive.infrastructure.nodes[node].name
        truth, estimate = drive.post_truth.of(node), posts.of(node)
        if len(truth):
            estimate = estimate.take(_inside(estimate, truth, start_ns))
            found |= {f"posts.{name}.{key}": m for key, m in _scores(estimate, truth).items()}
    return found


def post_errors(estimate: PostStates, truth: PostStates, column: str) -> Array:
    """Estimate minus truth (n, 2) of one column, at the estimate's instants."""
    return np.asarray(getattr(estimate, column) - _at(truth, column, estimate))


def _inside(estimate: PostStates, truth: PostStates, start_ns: int) -> Array:
    t = estimate.t_ns
    return np.asarray((t >= start_ns) & (t >= truth.t_ns[0]) & (t <= truth.t_ns[-1]))


def _at(states: PostStates, column: str, where: PostStates) -> Array:
    t, at = (elapsed_s(table.t_ns, int(states.t_ns[0])) for table in (states, where))
    return np.stack([np.interp(at, t, axis) for axis in getattr(states, column).T], -1)


def _scores(estimate: PostStates, truth: PostStates) -> dict[str, Metric]:
    if not len(estimate):
        why = "no state of the estimate lies within the truth"
        return {f"{axis}_rmse_{unit}": Metric(None, _UNITS[unit], why=why)
                for _, axes, unit in _PARTS for axis in axes}  # fmt: skip
    found: dict[str, Metric] = {}
    for column, axes, unit in _PARTS:
        error = 1000 * post_errors(estimate, truth, column)
        for k, axis in enumerate(axes):
            found |= _size(error[:, k], axis, unit)
    return found | _between(estimate, truth) | _claims(estimate, truth)


def _size(error: Array, axis: str, unit: str) -> dict[str, Metric]:
    """RMSE and largest error of one column where it is told."""
    size, names = np.abs(error[np.isfinite(error)]), (f"{axis}_rmse_{unit}", f"{axis}_max_{unit}")
    if not len(size):
        return dict.fromkeys(names, Metric(None, _UNITS[unit], why="the estimate does not tell it"))
    values = (float(np.sqrt(np.mean(size**2))), float(size.max()))
    return {name: Metric(value, _UNITS[unit], n=len(size))
            for name, value in zip(names, values, strict=True)}  # fmt: skip


def _between(estimate: PostStates, truth: PostStates) -> dict[str, Metric]:
    """Of the length of the horizontal error at all instants of the truth."""
    name = "between_rmse_mm"
    if len(estimate) < 2 or not np.isfinite(estimate.v_node_mps).all():
        why = "the estimate has no velocity, or one state alone"
        return {name: Metric(None, "mm", why=why)}
    from scipy.interpolate import CubicHermiteSpline

    t = elapsed_s(estimate.t_ns, int(estimate.t_ns[0]))
    at = (truth.t_ns - estimate.t_ns[0]) / NS_PER_S
    k = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
    keep = (at >= 0) & (at <= t[-1]) & (np.diff(t)[k] <= MAX_GAP_S)
    if not keep.any():
        return {name: Metric(None, "mm", why=f"all states are more than {MAX_GAP_S} s apart")}
    curve = CubicHermiteSpline(t, estimate.p_node_m, estimate.v_node_mps)
    error = 1000 * (curve(at[keep]) - truth.p_node_m[keep])
    rmse = float(np.sqrt(np.mean(np.sum(error**2, -1))))
    return {name: Metric(rmse, "mm", n=int(keep.sum()))}


def _claims(estimate: PostStates, truth: PostStates) -> dict[str, Metric]:
    parts = post_errors(estimate, truth, "p_node_m") / estimate.sigma_p_m
    if not np.isfinite(parts).all():
        why = "the estimate claims no sigma of displacement"
        return {name: Metric(None, "1", why=why) for name in ("anees", "coverage95")}
    inside, n = float(np.mean(np.abs(parts) < 1.959964)), len(parts)
    return {
        "anees": Metric(float(np.mean(parts**2)), "1", "target", n, target=1.0),
        "coverage95": Metric(inside, "1", "target", n, target=0.95),
    }
