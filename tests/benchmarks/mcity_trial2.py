# ruff: noqa: T201
"""What trial 2 of the Mcity roadside data says of the node: latency, box offset, noise, survey.

    python tests/benchmarks/mcity_trial2.py SOURCE [--trial 2]

SOURCE is the folder with dets/ and gts/. The constants in `datasets/mcity_roadside.py` are those of
trial 2 and of no other. Detections of vehicles within 4 m of the RTK count.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import curve_fit

from fgloc.datasets import import_recording
from fgloc.datasets.mcity_roadside import LATENCY_S, NODE_RANGE_M
from fgloc.measurements import VEHICLE, Array

GATE_M = 4.0
LAGS_S = np.arange(0.1, 3.05, 0.1)


@dataclass
class Seen:
    """Vehicle detections (N,) with the RTK around them."""

    stamp_s: Array
    p_world_m: Array
    t_rtk_s: Array
    p_rtk_m: Array
    v_rtk_mps: Array
    distance_m: Array
    bearing_rad: Array

    def errors(self, latency_s: float) -> tuple[Array, Array, Array]:
        """Rows within the gate (M,), their errors (M, 2) East and North, the velocity (M, 2)."""
        p_m, v_mps = (self._rtk(columns, latency_s) for columns in (self.p_rtk_m, self.v_rtk_mps))
        error_m = self.p_world_m - p_m
        rows = np.flatnonzero(np.hypot(*error_m.T) < GATE_M)
        return rows, error_m[rows], v_mps[rows]

    def _rtk(self, columns: Array, latency_s: float) -> Array:
        at_s = self.stamp_s - latency_s
        return np.stack([np.interp(at_s, self.t_rtk_s, column) for column in columns.T], -1)


def main() -> None:
    """Measure, and print each constant beside what it was measured as."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("source", type=Path)
    parser.add_argument("--trial", type=int, default=2)
    args = parser.parse_args()
    seen = read(args.source, args.trial)
    latency_s = latency(seen)
    rows, error_m, _ = seen.errors(latency_s)
    print(f"latency {latency_s:.3f} s from {len(rows)} detections (in use: {LATENCY_S} s)")
    joint_s, ahead_m, left_m = latency_and_box(seen, latency_s)
    print(f"with a box offset: latency {joint_s:.3f} s, {ahead_m:.2f} m ahead, {left_m:.2f} m left")
    far = seen.distance_m[rows] > NODE_RANGE_M
    for name, part in ((f"to {NODE_RANGE_M:g} m", ~far), ("beyond", far)):
        print(f"rms on an axis {name}: {rms(error_m[part]):.3f} m ({part.sum()} detections)")
    rows, error_m = rows[~far], error_m[~far]
    sigma_m, tau_s, white_m = noise(seen.stamp_s[rows], error_m)
    print(f"slow error {sigma_m:.3f} m, {tau_s:.1f} s; left beside it {white_m:.3f} m")
    east_m, north_m, yaw_rad, left_over_m = survey(seen, rows, error_m)
    print(f"as an error of the survey: {east_m:.2f} m East, {north_m:.2f} m North, "
          f"{yaw_rad:.4f} rad; rms without it {left_over_m:.3f} m")  # fmt: skip


def read(source: Path, trial: int) -> Seen:
    """A trial's detections of vehicles with their stamps, and the whole RTK of vehicle 0."""
    drive = import_recording("mcity-roadside", source, trial=trial)
    node, table, truth = drive.infrastructure.nodes[0], drive.tables["detections"], drive.truth
    table = table.take(table.kind == VEHICLE)
    start_ns = truth.t_ns[0]
    return Seen(
        (table.received_ns - start_ns) / 1e9, node.to_world(table.p_node_m),
        (truth.t_ns - start_ns) / 1e9, truth.p_world_m[:, :2], truth.v_world_mps[:, :2],
        np.hypot(*table.p_node_m.T), node.yaw_rad + np.arctan2(*table.p_node_m.T[::-1]),
    )  # fmt: skip


def latency(seen: Seen) -> float:
    """Least squares of the error against the velocity, with no box offset."""
    latency_s = 0.0
    for _ in range(20):
        _, error_m, v_mps = seen.errors(latency_s)
        latency_s -= float((error_m * v_mps).sum() / (v_mps**2).sum())
    return latency_s


def latency_and_box(seen: Seen, latency_s: float) -> tuple[float, float, float]:
    """The same with an offset ahead and to the left, which speeds that differ tell apart."""
    _, error_m, v_mps = seen.errors(latency_s)
    speed_mps = np.hypot(*v_mps.T)
    ahead = v_mps / speed_mps[:, None]
    along_m = (error_m * ahead).sum(1)
    across_m = error_m[:, 1] * ahead[:, 0] - error_m[:, 0] * ahead[:, 1]
    columns = np.stack([-speed_mps, np.ones(len(speed_mps))], -1)
    (more_s, ahead_m), *_ = np.linalg.lstsq(columns, along_m, rcond=None)
    return latency_s + more_s, ahead_m, float(across_m.mean())


def noise(t_s: Array, error_m: Array) -> tuple[float, float, float]:
    """Sigma and time constant of an exponential covariance over lags, and what it leaves at 0."""
    apart_s = t_s[:, None] - t_s
    product_m2 = error_m @ error_m.T / 2
    cov_m2 = [product_m2[np.abs(apart_s - lag_s) < 0.05].mean() for lag_s in LAGS_S]
    (variance_m2, tau_s), _ = curve_fit(
        lambda lag_s, variance_m2, tau_s: variance_m2 * np.exp(-lag_s / tau_s), LAGS_S, cov_m2,
        p0=(0.1, 3.0),
    )  # fmt: skip
    white_m2 = max(float(np.diag(product_m2).mean() - cov_m2[0]), 0.0)
    return float(np.sqrt(variance_m2)), float(tau_s), float(np.sqrt(white_m2))


def survey(seen: Seen, rows: Array, error_m: Array) -> tuple[float, float, float, float]:
    """Shift and turn of the node that explain the errors best, and their rms without them."""
    distance_m, bearing_rad = seen.distance_m[rows], seen.bearing_rad[rows]
    one, none = np.ones(len(rows)), np.zeros(len(rows))
    columns = np.concatenate([
        np.stack([one, none, -distance_m * np.sin(bearing_rad)], -1),
        np.stack([none, one, distance_m * np.cos(bearing_rad)], -1),
    ])  # fmt: skip
    error = error_m.T.ravel()
    found, *_ = np.linalg.lstsq(columns, error, rcond=None)
    return (*found.tolist(), rms(error - columns @ found))


def rms(values: Array) -> float:
    """Root of the mean square of all entries."""
    return float(np.sqrt(np.mean(np.square(values))))


if __name__ == "__main__":
    main()
