"""How often each matching of a node's objects to a car's fails, on seeded layouts.

Held against the truth of each layout: a failure is a heading off by more than 5 deg, any wrong
pair, or no answer where the layout has one. Layouts that leave a choice, by an exhaustive search
(`correspondence.oracle`), are counted apart and not scored.
"""

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from fgloc.correspondence import Correspondence, Rigid, Status, cpd, icp, is_ambiguous, match
from fgloc.correspondence.matching import APART_RAD
from fgloc.correspondence.rigid import wrapped
from fgloc.datasets.khamooshi2023_layouts import Layout, make_layout
from fgloc.datasets.simulator import stream
from fgloc.errors import InputError
from fgloc.evaluation.metric import Metric

WARM_SIGMA_M = 2.0
"""How far a point may be off under the last step's pose: a step at 15 m/s, and some turning."""
_Z95 = 1.959964

Method = Callable[[Layout], Correspondence]


def _last(x: Layout) -> Rigid:
    return Rigid(x.last_yaw_rad, x.last_t_m)


METHODS: dict[str, Method] = {
    "icp-printed": lambda x: icp(x.p_world_m, x.p_veh_m, printed=True),
    "icp": lambda x: icp(x.p_world_m, x.p_veh_m, gate_m=_gate_m(x)),
    "icp-warm": lambda x: icp(x.p_world_m, x.p_veh_m, _last(x), gate_m=_gate_m(x)),
    "cpd-printed": lambda x: cpd(x.p_world_m, x.p_veh_m, printed=True, gate_m=_gate_m(x)),
    "cpd": lambda x: cpd(x.p_world_m, x.p_veh_m, gate_m=_gate_m(x)),
    "cpd-warm": lambda x: cpd(
        x.p_world_m, x.p_veh_m, _last(x), sigma_m=WARM_SIGMA_M, gate_m=_gate_m(x)
    ),
    "consistent": lambda x: match(x.p_world_m, x.p_veh_m, sigma_m=x.sigma_m),
}
"""Khamooshi's two, as printed, mended and warm-started, and ours, which needs no start."""


@dataclass(frozen=True)
class Row:
    """One method on layouts of one size; rates are of the layouts that are not ambiguous.

    failed        any of the three; `heading`, `wrong_pair` and `no_answer` are the reasons
    found         share of the true pairs that were claimed
    wrong_likely  share of layouts in which a pair is wrong once the likely ones are taken too
    found_likely  share of the true pairs that were claimed or likely
    """

    method: str
    objects: int
    layouts: int
    ambiguous: int
    failed: Metric
    heading: Metric
    wrong_pair: Metric
    no_answer: Metric
    found: Metric
    wrong_likely: Metric
    found_likely: Metric
    median_s: float

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            name: value.to_dict() if isinstance(value, Metric) else value
            for name, value in vars(self).items()
        }


@dataclass(frozen=True)
class _Outcome:
    heading: bool
    wrong: bool
    silent: bool
    found: float
    wrong_likely: bool
    found_likely: float
    wall_s: float


def study(
    layouts: int,
    sizes: Sequence[int],
    seed: int = 0,
    *,
    methods: Mapping[str, Method] = METHODS,
    tell: Callable[[str], None] = lambda line: None,
    options: Mapping[str, Any] = MappingProxyType({}),
) -> list[Row]:
    """Rows for each size and method; equal arguments give equal layouts.

    options  of the layouts: sigma_m, missing, ghosts, one_sided
    Raises InputError for values out of range.
    """
    if layouts < 1 or not sizes:
        raise InputError("give at least one layout and one size")
    rows = []
    for objects in sizes:
        rng = stream(seed, f"layouts of {objects}")
        made = [make_layout(rng, objects, **options) for _ in range(layouts)]
        tell(f"{objects} objects: which layouts are ambiguous")
        clear = [x for x in made if not _ambiguous(x)]
        for name, method in methods.items():
            tell(f"{objects} objects: {name}")
            outcomes = [_judge(method, x) for x in clear]
            rows.append(_row(name, objects, layouts, outcomes))
    return rows


def wilson(hits: int, n: int) -> tuple[float, float]:
    """95 % interval of a share of which `hits` of `n` were seen (Wilson 1927)."""
    p, z2 = hits / n, _Z95**2
    middle = (p + z2 / (2 * n)) / (1 + z2 / n)
    half = _Z95 * math.sqrt(p * (1 - p) / n + z2 / (4 * n * n)) / (1 + z2 / n)
    return max(middle - half, 0.0), min(middle + half, 1.0)


def _ambiguous(x: Layout) -> bool:
    return is_ambiguous(x.p_world_m, x.p_veh_m, x.yaw_rad, x.pairs, sigma_m=x.sigma_m)


def _gate_m(x: Layout) -> float:
    return 3 * math.sqrt(2) * x.sigma_m


def _judge(method: Method, x: Layout) -> _Outcome:
    began = time.perf_counter()
    found = method(x)
    wall_s = time.perf_counter() - began
    true, claimed = _set(x.pairs), _set(found.pairs)
    taken = claimed | _set(found.likely)
    told = found.status != Status.AMBIGUOUS  # a pose that an ambiguous answer has is no claim
    return _Outcome(
        heading=told and abs(wrapped(found.pose.yaw_rad - x.yaw_rad)) > APART_RAD,
        wrong=bool(claimed - true),
        silent=found.status != Status.MATCHED,
        found=len(claimed & true) / len(true),
        wrong_likely=bool(taken - true),
        found_likely=len(taken & true) / len(true),
        wall_s=wall_s,
    )


def _set(pairs: np.ndarray) -> set[tuple[int, int]]:
    return {(int(own), int(theirs)) for own, theirs in pairs}


def _row(method: str, objects: int, layouts: int, outcomes: Sequence[_Outcome]) -> Row:
    rate = partial(_rate, n=len(outcomes))
    return Row(
        method, objects, layouts, layouts - len(outcomes),
        failed=rate(o.heading or o.wrong or o.silent for o in outcomes),
        heading=rate(o.heading for o in outcomes),
        wrong_pair=rate(o.wrong for o in outcomes),
        no_answer=rate(o.silent for o in outcomes),
        found=_mean([o.found for o in outcomes]),
        wrong_likely=rate(o.wrong_likely for o in outcomes),
        found_likely=_mean([o.found_likely for o in outcomes]),
        median_s=float(np.median([o.wall_s for o in outcomes])) if outcomes else math.nan,
    )  # fmt: skip


def _rate(hits: Iterable[bool], n: int) -> Metric:
    if n == 0:
        return Metric(None, "1", why="all layouts are ambiguous")
    count = sum(hits)
    return Metric(count / n, "1", "lower", n, *wilson(count, n))


def _mean(shares: Sequence[float]) -> Metric:
    if not shares:
        return Metric(None, "1", "higher", why="all layouts are ambiguous")
    return Metric(float(np.mean(shares)), "1", "higher", len(shares))
