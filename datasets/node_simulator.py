"""What a roadside node says of the objects that it sees: positions, numbers, noise, delay.

Each object that the node follows is a track; all tracks of a frame share its instant and arrive
together.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc.infrastructure import Node
from fgloc.measurements import VEHICLE, Array, NodeDetections
from fgloc.timing import Instants


@dataclass(frozen=True, eq=False)
class Track:
    """One object as the node follows it.

    frame      (M,) which of the frames show it
    p_world_m  (M, 2) where the node has the centre of its box but for white noise, East and North
    object_id  (M,) the number that the node gives it
    """

    frame: NDArray[np.int64]
    p_world_m: Array
    object_id: NDArray[np.int64]


def numbers(n: int, first: int, chance: float, rng: np.random.Generator) -> NDArray[np.int64]:
    """(n,) numbers of one object: from `first` on, one up by `chance` at each frame."""
    changes = rng.random(n) < chance
    changes[:1] = False
    return first + np.cumsum(changes)


def line_of_sight_covariance(p_node_m: Array, along_m: Array, across_m: Array) -> Array:
    """(N, 2, 2) in the node's axes, of sigmas (N,) along and across the line to places (N, 2)."""
    along = p_node_m / np.linalg.norm(p_node_m, axis=1, keepdims=True)
    across = np.stack([-along[:, 1], along[:, 0]], -1)
    axes = np.stack([along, across], -1)
    return axes * np.stack([along_m, across_m], -1)[:, None, :] ** 2 @ axes.swapaxes(-1, -2)


def simulate_node(
    frames_ns: tuple[Instants, Instants],
    node: Node,
    tracks: Sequence[Track],
    white_m: Callable[[Array], tuple[Array, Array]],
    rng: np.random.Generator,
) -> NodeDetections:
    """Detections of all tracks of the drive's first node, in the order of time.

    frames_ns  (N,) each: instants of the frames and of their arrival
    white_m    sigmas along and across the line of sight by the distance; stated as covariance
    """
    frame = np.concatenate([track.frame for track in tracks])
    order = np.argsort(frame, kind="stable")
    p_node_m = node.from_world(np.concatenate([track.p_world_m for track in tracks])[order])
    cov_m2 = line_of_sight_covariance(p_node_m, *white_m(np.linalg.norm(p_node_m, axis=1)))
    noise_m = np.linalg.cholesky(cov_m2) @ rng.standard_normal((len(frame), 2, 1))
    n = len(frame)
    t_ns, received_ns = (instants[frame[order]] for instants in frames_ns)
    object_id = np.concatenate([track.object_id for track in tracks])[order]
    seen_m = p_node_m + noise_m[..., 0]
    return NodeDetections(
        t_ns, received_ns, np.zeros(n, np.int64), object_id, np.full(n, VEHICLE), seen_m, cov_m2
    )
