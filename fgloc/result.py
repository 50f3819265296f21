"""What every estimator gives back."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from fgloc.measurements import ObjectTracks
from fgloc.trajectory import Trajectory
from fgloc.verdicts import Verdicts


@dataclass(frozen=True)
class Event:
    """Something that happened during a run and that its user should know."""

    t_ns: int
    kind: str
    text: str


@dataclass(frozen=True, eq=False)
class Result:
    """One method's answer to one drive.

    trajectory  the estimate; of causal methods, each state as it was when it was the newest
    smoothed    causal methods only, on request: the last estimate of every state
    objects     tracks of other road users, of methods that follow them
    summary     what summary.json holds (see the README), metrics left out
    method      e.g. 'graph-batch'; `causal` says whether the trajectory looked ahead
    """

    trajectory: Trajectory
    verdicts: Verdicts
    summary: dict[str, Any]
    method: str
    causal: bool
    smoothed: Trajectory | None = None
    objects: ObjectTracks | None = None
    events: tuple[Event, ...] = ()
    config: Mapping[str, Any] = field(default_factory=dict)
