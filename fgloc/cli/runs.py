"""Commands that estimate: the graph and the documented filters."""

from pathlib import Path
from typing import Any

import click

from fgloc.cli import options
from fgloc.cli.options import Command
from fgloc.cli.screen import print_json, print_run, working

_SMOOTH_EPILOG = """\b
Examples:
  fgloc smooth mems-rtk --out result
  fgloc smooth mems-rtk --mode fixed-lag --lag 10 --smoothed --out online
  fgloc smooth city --seed 3 --set gnss.loss=none --out plain
"""


@click.command(cls=Command, epilog=_SMOOTH_EPILOG)
@options.drive_argument
@options.out_dir
@click.option(
    "--mode", type=click.Choice(["batch", "incremental", "fixed-lag"]),
    help="batch (the default) uses all data for each state; the others are causal.",
)  # fmt: skip
@click.option(
    "--lag",
    "lag_s",
    type=options.Seconds(),
    metavar="S",
    help="Of fixed-lag, seconds [default: 5].",
)
@options.config
@options.settings("One setting, e.g. gnss.loss=none")
@click.option(
    "--smoothed", is_flag=True, help="Causal modes: write the last estimate of each state as well."
)
@options.seed
@options.score_from
@options.also
@options.no_report
@options.as_json
def smooth(
    drive: str, out: Path, mode: Any, lag_s: float | None, config: Path | None,
    settings: tuple[str, ...], smoothed: bool, seed: int | None, score_from_s: float,
    also: tuple[str, ...], no_report: bool, as_json: bool,
) -> None:  # fmt: skip
    """Estimate by the factor graph.

    DRIVE is a drive folder or a name from fgloc datasets. DIR gets the trajectory, the verdict on
    every measurement, a summary and a report.
    """
    from fgloc import api, outputs

    options.check_settings(settings, mode=mode, lag_s=lag_s, smoothed=smoothed, seed=seed)
    outputs.check_folder(out)
    in_force = api.configure(
        mode, config=config, lag_s=lag_s, smoothed=smoothed, settings=settings, seed=seed
    )
    with working(f"smoothing {drive}"):
        opened, in_force = api.prepare(drive, in_force, seed)
        from fgloc.smoother import smooth as run

        result = run(opened, in_force)
        summary = outputs.write_result(
            out, opened, result, score_from_s=score_from_s, report=not no_report, also=also
        )
    _tell(summary, out, as_json)


@click.command(cls=Command, epilog="Example: fgloc baseline mems-rtk --method raw:gnss --out raw")
@options.drive_argument
@click.option("--method", required=True, metavar="NAME", help="The filter, e.g. raw:gnss.")
@options.out_dir
@options.seed
@options.score_from
@options.also
@options.no_report
@options.as_json
def baseline(
    drive: str, method: str, out: Path, seed: int | None, score_from_s: float,
    also: tuple[str, ...], no_report: bool, as_json: bool,
) -> None:  # fmt: skip
    """Estimate by a documented filter.

    raw:SOURCE takes that source alone, as it is; its trajectory is that of the antenna.
    """
    from fgloc import api, baselines, outputs

    outputs.check_folder(out)
    baselines.check(method)
    with working(f"running {method} on {drive}"):
        opened = api.load(drive, seed=seed)
        result = baselines.run(opened, method)
        summary = outputs.write_result(
            out, opened, result, score_from_s=score_from_s, report=not no_report, also=also
        )
    _tell(summary, out, as_json)


def _tell(summary: dict[str, Any], out: Path, as_json: bool) -> None:
    if as_json:
        print_json(summary)
    else:
        print_run(summary, out)
