"""nodes.csv: how nodes and their posts are doing, from what a drive holds and a run found."""

import csv
from dataclasses import replace

import numpy as np
import pytest

import fgloc
from fgloc.node_health import COLUMNS, format_nodes, node_rows
from fgloc.outputs import write_result

SCENARIO = "khamooshi2023/sway-drive"


@pytest.fixture(scope="module")
def drive():
    """A drive whose node is late, drops every tenth frame and looks away for five seconds; the
    survey of its place is 0.3 m wrong."""
    made = fgloc.make(SCENARIO, seed=4, duration_s=20.0, gnss_sigma_m=0.1)
    seen = made.tables["detections"]
    t_s = (seen.t_ns - seen.t_ns[0]) / 1e9
    kept = (np.arange(len(seen)) % 10 != 5) & ((t_s < 9.95) | (t_s > 15.05))
    late = replace(seen, received_ns=seen.t_ns + 80_000_000).take(kept)
    node = made.infrastructure.nodes[0]
    said = replace(node, p_world_m=node.p_world_m + [0.3, 0, 0], sigma_position_m=0.5)
    beside = replace(made.infrastructure, nodes=(said,))
    return replace(made.with_tables(detections=late), infrastructure=beside)


@pytest.fixture(scope="module", params=["batch", "fixed-lag"])
def result(request, drive):
    return fgloc.smooth(drive, request.param)


def test_a_row_tells_latency_drops_survey_and_sway(drive, result):
    (row,) = node_rows(drive, result.summary)
    assert set(row) <= set(COLUMNS)
    assert (row["node"], row["latency_s"]) == ("isn-1", 0.08)
    assert row["rate_hz"] == pytest.approx(10.0)
    assert row["drop_rate"] == pytest.approx(0.1, abs=0.01)  # looking away is no drop
    assert abs(row["survey_east_m"] + 0.3) < 4 * row["sigma_survey_east_m"] < 0.4
    assert abs(row["residual_east_m"]) < 0.15  # of causal states, which knew the survey less well
    true_m = np.linalg.norm(drive.post_truth.p_node_m, axis=-1)
    assert row["sway_rms_m"] == pytest.approx(np.sqrt(np.mean(true_m**2)), rel=0.2)
    assert row["frequency_hz"] == pytest.approx(1.965, abs=1e-3)
    assert row["damping"] == 0.05
    assert (row["poses"], row["poses_missing_share"]) == (201, 0.0)


def test_the_file_holds_what_the_summary_says(drive, result, tmp_path):
    write_result(tmp_path, drive, result, report=False)
    with (tmp_path / "nodes.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert list(row) == list(COLUMNS)
    told = result.summary["nodes"]["isn-1"]
    assert float(row["survey_east_m"]) == told["survey_off_m"]["value"][0]
    assert float(row["sigma_survey_yaw_rad"]) == told["survey_off_rad"]["sigma"][0]
    assert row["clock_late_s"] == row["sigma_frequency_hz"] == ""


def test_a_node_that_nobody_heard_of_has_a_row(drive):
    quiet = replace(drive.infrastructure.nodes[0], name='the "other", further on')
    nodes = (*drive.infrastructure.nodes, quiet)
    more = replace(drive, infrastructure=replace(drive.infrastructure, nodes=nodes))
    rows = node_rows(more, {})
    assert rows[1] == {"node": quiet.name, "detections": 0}
    last = format_nodes(rows).splitlines()[-1]
    assert last.startswith('"the ""other"", further on",0,,')


def test_a_post_that_was_sought_comes_with_sigmas(drive):
    told = {"frequency_hz": {"value": 2.0, "stated": 1.9, "relative_error": 0.01}}
    summary = {"posts": {"isn-1": {"frequency_hz": 1.9}}, "posts_sought": {"isn-1": told}}
    (row,) = node_rows(drive, summary)
    assert (row["frequency_hz"], row["sigma_frequency_hz"]) == (2.0, 0.02)


def test_how_late_a_nodes_stamps_are_is_read_of_its_clock(drive):
    clock = {"gnss": {"late_s": 0.2}, "nodes": {"late_s": 0.08}}
    (row,) = node_rows(drive, {"clock": clock})
    assert row["clock_late_s"] == 0.08
    (row,) = node_rows(drive, {"clock": {"gnss": {"late_s": 0.2}}})
    assert "clock_late_s" not in row
