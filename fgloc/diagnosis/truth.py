"""Checks of the truth against the fixes and against itself."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fgloc.diagnosis.finding import Finding, fault, warning
from fgloc.diagnosis.gnss import SIGMAS, sound_fixes
from fgloc.diagnosis.motion import LONGEST_M, slopes
from fgloc.diagnosis.planar import Planar
from fgloc.drive import Drive
from fgloc.frames import wrap_pi
from fgloc.measurements import Array, GnssFixes
from fgloc.timing import TAI_MINUS_GPS_S, Instants, elapsed_s, gps_minus_utc_s, seconds_to_ns
from fgloc.trajectory import Trajectory

GAP_S = 1.5
"""Truth is not read across wider gaps: a car may turn meanwhile."""
CLOSE_M = 0.5
"""Truth and fixes of one survey may differ by so much, by reference stations and epochs."""
TALL_M = 3.0
"""Heights of one datum agree to that; another datum is tens of metres off, mostly."""
OFF_DEG = 15.0
"""The course of a car in bends differs from its heading by less, on average over a drive."""
_FEWEST = 20


def check_truth(drive: Drive) -> Iterator[Finding]:
    """The truth against the fixes: clock, frame, height datum, lever arm."""
    gnss, truth = sound_fixes(drive), drive.truth
    if gnss is None or truth is None or len(truth) < 2:
        return
    if np.linalg.norm(drive.rig.p_veh_ant_m) > LONGEST_M:
        return  # told of already, and what follows would follow from that
    attitude = list(_attitude(drive))
    arm = [] if attitude else list(_arm(drive, gnss, truth))
    yield from (*attitude, *arm)
    has_attitude = truth.R_world_veh is not None and not attitude
    told = truth.at_point(drive.rig.p_veh_ant_m) if has_attitude else truth
    if not arm:
        yield from _horizontal(drive, gnss, told)
    yield from _vertical(gnss, told)


def _attitude(drive: Drive) -> Iterator[Finding]:
    """The truth's yaw against its own course, and which way is up."""
    truth = drive.truth
    if truth is None or truth.R_world_veh is None or len(truth) < _FEWEST:
        return
    if np.median(truth.R_world_veh[:, 2, 2]) < 0:
        yield fault(
            "truth-frame",
            "truth",
            "the attitude is upside down: its z axis is down",
            "turn forward-right-down and NED into forward-left-up and ENU",
        )
        return
    t_s = elapsed_s(truth.t_ns, int(truth.t_ns[0]))
    v, sound = slopes(t_s, truth.p_world_m, t_s, 0.5)
    moves = sound & (np.hypot(v[:, 0], v[:, 1]) > 3.0)
    if moves.sum() < _FEWEST:
        return
    course, yaw = np.arctan2(v[moves, 1], v[moves, 0]), truth.yaw_rad[moves]
    off_rad, spread = _circular(course - yaw)
    if abs(off_rad) < np.radians(OFF_DEG) and spread < 0.5:
        return
    compass_rad, compass_spread = _circular(course + yaw)
    if compass_spread < 0.2 and abs(wrap_pi(compass_rad - np.pi / 2)) < np.radians(OFF_DEG):
        yield fault(
            "truth-yaw",
            "truth",
            "the yaw is a compass heading, clockwise from north",
            "yaw is counter-clockwise from east: pi/2 less the heading",
        )
    else:
        yield fault(
            "truth-yaw",
            "truth",
            f"the yaw is {-np.degrees(off_rad):+.0f} deg from the course on average (spread "
            f"{np.degrees(spread):.0f} deg)",
            "yaw is counter-clockwise from east, of the vehicle's x axis",
        )


def _arm(drive: Drive, gnss: GnssFixes, truth: Trajectory) -> Iterator[Finding]:
    """The lever arm that the truth's attitude shows, against the rig's."""
    if truth.R_world_veh is None:
        return
    rows = _covered(gnss, truth)
    if len(rows) < _FEWEST:
        return
    at = truth.at(gnss.t_ns[rows])
    arm = np.einsum("nji,nj->ni", at.attitude(), gnss.p_world_ant_m[rows] - at.p_world_m)
    shown_m = np.median(arm, axis=0) + truth.p_veh_point_m
    sigma_m = 1.25 * np.std(arm, axis=0) / np.sqrt(len(rows) / _white(arm))
    claimed_m = drive.rig.p_veh_ant_m
    for axis, name in enumerate(("x", "y", "z")):
        shown, claimed, sigma = shown_m[axis], claimed_m[axis], sigma_m[axis]
        if abs(claimed) > 0.1 and abs(shown + claimed) < abs(claimed) / 2 and (
            abs(shown - claimed) > SIGMAS * sigma
        ):  # fmt: skip
            yield fault(
                "lever-arm-sign",
                "rig",
                f"by the truth the antenna is at {name} = {shown:+.2f} m (sigma {sigma:.2f} m), "
                f"rig.p_veh_ant_m says {claimed:+.2f} m",
                f"change the sign of {name}: x is forward, y is left, z is up",
            )


def _white(arm: Array) -> float:
    """How many neighbouring rows count as one, by the correlation from one row to the next."""
    centred = arm - arm.mean(axis=0)
    correlation = float(
        np.max((centred[1:] * centred[:-1]).sum(0) / np.maximum((centred**2).sum(0), 1e-12))
    )
    correlation = float(np.clip(correlation, 0, 0.99))
    return (1 + correlation) / (1 - correlation)


def _horizontal(drive: Drive, gnss: GnssFixes, truth: Trajectory) -> Iterator[Finding]:
    rows = _covered(gnss, truth)
    if len(rows) < _FEWEST:
        return
    off_m = _off_m(gnss, truth, rows)
    slow_m = 0.0 if drive.rig.gnss_bias is None else drive.rig.gnss_bias.sigma_m
    variance_m2 = gnss.cov_world_m2[rows, 0, 0] + gnss.cov_world_m2[rows, 1, 1]
    sigma_m = np.sqrt(variance_m2 + 2 * slow_m**2)
    arm_m = float(np.linalg.norm(truth.p_veh_point_m - drive.rig.p_veh_ant_m))
    usual_m = float(np.median(np.hypot(*off_m.T)))
    if usual_m <= 3 * float(np.nanmedian(sigma_m)) + arm_m + CLOSE_M:
        return
    what = f"fixes and truth differ by {usual_m:,.1f} m horizontally (median)"
    yield _why(what, gnss, truth, rows, off_m, usual_m)


def _why(
    what: str,
    gnss: GnssFixes,
    truth: Trajectory,
    rows: NDArray[np.int64],
    off_m: Array,
    usual_m: float,
) -> Finding:
    lag_s, left_m = _truth_lag(gnss, truth)
    if left_m < usual_m / 3:
        when = "earlier" if lag_s < 0 else "later"
        return fault(
            "lag",
            "truth",
            f"{what}; {left_m:,.1f} m are left if truth is read {abs(lag_s):.1f} s {when}",
            "bring both to UTC: GPS time is ahead by the leap seconds",
        )
    p_fix, p_truth = gnss.p_world_ant_m[rows, :2], truth.at(gnss.t_ns[rows]).p_world_m[:, :2]
    planar = Planar.of(p_fix - p_fix.mean(0), p_truth - p_truth.mean(0))
    if planar is not None and planar.mirrored:
        return fault(
            "mirrored",
            "truth",
            f"{what}: one is the mirror image of the other, north and east exchanged (NED read as "
            "ENU)",
            "write east, north, up in that order",
        )
    if planar is not None and abs(planar.turn_deg) > 1:
        return fault(
            "truth-frame",
            "truth",
            f"{what}: the fixes are turned by {planar.turn_deg:+.1f} deg",
            "bring both into one ENU frame of one origin",
        )
    east, north = np.median(off_m, axis=0)
    if np.hypot(east, north) < usual_m / 3:
        return warning(
            "scatter",
            "gnss",
            f"{what} to all sides; their covariance claims less",
            "it is too small: take it from the receiver, or set gnss.sigma_scale",
        )
    return warning(
        "truth-offset",
        "truth",
        f"{what}: by {east:+.2f} m east and {north:+.2f} m north",
        "is it the same origin, datum and point of the vehicle?",
    )


def _vertical(gnss: GnssFixes, truth: Trajectory) -> Iterator[Finding]:
    rows = _covered(gnss, truth)
    if len(rows) < _FEWEST:
        return
    up_m = float(np.median(gnss.p_world_ant_m[rows, 2] - truth.at(gnss.t_ns[rows]).p_world_m[:, 2]))
    sigma_m = float(np.nanmedian(np.sqrt(np.maximum(gnss.cov_world_m2[rows, 2, 2], 0))))
    if abs(up_m) > TALL_M + 2 * sigma_m:
        yield warning(
            "height-datum",
            "truth",
            f"the fixes lie {up_m:+.1f} m above the truth (median)",
            "are both above the ellipsoid, or both above sea level? Add the geoid's height to one",
        )


def _covered(gnss: GnssFixes, truth: Trajectory, lag_s: float = 0.0) -> NDArray[np.int64]:
    """Rows (M,) of fixes at whose time, `lag_s` later, there is truth."""
    return np.flatnonzero(truth.covers(gnss.t_ns + seconds_to_ns(lag_s), GAP_S))


def _off_m(
    gnss: GnssFixes, truth: Trajectory, rows: NDArray[np.int64], lag_s: float = 0.0
) -> Array:
    at: Instants = gnss.t_ns[rows] + seconds_to_ns(lag_s)
    return gnss.p_world_ant_m[rows, :2] - truth.at(at).p_world_m[:, :2]


def _truth_lag(gnss: GnssFixes, truth: Trajectory) -> tuple[float, float]:
    """The lag in s with which truth fits best, of small and well-known ones, and the m left."""
    leap_s = gps_minus_utc_s(int(gnss.t_ns[0]) / 1e9) if gnss.t_ns[0] > 4e17 else 18
    known = np.array([leap_s, TAI_MINUS_GPS_S, leap_s + TAI_MINUS_GPS_S], float)
    lags = np.concatenate([np.arange(-2, 2.01, 0.1), known, -known])
    best = (0.0, np.inf)
    for lag_s in lags:
        rows = _covered(gnss, truth, lag_s)
        if len(rows) >= _FEWEST:
            left_m = float(np.median(np.hypot(*_off_m(gnss, truth, rows, lag_s).T)))
            best = min(best, (float(lag_s), left_m), key=lambda one: one[1])
    return best


def _circular(angle_rad: Array) -> tuple[float, float]:
    """Mean direction of angles, and their standard deviation about it, in rad."""
    mean = np.exp(1j * angle_rad).mean()
    length = min(max(abs(mean), 1e-12), 1.0)
    return float(np.angle(mean)), float(np.sqrt(-2 * np.log(length)))
