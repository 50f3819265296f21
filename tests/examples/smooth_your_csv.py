# ruff: noqa: T201
"""From two plain CSV files, GPS and IMU, to a drive folder and a smoothed trajectory.

    python tests/examples/smooth_your_csv.py gps.csv imu.csv OUT

    gps.csv   time_s,lat_deg,lon_deg,height_m,sigma_m      one sigma per axis, height twice that
    imu.csv   time_s,ax,ay,az,gx,gy,gz                     m/s^2 and deg/s

Both on the same clock, in seconds of POSIX time. Change the columns below to your own names; the
rig is what you have to measure on your vehicle.
"""

import sys
from pathlib import Path

import numpy as np

import fgloc
from fgloc.datasets.drive_folder import write_drive
from fgloc.outputs import write_result

RIG = fgloc.Rig(
    p_veh_ant_m=np.array([1.2, 0.0, 1.5]),  # rear axle to GPS antenna: ahead, left, up
    T_veh_imu=np.array([[1, 0, 0, 0.5], [0, 1, 0, -0.2], [0, 0, 1, 0.4], [0, 0, 0, 1]]),
    imu_noise=fgloc.ImuNoise(
        accel_noise_mps2_per_sqrt_hz=2e-3, gyro_noise_radps_per_sqrt_hz=2e-4,
        accel_bias_walk_mps3_per_sqrt_hz=2e-4, gyro_bias_walk_radps2_per_sqrt_hz=4e-6,
    ),
)  # fmt: skip


def read(path: str) -> tuple[np.ndarray, np.ndarray]:
    """Instants in ns and a record array of a CSV file's columns, which its first line names."""
    rows = np.genfromtxt(path, delimiter=",", names=True, encoding="utf-8")
    return np.rint(rows["time_s"] * 1e9).astype(np.int64), rows


def gps(path: str) -> tuple[fgloc.Origin, fgloc.GnssFixes]:
    """The fixes, in metres about the first of them."""
    t_ns, rows = read(path)
    place = rows["lat_deg"], rows["lon_deg"], rows["height_m"]
    origin = fgloc.Origin(*(float(column[0]) for column in place))
    sigma_m = rows["sigma_m"][:, None] * [1, 1, 2]
    cov_m2 = np.eye(3) * (sigma_m**2)[:, None, :]
    unknown = np.full((len(t_ns), 3), np.nan)  # the velocity, which this file does not tell
    return origin, fgloc.GnssFixes(t_ns, t_ns, origin.to_world(*place), cov_m2, unknown)


def imu(path: str) -> fgloc.ImuSamples:
    """The samples; degrees become radians here."""
    t_ns, rows = read(path)
    accel_mps2 = np.stack([rows[name] for name in ("ax", "ay", "az")], -1)
    gyro_radps = np.deg2rad(np.stack([rows[name] for name in ("gx", "gy", "gz")], -1))
    return fgloc.ImuSamples(t_ns, t_ns, accel_mps2, gyro_radps)


def main(gps_csv: str, imu_csv: str, out: str) -> None:
    """Write OUT/drive, smooth it, write OUT/result."""
    origin, fixes = gps(gps_csv)
    drive = fgloc.Drive(Path(gps_csv).stem, origin, RIG, {"gnss": fixes, "imu": imu(imu_csv)})
    write_drive(drive, Path(out) / "drive", overwrite=True)
    result = fgloc.smooth(drive)
    write_result(Path(out) / "result", drive, result)
    print(f"{len(result.trajectory):,} states in {out}/result; look at report.html there")


if __name__ == "__main__":
    main(*sys.argv[1:])
