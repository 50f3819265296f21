"""Importer `mems-rtk`: a consumer IMU at 100 Hz beside an RTK receiver at 4 Hz, as two CSV files.

The source folder holds `imu.csv` and `rtk.csv`, both stamped with GPS seconds of the week; IMU
axes are forward-right-down, RTK velocities north-east-down. The drive gets

* GNSS: the fixes at whole GPS seconds from `start_sow_s` to `end_sow_s`, that is 1 Hz;
* truth: all other fixes of that span, a position and velocity of the antenna without attitude;
* IMU: the samples of that span, from the last at or before it to the first at or after it.

The vehicle frame is the IMU's, turned to forward-left-up: of no other lever arm than that to the
antenna anything is known.
"""

from pathlib import Path

import numpy as np

from fgloc.datasets.columns import Columns, Group, Layout
from fgloc.datasets.csv_table import read_csv
from fgloc.datasets.drive_tables import check_covariances
from fgloc.datasets.trajectory_columns import check_increasing, positions, stack
from fgloc.drive import About, Drive, ImuNoise, Rig
from fgloc.errors import DriveError
from fgloc.frames import R_ENU_NED, R_FLU_FRD, Origin
from fgloc.measurements import Array, GnssFixes, ImuSamples
from fgloc.timing import Instants, gps_week_to_ns
from fgloc.trajectory import Trajectory

GPS_WEEK = 2374
"""The week that began on 2025-07-06."""
START_SOW_S, END_SOW_S = 243_262.0, 243_804.0
"""The part of the recording on which other systems were measured."""

P_VEH_ANT_M = R_FLU_FRD @ [0.0, -0.05, 0.0]
_HOUR_S = 3600.0
_GAUSS_MARKOV_WALK = np.sqrt(2 / _HOUR_S)  # of a bias with a correlation time of one hour

IMU_NOISE = ImuNoise(
    accel_noise_mps2_per_sqrt_hz=1.0 / 60,  # 1 m/s per sqrt(h)
    gyro_noise_radps_per_sqrt_hz=float(np.deg2rad(6.0) / 60),  # 6 deg per sqrt(h)
    accel_bias_walk_mps3_per_sqrt_hz=float(1160e-5 * _GAUSS_MARKOV_WALK),  # 1160 mGal
    gyro_bias_walk_radps2_per_sqrt_hz=float(np.deg2rad(12.0) / _HOUR_S * _GAUSS_MARKOV_WALK),
)
"""Noise that fits this recording; the data sheet's is far too tight."""

_GEODETIC_SOURCE = ("lat_deg", "lon_deg", "ellipsoidal_height_m")
_SIGMA_ENU = ("sigma_e_m", "sigma_n_m", "sigma_u_m")
_VELOCITY_NED = ("v_north_mps", "v_east_mps", "v_down_mps")
_ACCEL_FRD = tuple(f"accel_{axis}_frd_mps2" for axis in "xyz")
_GYRO_FRD = tuple(f"gyro_{axis}_frd_radps" for axis in "xyz")
_RTK = Layout(
    tuple(
        Group.of(*names)
        for names in (("gps_sow_s",), _GEODETIC_SOURCE, ("quality",), _SIGMA_ENU, _VELOCITY_NED)
    )
)
_IMU = Layout(tuple(Group.of(*names) for names in (("gps_sow_s",), _ACCEL_FRD, _GYRO_FRD)))


def import_mems_rtk(
    source: str | Path,
    *,
    gps_week: int = GPS_WEEK,
    start_sow_s: float = START_SOW_S,
    end_sow_s: float = END_SOW_S,
) -> Drive:
    """The drive in a folder of this format, between two GPS seconds of the week.

    Raises DriveError where a file is missing or wrong, or no whole second lies in the span.
    """
    source = Path(source)
    rtk, t_rtk_ns = _read(source / "rtk.csv", _RTK, gps_week)
    imu, t_imu_ns = _read(source / "imu.csv", _IMU, gps_week)
    sow_s = rtk["gps_sow_s"]
    inside = (sow_s >= start_sow_s) & (sow_s <= end_sow_s)
    is_input = inside & (sow_s % 1 == 0)
    if not is_input.any():
        raise DriveError(
            f"{source / 'rtk.csv'}: no fix at a whole second from {start_sow_s} to {end_sow_s} s"
        )
    first = int(np.argmax(is_input))
    lat_deg, lon_deg, height_m = (float(rtk[name][first]) for name in _GEODETIC_SOURCE)
    origin = Origin(lat_deg, lon_deg, height_m)
    fixes = _fixes(source / "rtk.csv", rtk, t_rtk_ns, origin)
    samples = _samples(imu, t_imu_ns, start_sow_s, end_sow_s)
    left_out = len(t_rtk_ns) - int(inside.sum()), len(t_imu_ns) - len(samples)
    return Drive(
        "mems-rtk",
        origin,
        Rig(p_veh_ant_m=P_VEH_ANT_M, imu_noise=IMU_NOISE),
        {"gnss": fixes.take(is_input), "imu": samples},
        _truth(fixes.take(inside & ~is_input)),
        _about(*left_out),
    )


def _read(path: Path, layout: Layout, gps_week: int) -> tuple[Columns, Instants]:
    columns = read_csv(path, layout)
    t_ns = gps_week_to_ns(gps_week, columns["gps_sow_s"])
    check_increasing(path, t_ns)
    return columns, t_ns


def _fixes(path: Path, rtk: Columns, t_ns: Instants, origin: Origin) -> GnssFixes:
    geodetic = dict(zip(("lat_deg", "lon_deg", "height_m"), _GEODETIC_SOURCE, strict=True))
    p_world_ant_m = positions(path, {ours: rtk[its] for ours, its in geodetic.items()}, origin)
    cov_m2: Array = stack(rtk, _SIGMA_ENU)[:, :, None] ** 2 * np.eye(3)
    check_covariances(cov_m2, lambda row: f"{path}:{row + 2}")
    return GnssFixes(t_ns, t_ns, p_world_ant_m, cov_m2, stack(rtk, _VELOCITY_NED) @ R_ENU_NED.T)


def _samples(imu: Columns, t_ns: Instants, start_sow_s: float, end_sow_s: float) -> ImuSamples:
    sow_s = imu["gps_sow_s"]
    first = max(int(np.searchsorted(sow_s, start_sow_s, side="right")) - 1, 0)
    last = int(np.searchsorted(sow_s, end_sow_s, side="left"))
    rows = slice(first, last + 1)
    accel = stack(imu, _ACCEL_FRD)[rows] * np.diag(R_FLU_FRD)
    gyro = stack(imu, _GYRO_FRD)[rows] * np.diag(R_FLU_FRD)
    return ImuSamples(t_ns[rows], t_ns[rows], accel, gyro)


def _truth(fixes: GnssFixes) -> Trajectory | None:
    if not len(fixes):
        return None
    return Trajectory(
        fixes.t_ns, fixes.p_world_ant_m, v_world_mps=fixes.v_world_mps, p_veh_point_m=P_VEH_ANT_M
    )


def _about(rtk_left_out: int, imu_left_out: int) -> About:
    return About(
        title="Car with a consumer MEMS IMU at 100 Hz and RTK: 1 Hz in, the other 3 Hz as truth",
        licence="BSD-3-Clause",
        source=(
            "GitHub rtklibexplorer/GNSS_IMU, commit 8235ee6 (2025-09-23), data/drive_0708; "
            f"outside the span used and left out: {rtk_left_out} fixes, {imu_left_out} IMU samples"
        ),
    )
