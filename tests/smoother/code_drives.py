"""Drives that read Smart Codes, and what their graphs are held to."""

import numpy as np

from fgloc.datasets.registry import make
from fgloc.evaluation.consistency import nees
from fgloc.smoother.codes import SETTINGS, smooth_codes
from fgloc.smoother.codes_build import build
from fgloc.smoother.codes_model import CodeModel
from fgloc.verdicts import SourceVerdicts


def drive(seed=0, path="middle", yaw_deg=30.0, **options):
    return make("marr2019/smart-code", seed, path=path, camera_yaw_deg=yaw_deg, **options)


def error_m(one, trajectory, t_ns=None) -> np.ndarray:
    """Errors (N, 2) of a trajectory at instants, or at its own within the truth."""
    last = one.truth.t_ns[-1]
    t_ns = trajectory.t_ns[trajectory.t_ns <= last] if t_ns is None else t_ns
    true = one.truth.at_point(trajectory.p_veh_point_m).at(t_ns).p_world_m
    return (trajectory.at(t_ns).p_world_m - true)[:, :2]


def mean_nees(one) -> float:
    """Of the whole drive in the plane, by its dimension."""
    trajectory = smooth_codes(one).trajectory
    error = error_m(one, trajectory)
    return float(nees(error, trajectory.cov[: len(error), :2, :2]).mean() / 2)


def model_of(one) -> CodeModel:
    """The graph of a drive."""
    return build(one, SETTINGS, SourceVerdicts.of("smart_codes", one.tables["smart_codes"]))


def assert_gradients_are_differences(model: CodeModel):
    """Of the cost of five epochs, about states and globals that are off."""
    rng, n = np.random.default_rng(3), 5
    states = np.array([-5.0, -20.0]) + np.outer(np.arange(n), [0, 0.9]) + rng.normal(0, 0.2, (n, 2))
    globals_ = model.prior[0] + 0.01
    blocks = model.linearize(states, globals_, 20)

    def cost_at(change):
        moved = states + change[: states.size].reshape(states.shape)
        return model.linearize(moved, globals_ + change[states.size :], 20).cost

    told = np.r_[blocks.gradient.ravel(), blocks.gradient_globals]
    found = np.array([(cost_at(s) - cost_at(-s)) / 2e-6 for s in np.eye(len(told)) * 1e-6])
    np.testing.assert_allclose(told, found, rtol=1e-4, atol=1e-5 * np.abs(told).max())
