"""The velocities of a drive in a model: which keyframes have one, and what became of it."""

from functools import cached_property

import numpy as np

from fgloc.config import SmoothConfig
from fgloc.constraints import velocity_error_sigmas, velocity_of
from fgloc.drive import Drive
from fgloc.factors import noise, velocity
from fgloc.measurements import Array, EnuVelocities
from fgloc.smoother.lines import slopes
from fgloc.sync import Plan
from fgloc.timing import Instants
from fgloc.verdicts import SourceVerdicts

SOURCE = "velocity"
WIDTH = 3.4
"""Whitened norm where Huber's loss leaves the parabola: 99 % of errors of dimension 3."""


class Velocities:
    """Velocities (n, 3) in m/s at keyframes, their sigmas (n,), and their rows, -1 for none.

    error_sigmas  (2,) of lasting errors of speed and direction, a share and rad
    err           whether these are estimated
    found         (2,) the errors as last estimated, and `found_cov` (2, 2)
    """

    def __init__(self, drive: Drive, plan: Plan, config: SmoothConfig) -> None:
        at = plan.epochs.keyframes
        self.row = plan.constraints.velocity_row[at]
        self.keys = np.flatnonzero(self.row >= 0)
        self.v_world_mps, self.sigma_mps = np.zeros((len(at), 3)), np.ones(len(at))
        self.received_ns: Instants = np.empty(0, np.int64)
        self._verdicts, self._gate = plan.verdicts, config.gnss
        self.error_sigmas = velocity_error_sigmas(drive, config.motion)
        self.err = bool(self.error_sigmas.any() and len(self.keys))
        self.found, self.found_cov = np.zeros(2), np.diag(self.error_sigmas**2)
        self._table: EnuVelocities | None = None
        table, rows = velocity_of(drive), self.row[self.keys]
        if table is None or not len(rows):
            return
        self._table = table
        self.received_ns = table.received_ns[rows]
        self.v_world_mps[self.keys] = table.v_world_mps[rows]
        rate, arm = plan.epochs.rate_radps[at][self.keys], plan.motion.T_veh_imu[:3, 3]
        self.sigma_mps[self.keys] = velocity.sigma_with_arm(table.sigma_mps[rows], rate, arm)

    @cached_property
    def slope_mps2(self) -> Array:
        """How fast they change (n, 3), by their neighbours; 0 where there is none."""
        slope = np.zeros_like(self.v_world_mps)
        if self._table is not None:
            told = slopes(self._table.t_ns, self._table.v_world_mps)
            slope[self.keys] = told[self.row[self.keys]]
        return slope

    @property
    def verdicts(self) -> SourceVerdicts:
        """Those of the drive's velocities."""
        return self._verdicts[SOURCE]

    def summary(self) -> dict[str, float]:
        """What was found of the lasting errors, where they are estimated."""
        if not self.err:
            return {}
        found, sigma = self.found.tolist(), np.sqrt(np.diag(self.found_cov)).tolist()
        return {
            "velocity_scale": 1 + found[0], "velocity_scale_sigma": sigma[0],
            "velocity_heading_error_rad": found[1],
            "velocity_heading_error_sigma_rad": sigma[1],
        }  # fmt: skip

    def fits(self, j: int, v_world_mps: Array, cov: Array) -> bool:
        """Gate the velocity at keyframe j against one with the covariance (3, 3), and note it."""
        told = self.v_world_mps[j]
        by = velocity.by_errors(told)
        S = cov + by @ self.found_cov @ by.T + self.sigma_mps[j] ** 2 * np.eye(3)
        nis = float(noise.nis(velocity.residual(v_world_mps, told, self.found), S))
        return self.verdicts.gate(int(self.row[j]), nis, 3, self._gate.gate_nis(3))
