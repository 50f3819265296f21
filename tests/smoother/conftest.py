"""Drives for the smoother's tests, and how far an answer lies from another or from the truth."""

import dataclasses
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from fgloc import frames
from fgloc.config import load_config
from fgloc.datasets import make
from fgloc.datasets.city import GNSS_SIGMA_ENU_M, ORIGIN, START_NS, city_motion, city_rig
from fgloc.datasets.simulator import simulate_gnss, simulate_imu, stream, truth_of
from fgloc.drive import Drive, Rig
from fgloc.evaluation import errors
from fgloc.smoother import smooth


@cache
def _city(seed: int, duration_s: float) -> Drive:
    return make("city", seed=seed, duration_s=duration_s)


def _run(drive, mode="batch", **settings):
    return smooth(drive, load_config(mode=mode, **settings))


def _errors(trajectory, drive, from_s=0.0):
    """Errors from a time on, at instants that estimate and truth share: nothing interpolated."""
    shared = drive.truth.take(np.isin(drive.truth.t_ns, trajectory.t_ns))
    return errors(trajectory, shared, score_from_ns=drive.start_ns + round(from_s * 1e9))


def _rmse_m(trajectory, drive, from_s=0.0) -> float:
    return float(np.sqrt((_errors(trajectory, drive, from_s).horizontal_m ** 2).mean()))


def _apart(one, other, from_s=0.0):
    """At shared instants: metres (N,), radians (N,) and relative covariance (N,) apart."""
    shared = np.intersect1d(one.t_ns, other.t_ns)
    shared = shared[shared >= one.t_ns[0] + round(from_s * 1e9)]
    a, b = (t.take(np.isin(t.t_ns, shared)) for t in (one, other))
    turn = frames.log_so3(a.R_world_veh.swapaxes(-1, -2) @ b.R_world_veh)
    cov = np.linalg.norm(a.cov - b.cov, axis=(1, 2)) / np.linalg.norm(b.cov, axis=(1, 2))
    return SimpleNamespace(
        t_ns=shared, m=np.linalg.norm(a.p_world_m - b.p_world_m, axis=1),
        rad=np.linalg.norm(turn, axis=1), cov=cov,
    )  # fmt: skip


def _turned(drive, yaw_rad) -> Drive:
    """The same motion and measurements, told of a vehicle whose x axis points elsewhere; without
    wheel speeds, which are along x."""
    T = np.eye(4)
    T[:3, :3] = frames.yaw_matrix(yaw_rad).T
    rig = Rig(T[:3, :3] @ drive.rig.p_veh_ant_m, T @ drive.rig.T_veh_imu, drive.rig.imu_noise)
    R = drive.truth.R_world_veh @ T[:3, :3].T
    tables = {name: table for name, table in drive.tables.items() if name != "wheel"}
    truth = dataclasses.replace(drive.truth, R_world_veh=R)
    return dataclasses.replace(drive, rig=rig, tables=tables, truth=truth)


def _sensed(motion, name: str, seed: int) -> Drive:
    """A motion at 100 Hz as the car of `city` senses it."""
    rig = city_rig()
    gnss = simulate_gnss(motion.every(10), rig, GNSS_SIGMA_ENU_M, stream(seed, "gnss"))
    imu = simulate_imu(motion, rig, ORIGIN.gravity_mps2(), stream(seed, "imu"))
    return Drive(name, ORIGIN, rig, {"gnss": gnss, "imu": imu}, truth_of(motion.every(5)))


def _standing(duration_s: float, seed: int = 0) -> Drive:
    """A car that never moves, its heading 1 rad."""
    motion = city_motion(seed, duration_s)
    still = {name: np.zeros_like(a) for name, a in vars(motion).items() if name != "t_ns"}
    still["R_world_veh"] = np.tile(frames.yaw_matrix(1.0), (len(motion), 1, 1))
    return _sensed(dataclasses.replace(motion, **still), "standing", seed)


def _reversing(back_s: float, ahead_s: float, seed: int = 0) -> Drive:
    """A car that first drives in reverse, stands, and then drives the same way ahead."""
    ahead = city_motion(seed, ahead_s)
    sign = {"v_world_mps": -1, "w_veh_radps": -1}
    n = round(back_s * 100)
    columns = {
        name: np.concatenate([sign.get(name, 1) * column[n:0:-1], column])
        for name, column in vars(ahead).items()
    }
    columns["t_ns"] = START_NS + np.arange(len(columns["t_ns"])) * 10_000_000
    return _sensed(dataclasses.replace(ahead, **columns), "reversing", seed)


def _with_fixes(drive, **columns) -> Drive:
    return drive.with_tables(gnss=dataclasses.replace(drive.gnss, **columns))


def _without_imu(drive, first_s, last_s) -> Drive:
    """The drive with no IMU samples strictly between two times."""
    t = drive.imu.t_ns - drive.start_ns
    return drive.with_tables(imu=drive.imu.take((t <= first_s * 1e9) | (t >= last_s * 1e9)))


def _without_fixes(drive, first_s, last_s) -> Drive:
    """The drive with no fixes strictly between two times."""
    t = drive.gnss.t_ns - drive.start_ns
    return drive.with_tables(gnss=drive.gnss.take((t <= first_s * 1e9) | (t >= last_s * 1e9)))


@pytest.fixture(scope="session")
def city():
    """`city(seed, duration_s)`: a simulated drive, made once."""
    return _city


@pytest.fixture(scope="session")
def run():
    """`run(drive, mode, **settings)`: the result of the graph."""
    return _run


@pytest.fixture(scope="session")
def against_truth():
    """`against_truth(trajectory, drive, from_s)`: errors at shared instants."""
    return _errors


@pytest.fixture(scope="session")
def rmse_m():
    """`rmse_m(trajectory, drive, from_s)`: horizontal, in m."""
    return _rmse_m


@pytest.fixture(scope="session")
def apart():
    """`apart(one, other, from_s)`: how far two trajectories are apart at shared instants."""
    return _apart


@pytest.fixture(scope="session")
def altered():
    """Ways to make another drive of one: turned, standing, with_fixes, without_imu, ..."""
    return SimpleNamespace(
        turned=_turned, standing=_standing, reversing=_reversing, with_fixes=_with_fixes,
        without_imu=_without_imu, without_fixes=_without_fixes,
    )  # fmt: skip
