"""What filters of the plane have in common: covariances of six dimensions, and their summary."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from fgloc.drive import Drive
from fgloc.measurements import Array
from fgloc.trajectory import Trajectory
from fgloc.verdicts import Verdicts, counts

UNKNOWN_ROTATION_RAD2 = np.pi**2 / 3
"""Variance of an angle uniform over the circle: of an attitude that nothing is said of."""


def with_unknown_attitude(cov_position_m2: Array) -> Array:
    """Covariances (N, 6, 6) of positions with (N, 3, 3) in m^2 and an attitude that is unknown."""
    cov = np.zeros((len(cov_position_m2), 6, 6))
    cov[:, :3, :3] = cov_position_m2
    cov[:, 3:, 3:] = UNKNOWN_ROTATION_RAD2 * np.eye(3)
    return cov


def summarize(
    drive: Drive, method: str, mode: str, trajectory: Trajectory, verdicts: Verdicts,
    more: Mapping[str, Any] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """What summary.json holds of a baseline's run; `more` are figures of its own."""
    return {
        "drive": drive.name,
        "method": method,
        "mode": mode,
        "states": len(trajectory),
        "factors": 0,
        "counts": counts(verdicts),
        "origin": asdict(drive.origin),
        "duration_s": float(trajectory.t_ns[-1] - trajectory.t_ns[0]) / 1e9,
        **(more or {}),
    }
