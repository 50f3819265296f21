"""What a solved drive tells of the nodes beside its road."""

from typing import Any

import numpy as np

from fgloc.measurements import Array
from fgloc.positions import DETECTIONS
from fgloc.smoother.model import Model
from fgloc.smoother.states import SharedSigmas, States
from fgloc.verdicts import Verdict


def roadside(model: Model, states: States, sigmas: SharedSigmas) -> dict[str, Any]:
    """For the summary: `nodes` by name, and `box_offset_m` with its sigma where it is estimated."""
    told: dict[str, Any] = {}
    nodes = [s for s, source in enumerate(model.sources) if source.table == DETECTIONS]
    if nodes:
        told["nodes"] = {model.sources[s].name: _node(model, s, states, sigmas) for s in nodes}
    if sigmas.offset is not None:
        told["box_offset_m"] = _with_sigma(states.offset, sigmas.offset)
    return told


def _node(model: Model, s: int, states: States, sigmas: SharedSigmas) -> dict[str, Any]:
    """Of one node: how many frames saw the car and how well, its slow error, its survey."""
    p, verdicts = model.positions, model.plan.verdicts[DETECTIONS]
    own = p.source == s
    rows = p.row[own]
    used = np.isin(verdicts.verdict[rows], (Verdict.USED, Verdict.DOWN_WEIGHTED))
    delay_s = (p.received_ns[own] - p.t_ns[own]) / 1e9
    told: dict[str, Any] = {
        "frames": len(np.unique(p.frame[own])), "car_seen": int(used.sum()),
        "nis_mean": _mean(verdicts.nis[rows][used]), "delay_mean_s": _mean(delay_s),
    }  # fmt: skip
    if s in model.slow and used.any():
        at = 3 * model.slow.index(s)
        keys = model.key_of[own][used]
        told["slow_error_rms_m"] = float(
            np.sqrt((states.slow[keys][:, at : at + 2] ** 2).sum(-1).mean())
        )
    if s in sigmas.survey:
        off, sigma = states.survey[s], sigmas.survey[s]
        told["survey_off_m"] = _with_sigma(off[:2], sigma[:2])
        told["survey_off_rad"] = _with_sigma(off[2:], sigma[2:])
    return told


def _mean(values: Array) -> float | None:
    return float(values.mean()) if len(values) else None


def _with_sigma(value: Array, sigma: Array) -> dict[str, list[float]]:
    return {"value": value.tolist(), "sigma": sigma.tolist()}
