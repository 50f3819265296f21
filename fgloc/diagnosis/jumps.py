"""Checks of where the fixes go: jumps, repeated fixes, steps of the height."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fgloc.diagnosis.finding import Finding, fault, rows_of, warning
from fgloc.diagnosis.gnss import (
    FASTEST_MPS,
    SIGMAS,
    fixes_of,
    noise_m,
    sound_fixes,
    strays,
    too_fast,
)
from fgloc.diagnosis.sampling import longest_run, usual_interval_s
from fgloc.drive import Drive
from fgloc.measurements import Array, GnssFixes
from fgloc.timing import elapsed_s

STEEPEST = 0.2
"""Roads climb by less; a height that changes faster did not come from driving."""
HARDEST_MPS2 = 10.0
"""As hard as tyres can push."""
_SIDE = 5  # fixes to either side of a step in height
_FAR_M = 50_000.0


def check_jumps(drive: Drive) -> Iterator[Finding]:
    """Fixes that no vehicle could have come to: single ones, and a path that goes on elsewhere."""
    gnss = sound_fixes(drive)
    if gnss is None or len(gnss) < 3:
        return
    t_s = elapsed_s(gnss.t_ns, int(gnss.t_ns[0]))
    p = gnss.p_world_ant_m[:, :2]
    sigma_m = np.hypot(*noise_m(gnss)[:, :2].T)
    step_m = np.hypot(*np.diff(p, axis=0).T)
    alone = strays(t_s, p, sigma_m)
    jumps = np.flatnonzero(too_fast(t_s, p, sigma_m)) + 1
    stays = np.setdiff1d(jumps, np.concatenate([alone, alone + 1]))
    if len(alone):
        yield warning(
            "outlier",
            "gnss",
            f"{rows_of(gnss, alone)}: away from the fix before and after by up to "
            f"{step_m[alone - 1].max():,.0f} m",
            "the gate keeps them out; remove them if they are many",
        )
    if len(stays):
        yield fault(
            "jump",
            "gnss",
            f"{rows_of(gnss, stays)}: the position jumps by up to {step_m[stays - 1].max():,.0f} "
            f"m, faster than {FASTEST_MPS:g} m/s, and stays there",
            "was another reference station or frame used from there on, or two recordings joined?",
        )


def check_frozen(drive: Drive) -> Iterator[Finding]:
    """A receiver that repeats its last position and then jumps to where the vehicle is."""
    gnss = sound_fixes(drive)
    if gnss is None or len(gnss) <= _SIDE:
        return
    p = gnss.p_world_ant_m
    first, length = longest_run((np.diff(p, axis=0) == 0).all(-1))
    after = first + length + 1
    if length < _SIDE - 1 or after >= len(gnss):
        return
    jump_m = float(np.hypot(*(p[after] - p[first])[:2]))
    dt_s = usual_interval_s(gnss)
    if jump_m > SIGMAS * np.hypot(*noise_m(gnss)[:, :2].T)[first] + 2 * HARDEST_MPS2 * dt_s**2 / 2:
        yield warning(
            "stuck",
            "gnss",
            f"{length + 1} fixes are the same from {rows_of(gnss, [first])} on, then the position "
            f"jumps by {jump_m:,.1f} m",
            "the receiver repeated its last fix: remove the repeated rows",
        )


def check_heights(drive: Drive) -> Iterator[Finding]:
    """A height that steps while the vehicle drives on: another height datum."""
    gnss = sound_fixes(drive)
    if gnss is None or len(gnss) < 2 * _SIDE:
        return
    n = int(np.clip(round(1 / (usual_interval_s(gnss) or 1.0)), 1, 10))
    rows = np.arange(_SIDE, len(gnss) - _SIDE + 1)
    step_m, allowed_m = _step_up_m(gnss, rows, n)
    lasting_m = _step_up_m(gnss, rows, max(n, _SIDE))[0]
    over = (np.abs(step_m) > allowed_m) & (lasting_m * np.sign(step_m) > np.abs(step_m) / 2)
    for group in np.split(
        np.flatnonzero(over), np.flatnonzero(np.diff(np.flatnonzero(over)) > n) + 1
    ):
        if not len(group):
            continue
        sharpest = group[np.argmax(np.abs(step_m[group]) - allowed_m[group])]
        yield fault(
            "height-jump",
            "gnss",
            f"the height steps by {step_m[sharpest]:+.1f} m at {rows_of(gnss, [rows[sharpest]])} "
            "while the vehicle drives on; no road does that",
            "heights above the ellipsoid and above sea level differ by the geoid (up to 100 m): "
            "bring all fixes to the datum of [origin]",
        )


def _step_up_m(gnss: GnssFixes, rows: NDArray[np.int64], n: int) -> tuple[Array, Array]:
    """Median height of n fixes from each row on less that of n before, and what may be honest.

    A median of n has 1.25 / sqrt(n) of the sigma of one.
    """
    up, t_s = gnss.p_world_ant_m[:, 2], elapsed_s(gnss.t_ns, int(gnss.t_ns[0]))
    before = np.maximum(rows[:, None] - 1 - np.arange(n), 0)
    after = np.minimum(rows[:, None] + np.arange(n), len(gnss) - 1)
    step_m = np.median(up[after], axis=1) - np.median(up[before], axis=1)
    sigma_m = noise_m(gnss)[:, 2]
    usual_m = np.hypot(np.median(sigma_m[after], 1), np.median(sigma_m[before], 1))
    path_m = np.hypot(
        *(gnss.p_world_ant_m[after[:, n // 2]] - gnss.p_world_ant_m[before[:, n // 2]])[:, :2].T
    )
    span_s = t_s[after[:, n // 2]] - t_s[before[:, n // 2]]
    unseen = span_s > 5 * n * max(usual_interval_s(gnss), 0.2)
    path_m = np.where(unseen, np.maximum(path_m, FASTEST_MPS / 2 * span_s), path_m)
    return step_m, SIGMAS * 1.25 * usual_m / np.sqrt(n) + STEEPEST * path_m + 1.0


def check_place(drive: Drive) -> Iterator[Finding]:
    """Fixes far from the origin, where a flat world is no longer one."""
    gnss = fixes_of(drive)
    if gnss is None:
        return
    far_m = float(np.nanmedian(np.linalg.norm(gnss.p_world_ant_m, axis=-1)))
    if far_m > _FAR_M:
        yield fault(
            "far",
            "gnss",
            f"the fixes lie {far_m / 1000:,.0f} km from the origin",
            "are they ECEF or UTM coordinates? Give lat_deg,lon_deg,height_m, or an origin on "
            "the way",
        )
