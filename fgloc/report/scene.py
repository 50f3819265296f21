"""What a report is about, brought to one clock and one point of the vehicle, for all figures."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fgloc.drive import Drive
from fgloc.evaluation import Errors, Spans, gnss_outages
from fgloc.measurements import Array, GnssFixes
from fgloc.result import Result
from fgloc.timing import Instants, elapsed_s
from fgloc.trajectory import Trajectory
from fgloc.verdicts import SourceVerdicts

_LONGEST_STEP_S = 1.5


@dataclass(frozen=True, eq=False)
class Scene:
    """A drive, a method's answer to it, and its errors where there is truth.

    start_ns   the instant that all times in the report count from
    span_s     first and last time of any table or state, in s since the start
    estimate   the trajectory, at the truth's point of the vehicle where it can be carried there
    smoothed   the same of the states as they were in the end, where a causal method gives them
    outages_s  (K, 2) GNSS outages
    """

    drive: Drive
    result: Result
    errors: Errors | None
    start_ns: int
    span_s: tuple[float, float]
    estimate: Trajectory
    smoothed: Trajectory | None
    outages_ns: Spans
    outages_s: Array

    def seconds(self, t_ns: ArrayLike) -> Array:
        """Instants as seconds since the start."""
        return elapsed_s(t_ns, self.start_ns)

    def fixes(self) -> tuple[GnssFixes, SourceVerdicts | None] | None:
        """The GNSS fixes and, where they match row by row, their verdicts."""
        table = self.drive.tables.get("gnss")
        if not isinstance(table, GnssFixes) or len(table) == 0:
            return None
        verdicts = self.result.verdicts.get("gnss")
        return table, verdicts if verdicts is not None and len(verdicts) == len(table) else None


def scene(drive: Drive, result: Result, errors: Errors | None) -> Scene:
    """Everything the figures draw on."""
    start_ns, end_ns = _span_ns(drive, result)
    spans = gnss_outages(result)
    return Scene(
        drive, result, errors if errors is not None and len(errors) else None, start_ns,
        (0.0, float(elapsed_s(end_ns, start_ns))),
        at_truths_point(result.trajectory, drive.truth),
        None if result.smoothed is None else at_truths_point(result.smoothed, drive.truth),
 spans, elapsed_s(spans, start_ns),
    )  # fmt: skip


def longest_step_s(t_ns: Instants) -> float:
    """A line over these instants is broken where a step is longer than this."""
    return max(_LONGEST_STEP_S, 5 * float(np.median(np.diff(t_ns))) / 1e9) if len(t_ns) > 1 else 1.0


def _span_ns(drive: Drive, result: Result) -> tuple[int, int]:
    """First and last instant of the drive's tables and of the trajectory."""
    times = [table.t_ns for table in drive.tables.values()] + [result.trajectory.t_ns]
    times = [t for t in times if len(t)]
    first, last = (int(t[0]) for t in times), (int(t[-1]) for t in times)
    return min(first, default=0), max(last, default=0)


def at_truths_point(estimate: Trajectory, truth: Trajectory | None) -> Trajectory:
    """The estimate at the truth's point of the vehicle, where its attitude carries it there."""
    if truth is None or estimate.R_world_veh is None:
        return estimate
    return estimate.at_point(truth.p_veh_point_m)
