"""Methods `khamooshi2023-ckf`: constrained Kalman filter over a node's camera and LiDAR.

Khamooshi, Cooperative perception and localization for autonomous driving (thesis, Waterloo, 2023),
sections 3.2 to 3.4, with the mends below.

| thesis | here |
|---|---|
| X_k = [x, y, psi] | `x` (3,), `P` (3, 3) |
| u_k = [V, yaw rate], or the steering angle delta | odometry; delta = L yaw rate / V |
| Z_k, R_k, v = a_n d^2, Eq. (3.16) | `Sightings` |
| X_k^*, n_p, T, Eq. (3.15) | `_from_the_past`, `N_P`, `SOFT_SIGMA` |
| D X = d, Eq. (3.14) | `_project` |

Differs from the paper: the prediction keeps the input (3.12 drops it); the predicted covariance,
not Q, weighs the prediction in (3.15); Y' = V sin(psi) as in (3.7), not V psi; d is the slant
range; F holds what the heading does to the position (with F = I nothing corrects the heading).
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc.baselines.sightings import (
    Sightings,
    detections_of,
    inputs_at,
    usable_rows,
)
from fgloc.correspondence.results import planar_result
from fgloc.drive import Drive
from fgloc.measurements import Array, GnssFixes, NodeDetections
from fgloc.result import Result
from fgloc.timing import Instants
from fgloc.verdicts import SourceVerdicts, Verdict

A_N = {"camera": (2.5e-4, 1.9e-4), "lidar": (7.1e-4, 5.4e-4)}
"""Variance over the square of the slant range, in x and in y; not printed, see the scenario."""
A_N_OTHER = (3e-4, 3e-4)
"""Of nodes that do not say what they are."""
Q_SIGMA = (0.28, 0.10, 0.02)
"""Of x, y (m) and psi (rad) over `STEP_S`; not printed: with these the second stage of scenario 1
has about the error that is."""
STEP_S = 0.1
N_P = 10
SOFT_SIGMA = (0.6, 0.3, 0.1)
"""Root of T, Eq. (3.15): how far the polynomial may be off; not printed."""
WHEELBASE_M = 2.8
FIRST_YAW_SIGMA_RAD = 0.3


@dataclass(frozen=True)
class Stages:
    """What is switched on, and which nodes and object are meant.

    motion     '' for none, each instant by itself; 'velocity' (3.3); 'bicycle' (3.5)
    hard       no lateral motion in the last heading, by projection
    soft       a second-order polynomial through the last estimates, as a pseudo-measurement
    nodes      names of the nodes begin with this
    gnss       whether fixes of the car are taken as a sensor more
    object_id  number of the object that is followed
    """

    motion: str = "velocity"
    hard: bool = True
    soft: bool = True
    nodes: str = ""
    gnss: bool = True
    object_id: int = 0


def run(drive: Drive) -> Result:
    """The whole filter: motion model, hard and soft constraints."""
    return run_stages(drive, Stages(), "khamooshi2023-ckf")


def run_free(drive: Drive) -> Result:
    """Without constraints."""
    return run_stages(drive, Stages(hard=False, soft=False), "khamooshi2023-ckf:free")


def run_sensors(drive: Drive) -> Result:
    """Neither motion model nor constraints: the weighted mean of what is measured at an instant."""
    return run_stages(drive, Stages("", hard=False, soft=False), "khamooshi2023-ckf:sensors")


def run_hard(drive: Drive) -> Result:
    """The hard constraint alone."""
    return run_stages(drive, Stages(soft=False), "khamooshi2023-ckf:hard")


def run_soft(drive: Drive) -> Result:
    """The soft constraint alone."""
    return run_stages(drive, Stages(hard=False), "khamooshi2023-ckf:soft")


def run_bicycle(drive: Drive) -> Result:
    """The second motion model, with constraints."""
    return run_stages(drive, Stages("bicycle"), "khamooshi2023-ckf:bicycle")


def run_stages(drive: Drive, stages: Stages, method: str = "khamooshi2023-ckf") -> Result:
    """The filter with the stages that are asked for.

    Raises DriveError where the drive has no detections of the object, or no odometry although the
    motion model needs it.
    """
    seen = detections_of(drive)
    verdicts = {
        name: SourceVerdicts.of(name, table, Verdict.UNUSED, f"{method} does not take {name}")
        for name, table in drive.tables.items()
    }
    rows = usable_rows(drive, seen, stages.object_id, stages.nodes, verdicts[seen.KIND])
    t_ns = np.unique(seen.t_ns[rows])
    fixes = drive.tables.get("gnss") if stages.gnss else None
    by_time = [_at(drive, seen, rows[seen.t_ns[rows] == t], fixes, int(t)) for t in t_ns]
    inputs = inputs_at(drive, t_ns) if stages.motion else np.zeros((len(t_ns), 2))
    for name, taken in (("gnss", stages.gnss), ("odometry", bool(stages.motion))):
        if name in verdicts and taken:
            verdicts[name].set(np.isin(verdicts[name].t_ns, t_ns), Verdict.USED)
    x, P = _filter(by_time, t_ns, inputs, stages)
    return planar_result(drive, method, t_ns, x, P, verdicts)


def _at(
    drive: Drive, seen: NodeDetections, rows: NDArray[np.int64], fixes: object, t_ns: int
) -> Sightings:
    """All that is measured of the object at one instant."""
    nodes = [drive.infrastructure.nodes[i] for i in seen.node[rows]]
    z = [node.to_world(seen.p_node_m[row]) for node, row in zip(nodes, rows, strict=True)]
    place = [node.p_world_m for node in nodes]
    a = [A_N.get(node.name.rpartition("/")[2], A_N_OTHER) for node in nodes]
    cov = [np.full((2, 2), np.nan)] * len(nodes)
    if isinstance(fixes, GnssFixes):
        for row in np.flatnonzero(fixes.t_ns == t_ns):
            z, place = [*z, fixes.p_world_ant_m[row, :2]], [*place, np.zeros(3)]
            a, cov = [*a, (math.nan, math.nan)], [*cov, fixes.cov_world_m2[row, :2, :2]]
    return Sightings(np.array(z), np.array(place), np.array(a), np.array(cov))


def _filter(
    by_time: list[Sightings], t_ns: Instants, inputs: Array, stages: Stages
) -> tuple[Array, Array]:
    """States (N, 3) and covariances (N, 3, 3) after each instant."""
    x, P = _begin(by_time, t_ns)
    past: deque[Array] = deque(maxlen=N_P)
    states = []
    for k, sightings in enumerate(by_time):
        last, P_last, F = x, P, np.eye(3)
        if not stages.motion:
            x, P = _by_itself(x, sightings)
        elif k:
            dt_s = float(t_ns[k] - t_ns[k - 1]) / 1e9
            x, P, F = _predict(x, P, inputs[k - 1], dt_s, stages.motion)
        expected, P_expected = x, P
        H, z, R = _stacked(sightings, x)
        if stages.soft and len(past) == N_P:
            H, z, R = _with_soft(H, z, R, np.array(past))
        x, P = _update(x, P, H, z, R)  # Eq. (3.13) and (3.15)
        if stages.hard and past:
            corrected = last + P_last @ F.T @ np.linalg.solve(P_expected, x - expected)
            x = _project(x, P, last[2], corrected)
        past.append(x)
        states.append((x, P))
    return np.array([x for x, _ in states]), np.array([P for _, P in states])


def _begin(by_time: list[Sightings], t_ns: Instants) -> tuple[Array, Array]:
    """The first sighting, and the heading of the first of the path."""
    means = [s.z_m.mean(0) for s in by_time[: 2 * N_P]]
    ahead = np.polyfit((t_ns[: len(means)] - t_ns[0]) / 1e9, np.array(means), 1)[0] if (
        len(means) > 1
    ) else np.array([1.0, 0.0])  # fmt: skip
    x = np.array([*means[0], math.atan2(ahead[1], ahead[0])])
    return x, np.diag([1.0, 1.0, FIRST_YAW_SIGMA_RAD**2])


def _by_itself(x: Array, sightings: Sightings) -> tuple[Array, Array]:
    """Nothing but what is measured now."""
    return np.array([*sightings.z_m.mean(0), x[2]]), np.diag([1e6, 1e6, math.pi**2 / 3])


def _predict(x: Array, P: Array, u: Array, dt_s: float, motion: str) -> tuple[Array, Array, Array]:
    """One step of either motion model, both with the input held over the step."""
    V, rate = u
    c, s = math.cos(x[2]), math.sin(x[2])
    F, moved = np.eye(3), x + dt_s * np.array([V * c, V * s, rate])  # Eq. (3.3), (3.4)
    F[:2, 2] = dt_s * V * np.array([-s, c])
    if motion == "bicycle":
        # Eq. (3.7) to (3.10), linearised at the last heading; exp(F dt) and its integral.
        delta_rad = WHEELBASE_M * rate / V if V else 0.0
        turn = V / WHEELBASE_M * delta_rad
        moved[1] += V * c * turn * dt_s**2 / 2
    Q = np.diag(np.square(Q_SIGMA)) * dt_s / STEP_S
    return moved, F @ P @ F.T + Q, F


def _stacked(sightings: Sightings, x: Array) -> tuple[Array, Array, Array]:
    """H (2S, 3), z (2S,) and R (2S, 2S) of all sensors of an instant. Eq. (3.2)."""
    noise = sightings.noise(x[:2])
    S = len(noise)
    R = np.zeros((2 * S, 2 * S))
    for i, one in enumerate(noise):
        R[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = one
    return np.tile(np.eye(2, 3), (S, 1)), sightings.z_m.ravel(), R


def _with_soft(H: Array, z: Array, R: Array, past: Array) -> tuple[Array, Array, Array]:
    """The polynomial's prediction as a measurement of the whole state. Eq. (3.15)."""
    n = len(z)
    wider = np.zeros((n + 3, n + 3))
    wider[:n, :n], wider[n:, n:] = R, np.diag(np.square(SOFT_SIGMA))
    return np.concatenate([H, np.eye(3)]), np.concatenate([z, _from_the_past(past)]), wider


def _from_the_past(past: Array) -> Array:
    """(3,) second-order polynomials through the last estimates (n_p, 3), one step on."""
    k = np.arange(len(past))
    unwrapped = np.column_stack([past[:, :2], np.unwrap(past[:, 2])])
    return np.array([1.0, len(past), len(past) ** 2]) @ np.polynomial.polynomial.polyfit(
        k, unwrapped, 2
    )


def _update(x: Array, P: Array, H: Array, z: Array, R: Array) -> tuple[Array, Array]:
    """Kalman update, the covariance in Joseph's form."""
    innovation = z - H @ x
    if len(H) % 2:  # the polynomial's heading is the last row
        innovation[-1] = math.remainder(innovation[-1], 2 * math.pi)
    K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
    keep = np.eye(3) - K @ H
    return x + K @ innovation, keep @ P @ keep.T + K @ R @ K.T


def _project(x: Array, P: Array, yaw_rad: float, last: Array) -> Array:
    """The estimate on D x = d: no motion across the last heading. Eq. (3.11) to (3.14).

    Differs from the paper: d is of the last estimate as this instant's measurement corrects it.
    Held to the estimate as it was, the path would keep each error across it for ever.
    """
    D = np.array([[-math.sin(yaw_rad), math.cos(yaw_rad), 0.0]])
    d = D @ last
    K = P @ D.T / (D @ P @ D.T)
    return np.asarray(x - K @ (D @ x - d))
