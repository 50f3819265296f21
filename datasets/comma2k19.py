"""Importer `comma2k19`: a one-minute segment as published, .npy arrays without an extension.

The drive gets, all on the log's own clock,

* IMU: `processed_log/IMU/accelerometer` and `gyro` (its bias removed by the phone), about 104 Hz,
  turned from forward-right-down to forward-left-up;
* GNSS: `live_gnss_ublox`, 10 Hz, as stamped by the log, which is when the message came. Its
  altitude is above the ellipsoid. Speed and bearing are not taken, a vertical velocity is missing;
* wheel: `CAN/speed`, which is the mean of the four `wheel_speed`;
* steering: `CAN/steering_angle`, positive to the left;
* truth: `global_pose`, 20 Hz. Its makers solved it from the same receiver's raw data, so it is a
  reference and not independent.

The log counts seconds since the device was started. `frame_gps_times`, GPS time of the frames of
the pose, differs from it by a constant to a microsecond, and puts everything on POSIX time. The
UTC in the receiver's rows would be 0.2 s off and jitters by 0.01 s: it is late by the transport.

Vehicle frame: origin at the device (the camera), x forward and z up. The device leans by some
degrees, and how much is measured from the segment's own mean specific force, less the speeding up
that the wheels tell: right to a degree, where the road is level on the whole. Yaw of the device
in the car and the place of the antenna are unknown and taken as zero.
"""

from pathlib import Path

import numpy as np

from fgloc.arrays import Array, finite_rows
from fgloc.datasets.recording import check_sigma, geodetic_fixes, left_out
from fgloc.datasets.trajectory_columns import check_increasing
from fgloc.drive import About, Drive, ImuNoise, Rig
from fgloc.errors import DriveError
from fgloc.frames import R_FLU_FRD, Origin, exp_so3, quat_to_matrix
from fgloc.measurements import ImuSamples, SteeringAngles, WheelSpeeds
from fgloc.timing import Instants, gps_week_to_ns
from fgloc.trajectory import Trajectory

SIGMA_HORIZONTAL_M = 2.1
"""East and north: the 2.5 m circular error of half the fixes that the maker of M8 receivers states.

The receiver gives no covariance. Errors are alike over many seconds, so ten fixes a second are
less than ten times the information.
"""
SIGMA_UP_M = 4.2
"""Twice the horizontal one, as is usual for one receiver alone."""

WHEEL_SIGMA_MPS = 0.15
"""One per cent at 15 m/s: the radius of a tyre is not known better; the quantum is 0.003 m/s."""

IMU_NOISE = ImuNoise(
    accel_noise_mps2_per_sqrt_hz=0.009,
    gyro_noise_radps_per_sqrt_hz=0.0012,
    accel_bias_walk_mps3_per_sqrt_hz=3e-4,
    gyro_bias_walk_radps2_per_sqrt_hz=1e-5,
)
"""A phone's IMU: 104 Hz and steps of 2.4 mm/s^2 are those of the ST LSM6 family.

White noise is ten times its data sheet's 90 ug and 7 mdps per sqrt(Hz), since in a car vibration
and the mount rule, not the chip.
"""

_IMU, _CAN, _GNSS, _POSE = (
    f"processed_log/{part}" if part != "global_pose" else part
    for part in ("IMU", "CAN", "GNSS/live_gnss_ublox", "global_pose")
)
_NS_PER_S = 1e9


def import_comma2k19(
    source: str | Path,
    *,
    sigma_horizontal_m: float = SIGMA_HORIZONTAL_M,
    sigma_up_m: float = SIGMA_UP_M,
) -> Drive:
    """The drive in a segment's folder, fixes with the sigmas given.

    Raises DriveError where an array is missing, damaged, of a wrong shape or out of order,
    InputError where a sigma is not above 0.
    """
    check_sigma("sigma_horizontal_m", sigma_horizontal_m)
    check_sigma("sigma_up_m", sigma_up_m)
    source = Path(source)
    boot_ns = _boot_instant(source)
    fix_path = source / _GNSS / "value"
    rows, t_fix_ns = _log(source, _GNSS, 6, boot_ns, gaps_allowed=True)
    valid = np.isfinite(rows).all(-1) & (rows[:, :2] != 0).any(-1)
    lines = np.arange(1, len(rows) + 1)[valid].tolist()
    cov_m2 = np.tile(np.diag([sigma_horizontal_m, sigma_horizontal_m, sigma_up_m]) ** 2,
                     (len(lines), 1, 1))  # fmt: skip
    fixes, origin, _ = geodetic_fixes(
        fix_path, lines, t_fix_ns[valid], rows[valid][:, [0, 1, 4]], cov_m2
    )
    samples, wheel = _imu(source, boot_ns), _wheel(source, boot_ns)
    T_veh_imu = _levelled(samples, wheel)
    tables = {"gnss": fixes, "imu": samples, "wheel": wheel, "steering": _steering(source, boot_ns)}
    return Drive(
        "comma2k19",
        origin,
        Rig(T_veh_imu=T_veh_imu, imu_noise=IMU_NOISE),
        tables,
        _truth(source, boot_ns, origin, T_veh_imu[:3, :3]),
        _about(T_veh_imu, int((~valid).sum())),
    )


def _load(path: Path, *shape: int) -> Array:
    """An array whose trailing shape is given; DriveError where it is none."""
    try:
        array = np.load(path, allow_pickle=False)
    except FileNotFoundError as err:
        raise DriveError(f"{path}: no such file; is this a segment of comma2k19?") from err
    except (OSError, ValueError, EOFError) as err:
        raise DriveError(f"{path}: is not an array of numpy: copy it again") from err
    if array.dtype.kind not in "fiu" or not len(array) or array.shape[1:] != shape:
        raise DriveError(
            f"{path}: an array of {array.dtype} and shape {array.shape}, expected numbers of "
            f"shape {('N', *shape)}"
        )
    return np.asarray(array, float)


def _finite(path: Path, array: Array) -> Array:
    bad = ~finite_rows(array)
    if bad.any():
        raise DriveError(f"{path}: row {int(np.argmax(bad))} (from 0) is not finite; repair it")
    return array


def _times(path: Path, boot_ns: int, n: int, *, duplicates: bool = True) -> Instants:
    t_s = _finite(path, _load(path))
    if len(t_s) != n:
        raise DriveError(f"{path}: {len(t_s)} times for {n} values; copy both again")
    t_ns = np.rint(t_s * _NS_PER_S).astype(np.int64) + boot_ns
    check_increasing(path, t_ns, duplicates=duplicates, lines=range(1, n + 1))
    return t_ns


def _log(
    source: Path, name: str, width: int | None, boot_ns: int, *, gaps_allowed: bool = False,
    duplicates: bool = True,
) -> tuple[Array, Instants]:  # fmt: skip
    """Values (N, width), or (N,) without a width, and their instants (N,)."""
    path = source / name / "value"
    values = _load(path, *(() if width is None else (width,)))
    if not gaps_allowed:
        _finite(path, values)
    return values, _times(source / name / "t", boot_ns, len(values), duplicates=duplicates)


def _boot_instant(source: Path) -> int:
    """POSIX nanoseconds of the instant from which the log counts its seconds."""
    week, sow_s = _finite(
        source / _POSE / "frame_gps_times", _load(source / _POSE / "frame_gps_times", 2)
    ).T
    frame_s = _finite(source / _POSE / "frame_times", _load(source / _POSE / "frame_times"))
    if len(frame_s) != len(week):
        raise DriveError(
            f"{source / _POSE}: {len(week)} frame_gps_times for {len(frame_s)} frame_times"
        )
    since_boot_ns = np.rint(frame_s * _NS_PER_S).astype(np.int64)
    # Whole weeks first: the seconds of one week keep their digits.
    t_ns = gps_week_to_ns(int(week[0]), sow_s + (week - week[0]) * 604_800)
    return int(np.median(t_ns - since_boot_ns))


def _imu(source: Path, boot_ns: int) -> ImuSamples:
    accel, t_ns = _log(source, f"{_IMU}/accelerometer", 3, boot_ns, duplicates=False)
    gyro, t_gyro_ns = _log(source, f"{_IMU}/gyro", 3, boot_ns, duplicates=False)
    if not np.array_equal(t_ns, t_gyro_ns):
        raise DriveError(f"{source / _IMU}: accelerometer/t and gyro/t differ; copy both again")
    return ImuSamples(t_ns, t_ns, accel @ R_FLU_FRD, gyro @ R_FLU_FRD)


def _wheel(source: Path, boot_ns: int) -> WheelSpeeds:
    speed, t_ns = _log(source, f"{_CAN}/speed", 1, boot_ns)
    return WheelSpeeds(t_ns, t_ns, speed[:, 0], np.full(len(t_ns), WHEEL_SIGMA_MPS))


def _steering(source: Path, boot_ns: int) -> SteeringAngles:
    angle_deg, t_ns = _log(source, f"{_CAN}/steering_angle", None, boot_ns)
    return SteeringAngles(t_ns, t_ns, np.deg2rad(angle_deg))


def _levelled(samples: ImuSamples, wheel: WheelSpeeds) -> Array:
    """T_veh_imu (4, 4) of the smallest turn that brings the mean specific force upright."""
    span_s = max(float(wheel.t_ns[-1] - wheel.t_ns[0]) / _NS_PER_S, 1.0)
    speeding_up_mps2 = (wheel.speed_mps[-1] - wheel.speed_mps[0]) / span_s
    up = samples.accel_mps2.mean(0) - [speeding_up_mps2, 0, 0]
    axis = np.cross(up, [0, 0, 1])
    sine = float(np.linalg.norm(axis))
    T_veh_imu = np.eye(4)
    if sine > 0:
        T_veh_imu[:3, :3] = exp_so3(axis / sine * np.arctan2(sine, up[2]))
    return T_veh_imu


def _truth(source: Path, boot_ns: int, origin: Origin, R_veh_device: Array) -> Trajectory:
    """The pose of the vehicle frame, at the device.

    The quaternions are (w, x, y, z) and turn forward-right-down into Earth-centred axes: with
    this reading the device looks along the velocity, with the others it does not.
    """
    folder = source / _POSE
    p_ecef_m = _finite(folder / "frame_positions", _load(folder / "frame_positions", 3))
    v_ecef_mps = _finite(folder / "frame_velocities", _load(folder / "frame_velocities", 3))
    q_wxyz = _finite(folder / "frame_orientations", _load(folder / "frame_orientations", 4))
    t_ns = _times(folder / "frame_times", boot_ns, len(p_ecef_m), duplicates=False)
    if not len(p_ecef_m) == len(v_ecef_mps) == len(q_wxyz):
        raise DriveError(f"{folder}: the arrays differ in length; copy them again")
    centre = origin.world_to_ecef(np.zeros(3))
    R_world_ecef = origin.ecef_to_world(centre + np.eye(3)).T
    R_ecef_frd = quat_to_matrix(q_wxyz[:, [1, 2, 3, 0]])
    R_world_veh = R_world_ecef @ R_ecef_frd @ R_FLU_FRD @ R_veh_device.T
    return Trajectory(
        t_ns, origin.ecef_to_world(p_ecef_m), R_world_veh, v_ecef_mps @ R_world_ecef.T
    )


def _about(T_veh_imu: Array, invalid: int) -> About:
    lean_deg = np.rad2deg(np.arccos(np.clip(T_veh_imu[2, 2], -1, 1)))
    return About(
        title="Car on a motorway: phone IMU at 104 Hz, u-blox at 10 Hz, CAN; the makers' pose",
        licence="MIT",
        source=(
            "comma2k19 (comma.ai); fixes as stamped by the log; the device leans by "
            f"{lean_deg:.2f} deg; not taken: the phone's fixes, raw pseudoranges, magnetometer; "
            + left_out({"u-blox rows without a position": invalid})
        ),
    )
