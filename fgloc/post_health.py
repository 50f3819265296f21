"""How posts and what watches them are doing: amplitude, frequency, latency, missing poses."""

from typing import Any

import numpy as np

from fgloc.drive import Drive
from fgloc.measurements import Array, NodeDetections, NodePoses
from fgloc.posts import PostStates
from fgloc.timing import NS_PER_S

LEAST_ROWS = 16
"""For a spectrum."""


def post_health(drive: Drive, posts: PostStates) -> dict[str, dict[str, Any]]:
    """By the name of the node; a value that cannot be told is None.

    frequency_hz, damping  of the first mode, as the drive states them
    rms_m, largest_m       of the estimated displacement, its length in plan
    strongest_hz           where its spectrum is highest, below half the rate of the poses
    poses, rate_hz         how many there are, and how many a second
    missing_share          of the poses that the rate lets expect
    latency_s              median time from a pose to its arrival
    """
    found = {}
    for node in np.unique(posts.node).tolist():
        post = drive.infrastructure.post_of(node)
        if post is None:
            continue
        length_m = np.linalg.norm(posts.of(node).p_node_m, axis=-1)
        found[post.node] = {
            "frequency_hz": post.frequency_hz, "damping": post.damping,
            "rms_m": float(np.sqrt(np.mean(length_m**2))), "largest_m": float(length_m.max()),
            "strongest_hz": strongest_hz(posts.of(node)),
            **_watched(drive, node),
        }  # fmt: skip
    return found


def _watched(drive: Drive, node: int) -> dict[str, Any]:
    """How the poses of a node came in, where there are any."""
    poses = drive.tables.get(NodePoses.KIND)
    own = poses.take(poses.node == node) if isinstance(poses, NodePoses) else ()
    return arrival(own, "poses") if isinstance(own, NodePoses) and len(own) else {}


def amplitudes_m(posts: PostStates) -> tuple[Array, Array]:
    """Frequencies above 0 (m,) in Hz and amplitudes of the displacement along both axes (m, 2).

    Under a Hann window; as if the rows of the one post were evenly spread in time.
    """
    n, span_s = len(posts), float(posts.t_ns[-1] - posts.t_ns[0]) / NS_PER_S
    window = np.hanning(n)[:, None]
    swing = posts.p_node_m - posts.p_node_m.mean(0)
    amplitude = 2 * np.abs(np.fft.rfft(swing * window, axis=0)) / window.sum()
    frequency_hz = np.asarray(np.fft.rfftfreq(n, span_s / (n - 1)), float)
    return frequency_hz[1:], np.asarray(amplitude[1:])


def strongest_hz(posts: PostStates) -> float | None:
    """Where the spectrum of one post is highest; None for fewer than `LEAST_ROWS` states."""
    if len(posts) < LEAST_ROWS:
        return None
    frequency_hz, amplitude_m = amplitudes_m(posts)
    return float(frequency_hz[np.argmax(np.linalg.norm(amplitude_m, axis=-1))])


def arrival(
    rows: NodePoses | NodeDetections, name: str, absent_s: float = np.inf
) -> dict[str, Any]:
    """What is known of how the rows of one node, one or more, came in.

    How many there are is called `name`. Instants more than `absent_s` apart have none missing
    between them.
    """
    latency_s = float(np.median(rows.received_ns - rows.t_ns)) / NS_PER_S
    told: dict[str, Any] = {name: len(rows), "latency_s": latency_s}
    steps_s = np.asarray(np.diff(np.unique(rows.t_ns)) / NS_PER_S, float)
    steps_s = steps_s[steps_s <= absent_s]
    if len(steps_s) < 2:
        return told | {"rate_hz": None, "missing_share": None}
    period_s = float(np.median(steps_s))
    expected = max(round(float(steps_s.sum()) / period_s), len(steps_s))
    return told | {"rate_hz": 1 / period_s, "missing_share": 1 - len(steps_s) / expected}
