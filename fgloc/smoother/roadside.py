"""What a solved drive tells of the nodes beside its road."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgloc.factors import noise
from fgloc.factors.detection import FLAT_SURVEY, SURVEY, by_survey
from fgloc.measurements import Array
from fgloc.positions import DETECTIONS
from fgloc.smoother.beside import reference_errors
from fgloc.smoother.chain import position_errors
from fgloc.smoother.model import Model
from fgloc.smoother.states import SharedSigmas, StateLog, States
from fgloc.verdicts import Verdict

LEAST_ROWS = 10
"""For a fit of what a node is off."""


def roadside(model: Model, states: States, sigmas: SharedSigmas) -> dict[str, Any]:
    """For the summary: `nodes` by name, and `box_offset_m` with its sigma where it is estimated."""
    told: dict[str, Any] = {}
    nodes = [s for s, source in enumerate(model.sources) if source.table == DETECTIONS]
    if nodes:
        told["nodes"] = {model.sources[s].name: _node(model, s, states, sigmas) for s in nodes}
    if sigmas.offset is not None:
        told["box_offset_m"] = _with_sigma(states.offset, sigmas.offset)
    return told


def causal_states(model: Model, log: StateLog, posts: Array, survey: Mapping[int, Array]) -> States:
    """The keyframes of a log, with posts and surveys as they were found; slow errors at zero."""
    at, n = model.epoch_of, len(model)
    off = np.zeros((len(model.sources), SURVEY))
    for s, value in survey.items():
        off[s] = value
    zeros = np.zeros((n, 6)), np.zeros((n, 3 * len(model.slow)))
    return States(log.R[at], log.p[at], log.v[at], *zeros, survey=off, posts=posts)


def _node(model: Model, s: int, states: States, sigmas: SharedSigmas) -> dict[str, Any]:
    """Of one node: how many frames saw the car and how well, its slow error, its survey."""
    p, verdicts = model.positions, model.plan.verdicts[DETECTIONS]
    own = p.source == s
    rows = p.row[own]
    used = verdicts.is_(Verdict.USED, Verdict.DOWN_WEIGHTED)[rows]
    delay_s = (p.received_ns[own] - p.t_ns[own]) / 1e9
    told: dict[str, Any] = {
        "frames": len(np.unique(p.frame[own])), "car_seen": int(used.sum()),
        "nis_mean": _mean(verdicts.nis[rows][used]), "delay_mean_s": _mean(delay_s),
    }  # fmt: skip
    told |= _residual(model, s, states, np.flatnonzero(own)[used])
    if s in model.slow and used.any() and model.config.mode == "batch":
        at = 3 * model.slow.index(s)
        keys = model.key_of[own][used]
        told["slow_error_rms_m"] = float(
            np.sqrt((states.slow[keys][:, at : at + 2] ** 2).sum(-1).mean())
        )
    if s in sigmas.survey:
        off, sigma = states.survey[s], sigmas.survey[s]
        told["survey_off_m"] = _with_sigma(off[:2], sigma[:2])
        told["survey_off_rad"] = _with_sigma(off[2:3], sigma[2:3])
        if model.survey_size == SURVEY:
            told["survey_off_up_m"] = _with_sigma(off[3:4], sigma[3:4])
            told["survey_off_level_rad"] = _with_sigma(off[4:], sigma[4:])
    return told


def _residual(model: Model, s: int, states: States, rows: NDArray[np.int64]) -> dict[str, float]:
    """Shift and turn of a node about itself that fit best what its used detections, and those of
    users whose places are known, still differ by from the solution."""
    found, node = model.references, model.sources[s].p_world_m
    known = np.flatnonzero(found.source == s)
    error = [position_errors(model, states, rows), reference_errors(model, states, known, s)]
    cov = np.concatenate([model.cov_world_m2[rows], found.cov_world_m2[known]])[:, :2, :2]
    z = np.concatenate([model.positions.z_world_m[rows], found.z_world_m[known]])
    if len(z) < LEAST_ROWS:
        return {}
    W = noise.whitening(cov)
    J = W @ by_survey(z, node, np.zeros(len(z), bool))[:, :2, :FLAT_SURVEY]
    e = np.einsum("nij,nj->ni", W, np.concatenate(error)[:, :2])
    fit = np.linalg.lstsq(J.reshape(-1, 3), e.ravel(), rcond=None)[0]
    names = ("residual_east_m", "residual_north_m", "residual_yaw_rad")
    return dict(zip(names, fit.tolist(), strict=True))


def _mean(values: Array) -> float | None:
    return float(values.mean()) if len(values) else None


def _with_sigma(value: Array, sigma: Array) -> dict[str, list[float]]:
    return {"value": value.tolist(), "sigma": sigma.tolist()}
