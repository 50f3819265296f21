"""Commands about drives: what there is, make one, import one, make one worse."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from fgloc.cli import options
from fgloc.cli.options import Command, Numbers
from fgloc.cli.screen import print_json, say, table, working
from fgloc.errors import InputError

if TYPE_CHECKING:
    from fgloc.drive import Drive


@click.command(cls=Command, epilog="Example: fgloc datasets")
@options.as_json
def datasets(as_json: bool) -> None:
    """List the drives that have a name.

    Real samples, simulated scenarios, and the formats that can be imported.
    """
    from fgloc.datasets import available

    infos = available()
    if as_json:
        print_json({"datasets": [vars(info) for info in infos]})
        return
    rows = [
        (
            info.name, info.kind, "" if info.duration_s is None else f"{info.duration_s:g} s",
            ", ".join(info.sensors), info.licence, info.description,
        )
        for info in infos
    ]  # fmt: skip
    table("", ("name", "kind", "duration", "sensors", "licence", "what it is"), rows)
    say("real: open by name; scenario: by name, with --seed; importer: with fgloc import")


@click.command(cls=Command, epilog="Example: fgloc make city --seed 1 --duration 300 --out city")
@click.argument("scenario", metavar="SCENARIO")
@options.seed
@click.option(
    "--duration", "duration_s", type=float, metavar="S", help="Length of the drive in seconds."
)
@options.settings("One option more, by name")
@options.out_drive
@options.as_json
def make(
    scenario: str, seed: int | None, duration_s: float | None, settings: tuple[str, ...],
    out: Path, overwrite: bool, as_json: bool,
) -> None:  # fmt: skip
    """Write a simulated drive.

    fgloc datasets lists the scenarios. Equal seeds give equal drives, bit for bit; without a seed
    it is 0.
    """
    from fgloc import api

    options.check_settings(settings, duration_s=duration_s)
    chosen = options.parse_settings(settings)
    if "seed" in chosen:
        raise InputError("--set seed: a seed comes from --seed alone")
    if duration_s is not None:
        chosen["duration_s"] = duration_s
    with working(f"making {scenario}"):
        drive = api.make(scenario, seed=seed or 0, **chosen)
        _write(drive, out, overwrite)
    _tell(drive, out, as_json)


@click.command(
    cls=Command, name="import", epilog="Example: fgloc import mems-rtk drive_0708 --out mems"
)
@click.argument("format_", metavar="FORMAT")
@click.argument("source", metavar="[SOURCE]", required=False)
@options.import_files
@options.import_numbers
@options.settings("One option more, by name")
@options.out_drive
@options.as_json
def import_drive(
    format_: str, source: str | None, settings: tuple[str, ...], out: Path, overwrite: bool,
    as_json: bool, **given: str | float | None,
) -> None:  # fmt: skip
    """Turn a recording into a drive folder.

    fgloc datasets lists the formats, datasets/README.md their options. What cannot be used is left
    out and counted.
    """
    from fgloc.datasets import import_recording

    options.check_settings(settings, **given)
    chosen = options.parse_settings(settings)
    chosen |= {name: value for name, value in given.items() if value is not None}
    with working(f"importing {source or format_}"):
        drive = import_recording(format_, source, **chosen)
        _write(drive, out, overwrite)
    _tell(drive, out, as_json, source=drive.about.source)


@click.command(
    cls=Command,
    epilog="Example, ten seconds of every sixty without GNSS: "
    "fgloc degrade mems-rtk --outage 60:10:60 --out worse",
)
@options.drive_argument
@click.option("--source", type=click.Choice(["gnss"]), default="gnss", help="What is made worse.")
@click.option("--keep-every", type=click.IntRange(min=1), metavar="N", help="Keep each N-th fix.")
@click.option(
    "--outage", type=Numbers("FIRST:LEN:PERIOD", ":"), metavar="FIRST:LEN:PERIOD",
    help="Without fixes from FIRST for LEN seconds, and again every PERIOD seconds.",
)  # fmt: skip
@click.option(
    "--noise", type=Numbers("E,N,U", ","), metavar="E,N,U",
    help="Add white noise of these sigmas in metres; they become the stated covariance.",
)  # fmt: skip
@click.option(
    "--seed", type=click.IntRange(min=0), metavar="N",
    help="Seed of the noise, and of a scenario given by name.",
)  # fmt: skip
@options.out_drive
@options.as_json
def degrade(
    drive: str, source: str, keep_every: int | None, outage: tuple[float, float, float] | None,
    noise: tuple[float, float, float] | None, seed: int | None, out: Path, overwrite: bool,
    as_json: bool,
) -> None:  # fmt: skip
    """Take GNSS away, or make it worse.

    Fixes that are removed become truth; the drive itself stays as it is. Seconds count from the
    first fix.
    """
    from fgloc import api
    from fgloc.datasets.degrade import degrade as worsen

    scenario = api.is_scenario(drive)
    if seed is not None and noise is None and not scenario:
        raise click.UsageError("--seed goes with --noise or with a scenario; leave it out")
    with working(f"degrading {drive}"):
        worse = worsen(
            api.load(drive, seed=seed if scenario else None),
            keep_every=keep_every, outage=outage, noise_enu_m=noise, seed=seed or 0,
        )  # fmt: skip
        _write(worse, out, overwrite)
    _tell(worse, out, as_json)


def _write(drive: "Drive", folder: Path, overwrite: bool) -> None:
    from fgloc.datasets.drive_folder import write_drive

    write_drive(drive, folder, overwrite=overwrite)


def _tell(drive: "Drive", folder: Path, as_json: bool, **more: str) -> None:
    """Say what was written and where; `more` is said after the counts."""
    rows = {name: len(table) for name, table in drive.tables.items()}
    truth = 0 if drive.truth is None else len(drive.truth)
    duration_s = (drive.end_ns - drive.start_ns) / 1e9
    if as_json:
        print_json({
            "drive": drive.name, "folder": str(folder), "duration_s": duration_s, "rows": rows,
            "truth_rows": truth, **more,
        })  # fmt: skip
        return
    counts = ", ".join(f"{n:,} {name}" for name, n in {**rows, "truth": truth}.items())
    say(f"{drive.name}: {duration_s:g} s; rows: {counts}")
    for name, text in more.items():
        say(f"{name}: {text}")
    say(f"Drive written to {folder}")
