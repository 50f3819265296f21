"""What the error-state filter takes in: a fix, or what a node sees at one instant.

A reading is judged once, when it arrives: whether it is believed, which object of a frame is the
vehicle, how much it is weighed down. Where the filter goes back in time for one that came late,
those after it are taken in again as they were judged. Models, gates, losses and the rule of
association are the graph's.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc.association import Witness
from fgloc.baselines.eskf_state import CORE, PER_SOURCE, Slow, State
from fgloc.config import GnssConfig
from fgloc.factors import noise
from fgloc.factors.detection import FLAT_SURVEY, by_survey
from fgloc.measurements import Array
from fgloc.positions import Positions, PositionSource
from fgloc.result import Event
from fgloc.verdicts import SourceVerdicts, Verdict

OPEN_ANYWAY = 2.0
"""After so many times the reset the gate for fixes opens to any, not only to two that agree."""
_NEAR = "another candidate of the frame is nearer"


@dataclass(frozen=True, eq=False)
class Reading:
    """Positions that exclude each other: their rows among all, when true and when received."""

    t_ns: int
    received_ns: int
    rows: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Taken:
    """A position that was believed, with the noise (n, n) that it enters with."""

    row: int
    noise: Array


class Readings:
    """All that a drive measured of the vehicle's position, and what is believed of it."""

    def __init__(
        self, positions: Positions, sources: tuple[PositionSource, ...], slow: Slow, p_veh_m: Array,
        verdicts: dict[str, SourceVerdicts],
    ) -> None:  # fmt: skip
        self.positions, self._sources, self._slow = positions, sources, slow
        self._levers = [source.p_veh_m - p_veh_m for source in sources]
        self._verdicts, self._witness = verdicts, Witness()
        self._accepted_ns: int | None = None
        self._refused: Array | None = None
        self.events: list[Event] = []

    def all(self) -> list[Reading]:
        """The readings in order of time."""
        p = self.positions
        order = np.argsort(p.frame, kind="stable")
        cuts = np.flatnonzero(np.diff(p.frame[order])) + 1
        readings = [
            Reading(int(p.t_ns[rows[0]]), int(p.received_ns[rows].max()), rows)
            for rows in np.split(order, cuts)
        ]
        return sorted(readings, key=lambda one: one.t_ns)

    def is_fix(self, reading: Reading) -> bool:
        """Whether a reading is surely of the vehicle."""
        return not self.positions.candidates[reading.rows[0]]

    def observe(self, state: State, row: int) -> tuple[Array, Array]:
        """Error (2 or 3,) in m, predicted minus measured, and its Jacobian; see
        `factors/detection.py` for the model."""
        p, s = self.positions, int(self.positions.source[row])
        place, H = state.point(self._levers[s])
        by_slow = np.zeros((3, PER_SOURCE * len(self._sources)))
        by_slow[:, PER_SOURCE * s : PER_SOURCE * s + 3] = np.eye(3)
        if self._sources[s].surveyed:
            z, flat = p.z_world_m[row : row + 1], np.zeros(1, bool)
            survey = by_survey(z, self._sources[s].p_world_m, flat)[0, :, :FLAT_SURVEY]
            by_slow[:, PER_SOURCE * s + 3 : PER_SOURCE * (s + 1)] = -survey
        H[:, CORE:] = by_slow[:, self._slow.active]
        dof = self._sources[s].dof
        return (place + H[:, CORE:] @ state.slow - p.z_world_m[row])[:dof], H[:dof]

    def noise(self, row: int) -> Array:
        """Covariance (2, 2) or (3, 3) of a position as the configuration believes it."""
        source = self._source(row)
        cov = self.positions.cov_world_m2[row] * source.settings.sigma_scale**2
        return np.asarray(cov[: source.dof, : source.dof])

    def judge(self, state: State, reading: Reading) -> tuple[State, Taken | None]:
        """What is believed of a reading; a gate that opens gives the state more doubt."""
        if self.is_fix(reading):
            return self._judge_fix(state, reading)
        return state, self._judge_frame(state, reading)

    def set(self, reading: Reading, verdict: Verdict, reason: str = "") -> None:
        """One verdict for all rows of a reading."""
        for row in reading.rows:
            self._set(int(row), verdict, reason)

    def _judge_fix(self, state: State, reading: Reading) -> tuple[State, Taken | None]:
        row = int(reading.rows[0])
        error, _ = self.observe(state, row)
        nis, gate = self._nis(state, row), self._source(row).gate_nis
        if nis > gate and not self._opens(reading.t_ns, error, row):
            self._set(row, Verdict.GATED, "does not fit the prediction")
            self._refused = error
            return state, None
        if nis > gate:
            state = state.loosened(float(np.linalg.norm(error)))
            self.events.append(Event(reading.t_ns, "gate reset", "no fix fitted: the gate opened"))
        self._accepted_ns, self._refused = reading.t_ns, None
        return state, self._take(state, row)

    def _judge_frame(self, state: State, reading: Reading) -> Taken | None:
        """The candidate that fits best, the numbers that the node gives being a second witness."""
        p, rows = self.positions, reading.rows
        nis = np.array([self._nis(state, int(row)) for row in rows])
        fits = nis <= self._source(int(rows[0])).gate_nis
        for row, fit in zip(rows.tolist(), fits.tolist(), strict=True):
            text = _NEAR if fit else "does not fit the prediction"
            self._set(row, Verdict.OTHER if fit else Verdict.GATED, text)
        if not fits.any():
            return None
        numbers = [(int(p.source[row]), int(p.object_id[row])) for row in rows]
        cost = nis + np.array([self._witness.cost(*number) for number in numbers])
        best = int(np.argmin(np.where(fits, cost, np.inf)))
        for n, number in enumerate(numbers):
            self._witness.note(*number, car=n == best)
        return self._take(state, int(rows[best]))

    def _take(self, state: State, row: int) -> Taken:
        """A position as it enters: less the farther it lies, by the loss of its source."""
        settings, R = self._source(row).settings, self.noise(row)
        error, H = self.observe(state, row)
        norm = np.sqrt(error @ np.linalg.solve(state.innovation(H, R), error))
        w = float(noise.weight(norm, settings.loss, settings.loss_width))
        if w < 1:
            self._set(row, Verdict.DOWN_WEIGHTED, f"{settings.loss} weight {w:.3g}")
        else:
            self._set(row, Verdict.USED)
        return Taken(row, R / w)

    def _nis(self, state: State, row: int) -> float:
        """The NIS of a position, noted with its verdict."""
        error, H = self.observe(state, row)
        nis = float(error @ np.linalg.solve(state.innovation(H, self.noise(row)), error))
        source, at = self._source(row), self.positions.row[row]
        own = self._verdicts[source.table]
        own.nis[at], own.dof[at], own.threshold[at] = nis, source.dof, source.gate_nis
        return nis

    def _opens(self, t_ns: int, error: Array, row: int) -> bool:
        """Whether the gate has been closed for so long that this fix may pass."""
        if self._accepted_ns is None:
            return True
        source = self._source(row)
        assert isinstance(source.settings, GnssConfig)
        waited = (t_ns - self._accepted_ns) / 1e9 / source.settings.gate_reset_s
        if self._refused is None or waited <= 1:
            return waited > OPEN_ANYWAY
        apart = error - self._refused
        agrees = float(apart @ np.linalg.solve(2 * self.noise(row), apart)) <= source.gate_nis
        return agrees or waited > OPEN_ANYWAY

    def _source(self, row: int) -> PositionSource:
        return self._sources[int(self.positions.source[row])]

    def _set(self, row: int, verdict: Verdict, reason: str = "") -> None:
        self._verdicts[self._source(row).table].set(self.positions.row[row], verdict, reason)
