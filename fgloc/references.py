"""Other road users that tell where they are, as references for what the nodes see.

A car with good GPS that passes a node and broadcasts its place tells what the node is off: how its
post sways, what its survey errs by. What it tells (`UserFixes`) is brought to the instant of the
detection along a straight line between two fixes; which object it is, the node does not say. Per
frame it is the one detection that fits, by the covariances of both, with the sway that the wind
makes likely and the survey's error added; where two users or two detections fit, none is taken.
Where node and user both tell a height, it is compared as well: of a LiDAR it shows a tilt best.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from fgloc.arrays import Array, finite_rows
from fgloc.chi_square import chi2_quantile
from fgloc.config import SmoothConfig
from fgloc.drive import Drive
from fgloc.factors.detection import by_survey
from fgloc.factors.noise import nis
from fgloc.factors.post import post_spread
from fgloc.factors.sway import linear_row
from fgloc.measurements import PEDESTRIAN, NodeDetections, UserFixes
from fgloc.positions import (
    DETECTIONS,
    FREE_UP_M,
    PositionSource,
    position_sources,
    world_places,
)
from fgloc.timing import NS_PER_S, Instants
from fgloc.verdicts import SourceVerdicts, Verdict

USERS = UserFixes.KIND
APART_S = 1.0
"""Fixes of a user further apart say nothing of the time between them."""
ACCELERATION_MPS2 = 2.0
"""Of a user between two fixes: a straight line is off by an eighth of it times the time squared."""
_PLANE = np.array([True, True, False])
_OF_NODES = "tells of nodes alone, which this method takes as they were surveyed"


@dataclass(frozen=True, eq=False)
class References:
    """n detections of users whose places are known, in order of time.

    t_ns, received_ns  (n,) true, and when both the detection and the fixes had arrived
    source        (n,) the node's number among the sources, see `position_sources`
    row           (n,) of the detection; user (n,) the user's number
    z_world_m     (n, 3) where the node reports it, told_m (n, 3) where it says it is, ENU m
    cov_world_m2  (n, 3, 3) of the difference
    dof           (n,) 3, or 2 where heights are not both told: they are then alike and free
    """

    t_ns: Instants
    received_ns: Instants
    source: NDArray[np.int64]
    row: NDArray[np.int64]
    user: NDArray[np.int64]
    z_world_m: Array
    told_m: Array
    cov_world_m2: Array
    dof: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.t_ns)

    def take(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> Self:
        """The rows that a mask or an index array selects."""
        names = type(self).__dataclass_fields__
        return type(self)(**{name: getattr(self, name)[rows] for name in names})

    @classmethod
    def none(cls) -> Self:
        """No rows."""
        no = np.zeros(0, np.int64)
        places = np.zeros((0, 3))
        return cls(no, no, no, no, no, places, places, np.zeros((0, 3, 3)), no)

    def by_survey(self, rows: NDArray[np.int64], p_world_node_m: Array) -> Array:
        """How what a node sees in some rows (m,) moves with what its survey is off (m, 3, 6)."""
        return by_survey(self.z_world_m[rows], p_world_node_m, self.dof[rows] == 3)


def find_references(
    drive: Drive, config: SmoothConfig, span_ns: tuple[int, int],
    verdicts: dict[str, SourceVerdicts],
) -> References:  # fmt: skip
    """The references that a drive has within a span, with verdicts on what users tell.

    Only of nodes of which something is to be found: that sway, or whose survey has an error.
    """
    seen, users = drive.tables.get(DETECTIONS), drive.tables.get(USERS)
    if not isinstance(users, UserFixes):
        return References.none()
    verdicts[USERS].set(slice(None), Verdict.UNUSED, "no node that sees it has errors to be found")
    if not isinstance(seen, NodeDetections) or not config.detections.use:
        return References.none()
    sources = position_sources(drive, config)
    parts = [
        _of_node(drive, config, seen, users, s, span_ns, verdicts[USERS])
        for s, source in enumerate(sources)
        if source.table == DETECTIONS and (source.sways or source.surveyed)
    ]
    if not parts:
        return References.none()
    columns = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in References.__dataclass_fields__
    }
    found = References(**columns).take(np.argsort(columns["t_ns"], kind="stable"))
    verdicts[DETECTIONS].set(found.row, Verdict.OTHER, "a road user who says where it is")
    return found


def judge_references(found: References, verdicts: dict[str, SourceVerdicts]) -> None:
    """Say of the detections what they are used for, and of what users tell that it is."""
    if USERS in verdicts:
        verdicts[USERS].set(verdicts[USERS].reason == _OF_NODES, Verdict.USED)
    for user in np.unique(found.user).tolist():
        reason = f"user {user}, who says where it is: tells of the node"
        verdicts[DETECTIONS].set(found.row[found.user == user], Verdict.USED, reason)


def _of_node(
    drive: Drive, config: SmoothConfig, seen: NodeDetections, users: UserFixes, s: int,
    span_ns: tuple[int, int], judged: SourceVerdicts,
) -> References:  # fmt: skip
    """The references of one node."""
    source, node = position_sources(drive, config)[s], drive.infrastructure.nodes[s - 1]
    sound = np.isfinite(seen.p_node_m).all(-1) & (seen.kind != PEDESTRIAN) & (seen.node == s - 1)
    near = np.hypot(*np.where(sound[:, None], seen.p_node_m, 0.0).T) <= node.range_m
    rows = np.flatnonzero(sound & near & (seen.t_ns >= span_ns[0]) & (seen.t_ns <= span_ns[1]))
    of_node = seen.take(rows)
    z, cov = world_places(drive, of_node, config.detections)
    cov *= config.detections.sigma_scale**2
    if source.bias is not None:
        cov = cov + source.bias.sigma_m**2 * np.eye(3)
    slow_m = drive.rig.user_bias.sigma_m if drive.rig.user_bias else 0.0
    sway_m2 = _sway_m2(drive, source, s, of_node)
    parts, fits = [], []
    for user in np.unique(users.user_id).tolist():
        told_m, told_cov, received_ns, known = _placed(users, user, of_node.t_ns, judged)
        both = of_node.has_height & np.isfinite(told_m[:, 2])
        told_cov = told_cov + slow_m**2 * np.eye(3)
        one = References(
            of_node.t_ns, np.maximum(received_ns, of_node.received_ns), np.full(len(rows), s), rows,
            np.full(len(rows), user), z, np.where(_PLANE | both[:, None], told_m, z),
            _free(cov + told_cov, ~both), 2 + both,
        )  # fmt: skip
        parts.append(one)
        fits.append(known & _fits(config, source, one, sway_m2))
    clear = _unambiguous(np.array(fits), of_node.t_ns)
    return References(*(
        np.concatenate([getattr(part, name)[own] for part, own in zip(parts, clear, strict=True)])
        for name in References.__dataclass_fields__
    ))  # fmt: skip


def _free(cov: Array, of: NDArray[np.bool_]) -> Array:
    """Covariances (n, 3, 3) with the height of some rows (n,) left free."""
    cov = cov.copy()
    cov[of, 2], cov[of, :, 2] = 0.0, 0.0
    cov[of, 2, 2] = FREE_UP_M**2
    return cov


def _fits(
    config: SmoothConfig, source: PositionSource, found: References, sway_m2: Array
) -> NDArray[np.bool_]:
    """(n,) whether a user is where the node sees something, as far as post and survey let it."""
    J = found.by_survey(np.arange(len(found)), source.p_world_m)
    doubt = J @ np.diag(source.survey_sigmas**2) @ J.swapaxes(-1, -2)
    S = found.cov_world_m2 + doubt + sway_m2
    by_dof = [chi2_quantile(config.detections.gate_probability, dof) for dof in (2, 3)]
    return np.asarray(nis(found.told_m - found.z_world_m, S) <= np.array(by_dof)[found.dof - 2])


def _sway_m2(drive: Drive, source: PositionSource, s: int, seen: NodeDetections) -> Array:
    """Covariance (n, 3, 3) of what the post does to detections."""
    node, post = drive.infrastructure.nodes[s - 1], drive.infrastructure.post_of(s - 1)
    if not source.sways or post is None:
        return np.zeros((len(seen), 3, 3))
    J, _ = linear_row(seen.place_node_m, post, node, post.height_m, node.sensor)
    return np.asarray(J @ post_spread(post) @ J.swapaxes(-1, -2))


def _placed(
    users: UserFixes, user: int, t_ns: Instants, judged: SourceVerdicts
) -> tuple[Array, Array, Instants, NDArray[np.bool_]]:
    """Where a user is at some instants (n,): ENU (n, 3) in m, NaN for a height that is not told,
    covariance (n, 3, 3), when that was known, and whether it is."""
    own = np.flatnonzero(users.user_id == user)
    sound = finite_rows(users.p_world_m[own], users.cov_m2[own])
    judged.set(own[~sound], Verdict.INVALID, "place or covariance is not finite")
    own = own[sound]
    own = own[np.diff(users.t_ns[own], prepend=-1) > 0]
    if len(own) < 2:
        n = len(t_ns)
        return np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1)), t_ns, np.zeros(n, bool)
    have_ns = users.t_ns[own]
    after = np.clip(np.searchsorted(have_ns, t_ns), 1, len(own) - 1)
    a, b = own[after - 1], own[after]
    span_s = (users.t_ns[b] - users.t_ns[a]) / NS_PER_S
    share = (t_ns - users.t_ns[a]) / NS_PER_S / span_s
    inside = (share >= 0) & (share <= 1) & (span_s <= APART_S)
    judged.set(np.union1d(a[inside], b[inside]), Verdict.UNUSED, _OF_NODES)
    w, places, covs = share[:, None], *_in_space(users)
    p = (1 - w) * places[a] + w * places[b]
    bend_m = ACCELERATION_MPS2 / 2 * share * (1 - share) * span_s**2
    w = w[..., None]
    cov = (1 - w) ** 2 * covs[a] + w**2 * covs[b]
    cov = cov + (bend_m**2)[:, None, None] * np.eye(3)
    known_ns = np.where(share < 1, np.maximum(users.received_ns[a], users.received_ns[b]),
                        users.received_ns[b])  # fmt: skip
    known_ns = np.where(share > 0, known_ns, users.received_ns[a])
    return p, cov, known_ns, inside


def _in_space(users: UserFixes) -> tuple[Array, Array]:
    """Places (N, 3) and covariances (N, 3, 3) of what users tell, NaN for heights that they do
    not."""
    cov = np.zeros((len(users), 3, 3))
    cov[:, :2, :2], cov[:, 2, 2] = users.cov_m2, users.sigma_up_m**2
    return np.column_stack([users.p_world_m, users.up_m]), cov


def _unambiguous(fits: NDArray[np.bool_], t_ns: Instants) -> NDArray[np.bool_]:
    """Of which user (u, n) says which detection (n,) fits it, the pairs where in one frame each
    fits the other alone."""
    _, frame = np.unique(t_ns, return_inverse=True)
    only_user = fits.sum(0) == 1
    result = np.zeros_like(fits)
    for user, own in enumerate(fits):
        many = np.bincount(frame, own)
        result[user] = own & only_user & (many[frame] == 1)
    return result
