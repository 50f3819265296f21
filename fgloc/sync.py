"""From tables to epochs: which instants get a state, and which IMU samples lie between them.

Both estimator families take the same epochs. An epoch is a keyframe (a state of the graph) where
an aiding measurement is true, at either end of an IMU gap, and at least every
`keyframe_interval_s`, or as often as the vehicle is constrained; between keyframes lie output
epochs, which the IMU alone reaches.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgloc.arrays import Array, finite_rows
from fgloc.config import SmoothConfig
from fgloc.constraints import (
    NON_HOLONOMIC,
    STANDSTILL,
    Constraints,
    chosen_rows,
    constraints,
    velocity_of,
    wheel_of,
)
from fgloc.drive import Drive
from fgloc.errors import DriveError
from fgloc.factors.fields import cross
from fgloc.measurements import ImuSamples
from fgloc.motion import Motion, credit, kind_of, made_up, measured
from fgloc.parallel import each
from fgloc.positions import Positions, measured_positions, repeats
from fgloc.references import References, find_references
from fgloc.result import Event
from fgloc.timing import Instants, elapsed_s, seconds_to_ns
from fgloc.verdicts import SourceVerdicts, Verdict
from fgloc.watches import Watch, beside_cars


@dataclass(frozen=True, eq=False)
class Epochs:
    """K epochs and the IMU samples between them.

    t_ns          (K,) instants, increasing
    is_keyframe   (K,) bool
    in_gap        (K,) bool: the interval that ends here lies in an IMU gap
    first_sample  (K + 1,) samples first_sample[k]:first_sample[k + 1] lead from epoch k - 1 to k
    accel_mps2    (M, 3) mean specific force of each step between samples: at the IMU's place,
                  along the vehicle's axes
    gyro_radps    (M, 3) mean angular rate of each step, vehicle axes
    dt_s          (M,) length of each step
    rate_radps    (K, 3) angular rate at the epochs themselves, vehicle axes
    """

    t_ns: Instants
    is_keyframe: NDArray[np.bool_]
    in_gap: NDArray[np.bool_]
    first_sample: NDArray[np.int64]
    accel_mps2: Array
    gyro_radps: Array
    dt_s: Array
    rate_radps: Array

    def __len__(self) -> int:
        return len(self.t_ns)

    @property
    def keyframes(self) -> NDArray[np.int64]:
        """Indices of the epochs that are keyframes."""
        return np.flatnonzero(self.is_keyframe)

    def samples(self, epoch: int) -> tuple[Array, Array, Array]:
        """Specific force, angular rate and dt of the steps that lead to an epoch."""
        steps = slice(self.first_sample[epoch], self.first_sample[epoch + 1])
        return self.accel_mps2[steps], self.gyro_radps[steps], self.dt_s[steps]


@dataclass(frozen=True, eq=False)
class Plan:
    """Epochs of a drive, what leads from one to the next, the positions measured and the vehicle's
    constraints at them, the first verdicts on every row, and what there was to remark; besides,
    the detections of users whose places are known, and what is told of swaying posts."""

    epochs: Epochs
    motion: Motion
    positions: Positions
    constraints: Constraints
    verdicts: dict[str, SourceVerdicts]
    events: tuple[Event, ...]
    references: References = field(default_factory=References.none)
    posts: tuple[Watch, ...] = ()


def plan(drive: Drive, config: SmoothConfig) -> Plan:
    """Epochs from the first usable fix to the last IMU sample, or what stands for one.

    Raises DriveError where there are no fixes, or they do not overlap in time with the IMU.
    """
    verdicts = {
        name: SourceVerdicts.of(name, table, Verdict.UNUSED, f"no {name} factor in this method")
        for name, table in drive.tables.items()
    }
    motion = _motion(drive, config, verdicts)
    imu = motion.samples
    span_ns = (int(imu.t_ns[0]), int(imu.t_ns[-1]))
    positions = measured_positions(drive, config, span_ns, verdicts)
    first, last = positions.t_ns[0], imu.t_ns[-1]
    if not motion.is_made_up:
        _judge_early(drive.imu, imu, first, verdicts["imu"])
    references = find_references(drive, config, (int(first), int(last)), verdicts)
    posts = beside_cars(drive, config, *_seen(positions, references), np.array([first, last]))
    positions = positions.take(~_claimed(positions, references))
    gaps = _gaps(imu, first, motion.gap_s)
    told_ns = positions.t_ns, references.t_ns, *(watch.t_ns for watch in posts)
    keyframes = _merged(*told_ns, gaps.ravel(), [first, last])
    rows = chosen_rows(drive, keyframes, config, motion, verdicts)
    credit(motion, verdicts)
    keyframes = _merged(keyframes, *_times(drive, rows))
    keyframes = _fill(keyframes, _keyframe_interval_s(config, motion))
    t_ns = _fill(keyframes, config.output_interval_s)
    in_gap = np.zeros(len(t_ns), bool)
    for start, end in gaps:
        in_gap |= (t_ns > start) & (t_ns <= end)
    steps = _steps(imu, motion.T_veh_imu[:3, :3], t_ns)
    is_keyframe = np.zeros(len(t_ns), bool)
    is_keyframe[np.searchsorted(t_ns, keyframes)] = True
    epochs = Epochs(t_ns, is_keyframe, in_gap, *steps)
    held = constraints(drive, motion, t_ns, epochs.is_keyframe, rows)
    _count(held, t_ns, motion, verdicts)
    return Plan(
        epochs,
        motion,
        positions,
        held,
        verdicts,
        (*_carried(motion, t_ns), *_gap_events(gaps, motion), *_tilted(drive, config, positions)),
        references,
        posts,
    )


def _seen(positions: Positions, references: References) -> tuple[NDArray[np.int64], Instants]:
    """Which node saw something of use, and when."""
    own = positions.candidates
    node = np.concatenate([positions.source[own], references.source]) - 1
    return node, np.concatenate([positions.t_ns[own], references.t_ns])


def _claimed(positions: Positions, references: References) -> NDArray[np.bool_]:
    """Candidates that are another road user, who says where it is."""
    return np.asarray(positions.candidates & np.isin(positions.row, references.row))


def _motion(drive: Drive, config: SmoothConfig, verdicts: dict[str, SourceVerdicts]) -> Motion:
    """The drive's IMU, or what stands for one."""
    kind = kind_of(drive, config)
    if kind == "imu":
        samples = _usable_samples(drive.imu, verdicts["imu"], drive.name)
        return measured(drive, samples, config)
    return made_up(drive, kind, config, verdicts)


def _count(
    held: Constraints, t_ns: Instants, motion: Motion, verdicts: dict[str, SourceVerdicts]
) -> None:
    """Constraints that nobody measured get verdicts of their own, where they are asked for."""
    for name, asked, where in (
        (NON_HOLONOMIC, motion.vehicle.non_holonomic, held.in_force),
        (STANDSTILL, motion.vehicle.zero_velocity, held.stands),
    ):
        if asked:
            at_ns = t_ns[where]
            verdicts[name] = SourceVerdicts.at(
                name, at_ns, at_ns, Verdict.UNUSED, "before the yaw was aligned"
            )


def _times(drive: Drive, rows: tuple[NDArray[np.int64], NDArray[np.int64]]) -> tuple[Instants, ...]:
    tables = wheel_of(drive), velocity_of(drive)
    return tuple(t.t_ns[taken] for t, taken in zip(tables, rows, strict=True) if t is not None)


def _keyframe_interval_s(config: SmoothConfig, motion: Motion) -> float:
    """The vehicle's constraints need states of their own where the measurements give none."""
    asked = motion.vehicle.non_holonomic or motion.vehicle.zero_velocity
    return min(config.keyframe_interval_s, motion.vehicle.interval_s if asked else np.inf)


def _usable_samples(imu: ImuSamples, verdicts: SourceVerdicts, name: str) -> ImuSamples:
    """The samples that are finite and the first of their instant."""
    finite = finite_rows(imu.accel_mps2, imu.gyro_radps)
    duplicate = repeats(imu.t_ns, finite)
    verdicts.set(slice(None), Verdict.USED)
    verdicts.set(duplicate, Verdict.DUPLICATE, "an earlier row has the same t_ns")
    verdicts.set(~finite, Verdict.INVALID, "specific force or angular rate is not finite")
    if not finite.any():
        raise DriveError(f"drive {name!r}: none of its {len(imu)} IMU samples is finite")
    kept = finite & ~duplicate
    return imu if kept.all() else imu.take(kept)


def _judge_early(
    read: ImuSamples, usable: ImuSamples, first_ns: int, verdicts: SourceVerdicts
) -> None:
    """Samples before the last one at or before the first fix have nothing to carry."""
    start = max(int(np.searchsorted(usable.t_ns, first_ns, side="right")) - 1, 0)
    early = verdicts.is_(Verdict.USED) & (read.t_ns < usable.t_ns[start])
    verdicts.set(early, Verdict.OUTSIDE, "before the first usable fix")


def _gaps(imu: ImuSamples, first_ns: int, gap_s: float) -> NDArray[np.int64]:
    """(G, 2) start and end of the intervals without IMU samples, from the first fix on."""
    wide = np.flatnonzero(np.diff(imu.t_ns) > seconds_to_ns(gap_s))
    gaps = np.stack([imu.t_ns[wide], imu.t_ns[wide + 1]], -1)
    gaps = gaps[gaps[:, 1] > first_ns]
    return np.maximum(gaps, first_ns)


def _carried(motion: Motion, t_ns: Instants) -> tuple[Event, ...]:
    """A drive without an IMU is worth a word: what is told between its fixes is a model's."""
    if not motion.is_made_up:
        return ()
    return (Event(int(t_ns[0]), "motion", f"no IMU in use: states are carried by {motion.kind}"),)


def _tilted(drive: Drive, config: SmoothConfig, positions: Positions) -> tuple[Event, ...]:
    """Heights that a swaying node tells are worth a word where its tilt is not followed."""
    if config.posts.compensate:
        return ()
    high = positions.source[positions.candidates & (positions.dof == 3)] - 1
    names = [drive.infrastructure.nodes[i].name for i in np.unique(high).tolist()
             if drive.infrastructure.post_of(i)]  # fmt: skip
    text = "its post is left out: heights that it tells are taken as if it stood level"
    start_ns = int(positions.t_ns[0])
    return tuple(Event(start_ns, "post", f"node {name!r}: {text}") for name in names)


def _gap_events(gaps: NDArray[np.int64], motion: Motion) -> tuple[Event, ...]:
    missing = "yaw rates" if motion.is_made_up else "IMU samples"
    return tuple(
        Event(int(start), "imu gap", f"no {missing} for {(end - start) / 1e9:.2f} s; "
              "bridged with unknown acceleration and turn rate")
        for start, end in gaps
    )  # fmt: skip


def _fill(t_ns: Instants, longest_s: float) -> Instants:
    """The instants with evenly spread ones between, so that no interval exceeds `longest_s`."""
    span = np.diff(t_ns)
    parts = np.maximum(-(-span // seconds_to_ns(longest_s)), 1)
    which = np.repeat(np.arange(len(span)), parts)
    place = np.arange(len(which)) - np.repeat(np.cumsum(parts) - parts, parts)
    return np.append(t_ns[which] + span[which] * place // parts[which], t_ns[-1:])


def _merged(*instants: ArrayLike) -> Instants:
    """All instants in order, each once; in runs that are sorted, a stable sort only merges."""
    both = np.sort(np.concatenate([np.asarray(t) for t in instants]), kind="stable")
    return both[np.append(True, both[1:] != both[:-1])]


def _steps(
    imu: ImuSamples, R_veh_imu: Array, t_ns: Instants
) -> tuple[NDArray[np.int64], Array, Array, Array, Array]:
    """Steps between all samples and epochs, by the trapezoid rule.

    Preintegration turns a step's specific force by the attitude at its start, so the sample at
    the end is brought there first: in a bend, leaving that out errs by half a step's turn, some
    mm/s^2 that no bias can take up.
    """
    inside = (imu.t_ns > t_ns[0]) & (imu.t_ns < t_ns[-1])
    knots = _merged(imu.t_ns[inside], t_ns)
    at, have = elapsed_s(knots, int(t_ns[0])), elapsed_s(imu.t_ns, int(t_ns[0]))
    turned = [*(R_veh_imu @ imu.accel_mps2.T), *(R_veh_imu @ imu.gyro_radps.T)]
    force, rate = np.split(np.array(each(lambda axis: np.interp(at, have, axis), turned)), 2)
    dt_s = np.diff(at)
    gyro = rate[:, 1:] + rate[:, :-1]
    gyro /= 2  # in place: of so many samples, to get the memory takes longer than to add them up
    mean = cross(gyro * dt_s, force[:, 1:])
    mean += force[:, 1:]
    mean += force[:, :-1]
    mean /= 2
    ends = np.searchsorted(knots, t_ns)
    return np.concatenate([[0], ends]), mean.T, gyro.T, dt_s, rate[:, ends].T
