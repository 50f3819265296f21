"""The command that checks a drive before it is fused."""

from collections.abc import Sequence
from itertools import groupby
from typing import TYPE_CHECKING

import click

from fgloc.cli import options
from fgloc.cli.options import Command
from fgloc.cli.screen import print_json, say, working

if TYPE_CHECKING:
    from fgloc.diagnosis import Finding

FAULTY = 2
"""Exit status where there is a fault: the drive is bad input to every other command."""

_EPILOG = """\b
Examples:
  fgloc doctor mems-rtk
  fgloc doctor my-drive --json

Exit status: 0 where the drive can be fused, though warnings say at what cost; 2 with a fault.
"""
_COLOURS = {"fault": "red", "warning": "yellow", "remark": None}


@click.command(cls=Command, epilog=_EPILOG)
@options.drive_argument
@options.seed
@options.as_json
def doctor(drive: str, seed: int | None, as_json: bool) -> int:
    """Check a drive before it is fused.

    Rates, gaps, stamps and clocks, units, axes and frames, covariances, heights, lever arms, noise.
    A fault ruins the result or is refused, a warning makes it worse, a remark is good to know; each
    comes with a remedy. Of a folder that cannot be read as a drive, what can be read is checked.
    """
    from fgloc import api

    with working(f"checking {drive}"):
        findings = api.doctor(drive, seed=seed)
    counts = _counts(findings)
    if as_json:
        print_json({
            "drive": drive, "counts": counts, "findings": [one.to_dict() for one in findings],
        })  # fmt: skip
    else:
        _print(drive, findings, counts)
    return FAULTY if counts["fault"] else 0


def _counts(findings: Sequence["Finding"]) -> dict[str, int]:
    from fgloc.diagnosis import SEVERITIES

    return {kind: sum(one.severity == kind for one in findings) for kind in SEVERITIES}


def _print(drive: str, findings: Sequence["Finding"], counts: dict[str, int]) -> None:
    for source, group in groupby(findings, key=lambda one: one.source):
        say(source)
        for one in group:
            severity = click.style(f"{one.severity:<8}", fg=_COLOURS[one.severity])
            say(f"  {severity} {one.check}: {one.what}")
            if one.remedy:
                say(f"  {'':<8} remedy: {one.remedy}")
        say("")
    say(f"{drive}: " + ", ".join(f"{n} {kind}{'s' * (n != 1)}" for kind, n in counts.items()))
