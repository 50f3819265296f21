"""What the messages of errors are made of."""

import pytest

from fgloc.errors import nearest


@pytest.mark.parametrize(
    ("name", "valid", "found"),
    [
        ("gnss.los", ["gnss.loss", "imu.gap_s"], "gnss.loss"),
        ("City", ("city", "mems-rtk"), "city"),
        ("t_VEH_imu", ["p_veh_ant_m", "T_veh_imu"], "T_veh_imu"),
        ("nothing like it", {"zzz": 1}, "zzz"),
        ("", ["only"], "only"),
    ],
)
def test_there_is_always_a_nearest_name(name, valid, found):
    assert nearest(name, valid) == found
