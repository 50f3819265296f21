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
    table = drive.tables.get(NodePoses.KIND)
    for node in np.unique(posts.node).tolist():
        post = drive.infrastructure.post_of(node)
        if post is None:
            continue
        length_m = np.linalg.norm(posts.of(node).p_node_m, axis=-1)
        found[post.node] = {
            "frequency_hz": post.frequency_hz, "damping": post.damping,
            "rms_m": float(np.sqrt(np.mean(length_m**2))), "largest_m": float(length_m.max()),
            "strongest_hz": strongest_hz(posts.of(node)),
            **(arrival(table.take(table.node == node), "poses") if isinstance(table, NodePoses) else {}),
        }  # fmt: skip
    return found


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


def arrival(poses: NodePoses | NodeDetections, name: str) -> dict[str, Any]:
    """What is known of how the rows of one node, called so, came in."""
    latency_s = float(np.median(poses.received_ns - poses.t_ns)) / NS_PER_S
    instants = np.unique(poses.t_ns)
    told: dict[str, Any] = {name: len(poses), "latency_s": latency_s}
    if len(instants) < 3:
        return told | {"rate_hz": None, "missing_share": None}
    period_ns = float(np.median(np.diff(instants)))
    expected = round(float(instants[-1] - instants[0]) / period_ns) + 1
    missing = max(1 - len(instants) / expected, 0.0)
    return told | {"rate_hz": NS_PER_S / period_ns, "missing_share": missing}
