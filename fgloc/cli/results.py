"""Commands that look at results: score a trajectory, explain a moment."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fgloc.cli import options
from fgloc.cli.options import Command
from fgloc.cli.screen import print_explanation, print_json, print_metrics, print_requirements, say
from fgloc.errors import InputError

if TYPE_CHECKING:
    from fgloc.trajectory import Trajectory

_EVAL_EPILOG = """\b
Examples:
  fgloc eval result/trajectory.csv mems-rtk
  fgloc eval estimate.tum truth.tum --score-from 10
"""


@click.command(cls=Command, name="eval", epilog=_EVAL_EPILOG)
@click.argument("estimate", metavar="ESTIMATE")
@click.argument("truth", metavar="TRUTH")
@click.option(
    "--out", metavar="DIR", type=click.Path(path_type=Path), help="Folder for summary.json."
)
@options.score_from
@options.as_json
def evaluate(
    estimate: str, truth: str, out: Path | None, score_from_s: float, as_json: bool
) -> None:
    """Score a trajectory against the truth.

    Nothing is aligned: a constant offset counts.

    ESTIMATE is a trajectory file (.tum, .txt, .csv) or a result folder; TRUTH is a trajectory file,
    or a drive that has truth. Files tell of the vehicle's origin, unless they lie in a result
    folder whose summary names another point; a drive's truth tells of the point that it states.
    """
    from fgloc import outputs
    from fgloc.evaluation import judge_trajectory, requirements

    if out is not None:
        outputs.check_folder(out)
    judged = judge_trajectory(_estimate(estimate), _truth(truth), score_from_s=score_from_s)
    metrics = {name: metric.to_dict() for name, metric in judged.metrics.items()}
    summary: dict[str, Any] = {
        "estimate": estimate, "truth": truth, "score_from_s": score_from_s, "metrics": metrics,
        "requirements": requirements.as_dict(judged.requirements),
    }  # fmt: skip
    if out is not None:
        outputs.write_scores(out, summary)
    if as_json:
        print_json(summary)
        return
    print_metrics(f"{estimate} against {truth}", metrics)
    print_requirements(summary["requirements"])
    if out is not None:
        say(f"Results in {out}")


@click.command(cls=Command, epilog="Example: fgloc explain result --t 61.5 --window 3")
@click.argument("folder", metavar="DIR")
@click.option(
    "--t", "t_s", type=options.Seconds(signed=True), required=True, metavar="SECONDS",
    help="Since the drive's start.",
)  # fmt: skip
@click.option(
    "--window", "window_s", type=options.Seconds(), default=2.0, show_default=True,
    metavar="S", help="So many seconds before and after.",
)  # fmt: skip
@options.as_json
def explain(folder: str, t_s: float, window_s: float, as_json: bool) -> None:
    """Why each measurement was used or not.

    DIR is a folder that fgloc smooth or fgloc baseline has written. Sources with many
    measurements there, such as an IMU, are counted.
    """
    from fgloc.explain import explain as find

    found = find(folder, t_s, window_s=window_s)
    if as_json:
        print_json(found.to_dict())
    else:
        print_explanation(found)


def _estimate(name: str) -> "Trajectory":
    """The trajectory of a file or a result folder."""
    from fgloc.outputs import TRAJECTORY, read_result_trajectory

    path = Path(name)
    return read_result_trajectory(path / f"{TRAJECTORY}.csv" if path.is_dir() else path)


def _truth(name: str) -> "Trajectory":
    """The truth of a file, or that of a drive; InputError where that has none."""
    from fgloc import api

    path = Path(name)
    if path.suffix in (".tum", ".txt", ".csv") and not path.is_dir():
        return _estimate(name)
    truth = api.load(name).truth
    if truth is None:
        raise InputError("there is no truth to score against: this drive has none")
    return truth
