"""What the commands show: tables on a terminal through rich, plain aligned text elsewhere."""

import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

SHOWN = (
    "horizontal_rmse_m", "horizontal_p95_m", "horizontal_max_m", "lateral_rmse_m",
    "longitudinal_rmse_m", "up_rmse_m", "yaw_rmse_rad", "anees", "coverage95", "scored_share",
    "outage_count", "outage_rmse_m", "outage_end_max_m",
)  # fmt: skip
"""The metrics of the table on screen; summary.json holds all."""
MOST_EVENTS = 10
_PATIENCE_S = 1.0


def say(text: str) -> None:
    """One line on standard output."""
    click.echo(text)


def print_json(values: Mapping[str, Any]) -> None:
    """The machine-readable result, alone on standard output."""
    from fgloc.outputs import format_json

    click.echo(format_json(values), nl=False)


def table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table of texts; columns of numbers stand to the right."""
    right = [bool(rows) and all(_is_number(row[i]) for row in rows) for i in range(len(header))]
    if sys.stdout.isatty():
        _rich_table(title, header, rows, right)
        return
    if title:
        say(title)
    widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
    for row in (header, *rows):
        cells = (
            text.rjust(width) if is_right else text.ljust(width)
            for text, width, is_right in zip(row, widths, right, strict=True)
        )
        say("  ".join(cells).rstrip())
    say("")


@contextmanager
def working(text: str) -> Iterator[None]:
    """Show that work goes on, on a terminal only and once it has taken a second."""
    if not sys.stderr.isatty():
        yield
        return
    done = threading.Event()
    watcher = threading.Thread(target=_spin, args=(text, done), daemon=True)
    watcher.start()
    try:
        yield
    finally:
        done.set()
        watcher.join()


@contextmanager
def steps(text: str) -> Iterator[Callable[[str], None]]:
    """The same for work in steps: the function it gives shows a line for the latest one."""
    if not sys.stderr.isatty():
        yield lambda line: None
        return
    from rich.console import Console

    with Console(stderr=True).status(text) as status:
        yield lambda line: status.update(f"{text}: {line}")


def print_run(summary: Mapping[str, Any], out: Path) -> None:
    """The outcome of a run: metrics where there is truth, verdicts, events, where the files are."""
    causal = "causal, no look-ahead" if summary["causal"] else "each state uses the whole drive"
    say(
        f"{summary['drive']}: {summary['method']} ({causal}); {summary['duration_s']:,.1f} s of "
        f"driving in {summary['wall_s']:.2f} s, {summary['states']:,} states"
    )
    say("")
    if "metrics" in summary:
        print_metrics("Errors against the truth", summary["metrics"])
        if "requirements" in summary:
            print_requirements(summary["requirements"])
    else:
        say("This drive has no truth, so there are no errors to show.\n")
    if "smoothed_metrics" in summary:
        print_metrics(
            "The same of trajectory_smoothed, which looks ahead", summary["smoothed_metrics"]
        )
        print_requirements(summary["smoothed_requirements"])
    _print_counts(summary["counts"])
    _print_events(summary["events"])
    say(f"Results in {out}")


def print_metrics(title: str, metrics: Mapping[str, Mapping[str, Any]]) -> None:
    """The main metrics; one without a value shows why."""
    from fgloc.evaluation.metric import Metric
    from fgloc.report.tables import metric_rows

    shown = [name for name in SHOWN if name in metrics]
    shown += [name for name in metrics if name.startswith("posts.")]
    found = {name: Metric(**metrics[name]) for name in shown}
    rows = [
        (row["label"], row["value"], row["unit"], row["interval"], row["n"], row["remark"])
        for row in metric_rows(found)
    ]
    table(title, ("metric", "value", "unit", "95 % interval", "n", "remark"), rows)


def print_requirements(found: Mapping[str, Any]) -> None:
    """A line for each kind of road: what is met, what is missed, what cannot be said."""
    from fgloc.report.requirements import answer_lines

    title = "Requirements (Reid et al. 2019; of alert limits a drive can only say no)"
    table(title, ("road", "95 % accuracy", "alert limits"), answer_lines(found))


def print_explanation(found: Any) -> None:
    """The measurements around a moment, as `fgloc.explain` found them."""
    say(f"{found.method}: {found.t_s - found.window_s:g} to {found.t_s + found.window_s:g} s")
    sigmas = ", ".join(f"{name.rpartition('_')[0]} {_sigma(name, value)}"
                       for name, value in found.sigmas.items())  # fmt: skip
    at = f"Sigma of the trajectory at {found.t_s:g} s"
    say(f"{at}: {sigmas}\n" if sigmas else f"{at}: none; the estimate says nothing there\n")
    rows = [
        (
            f"{row.t_s:.3f}", row.source, row.verdict, _number(row.nis), _number(row.threshold),
            f"{row.delay_s:.3f}" if row.delay_s else "", row.reason,
        )
        for row in found.listed
    ]  # fmt: skip
    header = ("t in s", "source", "verdict", "NIS", "threshold", "late by s", "reason")
    if rows:
        table("", header, rows)
    for source, groups in found.counted.items():
        parts = [f"{n:,} {verdict}" + (f" ({why})" if why else "")
                 for (verdict, why), n in groups.items()]  # fmt: skip
        say(f"{source}: {', '.join(parts)}")
    if not rows and not found.counted:
        say("No measurements there.")
    for t_s, kind, text in found.events:
        say(f"event at {t_s:.2f} s: {kind}: {text}")


def _spin(text: str, done: threading.Event) -> None:
    if done.wait(_PATIENCE_S):
        return
    from rich.console import Console

    with Console(stderr=True).status(text):
        done.wait()


def _rich_table(
    title: str, header: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[bool]
) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    made = Table(title=title or None, title_justify="left", box=None, padding=(0, 2, 0, 0))
    for name, is_right in zip(header, right, strict=True):
        made.add_column(name, justify="right" if is_right else "left", overflow="fold")
    for row in rows:
        made.add_row(*map(Text, row))  # Text: what stands in brackets is not markup
    console = Console(highlight=False)
    console.print(made)
    console.print()


def _print_counts(counts: Mapping[str, Mapping[str, int]]) -> None:
    from fgloc.verdicts import Verdict

    order = [str(v) for v in Verdict if any(v in of for of in counts.values())]
    rows = [
        (source, *(f"{of[v]:,}" if v in of else "0" for v in order), f"{sum(of.values()):,}")
        for source, of in counts.items()
    ]
    table("What became of the measurements", ("source", *order, "total"), rows)


def _print_events(events: Sequence[Mapping[str, Any]]) -> None:
    for event in events[:MOST_EVENTS]:
        say(f"note: at {event['t_s']:.2f} s: {event['kind']}: {event['text']}")
    if len(events) > MOST_EVENTS:
        say(f"note: {len(events) - MOST_EVENTS:,} more events in summary.json")
    if events:
        say("")


def _is_number(text: str) -> bool:
    return not text or text == "none" or text.replace(",", "").lstrip("-")[:1].isdigit()


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def _sigma(name: str, value: float) -> str:
    from math import degrees

    from fgloc.report.tables import number

    return f"{number(degrees(value))} deg" if name.endswith("_rad") else f"{number(value)} m"
