"""What a drive tells of its swaying posts, sorted by node.

Every estimator of posts, filter or graph, gets the same `Watch` of each node and gives back its
states at the watch's instants.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc.config import SmoothConfig
from fgloc.drive import Drive
from fgloc.errors import DriveError
from fgloc.infrastructure import Post
from fgloc.measurements import Array, NodePoses
from fgloc.timing import NS_PER_S, Instants, seconds_to_ns
from fgloc.verdicts import SourceVerdicts, Verdict, Verdicts

SOURCE = NodePoses.KIND
AROUND_S = 10.0
"""A post beside cars is followed from so long before its node first sees anything until so long
after the last time: what a post did earlier it has forgotten."""


@dataclass(frozen=True, eq=False)
class Watch:
    """One post and what pose estimators say of it.

    node    its number, `name` what it is called
    rows    (n,) rows of the drive's table
    told    (n, 4) displacement x, y in m, roll and pitch in rad, NaN where not told
    sigmas  (n, 4) of these
    t_ns    (k,) the instants at which anything is told, or the node sees something
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
    nothing = np.zeros(0, np.int64)
    posts = _posts(drive, poses.node)
    found = [_watch(drive, node, post, nothing, poses.t_ns[[0, -1]]) for node, post in posts]
    found = [watch for watch in found if len(watch.rows)]
    if not found:
        raise DriveError(
            f"drive {drive.name!r}: no finite pose of a node with a post; say in drive.toml which "
            "node stands on one, as [[post]]"
        )
    judge_poses(drive, found, verdicts[SOURCE])
    return found, verdicts


def beside_cars(
    drive: Drive, config: SmoothConfig, node: NDArray[np.int64], t_ns: Instants, span_ns: Instants
) -> tuple[Watch, ...]:
    """A watch of each post whose node sees something: at (N,) instants, (N,) the node's number.

    Its instants are those at which the node sees or its pose is told, within `AROUND_S` of the
    first and the last thing seen and within the span (2,). None where the configuration leaves the
    posts out.
    """
    if not config.posts.compensate:
        return ()
    around_ns, found = np.array([-1, 1]) * seconds_to_ns(AROUND_S), []
    for number, post in _posts(drive, node):
        seen_ns = t_ns[node == number]
        reach = np.array([seen_ns.min(), seen_ns.max()]) + around_ns
        found.append(_watch(drive, number, post, seen_ns, np.clip(reach, *span_ns)))
    return tuple(found)


def judge_poses(drive: Drive, found: Iterable[Watch], judged: SourceVerdicts) -> None:
    """Say of every pose whether a watch has it, and why not."""
    poses = drive.tables[SOURCE]
    assert isinstance(poses, NodePoses)
    judged.set(slice(None), Verdict.UNUSED, "the node has no [[post]]")
    posts = [node for node, _ in _posts(drive, poses.node)]
    reason = "nothing that the node saw then is in the graph"
    judged.set(np.isin(poses.node, posts), Verdict.UNUSED, reason)
    judged.set(~_finite(poses), Verdict.INVALID, "displacement or its sigma is not finite")
    for watch in found:
        judged.set(watch.rows, Verdict.USED)


def _posts(drive: Drive, node: NDArray[np.int64]) -> list[tuple[int, Post]]:
    """The numbers of nodes that stand on posts, and these."""
    pairs = ((one, drive.infrastructure.post_of(one)) for one in np.unique(node).tolist())
    return [(one, post) for one, post in pairs if post is not None]


def _finite(poses: NodePoses) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(poses.p_node_m).all(-1) & (poses.sigma_p_m > 0).all(-1))


def _watch(
    drive: Drive, node: int, post: Post, seen_ns: Instants, reach_ns: Instants
) -> Watch:  # fmt: skip
    """The watch of one node: what it sees, and its usable poses between two instants."""
    poses = drive.tables.get(SOURCE)
    if not isinstance(poses, NodePoses):
        nothing, none = np.zeros((0, 4)), np.zeros(0, np.int64)
        return Watch(node, post.node, post, none, nothing, nothing, np.unique(seen_ns), none)
    within = (poses.t_ns >= reach_ns[0]) & (poses.t_ns <= reach_ns[1])
    rows = np.flatnonzero(within & (poses.node == node) & _finite(poses))
    told = np.concatenate([poses.p_node_m, poses.tilt_rad], -1)[rows]
    sigmas = np.concatenate([poses.sigma_p_m, poses.sigma_tilt_rad], -1)[rows]
    told[~np.isfinite(sigmas)] = np.nan
    t_ns = np.unique(np.concatenate([seen_ns, poses.t_ns[rows]]))
    state = np.searchsorted(t_ns, poses.t_ns[rows])
    return Watch(node, post.node, post, rows, told, sigmas, t_ns, state)
