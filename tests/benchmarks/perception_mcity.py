# ruff: noqa: T201
"""From images and clouds to the comparison table: the second pass of `lee2021/mcity`.

    python tests/benchmarks/perception_mcity.py [--seed 0] [--every 1] [--out FOLDER]

Images of 1920 x 1200 px and clouds of both heads of Lee's node at the instants of the scenario's
fixes (tunnel, a lorry that hides a stretch of the road, a second car behind the first) go through
`fgloc perceive`; its detections replace those that the scenario simulates, in a drive that is cut
to the pass and 15 s before and after. Then `fgloc compare`: fixes, what the node says, the
documented EKF, the graph without look-ahead and as a whole; once with each report of the node. The
node's slow error is set to 0, as these sensors have none.
"""

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import fgloc
from fgloc import api
from fgloc.cli import main as command
from fgloc.datasets.drive_folder import write_drive
from fgloc.datasets.streets import make_mcity_street
from fgloc.drive import Drive
from fgloc.infrastructure import Infrastructure
from fgloc.measurements import NodeDetections
from fgloc.perception.recording import Frames, Recording
from fgloc.timing import NS_PER_S

METHODS = "raw:gnss,raw:detections,lee2021-ekf,graph-lag,graph-batch"
BESIDE_S = 15.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--every", type=int, default=1, help="take every N-th frame")
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    recording = every(make_mcity_street(given.seed), given.every)
    scenario = fgloc.load("lee2021/mcity", seed=given.seed)
    with tempfile.TemporaryDirectory() as spare:
        out = given.out or Path(spare)
        for report in ("measured", "tracked"):
            seen, found = api.perceive(recording, report=report)
            print(f"\n{report}: {found.frames} frames, {len(seen.tables['detections'])} detections")
            print(f"dropped: {found.dropped}; remarks: {found.remarks}")
            print(f"processor seconds: { {k: round(v, 1) for k, v in found.seconds.items()} }")
            drive = with_detections(scenario, seen.tables["detections"])
            write_drive(drive, out / report)
            command(["compare", str(out / report), "--methods", METHODS,
                     "--out", str(out / f"{report}-result"), "--no-report"])  # fmt: skip


def every(recording: Recording, n: int) -> Recording:
    """Every n-th frame of each sensor."""

    def thinned(frames: Frames) -> Frames:
        return Frames(frames.sensor, frames.t_ns[::n], frames.received_ns[::n],
                      lambda k: frames.load(n * k))  # fmt: skip

    return replace(
        recording, images=tuple(map(thinned, recording.images)),
        clouds=tuple(map(thinned, recording.clouds)),
    )  # fmt: skip


def with_detections(scenario: Drive, seen: NodeDetections) -> Drive:
    """The scenario around the detections, with these instead of its own."""
    first, last = (
        int(t) + sign * int(BESIDE_S * NS_PER_S)
        for t, sign in ((seen.t_ns[0], -1), (seen.t_ns[-1], 1))
    )
    tables = {
        name: table.take((table.t_ns >= first) & (table.t_ns <= last))
        for name, table in scenario.tables.items()
    }
    truth = scenario.truth.take((scenario.truth.t_ns >= first) & (scenario.truth.t_ns <= last))
    node = replace(scenario.infrastructure.nodes[0], bias_sigma_m=0.0)
    return replace(
        scenario, tables={**tables, "detections": seen}, truth=truth,
        infrastructure=Infrastructure((node,)),
    )  # fmt: skip


if __name__ == "__main__":
    main()
