"""Motion along a straight, level road at one speed, with lane changes along a smooth step.

Every derivative is a closed formula of time, so what sensors say fits the truth exactly.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fgloc.datasets.simulator import Motion
from fgloc.frames import yaw_matrix
from fgloc.measurements import Array
from fgloc.timing import Instants, elapsed_s


@dataclass(frozen=True)
class LaneChange:
    """From `start_s` on, to the left by `left_m`, within `duration_s`."""

    start_s: float
    duration_s: float
    left_m: float


def lane_motion(
    t_ns: Instants, start_m: Array, heading_rad: float, speed_mps: float,
    changes: Sequence[LaneChange] = (),
) -> Motion:  # fmt: skip
    """The vehicle frame at instants (N,), from `start_m` (3,) at the first; `speed_mps` is along
    the road, which lies at `heading_rad` from East."""
    t_s, n = elapsed_s(t_ns, int(t_ns[0])), len(t_ns)
    left = sum((_smooth_step(t_s, change) for change in changes), np.zeros((4, n)))
    along = np.array([np.cos(heading_rad), np.sin(heading_rad), 0.0])
    to_left = np.array([-along[1], along[0], 0.0])
    p = start_m + np.outer(speed_mps * t_s, along) + np.outer(left[0], to_left)
    v = speed_mps * along + np.outer(left[1], to_left)
    square = speed_mps**2 + left[1] ** 2
    turn, turn_rate = np.zeros((2, n, 3))
    turn[:, 2] = speed_mps * left[2] / square
    turn_rate[:, 2] = speed_mps * (left[3] / square - 2 * left[1] * left[2] ** 2 / square**2)
    yaw_rad = heading_rad + np.arctan2(left[1], speed_mps)
    return Motion(
        t_ns, p, v, np.outer(left[2], to_left), yaw_matrix(yaw_rad), turn, turn_rate
    )  # fmt: skip


def _smooth_step(t_s: Array, change: LaneChange) -> Array:
    """(4, N): 10x^3 - 15x^4 + 6x^5 over the change's time, in m, and its three derivatives."""
    x = np.clip((t_s - change.start_s) / change.duration_s, 0, 1)
    rates = change.duration_s ** -np.arange(4.0)
    changing = (x > 0) & (x < 1)
    derivatives = np.stack(
        [
            x**3 * (10 - 15 * x + 6 * x**2),
            30 * x**2 * (1 - x) ** 2,
            60 * x * (1 - x) * (1 - 2 * x),
            np.where(changing, 60 * (1 - 6 * x + 6 * x**2), 0.0),
        ]
    )
    return change.left_m * rates[:, None] * derivatives
