"""How far the chain's optimum, and the covariance there, is from that of GTSAM's graph."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fgloc.config import load_config
from fgloc.frames import log_so3
from fgloc.smoother.chain import Chain
from fgloc.smoother.graph import GraphModel
from fgloc.smoother.guess import guess, yaw_by_turns
from fgloc.smoother.states import Robustness, States
from fgloc.smoother.whole import Whole
from fgloc.sync import plan


class Apart(NamedTuple):
    """The largest difference of cost (share), positions, rotations, velocities and covariances
    (share, by Frobenius's norm) of poses and of what measurements see."""

    cost: float
    p_m: float
    turn_rad: float
    v_mps: float
    cov: float
    predicted: float


def solvers(drive, **settings):
    """The model of a drive, its guess, and its graph as a chain and for GTSAM."""
    config = load_config(**settings)
    model = GraphModel(drive, plan(drive, config), config)
    start = guess(model, 0, len(model) - 1, yaw_by_turns(model))
    deltas, _ = model.deltas()
    return model, start, Chain(model, start, deltas), Whole(model, start, deltas)


def robustness(chain, gated=False):
    """The configured loss, with some fixes gated."""
    gnss = chain.model.config.gnss
    width = np.inf if gnss.loss == "none" else gnss.loss_width
    return Robustness(gated | np.zeros(chain.rows, bool), width)


def apart(drive, gated=(), unheld=(), **settings):
    """Solve a drive as a chain, and from there by GTSAM: its steps are damped and the tail of a
    robust loss is long."""
    settings = {"solver": {"cost_tolerance": 1e-7}, **settings}
    _, start, chain, whole = solvers(drive, **settings)
    robust = robustness(chain, np.isin(np.arange(chain.rows), gated))
    robust = replace(robust, unheld=dict(unheld))
    near, _, _ = chain.optimum(
        States.of(start, chain.model), replace(robust, plain=True), rough=True
    )
    ours, cost, _ = chain.optimum(near, robust)
    theirs, its_cost, _ = whole.optimum(ours, robust)
    mine, its = (one.covariances(theirs, robust) for one in (chain, whole))
    return Apart(
        abs(cost / its_cost - 1),
        np.abs(ours.p - theirs.p).max(),
        np.abs(log_so3(ours.R.swapaxes(-1, -2) @ theirs.R)).max(),
        np.abs(ours.v - theirs.v).max(),
        relative(mine.poses, its.poses).max(),
        relative(mine.positions, its.positions).max(),
    )


def relative(cov, other):
    """How far covariances (n, m, m) are apart, relative to the second."""
    return np.linalg.norm(cov - other, axis=(1, 2)) / np.linalg.norm(other, axis=(1, 2))
