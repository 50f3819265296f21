"""Method `eskf`: an error-state Kalman filter on the same models as the graph.

What a modern filter makes of the same drive, so that filter against smoother can be told from old
model against new: the IMU by the graph's preintegration, lever arms, fixes with a slowly varying
error, nodes with survey errors and slowly varying ones, association by chi-square, and data that
came late put where they belong, by going back as far as `BUFFER_S`. Without an IMU it moves by the
table of velocities (`eskf_motion.Planar`).
"""

from collections import defaultdict
from dataclasses import replace

import numpy as np

from fgloc.baselines.eskf_motion import Inertial
from fgloc.baselines.eskf_readings import Reading, Readings, Taken
from fgloc.baselines.eskf_start import start_inertial, start_planar, window
from fgloc.baselines.eskf_state import Slow, State
from fgloc.baselines.eskf_timeline import Timeline, timeline
from fgloc.baselines.planar import summarize
from fgloc.config import SmoothConfig
from fgloc.drive import Drive
from fgloc.errors import SolverError
from fgloc.frames import pose_cov_to_world
from fgloc.positions import PositionSource, position_sources
from fgloc.result import Event, Result
from fgloc.timing import seconds_to_ns
from fgloc.trajectory import Trajectory
from fgloc.verdicts import Verdict

BUFFER_S = 2.0
"""How far the filter goes back for what came late; older readings are left out."""


def run_by_velocity(drive: Drive) -> Result:
    """The same by the table of velocities alone, as `lee2021-ekf` moves, whether or not there is
    an IMU; its samples have no verdicts."""
    tables = {name: table for name, table in drive.tables.items() if name != "imu"}
    return run(replace(drive, tables=tables), "eskf:velocity")


def run(drive: Drive, method: str = "eskf") -> Result:
    """The filter's estimate of a drive, from the epoch on at which the course shows.

    Each state is as it was when it was the newest. Raises DriveError where the drive lacks fixes
    or anything that tells how the vehicle moves, SolverError where no course ever shows.
    """
    config = SmoothConfig()
    sources = position_sources(drive, config)
    slow = Slow.of(sources)
    line = timeline(drive, config, slow)
    filtering = Eskf(line, sources, slow)
    try:
        filtering.run()
    except SolverError as err:
        raise SolverError(f"drive {drive.name!r}: {err}") from err
    trajectory = filtering.trajectory()
    more = {"moves_by": filtering.moves_by, "start_s": filtering.waited_s}
    summary = summarize(drive, method, "filter", trajectory, line.verdicts, more)
    events = sorted([*line.events, *filtering.events], key=lambda event: event.t_ns)
    return Result(trajectory, line.verdicts, summary, method, causal=True, events=tuple(events))


class Eskf:
    """One pass over the epochs of a drive."""

    def __init__(self, line: Timeline, sources: tuple[PositionSource, ...], slow: Slow) -> None:
        self._line, self._slow = line, slow
        self._p_veh_ant_m = sources[0].p_veh_m
        self._readings = Readings(line.positions, sources, slow, line.motion.p_veh_m, line.verdicts)
        self._arriving = self._by_arrival(self._readings.all())
        self._states: dict[int, State] = {}
        self._taken: defaultdict[int, list[Taken]] = defaultdict(list)  # what was believed where
        self._written: list[State] = []
        self._start = -1

    @property
    def events(self) -> list[Event]:
        """The start, and gates that opened."""
        text = "a course is known: the estimate starts here; before, nothing is estimated"
        return [Event(int(self._line.t_ns[self._start]), "aligned", text), *self._readings.events]

    @property
    def moves_by(self) -> str:
        """The table that carries the state from epoch to epoch."""
        return "imu" if isinstance(self._line.motion, Inertial) else "velocity"

    @property
    def waited_s(self) -> float:
        """Time from the first epoch to the start."""
        return float(self._line.t_ns[self._start] - self._line.t_ns[0]) / 1e9

    def run(self) -> None:
        """Wait for a course, then take in what arrives, epoch by epoch."""
        fixes: list[int] = []
        for k in range(len(self._line.t_ns)):
            arrived = self._arriving[k]
            if not self._written:
                found = [int(r.rows[0]) for _, r in arrived if self._readings.is_fix(r)]
                fixes += found
                self._refuse(arrived, Verdict.UNUSED, "before a course was known to start with")
                self._try_to_start(k, sorted(fixes) if found else [])
                continue
            self._states[k] = self._line.motion.step(k, self._states[k - 1])
            self._take_in(k, arrived)
            self._written.append(self._line.motion.told(k, self._states[k]))
        if not self._written:
            raise SolverError(
                "eskf starts where the fixes show a course, and they never did; a vehicle that "
                "stands cannot be told which way it points"
            )

    def trajectory(self) -> Trajectory:
        """What was written, of the vehicle's origin."""
        line = self._line
        R, p, v = (np.array([getattr(s, name) for s in self._written]) for name in ("R", "p", "v"))
        cov = pose_cov_to_world(R, np.array([s.cov[:6, :6] for s in self._written]))
        of_point = Trajectory(line.t_ns[self._start :], p, R, None, cov, line.motion.p_veh_m)
        rate = line.rate_radps[self._start :] - np.array([s.bias[3:] for s in self._written])
        arm = np.cross(rate, -line.motion.p_veh_m)
        v = v + np.einsum("nij,nj->ni", R, arm)
        return replace(of_point.at_point(np.zeros(3)), v_world_mps=v)

    def _by_arrival(self, readings: list[Reading]) -> list[list[tuple[int, Reading]]]:
        """For each epoch what arrives there, with the epoch at which it was true."""
        t_ns = self._line.t_ns
        out: list[list[tuple[int, Reading]]] = [[] for _ in range(len(t_ns))]
        for one in readings:
            true = int(np.searchsorted(t_ns, one.t_ns))
            at = max(true, int(np.searchsorted(t_ns, one.received_ns)))
            if at < len(t_ns):
                out[at].append((true, one))
            else:
                self._readings.set(one, Verdict.LATE, "received after the end of the drive")
        return out

    def _take_in(self, k: int, arrived: list[tuple[int, Reading]]) -> None:
        """Go back to the earliest of what has arrived, and come forward again with all of it."""
        oldest = int(np.searchsorted(
            self._line.t_ns, self._line.t_ns[k] - seconds_to_ns(BUFFER_S)))  # fmt: skip
        oldest = max(oldest, self._start)
        timely = [(true, one) for true, one in arrived if true >= oldest]
        self._refuse(
            [pair for pair in arrived if pair[0] < oldest], Verdict.LATE,
            f"true before the start or more than {BUFFER_S:g} s before it came",
        )  # fmt: skip
        first = min((true for true, _ in timely), default=k + 1)
        for i in range(first, k + 1):
            state = self._states[i] if i == first else self._again(i)
            for one in (one for true, one in timely if true == i):
                state = self._judged(i, state, one)
            self._states[i] = state
        self._forget(oldest)

    def _again(self, i: int) -> State:
        """The state at an epoch from the one before, with all that was believed there already."""
        state = self._line.motion.step(i, self._states[i - 1])
        for taken in self._taken[i]:
            error, H = self._readings.observe(state, taken.row)
            state = state.corrected(error, H, taken.noise)
        return state

    def _judged(self, i: int, state: State, one: Reading) -> State:
        state, taken = self._readings.judge(state, one)
        if taken is None:
            return state
        self._taken[i].append(taken)
        error, H = self._readings.observe(state, taken.row)
        return state.corrected(error, H, taken.noise)

    def _forget(self, oldest: int) -> None:
        for store in (self._states, self._taken):
            for i in [i for i in store if i < oldest]:
                del store[i]

    def _refuse(self, readings: list[tuple[int, Reading]], verdict: Verdict, reason: str) -> None:
        for _, one in readings:
            self._readings.set(one, verdict, reason)

    def _try_to_start(self, k: int, rows: list[int]) -> None:
        """Start at the newest fix, if there is a course by now, and move on to epoch k."""
        begun = self._started(rows) if rows else None
        if begun is None:
            return
        at, state, used = begun
        for i in range(at + 1, k + 1):
            state = self._line.motion.step(i, state)
        self._start, self._states[k] = k, state
        self._written.append(self._line.motion.told(k, state))
        for row in used:
            self._line.verdicts["gnss"].set(
                self._line.positions.row[row], Verdict.USED, "the filter started from it"
            )

    def _started(self, rows: list[int]) -> tuple[int, State, list[int]] | None:
        """Epoch and state that the newest fixes give, and their rows among the positions."""
        motion, p = self._line.motion, self._line.positions
        lever_m = self._p_veh_ant_m - motion.p_veh_m
        at = int(np.searchsorted(self._line.t_ns, p.t_ns[rows[-1]]))
        if isinstance(motion, Inertial):
            fixes = window(p, self._line.t_ns, rows)
            if fixes is None:
                return None
            state = start_inertial(motion, fixes, lever_m, self._slow)
            return at, state, rows[-len(fixes.t_s) :]
        z, cov = p.z_world_m[rows[-1]], p.cov_world_m2[rows[-1]]
        begun = start_planar(motion, at, z, cov, lever_m, self._slow)
        return None if begun is None else (at, begun, rows[-1:])
