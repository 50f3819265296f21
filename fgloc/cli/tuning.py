"""The command that finds the noise of a drive's sources."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from fgloc.cli import options
from fgloc.cli.options import Command
from fgloc.cli.screen import print_json, say, steps, table

if TYPE_CHECKING:
    from fgloc.tuning import Tuning

_EPILOG = """\b
Examples:
  fgloc tune mems-rtk --out tuned.toml
  fgloc smooth mems-rtk --config tuned.toml --out result
  fgloc tune comma2k19 --set gnss.bias_sigma_m=1 --out slow.toml
"""


@click.command(cls=Command, epilog=_EPILOG)
@options.drive_argument
@options.out("CONFIG", "File that the configuration is written to, in TOML.")
@click.option("--overwrite", is_flag=True, help="Replace a file that is there already.")
@click.option(
    "--outage", "outage_s", type=options.Seconds(), default=20.0, show_default=True, metavar="S",
    help="The longest outage that the noise is to hold for, seconds; less on a short drive.",
)  # fmt: skip
@options.config
@options.settings("One setting to start from, e.g. gnss.sigma_scale=2")
@options.seed
@options.as_json
def tune(
    drive: str, out: Path, overwrite: bool, outage_s: float, config: Path | None,
    settings: tuple[str, ...], seed: int | None, as_json: bool,
) -> None:  # fmt: skip
    """Find the noise of a drive's sources from the drive itself.

    Fixes are withheld, one by one and in outages, and predicted from the rest; the noise under
    which that goes best becomes a configuration for fgloc smooth. A quarter of the drive is not
    seen by the search and shows whether the noise holds. Truth is not used. What the drive does not
    determine stays as it was. A slow error of the fixes is sought where gnss.bias_sigma_m is set.

    Wheels and roadside nodes come after: each of their rows is left out and predicted from all
    others. So do the sigmas of vehicle.non_holonomic where that is set.
    """
    from fgloc import api, outputs

    options.check_settings(settings, seed=seed)
    outputs.check_file(out, overwrite=overwrite)
    with steps(f"tuning on {drive}") as tell:
        found = api.tune(
            drive, config=config, settings=settings, outage_s=outage_s, seed=seed, tell=tell
        )
    outputs.write_file(out, found.to_toml())
    if as_json:
        print_json(found.to_dict())
    else:
        _print(found, drive, out)


def _print(found: "Tuning", drive: str, out: Path) -> None:
    from fgloc.report.tables import number

    rows = [
        (one.key, number(one.before), number(one.after),
         "" if one.relative_sigma is None else f"{100 * one.relative_sigma:.0f} %", one.status)
        for one in found.settings
    ]  # fmt: skip
    table(f"{found.drive}: noise from {found.fixes:,} fixes",
          ("setting", "before", "after", "sigma", "status"), rows)  # fmt: skip
    _print_gaps(found)
    _print_aids(found)
    for remark in found.remarks:
        say(f"note: {remark}")
    say(f"Configuration in {out}; use it with fgloc smooth {drive} --config {out}")


def _print_gaps(found: "Tuning") -> None:
    from fgloc.report.tables import number

    rows = [
        (f"{one.outage_s:.3g}", str(one.n), number(one.nis_before), number(one.nis_after),
         f"{one.low:.2f} to {one.high:.2f}", number(one.log_likelihood_before),
         number(one.log_likelihood_after))
        for one in found.consistency
    ]  # fmt: skip
    columns = ("gap in s", "n", "NIS before", "after", "consistent", "log-l. before", "after")
    if rows:
        table("Withheld fixes that the search has not seen: mean NIS / dof, log-likelihood of a "
              "fix", columns, rows)  # fmt: skip


def _print_aids(found: "Tuning") -> None:
    from fgloc.report.tables import number

    rows = [
        (one.source, str(one.n), number(one.nis_before), number(one.nis_after),
         f"{one.low:.2f} to {one.high:.2f}")
        for one in found.aids
    ]  # fmt: skip
    columns = ("source", "n", "NIS before", "after", "consistent")
    if rows:
        table("Rows that the search has not seen, by all others: mean NIS / dof", columns, rows)
