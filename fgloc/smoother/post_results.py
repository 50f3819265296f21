"""What a solved drive tells of the posts beside its road: their states, and verdicts on what told.

The states are those at the instants when a post's node saw something or its pose was told.
"""

import numpy as np

from fgloc.factors.noise import nis, weight
from fgloc.measurements import Array
from fgloc.posts import PostStates
from fgloc.references import judge_references
from fgloc.smoother.beside import reference_errors
from fgloc.smoother.model import Model
from fgloc.smoother.posts import judge
from fgloc.smoother.states import States
from fgloc.sway import post_states, together
from fgloc.verdicts import Verdict
from fgloc.watches import SOURCE, judge_poses


def post_table(model: Model, states: Array, cov: Array) -> PostStates | None:
    """The posts of all slots, (n, 6 each) with covariances, as a table; None where there are none.

    States that are NaN are left out.
    """
    swaying, tables = model.swaying, []
    for k, watch in enumerate(swaying.watches):
        keys, own = swaying.keys(k, model.t_ns), swaying.at(int(swaying.slot[k]))
        x, P = states[keys][:, own], cov[keys][:, own[:, None], own]
        table = post_states(watch, x, P)
        tables.append(table.take(np.isfinite(x).all(-1)))
    return together(tables) if tables else None


def judge_batch(model: Model, states: States, cov: Array) -> None:
    """Write the verdicts on poses of nodes, with their NIS, and on what users tell."""
    swaying, verdicts = model.swaying, model.plan.verdicts
    if SOURCE in verdicts and model.config.posts.compensate:
        judge_poses(model.drive, swaying.watches, verdicts[SOURCE])
        for k, watch in enumerate(swaying.watches):
            keys, own = swaying.keys(k, model.t_ns), swaying.at(int(swaying.slot[k]))
            estimate = states.posts[keys][:, own], cov[keys][:, own[:, None], own]
            judge(watch, estimate, verdicts[SOURCE])
    judge_references(model.references, verdicts)
    _weigh_references(model, states)


def _weigh_references(model: Model, states: States) -> None:
    """What the loss weighs down of the detections of users whose places are known."""
    found = model.references
    for s in np.unique(found.source).tolist():
        rows, settings = np.flatnonzero(found.source == s), model.sources[s].settings
        error = reference_errors(model, states, rows, s)
        norm = np.sqrt(nis(error, found.cov_world_m2[rows]))
        share = weight(norm, settings.loss, settings.loss_width)
        for i in np.flatnonzero(share < 1).tolist():
            reason = f"{settings.loss} weight {share[i]:.3g} of user {found.user[rows[i]]}"
            row = found.row[rows[i]]
            model.plan.verdicts["detections"].set(row, Verdict.DOWN_WEIGHTED, reason)
