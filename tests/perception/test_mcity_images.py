"""From images and clouds of a pass of `lee2021/mcity` to the comparison table, by the commands."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import fgloc
from fgloc.cli import main
from fgloc.datasets.drive_folder import read_drive, write_drive
from fgloc.datasets.lee2021_road import origin
from fgloc.datasets.perception_recording import write_recording
from fgloc.datasets.street_recording import record
from fgloc.datasets.streets import mcity_street
from fgloc.infrastructure import Infrastructure

from .small_street import two_small_heads

FRAMES = slice(40, 190, 4)
"""The car comes towards the node, is hidden behind a lorry, and drives away."""
BESIDE_NS = 1_000_000_000


@pytest.fixture(scope="module")
def perceived(tmp_path_factory):
    """The drive that `fgloc perceive` makes of the pass."""
    folder = tmp_path_factory.mktemp("mcity")
    street, t_ns = mcity_street(two_small_heads)
    write_recording(record("pass", street, origin(), t_ns[FRAMES], 0), folder / "recording")
    command = [Path(sys.executable).parent / "fgloc", "perceive", folder / "recording",
               "--set", "background.shrink=1", "--out", folder / "drive"]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""  # progress is for a terminal alone
    assert "detections of" in done.stdout
    return read_drive(folder / "drive")


def test_what_the_node_saw_goes_through_ekf_and_graph_to_the_table(perceived, tmp_path, capsys):
    scenario = fgloc.load("lee2021/mcity", seed=0)
    seen = perceived.tables["detections"]
    first, last = int(seen.t_ns[0]) - BESIDE_NS, int(seen.t_ns[-1]) + BESIDE_NS
    tables = {
        name: table.take((table.t_ns >= first) & (table.t_ns <= last))
        for name, table in scenario.tables.items()
    }
    truth = scenario.truth.take((scenario.truth.t_ns >= first) & (scenario.truth.t_ns <= last))
    node = replace(perceived.infrastructure.nodes[0], bias_sigma_m=0.0)  # of rendered sensors
    drive = replace(scenario, tables={**tables, "detections": seen}, truth=truth,
                    infrastructure=Infrastructure((node,)))  # fmt: skip
    write_drive(drive, tmp_path / "drive")
    methods = ["raw:gnss", "raw:detections", "lee2021-ekf", "graph-batch"]
    arguments = ["--methods", ",".join(methods), "--out", str(tmp_path / "out"), "--no-report"]
    assert main(["compare", str(tmp_path / "drive"), *arguments, "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    rmse_m = {row["method"]: row["metrics"]["horizontal_rmse_m"]["value"] for row in rows}
    assert rmse_m["raw:detections"] < 0.5
    assert rmse_m["graph-batch"] < 0.5 * rmse_m["raw:gnss"]
    assert rmse_m["lee2021-ekf"] < 0.5 * rmse_m["raw:gnss"]
