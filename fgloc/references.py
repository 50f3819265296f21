"""Other road users that tell where they are, as references for what the nodes see.

A car with good GPS that passes a node and broadcasts its place tells what the node is off: how its
post sways, what its survey errs by. What it tells (`UserFixes`) is brought to the instant of the
detection along a straight line between two fixes; which object it is, the node does not say. Per
frame it is the one detection that fits, by the covariances of both, with the sway that the wind
makes likely and the survey's error added; where two users or two detections fit, none is taken.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from fgloc.chi_square import chi2_quantile
from fgloc.config import SmoothConfig
from fgloc.drive import Drive
from fgloc.factors.detection import by_survey
from fgloc.factors.post import post_spread
from fgloc.factors.sway import linear_row
from fgloc.measurements import PEDESTRIAN, Array, NodeDetections, UserFixes
from fgloc.positions import (
    DETECTIONS,
    PositionSource,
    height_m,
    horizontal_cov_m2,
    position_sources,
    world_positions,
)
from fgloc.timing import NS_PER_S, Instants
from fgloc.verdicts import SourceVerdicts, Verdict

USERS = UserFixes.KIND
APART_S = 1.0
"""Fixes of a user further apart say nothing of the time between them."""
ACCELERATION_MPS2 = 2.0
"""Of a user between two fixes: a straight line is off by an eighth of it times the time squared."""


_OF_NODES = "tells of nodes alone, which this method takes as they were surveyed"


@dataclass(frozen=True, eq=False)
class References:
    """n detections of users whose places are known, in order of time.

    t_ns, received_ns  (n,) true, and when both the detection and the fixes had arrived
    source        (n,) the node's number among the sources, see `position_sources`
    row           (n,) of the detection; user (n,) the user's number
    z_world_m     (n, 2) where the node reports it, told_m (n, 2) where it says it is, ENU m
    cov_world_m2  (n, 2, 2) of the difference
    """

    t_ns: Instants
    received_ns: Instants
    source: NDArray[np.int64]
    row: NDArray[np.int64]
    user: NDArray[np.int64]
    z_world_m: Array
    told_m: Array
    cov_world_m2: Array

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
        return cls(no, no, no, no, no, np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 2, 2)))


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
    z = world_positions(drive, of_node)
    cov = horizontal_cov_m2(node, of_node, config.detections, height_m(drive))
    cov *= config.detections.sigma_scale**2
    if source.bias is not None:
        cov = cov + source.bias.sigma_m**2 * np.eye(2)
    slow_m = drive.rig.user_bias.sigma_m if drive.rig.user_bias else 0.0
    doubt = cov + _doubt_m2(drive, source, s, of_node, z)
    limit = chi2_quantile(config.detections.gate_probability, 2)
    parts, fits = [], []
    for user in np.unique(users.user_id).tolist():
        told_m, told_cov, received_ns, known = _placed(users, user, of_node.t_ns, judged)
        told_cov = told_cov + slow_m**2 * np.eye(2)
        gap, S = told_m - z, doubt + told_cov
        nis = np.where(known, np.einsum("ni,nij,nj->n", gap, np.linalg.inv(S), gap), np.inf)
        received_ns = np.maximum(received_ns, of_node.received_ns)
        number = np.full(len(rows), user)
        parts.append(References(of_node.t_ns, received_ns, np.full(len(rows), s), rows, number, z,
                                told_m, cov + told_cov))  # fmt: skip
        fits.append(nis <= limit)
    clear = _unambiguous(np.array(fits), of_node.t_ns)
    return References(*(
        np.concatenate([getattr(part, name)[own] for part, own in zip(parts, clear, strict=True)])
        for name in References.__dataclass_fields__
    ))  # fmt: skip


def _doubt_m2(
    drive: Drive, source: PositionSource, s: int, seen: NodeDetections, z_world_m: Array
) -> Array:
    """Covariance (n, 2, 2) of what the post and the survey do to detections."""
    node, post = drive.infrastructure.nodes[s - 1], drive.infrastructure.post_of(s - 1)
    J = by_survey(np.pad(z_world_m, ((0, 0), (0, 1))), source.p_world_m)[:, :2]
    doubt = J @ np.diag(source.survey_sigmas**2) @ J.swapaxes(-1, -2)
    if source.sways and post is not None:
        J, _ = linear_row(seen.p_node_m, post, node, post.height_m, node.sensor)
        doubt = doubt + J @ post_spread(post) @ J.swapaxes(-1, -2)
    return np.asarray(doubt)


def _placed(
    users: UserFixes, user: int, t_ns: Instants, judged: SourceVerdicts
) -> tuple[Array, Array, Instants, NDArray[np.bool_]]:
    """Where a user is at some instants (n,): East and North (n, 2) in m, covariance (n, 2, 2), when
    that was known, and whether it is."""
    own = np.flatnonzero(users.user_id == user)
    sound = np.isfinite(users.p_world_m[own]).all(-1) & np.isfinite(users.cov_m2[own]).all((1, 2))
    judged.set(own[~sound], Verdict.INVALID, "place or covariance is not finite")
    own = own[sound]
    own = own[np.diff(users.t_ns[own], prepend=-1) > 0]
    if len(own) < 2:
        n = len(t_ns)
        return np.zeros((n, 2)), np.tile(np.eye(2), (n, 1, 1)), t_ns, np.zeros(n, bool)
    have_ns = users.t_ns[own]
    after = np.clip(np.searchsorted(have_ns, t_ns), 1, len(own) - 1)
    a, b = own[after - 1], own[after]
    span_s = (users.t_ns[b] - users.t_ns[a]) / NS_PER_S
    share = (t_ns - users.t_ns[a]) / NS_PER_S / span_s
    inside = (share >= 0) & (share <= 1) & (span_s <= APART_S)
    judged.set(np.union1d(a[inside], b[inside]), Verdict.UNUSED, _OF_NODES)
    w = share[:, None]
    p = (1 - w) * users.p_world_m[a] + w * users.p_world_m[b]
    bend_m = ACCELERATION_MPS2 / 2 * share * (1 - share) * span_s**2
    w = w[..., None]
    cov = (1 - w) ** 2 * users.cov_m2[a] + w**2 * users.cov_m2[b]
    cov = cov + (bend_m**2)[:, None, None] * np.eye(2)
    known_ns = np.where(share < 1, np.maximum(users.received_ns[a], users.received_ns[b]),
                        users.received_ns[b])  # fmt: skip
    known_ns = np.where(share > 0, known_ns, users.received_ns[a])
    return p, cov, known_ns, inside


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
