"""The velocities of a drive in a model: which keyframes have one, and what became of it."""

import numpy as np
from numpy.typing import NDArray

from fgloc.chi_square import chi2_quantile
from fgloc.config import GnssConfig
from fgloc.constraints import velocity_of
from fgloc.drive import Drive
from fgloc.factors import noise, velocity
from fgloc.measurements import Array
from fgloc.sync import Plan
from fgloc.timing import Instants
from fgloc.verdicts import SourceVerdicts, Verdict

SOURCE = "velocity"
WIDTH = 3.4
"""Whitened norm where Huber's loss leaves the parabola: 99 % of errors of dimension 3."""


class Velocities:
    """Velocities (n, 3) in m/s at keyframes, their sigmas (n,), and their rows, -1 for none."""

    def __init__(self, drive: Drive, plan: Plan, gate: GnssConfig) -> None:
        at = plan.epochs.keyframes
        self.row = plan.constraints.velocity_row[at]
        self.keys = np.flatnonzero(self.row >= 0)
        self.v_world_mps, self.sigma_mps = np.zeros((len(at), 3)), np.ones(len(at))
        self.received_ns: Instants = np.empty(0, np.int64)
        self._verdicts, self._gate = plan.verdicts, gate
        table, rows = velocity_of(drive), self.row[self.keys]
        if table is None or not len(rows):
            return
        self.received_ns = table.received_ns[rows]
        self.v_world_mps[self.keys] = table.v_world_mps[rows]
        rate, arm = plan.epochs.rate_radps[at][self.keys], plan.motion.T_veh_imu[:3, 3]
        self.sigma_mps[self.keys] = velocity.sigma_with_arm(table.sigma_mps[rows], rate, arm)

    @property
    def verdicts(self) -> SourceVerdicts:
        """Those of the drive's velocities."""
        return self._verdicts[SOURCE]

    def fits(self, j: int, v_world_mps: Array, cov: Array) -> bool:
        """Gate the velocity at keyframe j against one with the covariance (3, 3), and note it."""
        c, own, row = self._gate, self.verdicts, int(self.row[j])
        error = velocity.residual(v_world_mps, self.v_world_mps[j])
        nis = float(noise.nis(error, cov + self.sigma_mps[j] ** 2 * np.eye(3)))
        limit = chi2_quantile(c.gate_probability, 3) * c.gate_slack**2
        own.nis[row], own.dof[row], own.threshold[row] = nis, 3, limit
        fits = nis <= limit
        reason = "" if fits else "does not fit the prediction"
        own.set(row, Verdict.USED if fits else Verdict.GATED, reason)
        return fits

    def whitened(self, v_world_mps: Array, keys: NDArray[np.int64]) -> Array:
        """Errors (m, 3) of the states' velocities (n, 3) at some keyframes, in sigmas."""
        error = velocity.residual(v_world_mps[keys], self.v_world_mps[keys])
        return error / self.sigma_mps[keys, None]

    def judge(self, v_world_mps: Array) -> None:
        """Verdicts of a graph that was solved at once: what the loss weighs down, and the rest."""
        if not len(self.keys):
            return
        norm = np.linalg.norm(self.whitened(v_world_mps, self.keys), axis=1)
        weight, rows = noise.weight(norm, "huber", WIDTH), self.row[self.keys]
        self.verdicts.set(rows, Verdict.USED)
        for row, w in zip(rows[weight < 1], weight[weight < 1], strict=True):
            self.verdicts.set(row, Verdict.DOWN_WEIGHTED, f"huber weight {w:.3g}")
