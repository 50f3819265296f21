"""Layouts of objects: their truth holds, their shares are those that were asked for."""

import numpy as np
import pytest

from fgloc.correspondence import Rigid
from fgloc.datasets.khamooshi2023_layouts import SIDE_M, make_layouts
from fgloc.errors import InputError


def test_true_pairs_meet_under_the_true_pose():
    for x in make_layouts(0, 10, 5, sigma_m=0.0):
        moved = Rigid(x.yaw_rad, x.t_m).apply(x.p_veh_m)
        assert moved[x.pairs[:, 0]] == pytest.approx(x.p_world_m[x.pairs[:, 1]], abs=1e-9)
        assert x.p_veh_m[0] == pytest.approx([0, 0])


def test_noise_missing_and_ghosts_are_as_asked():
    layouts = make_layouts(1, 30, 100)
    seen = np.mean([len(x.p_world_m) for x in layouts])
    assert seen == pytest.approx(30 * (0.8 + 0.2), abs=0.7)
    both = np.mean([len(x.pairs) for x in layouts])
    assert both == pytest.approx(0.8 + 29 * 0.8**2, abs=0.7)
    gaps = np.concatenate([
        Rigid(x.yaw_rad, x.t_m).apply(x.p_veh_m)[x.pairs[:, 0]] - x.p_world_m[x.pairs[:, 1]]
        for x in layouts
    ])  # fmt: skip
    assert gaps.std() == pytest.approx(0.3 * 2**0.5, rel=0.05)
    assert np.abs(np.concatenate([x.p_world_m for x in layouts])).max() < SIDE_M / 2 + 2


def test_one_sided_the_car_misses_objects_and_the_node_has_ghosts():
    for x in make_layouts(1, 12, 10, one_sided=True):
        assert len(x.p_veh_m) == len(x.pairs) <= 12 <= len(x.p_world_m)


def test_the_last_step_lies_close():
    for x in make_layouts(2, 5, 20):
        assert np.linalg.norm(x.last_t_m - x.t_m) <= 1.5
        assert abs(x.last_yaw_rad - x.yaw_rad) <= 0.05 + 1e-9


def test_equal_seeds_give_equal_layouts():
    a, b = make_layouts(5, 8, 2), make_layouts(5, 8, 3)
    assert np.array_equal(a[1].p_world_m, b[1].p_world_m)
    assert not np.array_equal(a[1].p_world_m, make_layouts(6, 8, 2)[1].p_world_m)


@pytest.mark.parametrize("wrong", [{"missing": 1.0}, {"ghosts": -0.1}, {"sigma_m": -1.0}])
def test_shares_out_of_range_are_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        make_layouts(0, 5, 1, **wrong)
