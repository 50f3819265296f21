"""Faults to plant in a clean drive, each by the name of the finding that must tell of it."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fgloc.drive import Drive
from fgloc.frames import R_ENU_NED, R_FLU_FRD, yaw_matrix
from fgloc.timing import GPS_EPOCH_UNIX_S, seconds_to_ns

G = 9.80665
AS_IT_IS = np.eye(3)


@dataclass(frozen=True)
class Planted:
    """A fault, the finding that must be there, and words that its text must hold."""

    check: str
    source: str
    words: str
    plant: Callable[[Drive], Drive]


def _change(drive: Drive, table: str, **columns) -> Drive:
    return drive.with_tables(**{table: dataclasses.replace(drive.tables[table], **columns)})


def _late(drive: Drive, table: str, seconds: float) -> Drive:
    t_ns = drive.tables[table].t_ns + seconds_to_ns(seconds)
    return _change(drive, table, t_ns=t_ns, received_ns=t_ns)


def _rig(drive: Drive, **parts) -> Drive:
    return dataclasses.replace(drive, rig=dataclasses.replace(drive.rig, **parts))


def _truth(drive: Drive, **parts) -> Drive:
    return dataclasses.replace(drive, truth=dataclasses.replace(drive.truth, **parts))


def _antenna(drive: Drive, *p_veh_ant_m: float) -> Drive:
    return _rig(drive, p_veh_ant_m=np.array(p_veh_ant_m, float))


def _imu(drive: Drive, accel=AS_IT_IS, gyro=AS_IT_IS) -> Drive:
    imu = drive.imu
    return _change(
        drive, "imu", accel_mps2=imu.accel_mps2 @ np.transpose(accel),
        gyro_radps=imu.gyro_radps @ np.transpose(gyro),
    )  # fmt: skip


def _fixes(drive: Drive, R) -> Drive:
    fixes = drive.gnss
    return _change(
        drive, "gnss", p_world_ant_m=fixes.p_world_ant_m @ np.transpose(R),
        v_world_mps=fixes.v_world_mps @ np.transpose(R),
    )  # fmt: skip


def _lift(drive: Drive, by_m: float) -> Drive:
    """From the middle on heights are above another datum."""
    p = drive.gnss.p_world_ant_m.copy()
    p[len(p) // 2 :, 2] += by_m
    return _change(drive, "gnss", p_world_ant_m=p)


def _scatter(drive: Drive, sigma_m: float) -> Drive:
    noise = np.random.default_rng(5).standard_normal(drive.gnss.p_world_ant_m.shape) * sigma_m
    return _change(drive, "gnss", p_world_ant_m=drive.gnss.p_world_ant_m + noise)


def _covariance(drive: Drive, row: int, value: float) -> Drive:
    cov = drive.gnss.cov_world_m2.copy()
    cov[row] = np.diag([value] * 3)
    return _change(drive, "gnss", cov_world_m2=cov)


def _hole(drive: Drive, length_s: float) -> Drive:
    t_ns = drive.imu.t_ns
    middle = t_ns[len(t_ns) // 2]
    keep = (t_ns < middle) | (t_ns > middle + seconds_to_ns(length_s))
    return drive.with_tables(imu=drive.imu.take(keep))


def _twice(drive: Drive) -> Drive:
    rows = np.sort(np.r_[np.arange(len(drive.gnss)), [10, 20]])
    return drive.with_tables(gnss=drive.gnss.take(rows))


def _hold(drive: Drive) -> Drive:
    rows = np.arange(len(drive.imu))
    rows[2000:2200] = 2000
    held = drive.imu.take(rows)
    return _change(drive, "imu", accel_mps2=held.accel_mps2, gyro_radps=held.gyro_radps)


def _stray(drive: Drive) -> Drive:
    p = drive.gnss.p_world_ant_m.copy()
    p[30] += [300.0, -200.0, 0.0]
    return _change(drive, "gnss", p_world_ant_m=p)


def _drifting(drive: Drive) -> Drive:
    t_ns = drive.imu.t_ns
    return _change(drive, "imu", received_ns=t_ns + ((t_ns - t_ns[0]) // 500) + 5_000_000)


def _noise(drive: Drive, **parts) -> Drive:
    return _rig(drive, imu_noise=dataclasses.replace(drive.rig.imu_noise, **parts))


_QUARTER_TURN = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]

FAULTS = {
    "imu in g": Planted("accel-unit", "imu", "in g,", lambda d: _imu(d, accel=np.eye(3) / G)),
    "gyro in deg/s": Planted(
        "gyro-unit", "imu", "in deg/s", lambda d: _imu(d, gyro=np.eye(3) * 180 / np.pi)
    ),
    "gravity taken out": Planted(
        "accel-gravity", "imu", "gravity has been taken out",
        lambda d: _change(d, "imu", accel_mps2=d.imu.accel_mps2 - [0, 0, G]),
    ),
    "imu axes z-down": Planted(
        "imu-axes", "imu", "z-down", lambda d: _imu(d, R_FLU_FRD, R_FLU_FRD)
    ),
    "imu on its side": Planted(
        "imu-axes", "imu", "along y", lambda d: _imu(d, *[[[1, 0, 0], [0, 0, 1], [0, -1, 0]]] * 2)
    ),
    "imu turned by a quarter": Planted(
        "imu-axes", "imu", "deg about up", lambda d: _imu(d, _QUARTER_TURN, _QUARTER_TURN)
    ),
    "sideways force reversed": Planted(
        "imu-axes", "imu", "mirror image", lambda d: _imu(d, accel=np.diag([1, -1, 1]))
    ),
    "gyro reversed": Planted("gyro-sign", "imu", "wrong sign", lambda d: _imu(d, gyro=-np.eye(3))),
    "fixes in north, east, down": Planted(
        "mirrored", "gnss", "north and east exchanged", lambda d: _fixes(d, R_ENU_NED)
    ),
    "heights of two datums": Planted(
        "height-jump", "gnss", "steps by +3", lambda d: _lift(d, 32.0)
    ),
    "sigma far too small": Planted(
        "scatter", "gnss", "claimed sigma",
        lambda d: _change(_scatter(d, 1.5), "gnss", cov_world_m2=d.gnss.cov_world_m2 / 100),
    ),
    "sigma far too large": Planted(
        "scatter", "gnss", "less than the claimed",
        lambda d: _change(d, "gnss", cov_world_m2=np.tile(np.eye(3) * 400.0, (len(d.gnss), 1, 1))),
    ),
    "zero covariance": Planted("covariance", "gnss", "row 7,", lambda d: _covariance(d, 7, 0.0)),
    "infinite covariance": Planted(
        "covariance", "gnss", "infinite", lambda d: _covariance(d, 7, np.inf)
    ),
    "fixes 18 s ahead": Planted("lag", "gnss", "GPS time against UTC (18 s)",
                                lambda d: _late(d, "gnss", 18.0)),
    "fixes 37 s ahead": Planted("lag", "gnss", "TAI against UTC (37 s)",
                                lambda d: _late(d, "gnss", 37.0)),
    "imu 1.5 s late": Planted("lag", "imu", "1.", lambda d: _late(d, "imu", 1.5)),
    "imu counted from 1980": Planted(
        "no-overlap", "imu", "epoch of GPS", lambda d: _late(d, "imu", -float(GPS_EPOCH_UNIX_S))
    ),
    "imu in a time zone": Planted(
        "no-overlap", "imu", "time zone of 2 h", lambda d: _late(d, "imu", 7200.0)
    ),
    "imu stamped in ms": Planted(
        "time-unit", "imu", "milliseconds",
        lambda d: _change(d, "imu", t_ns=d.imu.t_ns // 10**6, received_ns=d.imu.t_ns // 10**6),
    ),
    "imu gap": Planted("gap", "imu", "longest of 3.0", lambda d: _hole(d, 3.0)),
    "fixes twice": Planted("duplicate", "gnss", "rows 11, 22", _twice),
    "imu held": Planted("stuck", "imu", "equal in every digit", _hold),
    "imu clipped": Planted(
        "clipped", "imu", "gyro_z",
        lambda d: _change(d, "imu", gyro_radps=np.clip(d.imu.gyro_radps, -0.15, 0.15)),
    ),
    "a stray fix": Planted("outlier", "gnss", "row 30,", _stray),
    "imu not finite": Planted(
        "not-finite", "imu", "row 5,",
        lambda d: _change(d, "imu", accel_mps2=np.where(
            np.arange(len(d.imu))[:, None] == 5, np.nan, d.imu.accel_mps2)),
    ),
    "received before it was true": Planted(
        "latency", "gnss", "before it was true",
        lambda d: _change(d, "gnss", received_ns=d.gnss.t_ns - 250_000_000),
    ),
    "a drifting clock": Planted("drift", "imu", "+2,000 ppm", _drifting),
    "lever arm in mm": Planted(
        "lever-arm", "rig", "in mm", lambda d: _antenna(d, 1200, 0, 1500)
    ),
    "no imu noise": Planted("no-noise", "rig", "no [rig.imu_noise]",
                            lambda d: _rig(d, imu_noise=None)),
    "gyro noise in deg": Planted(
        "noise", "rig", "gyro_noise", lambda d: _noise(d, gyro_noise_radps_per_sqrt_hz=0.1)
    ),
    "bias that may not walk": Planted(
        "noise", "rig", "= 0", lambda d: _noise(d, gyro_bias_walk_radps2_per_sqrt_hz=0.0)
    ),
}  # fmt: skip
"""Faults that can be seen in any drive with turns."""

CITY_FAULTS = {
    "antenna behind": Planted(
        "lever-arm-sign", "rig", "sign of x", lambda d: _antenna(d, -1.2, 0, 1.5)
    ),
    "antenna below": Planted(
        "lever-arm-sign", "rig", "sign of z", lambda d: _antenna(d, 1.2, 0, -1.5)
    ),
    "wheel speed in km/h": Planted(
        "wheel-unit", "wheel", "in km/h",
        lambda d: _change(d, "wheel", speed_mps=d.tables["wheel"].speed_mps * 3.6),
    ),
    "wheel speed reversed": Planted(
        "wheel-sign", "wheel", "negative",
        lambda d: _change(d, "wheel", speed_mps=-d.tables["wheel"].speed_mps),
    ),
    "wheel 18 s ahead": Planted("lag", "wheel", "(18 s)", lambda d: _late(d, "wheel", 18.0)),
    "imu noise far too low": Planted(
        "noise", "rig", "at its quietest", lambda d: _noise(d, accel_noise_mps2_per_sqrt_hz=2e-5)
    ),
    "truth with compass headings": Planted(
        "truth-yaw", "truth", "compass",
        lambda d: _truth(d, R_world_veh=yaw_matrix(np.pi / 2 - d.truth.yaw_rad)),
    ),
    "truth above another datum": Planted(
        "height-datum", "truth", "above the truth",
        lambda d: _truth(d, p_world_m=d.truth.p_world_m - [0, 0, 46.0]),
    ),
}  # fmt: skip
"""Faults that need truth with attitude or a wheel to be seen."""

RTK_FAULTS = {
    "velocities north first": Planted(
        "velocity", "gnss", "mirror image",
        lambda d: _change(d, "gnss", v_world_mps=d.gnss.v_world_mps[:, [1, 0, 2]]),
    ),
    "velocities down": Planted(
        "velocity", "gnss", "sign of down",
        lambda d: _change(d, "gnss", v_world_mps=d.gnss.v_world_mps * [1, 1, -1]),
    ),
    "velocities in km/h": Planted(
        "velocity", "gnss", "0.27",
        lambda d: _change(d, "gnss", v_world_mps=d.gnss.v_world_mps * 3.6),
    ),
}  # fmt: skip
"""Faults of a receiver that gives velocities."""
