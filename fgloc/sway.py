"""What a drive tells of its swaying posts, sorted by node, and the result of who estimates them.

Every estimator of posts, filter or graph, gets the same `Watch` of each node and gives back its
states at the watch's instants.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgloc.drive import Drive
from fgloc.errors import DriveError
from fgloc.factors.post import POSITION, VELOCITY, tilt_rad
from fgloc.infrastructure import Post
from fgloc.measurements import Array, NodePoses
from fgloc.post_health import post_health
from fgloc.posts import PostStates
from fgloc.result import Result
from fgloc.timing import NS_PER_S, Instants
from fgloc.trajectory import Trajectory
from fgloc.verdicts import SourceVerdicts, Verdict, Verdicts, counts

SOURCE = NodePoses.KIND


@dataclass(frozen=True, eq=False)
class Watch:
    """One post and what pose estimators say of it.

    node    its number, `name` what it is called
    rows    (n,) rows of the drive's table
    told    (n, 4) displacement x, y in m, roll and pitch in rad, NaN where not told
    sigmas  (n, 4) of these
    t_ns    (k,) the instants at which anything is told, k <= n
    state   (n,) which instant a row belongs to, never less than that of the row before
    """

    node: int
    name: str
    post: Post
    rows: NDArray[np.int64]
    told: Array
    sigmas: Array
    t_ns: Instants
    state: NDArray[np.int64]

    @property
    def steps_s(self) -> Array:
        """Time (k - 1,) from each instant to the next."""
        return np.diff(self.t_ns) / NS_PER_S

    def rows_of(self, k: int) -> range:
        """Which of `told` are of the k-th instant."""
        first, after = np.searchsorted(self.state, [k, k + 1]).tolist()
        return range(first, after)


def watches(drive: Drive, method: str) -> tuple[list[Watch], Verdicts]:
    """A watch of each node with a post, and the verdicts on all tables.

    Raises DriveError where no pose of a node with a post can be used.
    """
    verdicts = {
        name: SourceVerdicts.of(name, table, Verdict.UNUSED, f"{method} takes {SOURCE} alone")
        for name, table in drive.tables.items()
    }
    poses = drive.tables.get(SOURCE)
    if not isinstance(poses, NodePoses):
        have = ", ".join(drive.tables) or "nothing"
        raise DriveError(f"drive {drive.name!r} has no {SOURCE} (it has {have}); {method} needs it")
    judged = verdicts[SOURCE]
    judged.set(slice(None), Verdict.UNUSED, "the node has no [[post]]")
    found = []
    for node in np.unique(poses.node).tolist():
        post = drive.infrastructure.post_of(node)
        if post is not None:
            found += _watch(poses, node, post, judged)
    if not found:
        raise DriveError(
            f"drive {drive.name!r}: no finite pose of a node with a post; say in drive.toml which "
            "node stands on one, as [[post]]"
        )
    return found, verdicts


def _watch(poses: NodePoses, node: int, post: Post, judged: SourceVerdicts) -> list[Watch]:
    """The watch of one node, or none where it has no usable row."""
    of_node = poses.node == node
    finite = np.isfinite(poses.p_node_m).all(-1) & (poses.sigma_p_m > 0).all(-1)
    judged.set(of_node & ~finite, Verdict.INVALID, "displacement or its sigma is not finite")
    rows = np.flatnonzero(of_node & finite)
    if not len(rows):
        return []
    judged.set(rows, Verdict.USED)
    told = np.concatenate([poses.p_node_m, poses.tilt_rad], -1)[rows]
    sigmas = np.concatenate([poses.sigma_p_m, poses.sigma_tilt_rad], -1)[rows]
    told[~np.isfinite(sigmas)] = np.nan
    t_ns, state = np.unique(poses.t_ns[rows], return_inverse=True)
    return [Watch(node, post.node, post, rows, told, sigmas, t_ns, state)]


def post_states(watch: Watch, states: Array, cov: Array) -> PostStates:
    """States (k, 6) with covariances (k, 6, 6) as a table, the tilt with them."""
    variance = np.maximum(np.diagonal(cov, axis1=-2, axis2=-1), 0.0)
    sigma_p_m, sigma_v_mps = np.sqrt(variance[:, POSITION]), np.sqrt(variance[:, VELOCITY])
    return table(watch, states[:, POSITION], states[:, VELOCITY], sigma_p_m, sigma_v_mps)


def table(
    watch: Watch, p_m: Array, v_mps: Array, sigma_p_m: Array, sigma_v_mps: Array
) -> PostStates:
    """Displacements and velocities (k, 2) with their sigmas as a table; the tilt follows."""
    slope = watch.post.tip_slope_per_m
    return PostStates(
        watch.t_ns, watch.t_ns, np.full(len(watch.t_ns), watch.node), p_m, v_mps,
        tilt_rad(p_m, slope), sigma_p_m, sigma_v_mps, slope * sigma_p_m[:, ::-1],
    )  # fmt: skip


def result(
    drive: Drive, method: str, tables: Sequence[PostStates], verdicts: Verdicts, *, causal: bool,
    mode: str, factors: int = 0, extra: Mapping[str, Any] | None = None,
    config: Mapping[str, Any] | None = None,
) -> Result:  # fmt: skip
    """The result of a method that estimates posts and no vehicle."""
    posts = together(tables)
    summary = {
        "drive": drive.name, "method": method, "mode": mode, "states": len(posts),
        "factors": factors, "counts": counts(verdicts), "origin": asdict(drive.origin),
        "duration_s": float(posts.t_ns[-1] - posts.t_ns[0]) / NS_PER_S,
        "posts": post_health(drive, posts), **(extra or {}),
    }  # fmt: skip
    nowhere = Trajectory(np.zeros(0, np.int64), np.zeros((0, 3)))
    return Result(
        nowhere, verdicts, summary, method, causal, config=dict(config or {}), posts=posts
    )


def together(tables: Sequence[PostStates]) -> PostStates:
    """Tables of several posts, one or more, as one, in the order of time."""
    columns = {
        name: np.concatenate([vars(one)[name] for one in tables]) for name in vars(tables[0])
    }
    order = np.argsort(columns["t_ns"], kind="stable")
    return PostStates(**{name: column[order] for name, column in columns.items()})
