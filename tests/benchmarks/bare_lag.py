# ruff: noqa: T201
"""A drive folder run through a bare loop of GTSAM's fixed-lag smoother: the online comparator.

    python tests/benchmarks/bare_lag.py FOLDER [--lag 5] [--loss huber]

One update per keyframe: preintegrate, ImuFactor, a bias node a second, GPSFactorArm, the newest
pose, velocity and bias and their joint covariance. Imports nothing from fgloc. It is spared the
search for the heading: it starts with the truth's yaw, or where the truth has no attitude with the
truth's course at the first moving moment less what the gyro turned until then, under a weak prior.
"""

import argparse
import json
import resource
import time
from dataclasses import dataclass, field
from pathlib import Path

import bare_batch as bare
import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

LAG_S, START_YAW_SIGMA_RAD = 5.0, 0.3
PAGE_MB = resource.getpagesize() / 2**20


def isam_params(factorization="QR", fix_sigma_m=1.0):
    """The settings of iSAM2 that fgloc has."""
    params = gtsam.ISAM2Params()
    thresholds = gtsam.ISAM2ThresholdMap()
    thresholds.insert(("x", np.repeat([0.01, min(0.1, fix_sigma_m)], 3)))
    thresholds.insert(("v", np.full(3, 0.1)))
    thresholds.insert(("b", np.full(6, 0.1)))
    params.setRelinearizeThreshold(thresholds)
    params.relinearizeSkip = 1
    params.findUnusedFactorSlots = True
    params.enablePartialRelinearizationCheck = True
    params.setFactorization(factorization)
    step = gtsam.ISAM2GaussNewtonParams()
    step.setWildfireThreshold(0.01)
    params.setOptimizationParams(step)
    return params


def start_yaw_rad(rec, line):
    """The heading at the first epoch, from the truth."""
    if rec.truth_R is not None:
        return float(np.arctan2(rec.truth_R[0, 1, 0], rec.truth_R[0, 0, 0]))
    t = line.t_s
    before, after = np.maximum(t - 1, t[0]), np.minimum(t + 1, t[-1])
    step = bare.interpolate(after, rec.truth_s, rec.truth_m)
    step -= bare.interpolate(before, rec.truth_s, rec.truth_m)
    moving = int(np.argmax(np.hypot(step[:, 0], step[:, 1]) > 2 * bare.MOVING_MPS))
    return float(np.arctan2(step[moving, 1], step[moving, 0]) - bare.turned_rad(line)[moving])


@dataclass
class Run:
    """What came out: poses at every epoch as they were when newest, and what each step cost."""

    poses: list
    cov: np.ndarray
    step_s: np.ndarray
    rss_mb: list = field(default_factory=list)


def run(rec, line, lag_s=LAG_S, loss="none", factorization="QR"):
    """Feed all keyframes."""
    keys = np.flatnonzero(line.is_key)
    t = line.t_s[keys].tolist()
    row_of = np.full(len(keys), -1)
    row_of[np.searchsorted(line.t_s[keys], rec.fix_s)] = np.arange(len(rec.fix_s))
    result = Run([], np.full((len(keys), 6, 6), np.nan), np.zeros(len(keys)))
    smoother = gtsam.IncrementalFixedLagSmoother(lag_s, isam_params(factorization))
    isam = smoother.getISAM2()
    pim = gtsam.PreintegratedImuMeasurements(bare.preintegration_params(rec))
    zero = gtsam.imuBias.ConstantBias()
    rot = gtsam.Rot3.Yaw(start_yaw_rad(rec, line))
    nav = gtsam.NavState(gtsam.Pose3(rot, rec.fix_m[0] - rot.matrix() @ rec.lever_m), np.zeros(3))
    bias, b, begun = zero, 0, 0.0
    for j in range(len(keys)):
        began = time.perf_counter()
        graph, values, stamps = gtsam.NonlinearFactorGraph(), gtsam.Values(), {}
        if j == 0:
            for factor in bare.priors(rec, nav.pose(), START_YAW_SIGMA_RAD):
                graph.add(factor)
            values.insert(B(0), zero)
        else:
            for part in bare.integrate(pim, line, keys[j - 1], keys[j]):
                result.poses.append(part.predict(nav, bias).pose())
            nav = pim.predict(nav, bias)
            graph.add(gtsam.ImuFactor(X(j - 1), V(j - 1), X(j), V(j), B(b), pim))
            if t[j] - begun >= bare.BIAS_S - 1e-9:
                walk = bare.bias_walk(rec, t[j] - begun)
                graph.add(gtsam.BetweenFactorConstantBias(B(b), B(b + 1), zero, walk))
                values.insert(B(b + 1), bias)
                b, begun = b + 1, t[j]
        values.insert(X(j), nav.pose())
        values.insert(V(j), nav.velocity())
        if row_of[j] >= 0:
            place_m, cov_m2 = rec.fix_m[row_of[j]], rec.fix_cov_m2[row_of[j]]
            width = bare.HUBER_WIDTH
            graph.add(bare.position_factor(X(j), place_m, cov_m2, rec.lever_m, loss, width))
        newest = [X(j), V(j), B(b)]
        stamps = dict.fromkeys(newest, t[j])
        smoother.update(graph, values, stamps)
        nav = gtsam.NavState(
            smoother.calculateEstimatePose3(X(j)), smoother.calculateEstimateVector(V(j))
        )
        bias = smoother.calculateEstimateConstantBias(B(b))
        result.cov[j] = isam.jointMarginalCovariance(newest).fullMatrix()[:6, :6]
        result.poses.append(nav.pose())
        result.step_s[j] = time.perf_counter() - began
        if j % 50 == 0:
            result.rss_mb.append((j, rss_mb()))
    return result


def rss_mb():
    """Resident memory of this process now."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE_MB


def peak_mb():
    """Most memory that this process ever had; getrusage would count its parent's too."""
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 1024


def step_figures(step_s, rss):
    """Totals, and per-step times and memory in the first and the last tenth of a run."""
    n = len(step_s)
    first, last = slice(0, n // 10), slice(n - n // 10, n)
    ms = {f"{name}_{where}_ms": float(np.quantile(step_s[part], q) * 1e3)
          for name, q in (("median", 0.5), ("p99", 0.99))
          for where, part in (("first", first), ("last", last), ("all", slice(None)))}  # fmt: skip
    memory = {f"rss_{where}_mb": max(mb for j, mb in rss if part.start <= j < part.stop)
              for where, part in (("first", first), ("last", last))}  # fmt: skip
    return {"total_s": float(step_s.sum()), "steps": n, **ms, **memory, "rss_peak_mb": peak_mb()}


def main():
    """Run a folder; print the RMSE, times per step and memory."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--lag", type=float, default=LAG_S, help="s")
    parser.add_argument("--loss", choices=["none", "huber"], default="none")
    parser.add_argument("--factorization", choices=["CHOLESKY", "QR"], default="QR")
    args = parser.parse_args()
    rec = bare.read_recording(args.folder)
    line = bare.timeline(rec)
    result = run(rec, line, args.lag, args.loss, args.factorization)
    rmse = bare.horizontal_rmse_m(rec, line.t_s, result.poses)
    print(json.dumps({"horizontal_rmse_m": rmse, **step_figures(result.step_s, result.rss_mb)}))


if __name__ == "__main__":
    main()
