"""A car beside swaying posts: what is known of the sway is taken back from the detections first.

The posts are estimated from the poses of their nodes alone (`fgloc.smoother.posts`); every
detection is then carried to where the node would have reported it at rest, exactly, and what is
left uncertain of the sway is added to its covariance. The car's own fixes tell the posts nothing
in this way, and the uncertainty is taken for white; where detections tell of both, the rows of
`fgloc.factors.sway` belong into one graph.

Causal modes take the state of the post from the poses up to the detection, by when they were true.
"""

from dataclasses import dataclass, replace

import numpy as np

from fgloc.config import SmoothConfig
from fgloc.drive import Drive
from fgloc.factors.post import pose_jacobian, post_spread, post_step
from fgloc.factors.sway import Sensor, compensated, reported
from fgloc.infrastructure import Post
from fgloc.measurements import Array, NodeDetections, NodePoses
from fgloc.post_health import post_health
from fgloc.posts import PostStates
from fgloc.result import Result
from fgloc.smoother.posts import Estimate, estimated
from fgloc.sway import SOURCE, Watch, post_states, together, watches
from fgloc.timing import NS_PER_S, Instants
from fgloc.verdicts import SourceVerdicts


@dataclass(frozen=True, eq=False)
class Steadied:
    """A drive whose detections are as of nodes at rest, and how the posts sway."""

    drive: Drive
    posts: PostStates
    verdicts: SourceVerdicts

    def completed(self, result: Result) -> Result:
        """A car's result with the posts beside it."""
        summary = result.summary
        summary["counts"][SOURCE] = self.verdicts.counts()
        summary["posts"] = post_health(self.drive, self.posts)
        verdicts = {**result.verdicts, SOURCE: self.verdicts}
        return replace(result, posts=self.posts, verdicts=verdicts)


def steadied(drive: Drive, config: SmoothConfig) -> Steadied | None:
    """The drive without its sway; None where it has no post with poses, or nobody saw anything."""
    seen, poses = drive.tables.get(NodeDetections.KIND), drive.tables.get(SOURCE)
    watched = isinstance(poses, NodePoses) and drive.infrastructure.posts
    if not config.posts.compensate or not watched or not isinstance(seen, NodeDetections):
        return None
    found, verdicts = watches(drive, "the graph")
    tables, p_m, cov_m2 = [], seen.p_node_m.copy(), seen.cov_node_m2.copy()
    for watch in found:
        estimate = estimated(watch, config, verdicts[SOURCE])
        tables.append(post_states(watch, *estimate))
        rows = np.flatnonzero(seen.node == watch.node)
        sensor = drive.infrastructure.nodes[watch.node].sensor
        at = state_at(watch, estimate, seen.t_ns[rows])
        p_m[rows], cov_m2[rows] = at_rest(p_m[rows], cov_m2[rows], at, watch.post, sensor)
    steady = replace(seen, p_node_m=p_m, cov_node_m2=cov_m2)
    return Steadied(drive.with_tables(detections=steady), together(tables), verdicts[SOURCE])


def state_at(watch: Watch, estimate: Estimate, t_ns: Instants) -> Estimate:
    """The post's state (N, 6) at other instants, with covariance, from the last one before each."""
    states, covs = np.zeros((len(t_ns), 6)), np.zeros((len(t_ns), 6, 6))
    before = np.searchsorted(watch.t_ns, t_ns, side="right") - 1
    for row, k in enumerate(before.tolist()):
        if k < 0:
            covs[row] = post_spread(watch.post)
            continue
        states[row], covs[row] = estimate[0][k], estimate[1][k]
        dt_s = int(t_ns[row] - watch.t_ns[k]) / NS_PER_S
        if dt_s > 0:
            step = post_step(watch.post, dt_s)
            states[row] = step.transition @ states[row]
            covs[row] = step.transition @ covs[row] @ step.transition.T + step.noise
    return states, covs


def at_rest(
    reported_m: Array, cov_m2: Array, at: Estimate, post: Post, sensor: Sensor
) -> tuple[Array, Array]:
    """What a node at rest would have reported, (N, 2) in its axes, and the covariance (N, 2, 2)."""
    states, covs = at
    by_state = pose_jacobian(post.tip_slope_per_m)
    sway = states @ by_state.T
    p_m = compensated(reported_m, sway, post.height_m, sensor)
    _, by_point, by_sway = reported(p_m, sway, post.height_m, sensor)
    J = np.linalg.solve(by_point, by_sway @ by_state)
    return p_m, np.asarray(cov_m2 + J @ covs @ J.swapaxes(-1, -2))
