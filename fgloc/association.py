"""Which of the objects that a node sees is the car.

The candidates of one frame, a node at one instant, exclude each other. Among those that pass the
gate the nearest in the sense of NIS is taken, with the number that the node gave it as a second
witness: -2 ln of the share of its frames in which that number was the car joins the NIS, so that a
neighbour does not take over for a moment, and a number that the node gives anew is believed soon.
"""

import numpy as np
from numpy.typing import NDArray

from fgloc.measurements import Array
from fgloc.positions import numbered

FEW = 3
"""A number seen in fewer frames is a ghost's, if it is not the car's."""


class Witness:
    """How often each number of each source was the car, among the frames that could tell."""

    def __init__(self) -> None:
        self._times: dict[tuple[int, int], list[int]] = {}

    def cost(self, source: int, object_id: int) -> float:
        """-2 ln of the share, by Laplace's rule; a candidate without a number has an even chance.

        How much a candidate's NIS is to be raised.
        """
        car, seen = self._times.get((source, object_id), (0, 0))
        if object_id < 0:
            car, seen = 0, 0
        return float(-2 * np.log((car + 1) / (seen + 2)))

    def note(self, source: int, object_id: int, car: int, frames: int = 1) -> None:
        """So many frames in which this number was the car, of those in which some candidate was."""
        times = self._times.setdefault((source, object_id), [0, 0])
        times[0] += car
        times[1] += frames


def nearest(
    frame: NDArray[np.int64], source: NDArray[np.int64], object_id: NDArray[np.int64], nis: Array,
    limit: Array,
) -> NDArray[np.bool_]:  # fmt: skip
    """Which of n candidates are the car, at most one of each frame.

    frame      (n,) number of the frame
    source     (n,) the node that sees it; object_id (n,) the number that it gives
    nis        (n,) against what is known without the frame; above limit (n,) it is not the car
    """
    fits = nis <= limit
    first = _least(frame, np.where(fits, nis, np.inf))
    witness = Witness()
    decided = np.isin(frame, frame[first])
    which = numbered(source, object_id)
    car, seen = (np.bincount(which, rows) for rows in (first, decided))
    _, one = np.unique(which, return_index=True)
    names = list(zip(source[one].tolist(), object_id[one].tolist(), strict=True))
    for name, times, frames in zip(names, car.tolist(), seen.tolist(), strict=True):
        witness.note(*name, int(times), int(frames))
    raised = nis + np.array([witness.cost(*name) for name in names])[which]
    return _least(frame, np.where(fits, raised, np.inf))


def _least(frame: NDArray[np.int64], cost: Array) -> NDArray[np.bool_]:
    """The candidate of least cost in each frame, if that is finite."""
    if (frame[1:] > frame[:-1]).all():  # each has one, as where a node saw nothing else
        return np.isfinite(cost)
    order = np.lexsort((cost, frame))
    best = order[np.append(True, np.diff(frame[order]) != 0)[: len(order)]]
    chosen = np.zeros(len(frame), bool)
    chosen[best] = np.isfinite(cost[best])
    return chosen


def explanations(
    frame: NDArray[np.int64], source: NDArray[np.int64], object_id: NDArray[np.int64],
    chosen: NDArray[np.bool_], fits: NDArray[np.bool_],
) -> list[tuple[bool, str]]:  # fmt: skip
    """For each candidate that was not chosen, in order: is it another object's, and why not.

    A number that was often seen and seldom the car is another road user; one that was seen in fewer
    than `FEW` frames is a ghost.
    """
    which = numbered(source, object_id)
    seen, car = np.bincount(which), np.bincount(which, chosen)
    frames_with_car = set(frame[chosen].tolist())
    told = []
    for i in np.flatnonzero(~chosen).tolist():
        n, m, name = int(seen[which[i]]), int(car[which[i]]), int(object_id[i])
        if name >= 0 and n >= FEW and 2 * m < n:
            told.append((True, f"object {name} is another road user: the car in {m} of {n} frames"))
        elif name >= 0 and n < FEW and not m:
            told.append((True, f"object {name} was seen {n} times only: a ghost"))
        elif int(frame[i]) in frames_with_car and fits[i]:
            told.append((True, "another candidate of the frame is nearer"))
        else:
            told.append((False, "does not fit"))
    return told
