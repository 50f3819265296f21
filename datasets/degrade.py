"""Take GNSS fixes away from a drive, or make them worse; what is removed becomes truth."""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc.datasets.simulator import stream
from fgloc.drive import About, Drive
from fgloc.errors import InputError
from fgloc.measurements import GnssFixes
from fgloc.timing import Instants, elapsed_s, seconds_to_ns
from fgloc.trajectory import Trajectory

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Outage:
    """Fixes are missing from `first_s` on for `length_s`, and again every `period_s`.

    Seconds count from the drive's first fix. Raises InputError where the numbers make no sense.
    """

    first_s: float
    length_s: float
    period_s: float

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not math.isfinite(value) or value < 0:
                raise InputError(f"outage {name} = {value}: expected seconds, 0 or more")
        if not 0 < seconds_to_ns(self.length_s) < seconds_to_ns(self.period_s):
            raise InputError(
                f"outage of {self.length_s:g} s every {self.period_s:g} s: "
                "the length must be above 0 and below the period"
            )

    def count(self, fixes: GnssFixes) -> int:
        """How many outages there are. Only whole ones: one with no fix after it is not begun."""
        begin, length, period = self._in_ns(fixes)
        return max((int(fixes.t_ns[-1]) - length - begin) // period + 1, 0)

    def covers(self, fixes: GnssFixes) -> Mask:
        """(N,) bool: the fixes that fall into an outage, its beginning included, its end not."""
        begin, length, period = self._in_ns(fixes)
        number, into = np.divmod(fixes.t_ns - begin, period)
        return (number >= 0) & (number < self.count(fixes)) & (into < length)

    def _in_ns(self, fixes: GnssFixes) -> tuple[int, int, int]:
        first, length, period = map(seconds_to_ns, (self.first_s, self.length_s, self.period_s))
        return int(fixes.t_ns[0]) + first, length, period


def degrade(
    drive: Drive,
    *,
    keep_every: int | None = None,
    outage: Outage | tuple[float, float, float] | None = None,
    noise_enu_m: Sequence[float] | None = None,
    seed: int = 0,
) -> Drive:
    """The drive with fewer or worse GNSS fixes; `about` says how many were removed.

    keep_every   only the fixes 0, N, 2N, ... stay
    outage       fixes within outages are removed: (first_s, length_s, period_s)
    noise_enu_m  white noise (3,) of these sigmas is added to the positions and its square becomes
                 the covariance; velocities, which are as good as before, are left out

    Removed fixes join the truth; with noise all original fixes do. A truth that knows attitude,
    such as a simulated one, knows better and stays as it is. Raises InputError where an option
    makes no sense, nothing is asked for, or the truth tells of another point than the antenna.
    """
    fixes = drive.gnss
    outage = Outage(*outage) if isinstance(outage, tuple) else outage
    if keep_every is None and outage is None and noise_enu_m is None:
        raise InputError("nothing to degrade: give keep_every, outage or noise")
    removed = np.zeros(len(fixes), bool)
    notes = []
    if keep_every is not None:
        removed |= _thinned(len(fixes), keep_every)
        notes.append(f"every {keep_every}th fix kept")
    if outage is not None:
        removed |= _in_outages(fixes, outage)
        number = outage.count(fixes)
        notes.append(f"{number} outages of {outage.length_s:g} s from {outage.first_s:g} s on")
    kept = fixes.take(~removed)
    if noise_enu_m is not None:
        kept = _with_noise(kept, noise_enu_m, seed)
        sigmas = ", ".join(f"{sigma:g}" for sigma in noise_enu_m)
        notes.append(f"white noise of {sigmas} m (E, N, U) added with seed {seed}")
    to_truth = fixes if noise_enu_m is not None else fixes.take(removed)
    counts = f"{int(removed.sum())} of {len(fixes)} fixes removed, {len(kept)} kept"
    return dataclasses.replace(
        drive.with_tables(gnss=kept),
        truth=_truth(drive, to_truth),
        about=_about(drive, "; ".join(notes), counts),
    )


def _thinned(n: int, keep_every: int) -> Mask:
    if keep_every < 1:
        raise InputError(f"keep_every = {keep_every}: expected a whole number from 1")
    return np.arange(n) % keep_every != 0


def _in_outages(fixes: GnssFixes, outage: Outage) -> Mask:
    if not outage.count(fixes):
        span_s = float(elapsed_s(fixes.t_ns[-1], int(fixes.t_ns[0])))
        raise InputError(
            f"no outage of {outage.length_s:g} s from {outage.first_s:g} s on ends within the "
            f"{span_s:g} s of fixes; begin earlier or make it shorter"
        )
    return outage.covers(fixes)


def _with_noise(fixes: GnssFixes, noise_enu_m: Sequence[float], seed: int) -> GnssFixes:
    sigma_m = np.asarray(noise_enu_m, float)
    if sigma_m.shape != (3,) or not (np.isfinite(sigma_m) & (sigma_m > 0)).all():
        raise InputError(f"noise {list(noise_enu_m)}: expected three sigmas above 0 m, E, N, U")
    noise_m = stream(seed, "degrade/gnss").standard_normal((len(fixes), 3)) * sigma_m
    return dataclasses.replace(
        fixes,
        p_world_ant_m=fixes.p_world_ant_m + noise_m,
        cov_world_m2=np.tile(np.diag(sigma_m**2), (len(fixes), 1, 1)),
        v_world_mps=np.full((len(fixes), 3), np.nan),
    )


def _truth(drive: Drive, fixes: GnssFixes) -> Trajectory | None:
    """The truth of the drive joined by fixes; where both have a state, the truth's stays."""
    old = drive.truth
    if not len(fixes) or (old is not None and old.R_world_veh is not None):
        return old
    new = _as_truth(fixes, drive)
    if old is None:
        return new
    if not np.array_equal(old.p_veh_point_m, new.p_veh_point_m):
        raise InputError(
            f"the truth tells of the point {old.p_veh_point_m.tolist()} m, the fixes of the "
            f"antenna at {new.p_veh_point_m.tolist()} m; without attitude they cannot be joined"
        )
    return _merge(old, new)


def _as_truth(fixes: GnssFixes, drive: Drive) -> Trajectory:
    once = np.diff(fixes.t_ns, prepend=fixes.t_ns[0] - 1) > 0  # of duplicates the first
    fixes = fixes.take(once)
    has_velocity = bool(np.isfinite(fixes.v_world_mps).all())
    return Trajectory(
        fixes.t_ns,
        fixes.p_world_ant_m,
        v_world_mps=fixes.v_world_mps if has_velocity else None,
        p_veh_point_m=drive.rig.p_veh_ant_m,
    )


def _merge(old: Trajectory, new: Trajectory) -> Trajectory:
    """Both in order of time; velocities survive only where both have them."""
    new = new.take(~np.isin(new.t_ns, old.t_ns))
    t_ns: Instants = np.concatenate([old.t_ns, new.t_ns])
    order = np.argsort(t_ns, kind="stable")
    velocity = None
    if old.v_world_mps is not None and new.v_world_mps is not None:
        velocity = np.concatenate([old.v_world_mps, new.v_world_mps])[order]
    position = np.concatenate([old.p_world_m, new.p_world_m])[order]
    return Trajectory(t_ns[order], position, None, velocity, None, old.p_veh_point_m)


def _about(drive: Drive, notes: str, counts: str) -> About:
    about = drive.about
    source = f"{about.source}; " if about.source else ""
    return dataclasses.replace(
        about,
        title=f"{about.title} ({notes})".strip(),
        source=f"{source}degraded: {notes}; {counts}",
    )
