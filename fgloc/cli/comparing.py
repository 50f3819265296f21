"""The command that holds methods against each other."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fgloc.cli import options
from fgloc.cli.options import Command
from fgloc.cli.screen import print_json, say, table, working
from fgloc.errors import SolverError

if TYPE_CHECKING:
    from fgloc.evaluation import Metric
    from fgloc.evaluation.comparison import Comparison, Row

MEAN = "horizontal_mean_m"
STANDING_METRICS = ("horizontal_std_m", "horizontal_rmse_m", "horizontal_p95_m", "anees_horizontal")
MOST_ROWS = 40
"""Rows of single drives on screen; compare.json holds all."""
_POST_UNITS = {"x": "mm", "y": "mm", "roll": "mrad", "pitch": "mrad"}
_EPILOG = """\b
Examples:
  fgloc compare mems-rtk --methods graph-lag,graph-batch,raw:gnss --out table
  fgloc compare city --seeds 0:20 --methods graph-lag,raw:gnss --out table
  fgloc compare lee2021/mcity --seeds 0:20 --methods lee2021-ekf,graph-lag --out table
  fgloc compare mems-rtk --methods graph-batch --config plain=plain.toml --out table
"""


class Seeds(click.ParamType):
    """`FIRST:END`, without END, or one number."""

    name = "FIRST:END"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> range:
        if isinstance(value, range):
            return value
        first, colon, end = value.partition(":")
        if not first.isdecimal() or (colon and not end.isdecimal()):
            self.fail(f"{value!r} is not of the form FIRST:END, e.g. 0:20 for 0 to 19", param, ctx)
        seeds = range(int(first), int(end) if colon else int(first) + 1)
        if not seeds:
            self.fail(
                f"{value!r} holds no seed: END is not among them, 0:20 is 0 to 19", param, ctx
            )
        return seeds


class Labelled(click.ParamType):
    """`LABEL=FILE`, a pair of texts."""

    name = "LABEL=FILE"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, str]:
        if isinstance(value, tuple):
            return value
        label, equals, path = value.partition("=")
        if not equals or not label.strip() or not path.strip():
            self.fail(f"{value!r} is not of the form LABEL=FILE", param, ctx)
        return label.strip(), path.strip()


@click.command(cls=Command, epilog=_EPILOG)
@click.argument("drives", metavar="DRIVE...", nargs=-1, required=True)
@click.option("--methods", metavar="A,B,..", help="Methods; the first is what others are held to.")
@click.option(
    "--config", "configs", type=Labelled(), multiple=True, metavar="LABEL=FILE",
    help="One method more: the graph with the configuration (and mode) of a TOML file.",
)  # fmt: skip
@click.option(
    "--seeds", type=Seeds(), metavar="FIRST:END",
    help="Make each scenario with these seeds; END is not among them.",
)  # fmt: skip
@options.settings("One option of the scenarios, e.g. duration_s=60")
@options.out_dir
@options.score_from
@options.no_report
@options.as_json
def compare(
    drives: tuple[str, ...], methods: str | None, configs: tuple[tuple[str, str], ...],
    seeds: range | None, settings: tuple[str, ...], out: Path, score_from_s: float,
    no_report: bool, as_json: bool,
) -> None:  # fmt: skip
    """The same drives through several methods.

    A method is graph-batch, graph-incremental, graph-lag (each with :velocity after it for the
    graph without the IMU) or a baseline such as raw:gnss. DIR gets compare.json and a report.
    """
    from fgloc import api, outputs

    names = [name.strip() for name in (methods or "").split(",") if name.strip()]
    labels = [label for label, _ in configs]
    twice = next((label for label in labels if labels.count(label) > 1), None)
    if twice is not None:
        raise click.UsageError(f"--config {twice}=.. is given twice; choose another label")
    if not names and not configs:
        raise click.UsageError("give --methods, --config or both, e.g. --methods graph-batch")
    options.check_settings(settings)
    outputs.check_folder(out)
    with working(f"comparing {', '.join([*names, *labels])}"):
        found = api.compare(
            drives, names, configs=dict(configs), seeds=seeds, score_from_s=score_from_s,
            options=options.parse_settings(settings),
        )  # fmt: skip
        outputs.write_comparison(out, found, report=not no_report)
    if as_json:
        print_json(found.to_dict())
    else:
        _print(found)
        say(f"Results in {out}")
    if all(row.failed for row in found.rows):
        raise SolverError(f"no method gave a result: {found.rows[0].failed}")


def _print(found: "Comparison") -> None:
    """Means over the drives where there are several, then the rows of each drive."""
    if any(_post_names(row) for row in found.rows):
        _print_posts(found)
        if not any("horizontal_rmse_m" in row.metrics for row in found.rows):
            return
    if found.drives > 1:
        header = ("method", "mean RMSE in m", "95 % interval", f"minus {found.against}",
                  "95 % interval", "drives", "failed", "wall s")  # fmt: skip
        rows = [
            (
                one.method, *_two(one.mean), *_two(one.difference), str(one.mean.n),
                str(one.failed), f"{one.wall_s:.2f}",
            )
            for one in found.overall()
        ]  # fmt: skip
        table(f"Horizontal RMSE over {found.drives} drives", header, rows)
    if any(row.conditions for row in found.rows):
        _print_standings(found)
    _print_rows(found, found.rows[:MOST_ROWS])
    if len(found.rows) > MOST_ROWS:
        say(f"{len(found.rows) - MOST_ROWS} more rows are in compare.json")


def _print_posts(found: "Comparison") -> None:
    """RMSE and largest error of each post: the mean over the drives of which there is a value."""
    posts = list(dict.fromkeys(name for row in found.rows for name in _post_names(row)))
    columns = [f"{axis}_{kind}" for axis in _POST_UNITS for kind in ("rmse", "max")]
    units = [_POST_UNITS[column.partition("_")[0]] for column in columns]
    titles = (f"{c.replace('_', ' ')} {unit}" for c, unit in zip(columns, units, strict=True))
    header = ("method", *titles, "drives", "remark")
    for post in posts:
        names = [f"{post}.{column}_{unit}" for column, unit in zip(columns, units, strict=True)]
        rows = [_post_row(found, method, names) for method in found.methods]
        table(f"Sway of {post.removeprefix('posts.')}", header, rows)


def _post_row(found: "Comparison", method: str, names: list[str]) -> tuple[str, ...]:
    from fgloc.report.tables import number

    rows = found.of(method)
    values = [[value for row in rows if (value := _value(row, name)) is not None] for name in names]
    means = (number(sum(column) / len(column)) if column else "" for column in values)
    failed = next((row.failed for row in rows if row.failed), "")
    return (method, *means, str(len(values[0])), failed)


def _value(row: "Row", name: str) -> float | None:
    metric = row.metrics.get(name)
    return None if metric is None else metric.value


def _post_names(row: "Row") -> list[str]:
    """What the metrics of each post of a row begin with."""
    ends = ".x_rmse_mm"
    return [name.removesuffix(ends) for name in row.metrics if name.endswith(ends)]


def _print_standings(found: "Comparison") -> None:
    """Near a node, elsewhere and as a whole: means over the drives."""
    header = (
        "where", "method", "mean in m", "95 % interval", "std in m", "RMSE in m", "95 % below",
        "ANEES", f"mean / {found.against}", "95 % interval", "drives",
    )  # fmt: skip
    rows = []
    for one in found.standings():
        mean = one.averages[MEAN]
        single = (_two(one.averages[name])[0] for name in STANDING_METRICS)
        rows.append((one.condition, one.method, *_two(mean), *single, *_two(one.ratio),
                     str(mean.n)))  # fmt: skip
    table("Horizontal errors within the range of a node, elsewhere and on the whole", header, rows)


def _print_rows(found: "Comparison", rows: Sequence[Any]) -> None:
    header = ("drive", "seed", "method", "kind", "RMSE in m", "95 % interval", "95 % below",
              f"minus {found.against}", "95 % interval", "scored", "wall s", "remark")  # fmt: skip
    cells = [
        (
            row.drive, "" if row.seed is None else str(row.seed), row.method, row.label,
            *_two(row.metrics.get("horizontal_rmse_m")),
            _two(row.metrics.get("horizontal_p95_m"))[0], *_two(row.difference),
            _two(row.metrics.get("scored_share"))[0], f"{row.wall_s:.2f}", row.failed,
        )
        for row in rows
    ]  # fmt: skip
    table("Horizontal errors, drive by drive", header, cells)


def _two(metric: "Metric | None") -> tuple[str, str]:
    """A metric's value and interval, empty where there is none."""
    from fgloc.report.tables import interval, number

    if metric is None or metric.value is None:
        return "", ""
    return number(metric.value), interval(metric)
