"""What the error-state filter takes in: fixes, and frames of detections; gates and association.

A reading is judged once, when it arrives: whether it is believed, which object of a frame is the
vehicle, how much it is weighed down. Where the filter goes back in time for one that came late,
those after it are taken in again as they were judged.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc.baselines.eskf_state import GNSS, Slow, State
from fgloc.chi_square import chi2_quantile
from fgloc.config import GnssConfig
from fgloc.drive import Drive
from fgloc.factors import noise
from fgloc.factors.roadside import line_of_sight_cov_m2
from fgloc.measurements import PEDESTRIAN, Array, GnssFixes, NodeDetections
from fgloc.result import Event
from fgloc.timing import Instants
from fgloc.verdicts import SourceVerdicts, Verdict

GATE_PROBABILITY = 0.999
"""A detection is gated where its NIS exceeds this quantile of chi-square."""
LOST_S = 2.0
"""So long after it was last seen, a node's number stands no longer for the vehicle."""
OPEN_ANYWAY = 2.0
"""After so many times the reset the gate for fixes opens to any, not only to two that agree."""


@dataclass(frozen=True, eq=False)
class Reading:
    """Something true at an instant: rows of a table, one of a fix, several of a frame."""

    source: str
    t_ns: int
    received_ns: int
    rows: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Taken:
    """A row that was believed, with the noise (n, n) that it enters with."""

    source: str
    row: int
    noise: Array


class Fixes:
    """Fixes of the antenna, with the graph's gate, reset and loss."""

    def __init__(
        self, drive: Drive, p_veh_m: Array, config: GnssConfig, verdicts: SourceVerdicts
    ) -> None:
        self._table: GnssFixes = drive.gnss
        self._lever, self._config, self._verdicts = (
            drive.rig.p_veh_ant_m - p_veh_m,
            config,
            verdicts,
        )
        self._gate = chi2_quantile(config.gate_probability, 3) * config.gate_slack**2
        self._accepted_ns: int | None = None
        self._refused: Array | None = None
        self.events: list[Event] = []

    def observe(self, state: State, row: int) -> tuple[Array, Array]:
        """Error (3,) in m, predicted minus measured, and its Jacobian."""
        place, H = state.point(self._lever)
        H[:, 15 : 15 + GNSS] = np.eye(3)
        return place + state.slow[:GNSS] - self._table.p_world_ant_m[row], H

    def judge(self, state: State, reading: Reading) -> tuple[State, Taken | None]:
        """Whether a fix is believed; a reset gives the state more doubt about its place."""
        row = int(reading.rows[0])
        error, H = self.observe(state, row)
        R = self._table.cov_world_m2[row]
        nis = float(error @ np.linalg.solve(state.innovation(H, R), error))
        own = self._verdicts
        own.nis[row], own.dof[row], own.threshold[row] = nis, 3, self._gate
        if nis > self._gate and not self._opens(reading.t_ns, error, R):
            own.set(row, Verdict.GATED, "does not fit the prediction")
            self._refused = error
            return state, None
        if nis > self._gate:
            state = state.loosened(float(np.linalg.norm(error)))
            self.events.append(Event(reading.t_ns, "gate reset", "no fix fitted: the gate opened"))
            nis = float(error @ np.linalg.solve(state.innovation(H, R), error))
        self._accepted_ns, self._refused = reading.t_ns, None
        w = float(noise.weight(np.sqrt(nis), self._config.loss, self._config.loss_width))
        reason = f"{self._config.loss} weight {w:.3g}" if w < 1 else ""
        own.set(row, Verdict.DOWN_WEIGHTED if w < 1 else Verdict.USED, reason)
        return state, Taken("gnss", row, R / w)

    def _opens(self, t_ns: int, error: Array, cov: Array) -> bool:
        """Whether the gate has been closed for so long that this fix may pass."""
        if self._accepted_ns is None:
            return True
        waited = (t_ns - self._accepted_ns) / 1e9 / self._config.gate_reset_s
        if self._refused is None or waited <= 1:
            return waited > OPEN_ANYWAY
        apart = error - self._refused
        agrees = float(apart @ np.linalg.solve(2 * cov, apart)) <= self._gate
        return agrees or waited > OPEN_ANYWAY


class Detections:
    """Frames of a node: which object, if any, is the vehicle."""

    def __init__(self, drive: Drive, p_veh_m: Array, verdicts: SourceVerdicts) -> None:
        table = drive.tables["detections"]
        assert isinstance(table, NodeDetections)
        self._table, self._nodes, self._verdicts = table, drive.infrastructure.nodes, verdicts
        self._lever = drive.rig.p_veh_box_m - p_veh_m
        self._gate = chi2_quantile(GATE_PROBABILITY, 2)
        stated = np.isfinite(table.cov_node_m2)
        self._cov = np.where(stated, table.cov_node_m2, line_of_sight_cov_m2(table.p_node_m))
        self._followed: dict[int, tuple[int, int]] = {}

    def readings(self, start_ns: int, end_ns: int) -> list[Reading]:
        """Frames within a time; rows that can never be used get their verdicts."""
        table, own = self._table, self._verdicts
        finite = np.isfinite(table.p_node_m).all(-1)
        inside = (table.t_ns >= start_ns) & (table.t_ns <= end_ns)
        ranges = np.array([node.range_m for node in self._nodes])
        far = np.linalg.norm(table.p_node_m, axis=1) > ranges[table.node]
        own.set(slice(None), Verdict.UNUSED, "not reached")
        own.set(far, Verdict.OUTSIDE, "beyond the node's range")
        own.set(table.kind == PEDESTRIAN, Verdict.UNUSED, "a pedestrian")
        own.set(~inside, Verdict.OUTSIDE, "before the first epoch or after the last")
        own.set(~finite, Verdict.INVALID, "position is not finite")
        rows = np.flatnonzero(finite & inside & ~far & (table.kind != PEDESTRIAN))
        key = np.stack([table.t_ns[rows], table.node[rows], table.received_ns[rows]])
        _, frame = np.unique(key, axis=1, return_inverse=True)
        order = np.argsort(frame, kind="stable")
        cuts = np.flatnonzero(np.diff(frame[order])) + 1
        return [
            Reading(
                "detections", int(table.t_ns[group[0]]), int(table.received_ns[group[0]]), group
            )
            for group in np.split(rows[order], cuts)
            if len(group)
        ]

    def observe(self, state: State, row: int) -> tuple[Array, Array]:
        """Error (2,) along the node's axes in m, predicted minus measured, and its Jacobian."""
        node = self._nodes[number := int(self._table.node[row])]
        place, by_state = state.point(self._lever)
        back = node.R_world_node.T
        seen = back @ (place[:2] - node.p_world_m[:2])
        H = back @ by_state[:2]
        at = Slow.of_node(number)
        H[:, at : at + 2] = -back
        H[:, at + 2] = seen[1], -seen[0]
        H[:, at + 3 : at + 5] = np.eye(2)
        own = slice(at, at + 5)
        slow = H[:, own] @ state.slow[own.start - 15 : own.stop - 15]
        return seen + slow - self._table.p_node_m[row], H

    def judge(self, state: State, reading: Reading) -> tuple[State, Taken | None]:
        """The followed object if it still fits, else the one that fits best."""
        nis = np.array([self._nis(state, int(row)) for row in reading.rows])
        own, rows = self._verdicts, reading.rows
        own.nis[rows], own.dof[rows], own.threshold[rows] = nis, 2, self._gate
        fits = nis <= self._gate
        own.set(rows[~fits], Verdict.GATED, "does not fit the prediction")
        own.set(rows[fits], Verdict.UNUSED, "another candidate fits better")
        if not fits.any():
            return state, None
        best = self._choose(reading, nis, fits)
        own.set(rows[best], Verdict.USED)
        row = int(rows[best])
        self._follow(row, reading.t_ns)
        return state, Taken("detections", row, self._cov[row])

    def _nis(self, state: State, row: int) -> float:
        error, H = self.observe(state, row)
        return float(error @ np.linalg.solve(state.innovation(H, self._cov[row]), error))

    def _choose(self, reading: Reading, nis: Array, fits: NDArray[np.bool_]) -> int:
        node = int(self._table.node[reading.rows[0]])
        followed, seen_ns = self._followed.get(node, (-1, 0))
        same = fits & (self._table.object_id[reading.rows] == followed)
        if followed >= 0 and same.any() and reading.t_ns - seen_ns <= LOST_S * 1e9:
            return int(np.argmax(same))
        return int(np.argmin(np.where(fits, nis, np.inf)))

    def _follow(self, row: int, t_ns: int) -> None:
        self._followed[int(self._table.node[row])] = (int(self._table.object_id[row]), t_ns)


def fix_readings(table: GnssFixes, rows: NDArray[np.int64]) -> list[Reading]:
    """Each of some fixes as a reading."""
    return [
        Reading("gnss", int(table.t_ns[row]), int(table.received_ns[row]), np.array([row]))
        for row in rows
    ]


def detection_instants(drive: Drive) -> Instants:
    """When nodes saw anything that could be used."""
    table = drive.tables.get("detections")
    if not isinstance(table, NodeDetections):
        return np.zeros(0, np.int64)
    return np.unique(table.t_ns[np.isfinite(table.p_node_m).all(-1)])
