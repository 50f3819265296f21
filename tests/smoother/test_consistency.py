"""The covariance tells the truth: NEES over 100 simulated drives, filtered and smoothed."""

import multiprocessing

import numpy as np
from consistency_runs import DOF, NAMES, nees_of_drive

from fgloc.evaluation import chi2_quantile

DRIVES = 100
ALPHA = 0.05
"""Shared by the four tests; a drive counts as one sample, since its instants are correlated."""


def test_nees_of_100_drives_lies_within_its_band():
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        nees = np.array(pool.map(nees_of_drive, range(DRIVES), chunksize=2))
    assert np.isfinite(nees).all(), "the yaw of some drive never became observable"
    for name, dof, mean in zip(NAMES, DOF, nees.mean(axis=0), strict=True):
        tail = ALPHA / len(DOF) / 2
        low, high = chi2_quantile([tail, 1 - tail], dof * DRIVES) / DRIVES
        assert low < mean < high, f"{name}: mean NEES {mean:.3f} outside {low:.3f} to {high:.3f}"
