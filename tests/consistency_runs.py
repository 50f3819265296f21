"""NEES of one seeded `city` drive: shared by the consistency test and its benchmark."""

from typing import Any

import numpy as np

from fgloc.config import load_config
from fgloc.datasets import make
from fgloc.drive import Drive
from fgloc.evaluation import errors
from fgloc.smoother import smooth
from fgloc.trajectory import Trajectory

NAMES = ("position filtered", "pose filtered", "position smoothed", "pose smoothed")
DOF = (3, 6, 3, 6)


CAR = {"wheel_speed": True, "non_holonomic": True, "zero_velocity": True,
       "pitch_rad_per_mps2": 0.0, "point_sigma_m": 0.05}  # fmt: skip
"""What is true of the car of `city`: no springs, and an axle that is where the rig says."""


def nees_with_car(seed: int, duration_s: float = 60.0) -> tuple[float, float, float, float]:
    """The same with wheel speeds and all constraints of the vehicle."""
    return nees_of_drive(seed, duration_s, CAR)


def nees_of_drive(
    seed: int, duration_s: float = 60.0, vehicle: dict[str, Any] | None = None
) -> tuple[float, float, float, float]:
    """Mean NEES over a drive, in the order of `NAMES`: fixed lag, then batch.

    Scored at the instants that an estimate and the truth share, from the one on at which the
    fixed lag's yaw is observable; NaN where it never is.
    """
    drive = make("city", seed=seed, duration_s=duration_s)
    filtered = smooth(drive, load_config(mode="fixed-lag", vehicle=vehicle or {}))
    smoothed = smooth(drive, load_config(mode="batch", vehicle=vehicle or {}))
    seen_s = filtered.summary["yaw_observable_s"]
    if seen_s is None:
        return (np.nan,) * 4
    from_ns = int(filtered.trajectory.t_ns[0]) + round(seen_s * 1e9)
    return (
        *_mean_nees(filtered.trajectory, drive, from_ns),
        *_mean_nees(smoothed.trajectory, drive, from_ns),
    )


def _mean_nees(estimate: Trajectory, drive: Drive, from_ns: int) -> tuple[float, float]:
    """Of position and of pose, at shared instants only: no covariance is interpolated."""
    assert drive.truth is not None
    shared = drive.truth.take(np.isin(drive.truth.t_ns, estimate.t_ns))
    scored = errors(estimate, shared, score_from_ns=from_ns)
    return float(scored.nees_position.mean()), float(scored.nees_pose.mean())
