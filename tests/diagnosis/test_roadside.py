"""What the doctor says of drives with signs, anchors and nodes."""

import dataclasses

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


def test_codes_without_corners_are_no_fault_but_without_a_size_they_are():
    codes = make("marr2019/smart-code", 0).tables["smart_codes"]
    assert not codes.has_corners.any()
    height_px = codes.height_px.copy()
    height_px[4] = np.nan
    broken = dataclasses.replace(codes, height_px=height_px)
    one = make("marr2019/smart-code", 0)
    assert ("not-finite", "smart_codes") not in kinds(one)
    assert ("not-finite", "smart_codes") in kinds(one.with_tables(smart_codes=broken))


def test_a_node_that_states_no_covariance_is_no_fault():
    drive = make("marr2019/iea", 0)
    seen = drive.tables["detections"]
    silent = dataclasses.replace(seen, cov_node_m2=np.full_like(seen.cov_node_m2, np.nan))
    assert ("not-finite", "detections") not in kinds(drive.with_tables(detections=silent))


def past_a_lidar(**how):
    """A LiDAR that tells heights, on a post that sways."""
    return make("khamooshi2023/sway-drive", 0, duration_s=20.0, sensor="lidar", **how)


def heights_found(drive) -> list[str]:
    return [one.what for one in diagnose(drive) if one.check == "node-height"]


def test_a_node_in_another_height_datum_is_a_fault():
    drive = past_a_lidar()
    assert not heights_found(drive)
    (node,) = drive.infrastructure.nodes
    high = dataclasses.replace(node, p_world_m=node.p_world_m + [0, 0, 36.0])
    beside = dataclasses.replace(drive.infrastructure, nodes=(high,))
    (what,) = heights_found(dataclasses.replace(drive, infrastructure=beside))
    assert what.startswith("node 'isn-1' tells heights that lie +36.")
    assert "detections near them" in what


def test_heights_are_judged_by_what_the_fixes_tell_of_them():
    seen = past_a_lidar().tables["detections"]
    lower = dataclasses.replace(seen, up_node_m=seen.up_node_m - 3.0)
    coarse, fine = (past_a_lidar(gnss_sigma_m=sigma).with_tables(detections=lower)
                    for sigma in (1.0, 0.1))  # fmt: skip
    assert not heights_found(coarse)
    assert len(heights_found(fine)) == 1
    bare = make("khamooshi2023/sway-drive", 0, duration_s=20.0, sensor="lidar", heights=False)
    assert not heights_found(bare)
