"""What the doctor says of drives with signs, anchors and nodes."""

import numpy as np
import pytest

from fgloc.datasets.registry import make
from fgloc.diagnosis import diagnose


def kinds(drive) -> set[str]:
    return {(finding.check, finding.source) for finding in diagnose(drive)}


@pytest.mark.parametrize("name", ["marr2019/iea", "marr2019/smart-code"])
def test_several_signs_or_cameras_at_one_instant_are_no_duplicates(name):
    assert not [part for check, part in kinds(make(name, 0)) if check == "duplicate"]


def test_one_sign_read_twice_at_one_instant_is_one():
    drive = make("marr2019/smart-code", 0)
    codes = drive.tables["smart_codes"]
    twice = codes.take(np.r_[0, np.arange(len(codes))])
    assert ("duplicate", "smart_codes") in kinds(drive.with_tables(smart_codes=twice))
