# ruff: noqa: T201
"""A drive folder solved by a bare GTSAM script, as one would write it by hand: the comparator.

Reads gnss.csv, imu.csv, truth.csv, drive.toml and, if there, detections.csv itself, and imports
nothing from fgloc.

    python tests/benchmarks/bare_batch.py FOLDER [--loss huber] [--out FILE.csv]

Keyframes lie at the fixes and at most 1 s apart; ImuFactor with a bias node a second; GPSFactorArm
with each fix's covariance, and another for each detection, all of them at keyframes and of the car,
with a height that is next to free; Levenberg-Marquardt; the marginal covariance of every pose.
States are of the IMU's place along the vehicle's axes, as fgloc's are: through a sensor pose the
tangential acceleration would be left out. The written trajectory has a row every 0.25 s: between
keyframes the IMU's prediction from the left one, with the left one's covariance. Prints the
horizontal RMSE against truth.csv from 75 s on as JSON.
"""

import argparse
import json
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

KEYFRAME_S, OUTPUT_S, BIAS_S = 1.0, 0.25, 1.0
LEVEL_RAD, YAW_RAD, POSITION_M, SPEED_MPS = 0.2, 10.0, 100.0, 30.0
HUBER_WIDTH, SEEN_HUBER_WIDTH = 3.4, 3.0
FREE_UP_M = 100.0
SCORE_FROM_S = 75.0
MOVING_MPS = 3.0
POSE_CSV = "t_s,east_m,north_m,up_m,qx,qy,qz,qw," + ",".join(
    f"cov_{i}{j}" for i in range(6) for j in range(i, 6)
)


@dataclass
class Recording:
    """A drive folder's contents; times in s since the first fix."""

    toml: dict
    fix_s: np.ndarray
    fix_m: np.ndarray
    fix_cov_m2: np.ndarray
    imu_s: np.ndarray
    imu: np.ndarray  # specific force and angular rate, (N, 6)
    truth_s: np.ndarray
    truth_m: np.ndarray
    truth_R: np.ndarray | None
    truth_lever_m: np.ndarray
    seen_s: np.ndarray
    seen_m: np.ndarray
    seen_cov_m2: np.ndarray

    @property
    def imu_m(self):
        """The IMU's place in the vehicle frame: states are of it, along the vehicle's axes."""
        return np.array(self.toml["rig"]["T_veh_imu"])[:3, 3]

    @property
    def lever_m(self):
        """From there to the antenna."""
        return np.array(self.toml["rig"]["p_veh_ant_m"]) - self.imu_m

    @property
    def box_m(self):
        """From there to the centre of the box that a node sees."""
        return np.array(self.toml["rig"].get("p_veh_box_m", [0.0, 0.0, 0.0])) - self.imu_m

    @property
    def gravity_mps2(self):
        """Somigliana's formula with the free-air term."""
        origin = self.toml["origin"]
        s2 = np.sin(np.deg2rad(origin["lat_deg"])) ** 2
        surface = 9.7803253359 * (1 + 0.00193185265241 * s2) / np.sqrt(1 - 0.00669437999013 * s2)
        return surface - 3.086e-6 * origin["height_m"]


def read_csv(path, *groups):
    """t_ns of a table and one array for each group of columns; None where a group is missing."""
    with path.open() as file:
        header = file.readline().strip().split(",")
        groups = [group if group[0] in header else () for group in groups]
        names = [name for group in groups for name in group]
        use = [header.index(name) for name in ("t_ns", *names)]
        row = [("t_ns", "i8"), ("values", "f8", (len(names),))]
        table = np.loadtxt(file, delimiter=",", usecols=use, dtype=row)
    ends = np.cumsum([len(group) for group in groups])[:-1]
    parts = np.split(table["values"], ends, axis=1)
    return table["t_ns"], *(p if g else None for p, g in zip(parts, groups, strict=True))


def read_recording(folder):
    """The drive in a folder."""
    toml = tomllib.loads((folder / "drive.toml").read_text())
    enu = ("east_m", "north_m", "up_m")
    cov = [f"cov_{name}_m2" for name in ("ee", "en", "eu", "nn", "nu", "uu")]
    imu = [f"{what}_{axis}_{unit}" for what, unit in (("accel", "mps2"), ("gyro", "radps"))
           for axis in "xyz"]  # fmt: skip
    matrix = [f"r{i}{j}" for i in range(3) for j in range(3)]
    t_fix, fix_m, fix_cov = read_csv(folder / "gnss.csv", enu, cov)
    t_imu, samples = read_csv(folder / "imu.csv", imu)
    t_truth, truth_m, truth_R = read_csv(folder / "truth.csv", enu, matrix)
    fix_cov = fix_cov[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    start = t_fix[0]
    point = np.array(toml.get("truth", {}).get("p_veh_point_m", [0.0, 0.0, 0.0]))
    point = point - np.array(toml["rig"]["T_veh_imu"])[:3, 3]
    return Recording(
        toml, (t_fix - start) / 1e9, fix_m, fix_cov, (t_imu - start) / 1e9, samples,
        (t_truth - start) / 1e9, truth_m,
        None if truth_R is None else truth_R.reshape(-1, 3, 3), point,
        *read_detections(folder, toml, start, fix_m),
    )  # fmt: skip


def read_detections(folder, toml, start, fix_m):
    """Times, places and covariances of what a single node sees; the height is the antenna's."""
    path = folder / "detections.csv"
    if not path.exists():
        return np.empty(0), np.empty((0, 3)), np.empty((0, 3, 3))
    seen, cov = ("x_m", "y_m"), ("cov_xx_m2", "cov_xy_m2", "cov_yy_m2")
    t, seen_m, upper = read_csv(path, seen, cov)
    (node,) = toml["node"]
    c, s = np.cos(node["yaw_rad"]), np.sin(node["yaw_rad"])
    R, at = np.array([[c, -s], [s, c]]), node["p_world_m"][:2]
    height = np.median(fix_m[:, 2]) - toml["rig"]["p_veh_ant_m"][2]
    place = np.column_stack([seen_m @ R.T + at, np.full(len(t), height)])
    cov_m2 = np.tile(np.diag([0.0, 0.0, FREE_UP_M**2]), (len(t), 1, 1))
    cov_m2[:, :2, :2] = R @ upper[:, [0, 1, 1, 2]].reshape(-1, 2, 2) @ R.T
    return (t - start) / 1e9, place, cov_m2


@dataclass
class Timeline:
    """Epochs of a recording and the IMU steps between them, along the vehicle's axes: each the mean
    of its two ends, the second of them turned to the first."""

    t_s: np.ndarray
    is_key: np.ndarray
    first_step: np.ndarray  # steps first_step[k]:first_step[k + 1] lead from epoch k to k + 1
    accel: np.ndarray
    gyro: np.ndarray
    dt_s: list


def timeline(rec):
    """Keyframes at the fixes and the end, output epochs between."""
    key_s = fill(np.unique(np.append(rec.fix_s, rec.imu_s[-1])), KEYFRAME_S)
    t_s = fill(key_s, OUTPUT_S)
    inside = (rec.imu_s > t_s[0]) & (rec.imu_s < t_s[-1])
    knots = np.union1d(np.round(rec.imu_s[inside], 9), np.round(t_s, 9))
    R = np.array(rec.toml["rig"]["T_veh_imu"])[:3, :3]
    along = np.concatenate([R @ rec.imu[:, :3].T, R @ rec.imu[:, 3:].T])
    values = np.stack([np.interp(knots, rec.imu_s, column) for column in along], -1)
    force, rate, dt_s = values[:, :3], values[:, 3:], np.diff(knots)
    gyro = (rate[1:] + rate[:-1]) / 2
    end = force[1:] + np.cross(gyro * dt_s[:, None], force[1:])
    first = np.searchsorted(knots, np.round(t_s, 9))
    accel = (force[:-1] + end) / 2
    return Timeline(t_s, np.isin(t_s, key_s), first, accel, gyro, dt_s.tolist())


def fill(t_s, longest_s):
    """The times with evenly spread ones between, none further apart than `longest_s`."""
    parts = np.maximum(np.ceil(np.diff(t_s) / longest_s - 1e-9), 1).astype(int)
    pieces = [np.linspace(a, b, n, endpoint=False)
              for a, b, n in zip(t_s[:-1], t_s[1:], parts, strict=True)]  # fmt: skip
    return np.append(np.concatenate(pieces), t_s[-1])


def preintegration_params(rec):
    """Noise densities of the drive's rig."""
    noise = rec.toml["rig"]["imu_noise"]
    params = gtsam.PreintegrationParams.MakeSharedU(rec.gravity_mps2)
    params.setAccelerometerCovariance(np.eye(3) * noise["accel_noise_mps2_per_sqrt_hz"] ** 2)
    params.setGyroscopeCovariance(np.eye(3) * noise["gyro_noise_radps_per_sqrt_hz"] ** 2)
    # Smaller makes 10 Hz keyframes too ill-conditioned for a Cholesky.
    params.setIntegrationCovariance(np.eye(3) * 1e-6)
    return params


def bias_walk(rec, dt_s):
    """Noise model of the biases' change over dt_s."""
    noise = rec.toml["rig"]["imu_noise"]
    walk = [noise["accel_bias_walk_mps3_per_sqrt_hz"]] * 3
    walk += [noise["gyro_bias_walk_radps2_per_sqrt_hz"]] * 3
    return gtsam.noiseModel.Diagonal.Sigmas(np.array(walk) * np.sqrt(dt_s))


def priors(rec, pose, yaw_sigma_rad):
    """Prior factors on keyframe 0: level, near the first fix, of any speed."""
    noise, sigmas = rec.toml["rig"]["imu_noise"], gtsam.noiseModel.Diagonal.Sigmas
    tilt = [LEVEL_RAD, LEVEL_RAD, yaw_sigma_rad]
    bias = [noise["accel_bias_sigma_mps2"]] * 3 + [noise["gyro_bias_sigma_radps"]] * 3
    level = gtsam.Pose3(gtsam.Rot3.Yaw(pose.rotation().yaw()), rec.fix_m[0])
    zero = gtsam.imuBias.ConstantBias()
    return [
        gtsam.PriorFactorPose3(X(0), level, sigmas(np.array(tilt + [POSITION_M] * 3))),
        gtsam.PriorFactorVector(V(0), np.zeros(3), sigmas(np.full(3, SPEED_MPS))),
        gtsam.PriorFactorConstantBias(B(0), zero, sigmas(np.array(bias))),
    ]


def position_factor(key, place_m, cov_m2, lever_m, loss, width):
    """A measured position of a point of the vehicle; `loss` is none or huber."""
    if np.count_nonzero(cov_m2 - np.diag(np.diagonal(cov_m2))):
        model = gtsam.noiseModel.Gaussian.Covariance(cov_m2)
    else:
        model = gtsam.noiseModel.Diagonal.Variances(np.diagonal(cov_m2))
    if loss == "huber":
        huber = gtsam.noiseModel.mEstimator.Huber.Create(width)
        model = gtsam.noiseModel.Robust.Create(huber, model)
    return gtsam.GPSFactorArm(key, place_m, lever_m, model)


def turned_rad(line):
    """Yaw at every epoch since the first from the gyro about the vehicle's vertical."""
    return np.append(0.0, np.cumsum(line.gyro[:, 2] * line.dt_s))[line.first_step]


def guess(rec, line, keys):
    """First attitudes, positions and velocities of the keyframes.

    Yaw is the gyro's, held to the course over ground over about 15 s; a course interpolated across
    an outage would end in a bad minimum.
    """
    t = line.t_s[keys]
    turned = turned_rad(line)[keys]
    p = interpolate(t, rec.fix_s, rec.fix_m)
    before, after = np.maximum(t - 1, t[0]), np.minimum(t + 1, t[-1])
    step = interpolate(after, rec.fix_s, rec.fix_m) - interpolate(before, rec.fix_s, rec.fix_m)
    v = step / (after - before)[:, None]
    near = np.searchsorted(rec.fix_s, t + 1) - np.searchsorted(rec.fix_s, t - 1)
    speed = np.hypot(v[:, 0], v[:, 1])
    good = (speed > MOVING_MPS) & (near >= 2)
    offset = np.arctan2(v[good, 1], v[good, 0]) - turned[good]
    phasor = speed[good] ** 2 * np.exp(1j * offset)
    total, at = np.append(0, np.cumsum(phasor)), t[good]
    low, high = np.searchsorted(at, at - 15), np.searchsorted(at, at + 15)
    held = np.unwrap(np.angle(total[high] - total[low]))
    yaw = turned + np.interp(t, at, held)
    R = [gtsam.Rot3.Yaw(angle) for angle in yaw.tolist()]
    p = p - np.stack([r.matrix() for r in R]) @ rec.lever_m
    return R, p, v


def interpolate(at, t, values):
    """Straight lines through the rows of `values`."""
    return np.stack([np.interp(at, t, column) for column in values.T], -1)


@dataclass
class Solution:
    """The solved drive; `between` are the preintegrations from a keyframe to output epochs."""

    keys: np.ndarray
    values: gtsam.Values
    bias_of: list
    cov: np.ndarray
    between: list
    iterations: int
    error: float


def solve(rec, line, loss="none"):
    """Build the graph, optimise it and take the marginals of all poses."""
    keys = np.flatnonzero(line.is_key)
    t = line.t_s[keys]
    R, p, v = guess(rec, line, keys)
    graph, values, zero = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.imuBias.ConstantBias()
    for j in range(len(keys)):
        values.insert(X(j), gtsam.Pose3(R[j], p[j]))
        values.insert(V(j), v[j])
    values.insert(B(0), zero)
    for factor in priors(rec, values.atPose3(X(0)), YAW_RAD):
        graph.add(factor)
    bias_of, begun, between = [0], 0.0, []
    pim = gtsam.PreintegratedImuMeasurements(preintegration_params(rec))
    for j in range(1, len(keys)):
        between += integrate(pim, line, keys[j - 1], keys[j])
        i, b = j - 1, bias_of[-1]
        graph.add(gtsam.ImuFactor(X(i), V(i), X(j), V(j), B(b), pim))
        if t[j] - begun >= BIAS_S - 1e-9:
            walk = bias_walk(rec, t[j] - begun)
            graph.add(gtsam.BetweenFactorConstantBias(B(b), B(b + 1), zero, walk))
            values.insert(B(b + 1), zero)
            b, begun = b + 1, t[j]
        bias_of.append(b)
    lever_m, box_m = rec.lever_m, rec.box_m
    for row, j in enumerate(np.searchsorted(t, rec.fix_s).tolist()):
        place_m, cov_m2 = rec.fix_m[row], rec.fix_cov_m2[row]
        graph.add(position_factor(X(j), place_m, cov_m2, lever_m, loss, HUBER_WIDTH))
    for row, j in enumerate(np.searchsorted(t, rec.seen_s).tolist()):
        place_m, cov_m2 = rec.seen_m[row], rec.seen_cov_m2[row]
        graph.add(position_factor(X(j), place_m, cov_m2, box_m, loss, SEEN_HUBER_WIDTH))
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values)
    solved = optimizer.optimize()
    marginals = gtsam.Marginals(graph, solved)
    cov = np.stack([marginals.marginalCovariance(X(j)) for j in range(len(keys))])
    return Solution(keys, solved, bias_of, cov, between, optimizer.iterations(), optimizer.error())


def integrate(pim, line, left, right):
    """Integrate from epoch `left` to `right`; copies of the sums at the epochs between."""
    pim.resetIntegration()
    add, copies = pim.integrateMeasurement, []
    for epoch in range(left, right):
        steps = slice(line.first_step[epoch], line.first_step[epoch + 1])
        for a, w, dt in zip(line.accel[steps], line.gyro[steps], line.dt_s[steps], strict=True):
            add(a, w, dt)
        if epoch + 1 < right:
            # A factor's constructor is the cheapest way to copy a preintegration from Python.
            copies.append(gtsam.ImuFactor(0, 1, 2, 3, 4, pim).preintegratedMeasurements())
    return copies


def trajectory(line, solution):
    """Pose at every epoch, as Pose3, and covariance (N, 6, 6) in GTSAM's pose tangent."""
    values, keys = solution.values, solution.keys
    poses, source = [], np.searchsorted(keys, np.arange(len(line.t_s)), side="right") - 1
    between = iter(solution.between)
    for epoch, j in enumerate(source.tolist()):
        pose = values.atPose3(X(j))
        if epoch != keys[j]:
            nav = gtsam.NavState(pose, values.atVector(V(j)))
            pose = next(between).predict(nav, values.atConstantBias(B(solution.bias_of[j]))).pose()
        poses.append(pose)
    return poses, solution.cov[source]


def write_poses(path, t_s, poses, cov):
    """CSV of times, the IMU's positions, quaternions and the covariance's upper triangle."""
    rows = [[*pose.translation(), *pose.rotation().toQuaternion().coeffs()] for pose in poses]
    upper = np.triu_indices(6)
    table = np.column_stack([t_s, rows, cov[:, upper[0], upper[1]]])
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=POSE_CSV, comments="")


def horizontal_rmse_m(rec, t_s, poses, score_from_s=SCORE_FROM_S):
    """Of the truth's point of the vehicle at all instants of truth from `score_from_s` on."""
    at = np.stack([pose.transformFrom(rec.truth_lever_m) for pose in poses])
    rows = (rec.truth_s >= score_from_s) & (rec.truth_s <= t_s[-1])
    error = interpolate(rec.truth_s[rows], t_s, at) - rec.truth_m[rows]
    return float(np.sqrt((error[:, :2] ** 2).sum(-1).mean()))


def main():
    """Solve a folder; print the RMSE and where the time went."""
    began = time.perf_counter()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--loss", choices=["none", "huber"], default="none")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    rec = read_recording(args.folder)
    line = timeline(rec)
    read = time.perf_counter()
    solution = solve(rec, line, args.loss)
    solved = time.perf_counter()
    poses, cov = trajectory(line, solution)
    if args.out:
        write_poses(args.out, line.t_s, poses, cov)
    print(json.dumps({
        "horizontal_rmse_m": horizontal_rmse_m(rec, line.t_s, poses),
        "iterations": solution.iterations, "cost": solution.error, "keyframes": len(solution.keys),
        "read_s": read - began, "solve_s": solved - read, "write_s": time.perf_counter() - solved,
    }))  # fmt: skip


if __name__ == "__main__":
    main()
