"""Ranges to anchors: the model by hand, its derivatives, and the native factors beside it."""

import gtsam
import numpy as np
import pytest

from fgloc.factors.ranging import biased_range_factor, range_factor, residual
from fgloc.frames import exp_so3

RNG = np.random.default_rng(4)
P, TURN, ANCHOR = RNG.normal(0, 5, (6, 3)), RNG.normal(0, 1, (6, 3)), RNG.normal(0, 9, (6, 3))
Z, LEVER = RNG.uniform(2, 20, 6), np.array([0.4, -0.3, 1.2])
MODEL = gtsam.noiseModel.Isotropic.Sigma(1, 1.0)


def test_a_range_by_hand():
    told = residual(
        np.array([[3.0, 0, 0]]), np.eye(3)[None], np.array([[0.0, 4, 0]]), [5.5], scale=1.1
    )
    np.testing.assert_allclose(told.error, [[0.0]], atol=1e-12)
    np.testing.assert_allclose(told.by_tag, [[[0.66, -0.88, 0]]])


def test_jacobians_are_the_differences():
    told = residual(P, exp_so3(TURN), ANCHOR, Z, LEVER, 1.07, 0.2)
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-6
        ends = [
            residual(P + s * np.einsum("nij,j->ni", exp_so3(TURN), step[3:]),
                     exp_so3(TURN) @ exp_so3(s * step[:3]), ANCHOR, Z, LEVER, 1.07, 0.2).error
            for s in (1, -1)
        ]  # fmt: skip
        np.testing.assert_allclose(
            told.by_pose[:, :, k], (ends[0] - ends[1]) / 2e-6, rtol=1e-6, atol=1e-8
        )
    more, less = (residual(P, exp_so3(TURN), ANCHOR, Z, LEVER, s, 0.2).error
                  for s in (1.07 + 1e-6, 1.07 - 1e-6))  # fmt: skip
    np.testing.assert_allclose(told.by_scale[:, :, 0], (more - less) / 2e-6, rtol=1e-6)


@pytest.mark.parametrize("bias_m", [0.0, 0.7])
def test_the_native_factors_say_the_same(bias_m):
    told = residual(P, exp_so3(TURN), ANCHOR, Z, LEVER, bias_m=bias_m)
    for i in range(len(P)):
        values = gtsam.Values()
        values.insert(1, gtsam.Pose3(gtsam.Rot3(exp_so3(TURN[i])), P[i]))
        values.insert(2, ANCHOR[i])
        values.insert(3, bias_m)
        factor = (
            biased_range_factor(1, 2, 3, Z[i], LEVER, MODEL)
            if bias_m
            else range_factor(1, 2, Z[i], LEVER, MODEL)
        )
        rows = factor.linearize(values)
        A, b = rows.jacobian()
        np.testing.assert_allclose(-b, told.error[i], atol=1e-9)
        np.testing.assert_allclose(A[:, :6], told.by_pose[i], atol=1e-9)
        np.testing.assert_allclose(A[:, 6:9], -told.by_tag[i], atol=1e-9)


def test_at_the_anchor_itself_a_range_has_no_direction():
    told = residual(np.zeros((1, 3)), np.eye(3)[None], np.zeros((1, 3)), [1.0])
    np.testing.assert_array_equal(told.by_pose, np.zeros((1, 1, 6)))
