"""The command that matches a node's objects to a car's, on layouts whose answer is known."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fgloc.cli import options
from fgloc.cli.options import Command
from fgloc.cli.screen import print_json, say, steps, table

if TYPE_CHECKING:
    from fgloc.evaluation.correspondence import Row

FILE = "correspond.json"
_EPILOG = """\b
Examples:
  fgloc correspond --layouts 100 --sizes 5,10,20
  fgloc correspond --layouts 1000 --sizes 5 --missing 0 --ghosts 0 --out rates
"""


class Sizes(click.ParamType):
    """Whole numbers with commas between."""

    name = "5,10,.."

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, ...]:
        if isinstance(value, tuple):
            return value
        parts = [part.strip() for part in value.split(",")]
        if not all(part.isdecimal() for part in parts):
            self.fail(f"{value!r} is not a list of whole numbers such as 5,10,20", param, ctx)
        return tuple(dict.fromkeys(int(part) for part in parts))


_share = click.FloatRange(0, 1, max_open=True)


@click.command(cls=Command, epilog=_EPILOG)
@click.option(
    "--layouts", type=click.IntRange(min=1), default=100, show_default=True, metavar="N",
    help="Layouts of each size.",
)  # fmt: skip
@click.option(
    "--sizes", type=Sizes(), default="5,10,20,30", show_default=True,
    help="Objects of a layout, the car included.",
)  # fmt: skip
@click.option("--noise", "sigma_m", type=click.FloatRange(0, 10, min_open=True), default=0.3,
              show_default=True, metavar="M",
              help="Sigma of each axis of each measured position, m.")  # fmt: skip
@click.option("--missing", type=_share, default=0.2, show_default=True, metavar="SHARE",
              help="Share of the objects that the node misses, and that the car does.")  # fmt: skip
@click.option("--ghosts", type=_share, default=0.2, show_default=True, metavar="SHARE",
              help="As many again that are not there, in both sets.")  # fmt: skip
@click.option(
    "--one-sided", is_flag=True, help="Only the car misses objects, only the node has ghosts."
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, metavar="N",
              help="Seed of the layouts.")  # fmt: skip
@click.option("--out", metavar="DIR", type=click.Path(path_type=Path),
              help=f"Folder for {FILE}; made where it is missing.")  # fmt: skip
@options.as_json
def correspond(
    layouts: int, sizes: tuple[int, ...], sigma_m: float, missing: float, ghosts: float,
    one_sided: bool, seed: int,
    out: Path | None, as_json: bool,
) -> None:  # fmt: skip
    """ICP, CPD, warm start and ours on object layouts.

    Which object that a node broadcasts is which that the car sees: how often each method fails, of
    the layouts that leave no choice. A failure is a heading off by more than 5 deg, any wrong pair,
    or no answer. Ours (consistent) claims the pairs that are beyond doubt and keeps the others as
    likely ones.
    """
    from fgloc import outputs
    from fgloc.evaluation.correspondence import study

    if out is not None:
        outputs.check_folder(out)
    given = {"sigma_m": sigma_m, "missing": missing, "ghosts": ghosts, "one_sided": one_sided}
    with steps("matching layouts") as tell:
        rows = study(layouts, sizes, seed, tell=tell, options=given)
    values = {"layouts": layouts, "seed": seed, **given, "rows": [row.to_dict() for row in rows]}
    if out is not None:
        outputs.write_file(out / FILE, outputs.format_json(values))
    if as_json:
        print_json(values)
        return
    for size in sizes:
        _print(size, [row for row in rows if row.objects == size])
    if out is not None:
        say(f"Results in {out}")


def _print(size: int, rows: "list[Row]") -> None:
    header = ("method", "failed %", "95 % interval", "heading off %", "wrong pair %",
              "no answer %", "pairs found %", "with likely ones %", "ms")  # fmt: skip
    cells = [
        (row.method, _percent(row.failed), _interval(row.failed), _percent(row.heading),
         _percent(row.wrong_pair), _percent(row.no_answer), _percent(row.found),
         _percent(row.found_likely), f"{1e3 * row.median_s:.1f}")
        for row in rows
    ]  # fmt: skip
    clear = rows[0].layouts - rows[0].ambiguous
    table(f"{size} objects: {clear} of {rows[0].layouts} layouts leave no choice", header, cells)


def _percent(metric: Any) -> str:
    return "" if metric.value is None else f"{100 * metric.value:.1f}"


def _interval(metric: Any) -> str:
    return "" if metric.low is None else f"{100 * metric.low:.1f} to {100 * metric.high:.1f}"
