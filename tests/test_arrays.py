"""Read-only arrays, and rows of finite numbers."""

import numpy as np

from fgloc.arrays import finite_rows, freeze


def test_what_is_frozen_already_is_shared_and_not_copied():
    frozen = freeze([1.0, 2.0])
    assert freeze(frozen) is frozen
    assert np.shares_memory(freeze(frozen[1:]), frozen)


def test_a_row_is_finite_where_all_numbers_of_all_its_columns_are():
    t_s, p_m, cov_m2 = np.zeros(4), np.zeros((4, 3)), np.zeros((4, 2, 2))
    t_s[0], p_m[1, 2], cov_m2[3, 1, 0] = np.inf, np.nan, -np.inf
    assert finite_rows(t_s, p_m, cov_m2).tolist() == [False, False, True, False]
    assert finite_rows(p_m[:0], cov_m2[:0]).tolist() == []
