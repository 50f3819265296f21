"""Where a vehicle is within the range of a roadside node, and errors there and elsewhere alone."""

from collections.abc import Mapping
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from fgloc.drive import Drive
from fgloc.evaluation.against_truth import Errors
from fgloc.evaluation.gaps import Spans
from fgloc.trajectory import Trajectory

IN_RANGE, ELSEWHERE = "in range", "elsewhere"
"""Conditions: within `Node.range_m` of a node on the map, by the truth, and not."""

Mask = NDArray[np.bool_]


def conditions(drive: Drive) -> dict[str, Mask]:
    """For each condition, which rows (N,) of the truth fulfil it; none without nodes or truth."""
    if drive.truth is None or not drive.infrastructure.nodes:
        return {}
    place = drive.truth.p_world_m[:, :2]
    near = np.zeros(len(place), bool)
    for node in drive.infrastructure.nodes:
        near |= np.linalg.norm(place - node.p_world_m[:2], axis=-1) <= node.range_m
    return {IN_RANGE: near, ELSEWHERE: ~near}


def under(errors: Errors, truth: Trajectory, mask: Mask) -> Errors:
    """The errors at rows of the truth (N,) that a mask selects."""
    rows = mask[np.searchsorted(truth.t_ns, errors.t_ns)]
    columns: Mapping[str, np.ndarray] = {
        field.name: value[rows]
        for field in fields(errors)
        if isinstance(value := getattr(errors, field.name), np.ndarray)
    }
    n, kept = int(mask.sum()), int(rows.sum())
    left_out = {"not covered by the estimate, or before the start": n - kept} if n > kept else {}
    return replace(errors, **columns, n_truth=n, left_out=left_out)  # type: ignore[arg-type]


def spans(truth: Trajectory, mask: Mask) -> Spans:
    """First and last instants (K, 2) of the stretches of a mask (N,) over the truth."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    begin, end = edges[::2], edges[1::2] - 1
    return np.stack([truth.t_ns[begin], truth.t_ns[end]], -1)
