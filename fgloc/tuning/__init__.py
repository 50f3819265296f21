"""The noise of a drive's sources, found by withholding fixes and predicting them.

What noise is right shows where something is predicted and then compared. Fixes are withheld one at
a time, in blocks and in outages, the rest is smoothed, and each withheld fix is scored by its
log-likelihood under the prediction's covariance plus its own. Short gaps show the noise of the
fixes, long ones that of the IMU, so the two can be told apart, which the NIS of a causal filter
alone cannot. A quarter of the drive, in stretches, is never seen by the search; the noise before
and after is judged there. The truth is not used.

What aids beside the fixes (wheels, roadside nodes, the axis that a car follows) comes after, under
the noise that was found: see `aids`. On a drive without an IMU the fixes are among them.

A constant or very slow error of the fixes cannot show in this way: nothing else knows the position.
Where the fixes scatter far less than they claim, suspect a receiver that filters, and ask for slow
errors: `gnss.bias_sigma_m` in the configuration, which is then sought as well.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fgloc.config import SmoothConfig
from fgloc.drive import Drive
from fgloc.errors import InputError
from fgloc.evaluation.consistency import anees_band, effective_samples
from fgloc.factors import noise
from fgloc.motion import kind_of
from fgloc.positions import DETECTIONS, gnss_bias
from fgloc.tuning.aids import Aids
from fgloc.tuning.bench import Bench, Predictions
from fgloc.tuning.result import AidConsistency, Consistency, TunedSetting, Tuning
from fgloc.tuning.rounds import make_rounds
from fgloc.tuning.scoring import scores
from fgloc.tuning.search import Search

__all__ = ["AidConsistency", "Consistency", "TunedSetting", "Tuning", "tune"]

OUTAGE_S = 20.0


def tune(
    drive: Drive,
    config: SmoothConfig,
    outage_s: float = OUTAGE_S,
    tell: Callable[[str], None] = lambda text: None,
) -> Tuning:
    """The noise under which withheld fixes of a drive are predicted best, and then that under which
    what else it measures is as far off as predicted.

    outage_s  the longest outage, in s, for which the noise is to hold; less on a short drive
    tell      is given a line at every step

    Raises InputError where the drive is too short or has too few fixes, DriveError where it lacks
    what the graph needs, SolverError where it cannot be solved.
    """
    if not 0 < outage_s < np.inf:
        raise InputError(f"outage_s = {outage_s}: expected seconds above 0")
    if kind_of(drive, config) != "imu":
        return _without_imu(drive, config, outage_s, tell)
    tables = {name: table for name, table in drive.tables.items() if name != DETECTIONS}
    blind = replace(drive, truth=None, tables=tables)
    if (slow := gnss_bias(drive, config.gnss)) is not None:
        named = {"bias_sigma_m": slow.sigma_m, "bias_tau_s": slow.tau_s}
        config = config.model_copy(update={"gnss": config.gnss.model_copy(update=named)})
    bench = Bench(blind, config)
    rounds = make_rounds(bench.fix_t_s, outage_s, drive.name)
    search = Search(bench, config, rounds.seen, tell)
    search.run()
    found = search.found()
    aids = Aids(replace(drive, truth=None), config)
    tuned, settings, aided = aids.tune(search.given(), found, rounds, tell)
    tell("judging the stretches that the search has not seen")
    before, after = (bench.settle(one, rounds.unseen) for one in (search.given(), found))
    every_s = float(np.median(np.diff(bench.fix_t_s)))
    return Tuning(
        drive.name, tuned, (*search.settings(), *settings),
        tuple(_consistency(before, after, n, n * every_s) for n in rounds.lengths),
        len(bench.outliers), int(bench.outliers.sum()), search.evaluations, aided,
    )  # fmt: skip


def _without_imu(
    drive: Drive, config: SmoothConfig, outage_s: float, tell: Callable[[str], None]
) -> Tuning:
    """Fixes and what else there is, each row by all others; what carries the states stays as it is:
    gaps would show its noise, but it is no sensor's."""
    aids = Aids(replace(drive, truth=None), config, fixes=True)
    t_s = aids.fix_times_s(config)
    rounds = make_rounds(t_s, outage_s, drive.name)
    found, settings, aided = aids.tune(config, config, rounds, tell)
    return Tuning(drive.name, found, settings, (), len(t_s), 0, 0, aided)


def _consistency(
    before: Predictions, after: Predictions, fixes: int, outage_s: float
) -> Consistency:
    """The unseen fixes that were withheld so many in a row.

    Errors of one block have in common what is not the fixes' own noise; their NIS correlate by the
    square of that share.
    """
    rows = before.fixes == fixes
    nis = [noise.nis(told.error, told.cov)[rows] / 3 for told in (before, after)]
    score = [float(scores(told)[rows].mean()) for told in (before, after)]
    order = np.argsort(after.t_s[rows], kind="stable")
    alike = 1 + (fixes - 1) * float((after.common[rows] ** 2).mean())
    worth = min(effective_samples(nis[1][order]), len(order) / alike)
    low, high = anees_band(worth, 3)
    return Consistency(
        fixes, outage_s, int(rows.sum()), worth, float(nis[0].mean()), float(nis[1].mean()),
        low, high, -score[0], -score[1],
    )  # fmt: skip
