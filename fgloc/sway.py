"""States of posts as tables, and the result of who estimates posts and no vehicle."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from fgloc.drive import Drive
from fgloc.factors.post import POSITION, VELOCITY, tilt_rad
from fgloc.measurements import Array
from fgloc.post_health import post_health
from fgloc.posts import PostStates
from fgloc.result import Result
from fgloc.timing import NS_PER_S
from fgloc.trajectory import Trajectory
from fgloc.verdicts import Verdicts, counts
from fgloc.watches import Watch


def post_states(watch: Watch, states: Array, cov: Array) -> PostStates:
    """States (k, 6) with covariances (k, 6, 6) as a table, the tilt with them."""
    variance = np.maximum(np.diagonal(cov, axis1=-2, axis2=-1), 0.0)
    sigma_p_m, sigma_v_mps = np.sqrt(variance[:, POSITION]), np.sqrt(variance[:, VELOCITY])
    return table(watch, states[:, POSITION], states[:, VELOCITY], sigma_p_m, sigma_v_mps)


def table(
    watch: Watch, p_m: Array, v_mps: Array, sigma_p_m: Array, sigma_v_mps: Array
) -> PostStates:
    """Displacements and velocities (k, 2) with their sigmas as a table; the tilt follows."""
    slope = watch.post.tip_slope_per_m
    return PostStates(
        watch.t_ns, watch.t_ns, np.full(len(watch.t_ns), watch.node), p_m, v_mps,
        tilt_rad(p_m, slope), sigma_p_m, sigma_v_mps, slope * sigma_p_m[:, ::-1],
    )  # fmt: skip


def result(
    drive: Drive, method: str, tables: Sequence[PostStates], verdicts: Verdicts, *, causal: bool,
    mode: str, factors: int = 0, extra: Mapping[str, Any] | None = None,
    config: Mapping[str, Any] | None = None,
) -> Result:  # fmt: skip
    """The result of a method that estimates posts and no vehicle."""
    posts = together(tables)
    summary = {
        "drive": drive.name, "method": method, "mode": mode, "states": len(posts),
        "factors": factors, "counts": counts(verdicts), "origin": asdict(drive.origin),
        "duration_s": float(posts.t_ns[-1] - posts.t_ns[0]) / NS_PER_S,
        "posts": post_health(drive, posts), **(extra or {}),
    }  # fmt: skip
    nowhere = Trajectory(np.zeros(0, np.int64), np.zeros((0, 3)))
    return Result(
        nowhere, verdicts, summary, method, causal, config=dict(config or {}), posts=posts
    )


def together(tables: Sequence[PostStates]) -> PostStates:
    """Tables of several posts, one or more, as one, in the order of time."""
    columns = {
        name: np.concatenate([vars(one)[name] for one in tables]) for name in vars(tables[0])
    }
    order = np.argsort(columns["t_ns"], kind="stable")
    return PostStates(**{name: column[order] for name, column in columns.items()})
