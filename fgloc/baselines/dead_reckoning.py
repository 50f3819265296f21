"""Displacement by the velocities that a vehicle tells of itself."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgloc.drive import Drive
from fgloc.errors import DriveError
from fgloc.measurements import Array, EnuVelocities
from fgloc.timing import Instants
from fgloc.verdicts import SourceVerdicts, Verdict


@dataclass(frozen=True, eq=False)
class DeadReckoning:
    """Each velocity holds until the next one, and the last for ever: what is known online.

    t_ns      (N,) distinct instants of velocities (N, 2), East and North in m/s
    travel_m  (N, 2) displacement since the first
    row       (N,) of the table
    """

    t_ns: Instants
    v_mps: Array
    travel_m: Array
    row: NDArray[np.int64]

    @classmethod
    def of(cls, drive: Drive, method: str) -> "DeadReckoning":
        """From the drive's velocities; DriveError where it has none that are finite."""
        table = drive.tables.get("velocity")
        if not isinstance(table, EnuVelocities):
            raise DriveError(
                f"drive {drive.name!r} has no velocity table; {method} needs speed and heading"
            )
        rows = np.flatnonzero(np.isfinite(table.v_world_mps[:, :2]).all(-1))
        t_ns, first = np.unique(table.t_ns[rows], return_index=True)
        if not len(t_ns):
            raise DriveError(f"drive {drive.name!r}: none of its velocities is finite")
        v_mps = table.v_world_mps[rows[first], :2]
        travel_m = np.zeros_like(v_mps)
        np.cumsum(v_mps[:-1] * (np.diff(t_ns) / 1e9)[:, None], axis=0, out=travel_m[1:])
        return cls(t_ns, v_mps, travel_m, rows[first])

    def at(self, t_ns: ArrayLike) -> Array:
        """Displacement (M, 2) East and North in m since the first velocity, at instants (M,)."""
        t = np.asarray(t_ns, np.int64)
        k = np.clip(np.searchsorted(self.t_ns, t, side="right") - 1, 0, None)
        since_s = (t - self.t_ns[k]) / 1e9
        return self.travel_m[k] + self.v_mps[k] * since_s[..., None]

    def judge(self, verdicts: SourceVerdicts) -> None:
        """Say of each row of the table whether it was used."""
        verdicts.set(slice(None), Verdict.INVALID, "not finite, or a row of its t_ns came before")
        verdicts.set(self.row, Verdict.USED)
