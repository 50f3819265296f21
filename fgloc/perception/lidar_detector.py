"""Objects in the clouds of a head's LiDAR: background removed, clusters found, cuboids fitted."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc.errors import InputError
from fgloc.measurements import Array
from fgloc.perception.boxes import Cuboids
from fgloc.perception.cuboid_fit import CAR_M, Fit, centre_cov_m2, fit_cuboid
from fgloc.perception.ground_plane import levelled
from fgloc.perception.heads import Lidar, PerceptionNode
from fgloc.perception.lidar_background import VoxelBackground
from fgloc.perception.lidar_clusters import cluster
from fgloc.perception.lidar_settings import LidarConfig
from fgloc.perception.lidar_shadows import shadowed

FEW, LOW, LONG = "few points", "low", "long"
CUT, HIDDEN = "cut off by the edge of the view", "partly hidden by something nearer"
"""Why clusters are left out."""
GROUND_REACH_M = 0.5


@dataclass(frozen=True)
class Found:
    """Cuboids in a cloud, and how many clusters were left out by the reason."""

    cuboids: Cuboids
    left_out: Counter[str]


@dataclass(frozen=True, eq=False)
class LidarDetector:
    """Finds objects in the clouds of one head; `learn` makes it."""

    head: int
    lidar: Lidar
    background: VoxelBackground
    config: LidarConfig

    @classmethod
    def learn(
        cls, node: PerceptionNode, head: int, clouds: Iterable[Array],
        config: LidarConfig | None = None,
    ) -> "LidarDetector":  # fmt: skip
        """The detector of a head, its background from clouds (M, 3) in the node's axes.

        Raises InputError where the head has no LiDAR, fewer than two clouds hold points, or the
        ground that they show is not where the survey has it.
        """
        lidar = node.heads[head].lidar
        if lidar is None:
            raise InputError(f"head {node.heads[head].name!r} has no LiDAR")
        config = config or LidarConfig()
        clouds = list(clouds)
        _check_ground(lidar.name, clouds, node.ground_m, config.least_ground_share)
        level = (levelled(cloud, node.ground_m) for cloud in clouds)
        background = VoxelBackground.learn(level, node.ground_m, config)
        return cls(head, lidar, background, config)

    def detect(self, cloud_m: Array, frame: int) -> Cuboids:
        """The cuboids in a cloud (M, 3) in the node's axes; M may be 0.

        Raises InputError where Open3D is missing.
        """
        return self.look(cloud_m, frame).cuboids

    def look(self, cloud_m: Array, frame: int) -> Found:
        """As `detect`, with what was left out."""
        points_m = self.foreground(cloud_m)
        return self.fit(points_m, self.clusters(points_m), cloud_m, frame)

    def foreground(self, cloud_m: Array) -> Array:
        """The points (N, 3) of a cloud that are neither ground nor background nor too high."""
        level_m = levelled(cloud_m, self.background.ground_m)
        height_m = level_m[:, 2] - self.background.ground_m
        kept = np.flatnonzero(
            (height_m > self.config.clearance_m) & (height_m < self.config.most_top_m)
        )
        return cloud_m[kept[~self.background.holds(level_m[kept])]]

    def clusters(self, points_m: Array) -> NDArray[np.int64]:
        """Label (N,) of each point (N, 3), -1 where it is of no cluster."""
        height_m = float(self.lidar.p_node_lidar_m[2]) - self.background.ground_m - CAR_M[2]
        ahead = self.lidar.R_node_lidar[:, 0]
        ahead_rad = float(np.arctan2(ahead[1], ahead[0]))
        plan_m = (points_m - self.lidar.p_node_lidar_m)[:, :2]
        step_rad = float(self.lidar.step_rad[1])
        return cluster(plan_m, max(height_m, 1.0), step_rad, ahead_rad, self.config)

    def fit(self, points_m: Array, labels: NDArray[np.int64], cloud_m: Array, frame: int) -> Found:
        """Cuboids around the clusters of points (N, 3) that are large and high enough, not too long
        and wholly in view, which the whole cloud (M, 3) tells."""
        order = np.argsort(labels, kind="stable")
        order = order[labels[order] >= 0]
        parts = np.split(points_m[order], np.flatnonzero(np.diff(labels[order])) + 1)
        why = [self._why_not(part) for part in parts if len(part)]
        parts = [part for part, reason in zip(parts, why, strict=False) if not reason]
        fits = [self._fit(part) for part in parts]
        hidden = self._hidden(parts, fits, cloud_m)
        left_out = Counter(reason for reason in [*why, *[HIDDEN] * int(hidden.sum())] if reason)
        kept = np.flatnonzero(~hidden)
        points = np.array([len(parts[k]) for k in kept], np.int64)
        return Found(self._cuboids([fits[k] for k in kept], points, frame), left_out)

    def _fit(self, part: Array) -> Fit:
        sensor_m, ground_m = self.lidar.p_node_lidar_m, self.background.ground_m
        return fit_cuboid(part, sensor_m, ground_m, self.config.person_m)

    def _hidden(self, parts: list[Array], fits: list[Fit], cloud_m: Array) -> NDArray[np.bool_]:
        """(P,) bool: what shows so little of itself that it matters what hides the rest, and is
        hidden."""
        unseen_m = np.array([self.config.fragment_m if f.person else f.aside_m for f in fits])
        hidden = unseen_m > self.config.shadow_m
        doubtful = np.flatnonzero(hidden)
        some = [parts[k] for k in doubtful]
        hidden[doubtful] = shadowed(self.lidar, cloud_m, some, unseen_m[doubtful])
        return hidden

    def _cuboids(self, fits: list[Fit], points: NDArray[np.int64], frame: int) -> Cuboids:
        if not fits:
            return Cuboids.none()
        centre_m = np.array([fit.centre_m for fit in fits])
        size_m = np.array([fit.size_m for fit in fits])
        yaw_rad = np.array([fit.yaw_rad for fit in fits])
        person = np.array([fit.person for fit in fits])
        cov_m2 = centre_cov_m2(centre_m, self.lidar.p_node_lidar_m, points, person)
        frames, head = np.full((2, len(fits)), [[frame], [self.head]])
        return Cuboids(frames, head, centre_m, size_m, yaw_rad, points, cov_m2)

    def _why_not(self, part: Array) -> str:
        """Why a cluster (N, 3) is not to be fitted; empty where it is."""
        if len(part) < self.config.least_points:
            return FEW
        if float(part[:, 2].max()) - self.background.ground_m < self.config.least_top_m:
            return LOW
        if float(np.linalg.norm(np.ptp(part[:, :2], axis=0))) > self.config.most_length_m:
            return LONG
        return CUT if self.lidar.at_edge(part).any() else ""


def _check_ground(name: str, clouds: list[Array], ground_m: float, least_share: float) -> None:
    """Raise InputError where hardly a point lies on the ground of the survey: a mount in other axes
    or a wrong height shows so, and would hide every object."""
    near = [np.abs(cloud[:, 2] - ground_m) < GROUND_REACH_M for cloud in clouds if len(cloud)]
    share = float(np.concatenate(near).mean()) if near else 1.0
    if share < least_share:
        raise InputError(
            f"LiDAR {name!r}: {share:.1%} of its points lie within {GROUND_REACH_M:g} m of the "
            f"ground, {-ground_m:g} m below the node; check the node's height_m and R_node_lidar "
            "(x ahead, y left, z up, to the node's axes)"
        )
