"""Which frames of a node's sensors belong together, and which are missing."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from fgloc.perception.recording import Frames, Recording
from fgloc.timing import NS_PER_S

GAP = 1.5
"""A step of more than so many usual ones is a gap."""


class Take(NamedTuple):
    """One frame of one sensor: a camera by its number, or a head's LiDAR by the head's."""

    t_ns: int
    is_camera: bool
    number: int
    frame: int
    received_ns: int


def node_frames(
    recording: Recording, together_s: float, cameras: bool = True, lidars: bool = True
) -> list[list[Take]]:
    """Frames of the node: what its sensors took within `together_s`, each at most one frame, in
    the order of time; of equal stamps the LiDAR's is first."""
    takes = sorted([
        Take(t_ns, is_camera, number, frame, received_ns)
        for is_camera, number, frames in _sensors(recording, cameras, lidars)
        for frame, (t_ns, received_ns) in enumerate(
            zip(frames.t_ns.tolist(), frames.received_ns.tolist(), strict=True)
        )
    ])  # fmt: skip
    groups: list[list[Take]] = []
    for take in takes:
        if (
            groups
            and take.t_ns - groups[-1][0].t_ns <= together_s * NS_PER_S
            and not any(
                (one.is_camera, one.number) == (take.is_camera, take.number) for one in groups[-1]
            )
        ):
            groups[-1].append(take)
        else:
            groups.append([take])
    return groups


def missing(frames: Frames) -> str:
    """What to say of frames that a sensor lacks by its usual step; '' where it lacks none."""
    if len(frames) < 3:
        return ""
    steps_s = np.diff(frames.t_ns) / NS_PER_S
    usual_s = float(np.median(steps_s))
    gaps = steps_s > GAP * usual_s
    lost = int(np.rint(steps_s[gaps] / usual_s).sum() - gaps.sum())
    if not lost:
        return ""
    return (
        f"{frames.sensor}: {lost} of {len(frames) + lost} frames are missing; the longest gap is "
        f"{steps_s.max():.2g} s"
    )


def spread(count: int, wanted: int) -> list[int]:
    """Numbers of so many frames over the whole of a recording, or of all."""
    return sorted({round(k) for k in np.linspace(0, count - 1, min(wanted, count)).tolist()})


def _sensors(
    recording: Recording, cameras: bool, lidars: bool
) -> Iterable[tuple[bool, int, Frames]]:
    if cameras:
        yield from ((True, number, frames) for number, frames in enumerate(recording.images))
    if lidars:
        yield from ((False, head, frames) for head, frames in enumerate(recording.clouds) if frames)
