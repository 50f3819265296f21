"""Fixes and detections as the filter of Marr (2019) takes them: the newest of each source."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc.drive import Drive
from fgloc.measurements import PEDESTRIAN, Array, GnssFixes, NodeDetections, Table
from fgloc.timing import Instants
from fgloc.verdicts import SourceVerdicts, Verdict


@dataclass(frozen=True, eq=False)
class Positions:
    """A source in the order of arrival: rows (N,) of its table, when each was true and came in
    (N,), and positions (N, 2) East and North in m."""

    source: str
    row: NDArray[np.int64]
    t_ns: Instants
    received_ns: Instants
    p_world_m: Array

    @classmethod
    def of(cls, table: Table, p_world_m: Array, usable: NDArray[np.bool_]) -> "Positions":
        """The usable rows of a table with a position (N, 2) for each."""
        row = np.flatnonzero(usable)
        row = row[np.argsort(table.received_ns[row], kind="stable")]
        return cls(table.KIND, row, table.t_ns[row], table.received_ns[row], p_world_m[row])

    @classmethod
    def none(cls, source: str) -> "Positions":
        """No position at all."""
        empty = np.zeros(0, np.int64)
        return cls(source, empty, empty, empty, np.zeros((0, 2)))

    def latest(self, now_ns: Instants) -> NDArray[np.int64]:
        """(K,) index of the newest that has come in by instants (K,), -1 where none has."""
        is_newest = self.t_ns == np.maximum.accumulate(self.t_ns)
        newest = np.maximum.accumulate(np.where(is_newest, np.arange(len(self.t_ns)), 0))
        return np.r_[-1, newest][np.searchsorted(self.received_ns, now_ns, side="right")]

    def judge(self, verdicts: dict[str, SourceVerdicts], latest: NDArray[np.int64]) -> None:
        """Say which rows were once the newest at a step, by what `latest` gave."""
        if not len(self.row):
            return
        verdicts[self.source].set(self.row, Verdict.UNUSED, "a newer one was there at every step")
        verdicts[self.source].set(self.row[np.unique(latest[latest >= 0])], Verdict.USED)


def fixed(drive: Drive, verdicts: dict[str, SourceVerdicts]) -> Positions:
    """The fixes that are finite; the others are said to be invalid."""
    fixes = drive.tables.get("gnss")
    if not isinstance(fixes, GnssFixes):
        return Positions.none("gnss")
    finite = np.asarray(np.isfinite(fixes.p_world_ant_m).all(-1))
    verdicts["gnss"].set(~finite, Verdict.INVALID, "position is not finite")
    return Positions.of(fixes, fixes.p_world_ant_m[:, :2], finite)


def detected(drive: Drive, verdicts: dict[str, SourceVerdicts]) -> Positions:
    """Detections of all nodes but of pedestrians; those that are not finite are invalid."""
    seen = drive.tables.get("detections")
    if not isinstance(seen, NodeDetections):
        return Positions.none("detections")
    p_m = np.empty_like(seen.p_node_m)
    for i, node in enumerate(drive.infrastructure.nodes):
        mine = seen.node == i
        p_m[mine] = node.to_world(seen.p_node_m[mine])
    finite, on_foot = np.isfinite(p_m).all(-1), seen.kind == PEDESTRIAN
    verdicts["detections"].set(on_foot, Verdict.UNUSED, "a pedestrian")
    verdicts["detections"].set(~finite, Verdict.INVALID, "position is not finite")
    return Positions.of(seen, p_m, finite & ~on_foot)


def heights_m(drive: Drive, gps: Positions, latest: NDArray[np.int64]) -> Array:
    """Up (K,) of the newest fix at each step; before the first, and without fixes, 0."""
    if not len(gps.row):
        return np.zeros(len(latest))
    return np.where(latest >= 0, drive.gnss.p_world_ant_m[gps.row[latest], 2], 0.0)
