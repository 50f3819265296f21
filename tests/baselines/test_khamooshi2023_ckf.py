"""The constrained filter of a node: its stages, its constraints, what it does not have."""

import numpy as np
import pytest

from fgloc import baselines
from fgloc.baselines import khamooshi2023_ckf as ckf
from fgloc.baselines.sightings import Sightings
from fgloc.datasets import make
from fgloc.drive import Drive, Rig
from fgloc.errors import DriveError
from fgloc.frames import Origin
from fgloc.verdicts import Verdict

METHODS = [name for name in baselines.available() if name.startswith("khamooshi2023-ckf")]
SEEDS = range(12)


def rmse_m(scenario, stages):
    """East and North over some seeds."""
    squares = []
    for seed in SEEDS:
        drive = make(scenario, seed)
        found = ckf.run_stages(drive, stages).trajectory
        squares.append(((found.p_world_m - drive.truth.p_world_m)[:, :2] ** 2).mean(0))
    return np.sqrt(np.mean(squares, 0))


def stages(motion="velocity", hard=True, soft=True, **more):
    return ckf.Stages(motion, hard, soft, **more)


def test_the_first_two_stages_are_those_of_the_thesis():
    first = rmse_m("khamooshi2023/constant-velocity", stages("", False, False, nodes="node-1"))
    then = rmse_m("khamooshi2023/constant-velocity", stages(hard=False, soft=False, nodes="node-1"))
    assert first == pytest.approx([0.33, 0.29], rel=0.2)
    assert then == pytest.approx([0.20, 0.13], rel=0.2)


def test_both_constraints_make_it_better_and_together_best():
    sizes = {
        (hard, soft): float(np.linalg.norm(rmse_m(
            "khamooshi2023/constant-velocity", stages(hard=hard, soft=soft, nodes="node-1"))))
        for hard in (False, True) for soft in (False, True)
    }  # fmt: skip
    assert sizes[True, True] < min(sizes[True, False], sizes[False, True])
    assert max(sizes[True, False], sizes[False, True]) < sizes[False, False]


@pytest.mark.parametrize("motion", ["velocity", "bicycle"])
def test_node_and_gnss_have_at_most_half_the_deviation_of_gnss(motion):
    both = rmse_m("khamooshi2023/right-turn", stages(motion))
    assert np.linalg.norm(both) < 0.5 * np.hypot(1.0, 1.0)


def test_the_projection_meets_the_constraint_and_moves_along_the_covariance():
    x, P = np.array([1.0, 2.0, 0.1]), np.diag([4.0, 1.0, 0.01])
    done = ckf._project(x, P, 0.0, np.zeros(3))
    assert done == pytest.approx([1.0, 0.0, 0.1])  # heading 0: nothing across, so y is 0
    tilted = ckf._project(x, P, np.pi / 4, np.zeros(3))
    D = np.array([-1, 1, 0]) / np.sqrt(2)
    assert D @ tilted == pytest.approx(0)
    assert tilted - x == pytest.approx(-P @ D * (D @ x) / (D @ P @ D))


def test_a_parabola_is_continued_exactly():
    k = np.arange(7.0)
    path = np.stack([1 + 2 * k + 0.5 * k**2, 3 - k, 0.1 * k], -1)
    assert ckf._from_the_past(path[:6]) == pytest.approx(path[6])


def test_a_heading_that_passes_180_degrees_is_continued():
    yaw = np.array([3.0, 3.1, -3.0832, -2.9832])
    path = np.stack([yaw * 0, yaw * 0, yaw], -1)
    assert np.angle(np.exp(1j * ckf._from_the_past(path)[2])) == pytest.approx(-2.8832, abs=1e-3)


def test_the_bicycle_turns_by_the_input_held_over_the_step():
    x, _, _ = ckf._predict(np.zeros(3), np.eye(3), np.array([10.0, 0.5]), 0.1, "bicycle")
    assert x == pytest.approx([1.0, 10 * 0.5 * 0.1**2 / 2, 0.05])


def test_the_prediction_carries_the_headings_error_into_the_position():
    P = np.diag([0.0, 0.0, 0.01])
    _, found, F = ckf._predict(
        np.array([0.0, 0, np.pi / 2]), P, np.array([10.0, 0]), 0.1, "velocity"
    )
    step = 1e-6
    u = np.array([10.0, 0])
    at = [
        ckf._predict(np.array([0.0, 0, np.pi / 2 + d]), P, u, 0.1, "velocity")[0]
        for d in (-step, step)
    ]
    assert F[:, 2] == pytest.approx((at[1] - at[0]) / (2 * step), abs=1e-6)
    assert found[0, 0] == pytest.approx(0.01 + ckf.Q_SIGMA[0] ** 2)


def test_noise_takes_the_slant_range_or_what_is_stated():
    seen = Sightings(
        np.zeros((2, 2)), np.array([[3.0, 4, 12], [0, 0, 0]]),
        np.array([[1e-2, 2e-2], [np.nan] * 2]),
        np.array([np.full((2, 2), np.nan), np.eye(2)]),
    )  # fmt: skip
    assert seen.noise(np.zeros(2))[0] == pytest.approx(np.diag([1.69, 3.38]))
    assert seen.noise(np.zeros(2))[1] == pytest.approx(np.eye(2))


@pytest.mark.parametrize("method", METHODS)
def test_every_variant_judges_every_measurement(method):
    drive = make("khamooshi2023/right-turn", 0)
    result = baselines.run(drive, method)
    for name, table in drive.tables.items():
        assert sum(result.verdicts[name].counts().values()) == len(table)
    assert result.verdicts["detections"].is_(Verdict.USED).all()
    assert result.causal and result.method == method
    assert len(result.trajectory) == len(drive.truth)


def test_what_is_missing_is_named():
    drive = make("khamooshi2023/constant-velocity", 0)
    bare = Drive("bare", Origin(0, 0, 0), Rig(), {}, None)
    with pytest.raises(DriveError, match="no detections"):
        ckf.run(bare)
    alone = Drive("alone", drive.origin, Rig(), {"detections": drive.tables["detections"]}, None,
                  infrastructure=drive.infrastructure)  # fmt: skip
    with pytest.raises(DriveError, match="no odometry"):
        ckf.run(alone)
    with pytest.raises(DriveError, match="object 9"):
        ckf.run_stages(drive, ckf.Stages(object_id=9))
    assert len(ckf.run_sensors(alone).trajectory) == len(drive.truth)
