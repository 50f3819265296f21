"""Measured positions of points of the vehicle, from whatever source.

GNSS measures where the antenna is; a roadside node where the centre of the vehicle's box is, but
among the objects that it sees it does not say which is the vehicle: its rows are candidates. A row
that has no height to tell gets one with a sigma that leaves the height free.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from fgloc.arrays import Array, finite_rows
from fgloc.config import DetectionConfig, GnssConfig, SmoothConfig
from fgloc.drive import Drive, GnssBias
from fgloc.errors import DriveError
from fgloc.factors import detection
from fgloc.factors.noise import positive_definite
from fgloc.infrastructure import Node
from fgloc.measurements import PEDESTRIAN, GnssFixes, NodeDetections
from fgloc.timing import Instants, elapsed_s
from fgloc.verdicts import SourceVerdicts, Verdict

GNSS, DETECTIONS = "gnss", "detections"
FREE_UP_M = 100.0
"""Sigma of a height that nobody measured."""
REACH_M, REACH_MPS = 50.0, 40.0
"""A candidate farther from the last fix than this, and this for each second since, is not the
car: no state is spent on it."""
DEFAULT_TAU_S = 60.0
EXACT = 1e-6
"""Sigma, m or rad, of the part of a survey that counts as exact where the other is uncertain."""


@dataclass(frozen=True, eq=False)
class PositionSource:
    """One sensor that measures positions, and how it is believed.

    name           'gnss', or the node's
    table          whose rows they are, and whose verdicts
    p_veh_m        (3,) the point of the vehicle that is measured
    p_world_m      (3,) where the sensor stands, of a node
    dof            of each row at least: 3, or 2 of a node, which may tell heights or not
    settings       loss and gate
    bias           its slow error, or None
    survey_sigmas  (6,) of the node's survey: east and north in m, yaw in rad, up in m, turns about
                   East and North in rad; zeros where exact
    point_sigma_m  of `p_veh_m`, each axis; 0 where known
    sways          whether the node's post is followed
    """

    name: str
    table: str
    p_veh_m: Array
    p_world_m: Array
    dof: int
    settings: GnssConfig | DetectionConfig
    bias: GnssBias | None
    survey_sigmas: Array
    point_sigma_m: float
    sways: bool = False

    @property
    def gate_nis(self) -> float:
        """NIS above which what all rows measure is gated."""
        return self.settings.gate_nis(self.dof)

    @property
    def surveyed(self) -> bool:
        """Whether the error of the survey is an unknown."""
        return bool(self.survey_sigmas.any())

    @property
    def linked(self) -> bool:
        """Whether a row depends on more unknowns than the pose."""
        return self.bias is not None or self.surveyed or self.point_sigma_m > 0 or self.sways


@dataclass(frozen=True, eq=False)
class Positions:
    """n measured positions in order of time.

    t_ns, received_ns  (n,)
    source       (n,) which of the drive's sources, see `position_sources`
    row          (n,) in the source's table
    frame        (n,) the same for candidates that exclude each other
    object_id    (n,) the number that a node gave; -1 for fixes
    z_world_m    (n, 3) ENU m, with cov_world_m2 (n, 3, 3) as stated
    dof          (n,) 3, or 2 where the height is not measured
    candidates   (n,) bool: may be of another object
    """

    t_ns: Instants
    received_ns: Instants
    source: NDArray[np.int64]
    row: NDArray[np.int64]
    frame: NDArray[np.int64]
    object_id: NDArray[np.int64]
    z_world_m: Array
    cov_world_m2: Array
    dof: NDArray[np.int64]
    candidates: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.t_ns)

    def by_survey(self, rows: NDArray[np.int64], p_world_node_m: Array) -> Array:
        """How some detections (m,) of a node move with what its survey is off (m, 3, 6)."""
        return detection.by_survey(self.z_world_m[rows], p_world_node_m, self.dof[rows] == 3)

    def take(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> Self:
        """The rows that a mask or an index array selects."""
        names = type(self).__dataclass_fields__
        return type(self)(**{name: getattr(self, name)[rows] for name in names})


def measured_positions(
    drive: Drive, config: SmoothConfig, span_ns: tuple[int, int],
    verdicts: dict[str, SourceVerdicts],
) -> Positions:  # fmt: skip
    """The usable fixes within a span of time, and candidates between the first of them and its end.

    Fills in the verdicts of the other rows. Raises DriveError where there are fewer than 2 fixes.
    """
    parts = [_fixes(drive, span_ns, verdicts)]
    seen = drive.tables.get(DETECTIONS)
    if isinstance(seen, NodeDetections) and len(seen) and config.detections.use:
        begin, end = int(parts[0].t_ns[0]), span_ns[1]
        rows = _candidates(drive, seen, (begin, end), verdicts[DETECTIONS])
        parts.append(_detections(drive, seen, rows, config.detections))
    return _joined(parts)


def position_sources(drive: Drive, config: SmoothConfig) -> tuple[PositionSource, ...]:
    """GNSS, and then every node of a drive, as a configuration believes them."""
    g, d = config.gnss, config.detections
    gnss = PositionSource(
        GNSS, GNSS, drive.rig.p_veh_ant_m, np.zeros(3), 3, g, gnss_bias(drive, g),
        np.zeros(detection.SURVEY), 0.0,
    )  # fmt: skip
    nodes = drive.infrastructure.nodes if DETECTIONS in drive.tables else ()
    return gnss, *(
        _node_source(
            drive,
            node,
            d,
            sways=config.posts.compensate and drive.infrastructure.post_of(i) is not None,
        )
        for i, node in enumerate(nodes)
    )


def _fixes(
    drive: Drive, span_ns: tuple[int, int], verdicts: dict[str, SourceVerdicts]
) -> Positions:
    fixes = drive.gnss  # says so where there are none
    rows = usable_fixes(fixes, span_ns, verdicts[GNSS], drive.name)
    n = len(rows)
    return Positions(
        fixes.t_ns[rows], fixes.received_ns[rows], np.zeros(n, np.int64), rows, np.arange(n),
        np.full(n, -1), fixes.p_world_ant_m[rows], fixes.cov_world_m2[rows], np.full(n, 3),
        np.zeros(n, bool),
    )  # fmt: skip


def usable_fixes(
    gnss: GnssFixes, span_ns: tuple[int, int], verdicts: SourceVerdicts, name: str
) -> NDArray[np.int64]:
    """Rows that can enter: sound, the first such of their instant, and within the span of the
    sensor that carries the state between them."""
    finite = finite_rows(gnss.p_world_ant_m, gnss.cov_world_m2)
    definite = np.zeros(len(gnss), bool)
    definite[finite] = positive_definite(gnss.cov_world_m2[finite])
    duplicate = repeats(gnss.t_ns, definite)
    outside = (gnss.t_ns < span_ns[0]) | (gnss.t_ns > span_ns[1])
    verdicts.set(slice(None), Verdict.UNUSED, "not reached")
    verdicts.set(duplicate, Verdict.DUPLICATE, "an earlier row has the same t_ns")
    verdicts.set(outside, Verdict.OUTSIDE, "no IMU samples at this time")
    verdicts.set(~definite, Verdict.INVALID, "the covariance is not positive definite")
    verdicts.set(~finite, Verdict.INVALID, "position or covariance is not finite")
    usable = np.flatnonzero(definite & ~duplicate & ~outside)
    if len(usable) < 2:
        raise DriveError(
            f"drive {name!r}: {len(usable)} of {len(gnss)} GNSS fixes lie within the IMU's span of "
            f"time and are valid ({int(outside.sum())} outside, {int((~definite).sum())} invalid); "
            "at least 2 are needed (are both on the same clock? GPS is 18 s ahead of UTC)"
        )
    return usable


def repeats(t_ns: Instants, sound: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(N,) bool: sound rows of an instant that an earlier sound row has already told of."""
    rows = np.flatnonzero(sound)
    result = np.zeros(len(t_ns), bool)
    result[rows[1:]] = t_ns[rows[1:]] == t_ns[rows[:-1]]
    return result


def _candidates(
    drive: Drive, seen: NodeDetections, span_ns: tuple[int, int], verdicts: SourceVerdicts
) -> NDArray[np.int64]:
    """Rows that may be the car."""
    finite = finite_rows(seen.p_node_m)
    ranges = np.array([node.range_m for node in drive.infrastructure.nodes])
    far = np.hypot(*np.where(finite[:, None], seen.p_node_m, 0.0).T) > ranges[seen.node]
    outside = (seen.t_ns < span_ns[0]) | (seen.t_ns > span_ns[1])
    walks = seen.kind == PEDESTRIAN
    possible = finite & ~far & ~outside & ~walks
    away = possible & ~_within_reach(drive, seen)
    verdicts.set(slice(None), Verdict.UNUSED, "not reached")
    verdicts.set(walks, Verdict.OTHER, "a pedestrian")
    verdicts.set(away, Verdict.OTHER, "too far from the last fix to be the car")
    verdicts.set(far, Verdict.OUTSIDE, "beyond the node's range")
    verdicts.set(outside, Verdict.OUTSIDE, "before the first fix or after the last state")
    verdicts.set(~finite, Verdict.INVALID, "the position is not finite")
    return np.flatnonzero(possible & ~away)


def _within_reach(drive: Drive, seen: NodeDetections) -> NDArray[np.bool_]:
    """(N,) bool: where the car may be, by the last fix before, received or not."""
    told = finite_rows(drive.gnss.p_world_ant_m)
    t_ns, place_m = drive.gnss.t_ns[told], drive.gnss.p_world_ant_m[told, :2]
    last = np.maximum(np.searchsorted(t_ns, seen.t_ns, side="right") - 1, 0)
    age_s = np.abs(elapsed_s(seen.t_ns, 0) - elapsed_s(t_ns[last], 0))
    apart = world_positions(drive, seen) - place_m[last]
    return np.asarray(np.hypot(*apart.T) <= REACH_M + REACH_MPS * age_s)


def world_positions(drive: Drive, seen: NodeDetections) -> Array:
    """(N, 2) East and North in m of what the nodes see, as they were surveyed."""
    p = np.empty((len(seen), 2))
    for i, node in enumerate(drive.infrastructure.nodes):
        rows = seen.node == i
        p[rows] = node.to_world(seen.p_node_m[rows])
    return p


def _detections(
    drive: Drive, seen: NodeDetections, rows: NDArray[np.int64], config: DetectionConfig
) -> Positions:
    seen = seen.take(rows)
    return Positions(
        seen.t_ns, seen.received_ns, 1 + seen.node, rows, numbered(seen.t_ns, seen.node),
        seen.object_id, *world_places(drive, seen, config), 2 + seen.has_height,
        np.ones(len(rows), bool),
    )  # fmt: skip


def world_places(
    drive: Drive, seen: NodeDetections, config: DetectionConfig
) -> tuple[Array, Array]:
    """Where nodes report what they see (N, 3), ENU m, as they were surveyed, and the covariance
    (N, 3, 3) in m^2; a height that is not told is about the car's, and free."""
    told, up_m = seen.has_height, height_m(drive)
    z = np.column_stack([world_positions(drive, seen), np.where(told, seen.up_node_m, up_m)])
    cov = np.zeros((len(seen), 3, 3))
    cov[:, 2, 2] = np.where(told, seen.sigma_up_m, FREE_UP_M) ** 2
    for i, node in enumerate(drive.infrastructure.nodes):
        own = seen.node == i
        cov[own, :2, :2] = horizontal_cov_m2(node, seen.take(own), config, up_m)
        z[own & told, 2] += node.p_world_m[2]
    return z, cov


def numbered(*columns: NDArray[np.int64]) -> NDArray[np.int64]:
    """A number (n,) for each row of some columns (n,): the same where all of them are the same."""
    order = np.lexsort(columns[::-1])
    new = np.any([np.diff(column[order], prepend=column[order[:1]]) != 0 for column in columns], 0)
    number = np.empty(len(order), np.int64)
    number[order] = np.cumsum(new)
    return number


def height_m(drive: Drive) -> float:
    """Height in m about where the car drives: only where the free heights are linearised."""
    up = drive.gnss.p_world_ant_m[:, 2]
    return float(np.median(up[np.isfinite(up)])) - float(drive.rig.p_veh_ant_m[2])


def _node_source(
    drive: Drive, node: Node, config: DetectionConfig, *, sways: bool
) -> PositionSource:
    place_m, level_rad = node.sigma_position_m, node.sigma_level_rad
    survey = np.array([place_m, place_m, node.sigma_yaw_rad, place_m, level_rad, level_rad])
    if survey.any():
        survey = np.maximum(survey, EXACT)
    return PositionSource(
        node.name, DETECTIONS, drive.rig.p_veh_box_m, node.p_world_m, 2, config,
        _slow(config, GnssBias(node.bias_sigma_m, node.bias_tau_s)), survey, config.offset_sigma_m,
        sways,
    )  # fmt: skip


def gnss_bias(drive: Drive, config: GnssConfig) -> GnssBias | None:
    """The slow error of a drive's fixes, as configured or as the rig states it."""
    return _slow(config, drive.rig.gnss_bias or GnssBias(0.0, DEFAULT_TAU_S))


def _slow(config: GnssConfig | DetectionConfig, stated: GnssBias) -> GnssBias | None:
    """The slow error as configured or stated; None where there is none."""
    sigma = stated.sigma_m if config.bias_sigma_m is None else config.bias_sigma_m
    tau = stated.tau_s if config.bias_tau_s is None else config.bias_tau_s
    return GnssBias(sigma, tau) if sigma > 0 else None


def horizontal_cov_m2(
    node: Node, seen: NodeDetections, config: DetectionConfig, up_m: float
) -> Array:
    """Covariance (N, 2, 2), East and North, of what one node sees at a height of `up_m`."""
    cov = seen.cov_node_m2
    if config.covariance != "stated":
        cov = _law_m2(node, seen, config, up_m)
    elif (untold := np.isnan(cov)).any():
        cov = np.where(untold, _law_m2(node, seen, config, up_m), cov)
    return node.R_world_node @ cov @ node.R_world_node.T


def _law_m2(node: Node, seen: NodeDetections, config: DetectionConfig, up_m: float) -> Array:
    """Covariance (N, 2, 2) along the node's axes that a documented law gives."""
    distance = np.maximum(np.hypot(*seen.p_node_m.T), 1e-6)
    if config.covariance == "khamooshi2023":
        slant = np.hypot(distance, node.p_world_m[2] - up_m)
        return detection.khamooshi2023_sigma_m(slant)[:, None, None] ** 2 * np.eye(2)
    along = detection.lee2021_sigma_m(distance, config.floor_m)
    sight = seen.p_node_m + np.where(distance > 1e-6, 0.0, 1e-6)[:, None]
    return detection.line_of_sight_cov_m2(sight, along, detection.LEE2021_ACROSS_M)


def _joined(parts: list[Positions]) -> Positions:
    """The rows of all parts in order of time; frames are counted on."""
    first = np.cumsum([0, *(part.frame.max(initial=-1) + 1 for part in parts)])
    columns = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in Positions.__dataclass_fields__
    }
    columns["frame"] = np.concatenate(
        [part.frame + n for part, n in zip(parts, first, strict=False)]
    )
    return Positions(**columns).take(np.argsort(columns["t_ns"], kind="stable"))
