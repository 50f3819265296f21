"""What commands have in common: options, what their text means, and the check against repeats."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])


class Command(click.Command):
    """A command that refuses an option given twice, where the last would win without a word."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        _, _, given = self.make_parser(ctx).parse_args(args=list(args))
        for param in set(given):
            once = isinstance(param, click.Option) and not param.multiple
            if once and given.count(param) > 1:
                raise click.UsageError(f"option {param.opts[0]} is given twice; give it once", ctx)
        return super().parse_args(ctx, args)


class Numbers(click.ParamType):
    """Numbers with something between them, such as FIRST:LEN:PERIOD."""

    def __init__(self, form: str, between: str) -> None:
        self.name, self.between = form, between

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        if isinstance(value, tuple):
            return value
        parts = value.split(self.between)
        names = self.name.split(self.between)
        try:
            numbers = tuple(float(part) for part in parts)
        except ValueError:
            numbers = ()
        if len(numbers) != len(names):
            self.fail(
                f"{value!r} is not of the form {self.name}: "
                f"{len(names)} numbers separated by {self.between!r}", param, ctx,
            )  # fmt: skip
        return numbers


class Seconds(click.FloatRange):
    """A finite number of seconds, 0 or more unless `signed`."""

    def __init__(self, *, signed: bool = False) -> None:
        super().__init__(min=None if signed else 0)

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        seconds = float(super().convert(value, param, ctx))
        if not math.isfinite(seconds):
            self.fail(f"{value} is not a finite number of seconds", param, ctx)
        return seconds


class Setting(click.ParamType):
    """`key=value`, kept as text."""

    name = "KEY=VALUE"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        key, equals, _ = value.partition("=")
        if not equals or not key.strip():
            self.fail(f"{value!r} is not of the form key=value", param, ctx)
        return str(value)


class Choices(click.ParamType):
    """Some of a few words, with commas between."""

    def __init__(self, *words: str) -> None:
        self.name, self.words = ",".join(words), words

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, ...]:
        given = value if isinstance(value, tuple) else tuple(value.split(","))
        for word in given:
            if word not in self.words:
                self.fail(f"{word!r} is none of {', '.join(self.words)}", param, ctx)
        return tuple(dict.fromkeys(given))


def check_settings(settings: tuple[str, ...], **given: Any) -> None:
    """Refuse a setting that is there twice, or once more as an option of its own."""
    keys = [setting.partition("=")[0].strip() for setting in settings]
    for key in keys:
        if keys.count(key) > 1:
            raise click.UsageError(f"--set {key} is given twice; give it once")
        if given.get(key) not in (None, False):
            raise click.UsageError(f"--set {key} and the option of that name; give one of them")


def parse_settings(settings: tuple[str, ...]) -> dict[str, Any]:
    """Settings as keyword arguments: numbers and truth values as such, all else as text."""
    from fgloc.config import parse_value

    pairs = (setting.partition("=") for setting in settings)
    return {key.strip(): parse_value(text.strip()) for key, _, text in pairs}


def with_options(*options: Callable[[F], F]) -> Callable[[F], F]:
    """Several option decorators as one, in the order of the help."""

    def decorate(function: F) -> F:
        for option in reversed(options):
            function = option(function)
        return function

    return decorate


def settings(what: str) -> Callable[[F], F]:
    """The option `--set`."""
    return click.option(
        "--set", "settings", type=Setting(), multiple=True, metavar="KEY=VALUE",
        help=f"{what}; may be given several times.",
    )  # fmt: skip


def out(metavar: str, what: str) -> Callable[[F], F]:
    """Where a command writes."""
    return click.option(
        "--out", required=True, metavar=metavar, type=click.Path(path_type=Path), help=what
    )


drive_argument = click.argument("drive", metavar="DRIVE")
out_drive = with_options(
    out("DRIVE", "Folder that the drive is written to; made where it is missing."),
    click.option("--overwrite", is_flag=True, help="Replace a drive that is there already."),
)
out_dir = out("DIR", "Folder for the results; made where it is missing.")
seed = click.option(
    "--seed", type=click.IntRange(min=0), metavar="N", help="Seed of a scenario given by name."
)
import_files = with_options(
    click.option("--imu", metavar="FILE", help="IMU beside the fixes: CSV as a drive's imu.csv."),
    click.option("--imu-noise", metavar="FILE", help="Noise of the IMU: imu.yaml of Kalibr."),
    click.option("--positions", metavar="FILE", help="Trajectory (TUM) that is measured."),
    click.option("--truth", metavar="FILE", help="Trajectory (TUM) that is the truth."),
)
import_numbers = with_options(
    click.option("--trial", type=int, metavar="K", help="mcity-roadside: which trial."),
    click.option("--vehicle", type=int, metavar="ID", help="Which vehicle; 0 if not given."),
    click.option("--gps-rate", "gps_rate_hz", type=float, metavar="HZ", help="Of simulated fixes."),
    click.option("--gps-sigma", "gps_sigma_m", type=float, metavar="M", help="Their white noise."),
    click.option(
        "--gps-bias-sigma", "gps_bias_sigma_m", type=float, metavar="M",
        help="Their slowly varying error; 0 is none.",
    ),
    click.option(
        "--gps-bias-tau", "gps_bias_tau_s", type=float, metavar="S", help="Its time constant."
    ),
    click.option(
        "--odometry", is_flag=True, flag_value=True, default=None, type=bool,
        help="Simulate speed, yaw rate and velocity as well.",
    ),
    click.option(
        "--others", is_flag=True, flag_value=True, default=None, type=bool,
        help="The other vehicle says where it is.",
    ),
    click.option("--seed", type=click.IntRange(min=0), metavar="N", help="Of what is simulated."),
)  # fmt: skip
config = click.option(
    "--config", metavar="FILE", type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Configuration in TOML, e.g. the config.toml of an earlier result.",
)  # fmt: skip
score_from = click.option(
    "--score-from", "score_from_s", type=Seconds(), default=0.0, metavar="S",
    help="Score from so many seconds after the estimate's start on.",
)  # fmt: skip
also = click.option(
    "--also", type=Choices("gpx", "kml"), default=(), metavar="gpx,kml",
    help="Write the trajectory in these formats as well.",
)  # fmt: skip
no_report = click.option("--no-report", is_flag=True, help="Leave report.html out.")
as_json = click.option(
    "--json", "as_json", is_flag=True,
    help="Print the result as JSON on standard output instead of tables.",
)  # fmt: skip
