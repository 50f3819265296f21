"""The command line. Each command is a thin door: options in, one call, files and a table out.

Nothing heavy is imported before a command runs, so that help comes at once. All errors end here,
in `main`: one line on standard error and an exit status.
"""

import ctypes
import gc
import os
import sys
import traceback
from collections.abc import Sequence
from contextlib import suppress
from typing import NoReturn

import click

from fgloc.cli.comparing import compare
from fgloc.cli.doctor import doctor
from fgloc.cli.drives import datasets, degrade, import_drive, make
from fgloc.cli.matching import correspond
from fgloc.cli.perceiving import perceive
from fgloc.cli.results import evaluate, explain
from fgloc.cli.runs import baseline, smooth
from fgloc.cli.tuning import tune
from fgloc.errors import FglocError

__all__ = ["cli", "main", "run"]

TRACEBACK = "FGLOC_TRACEBACK"
"""Set to 1 in the environment, errors come with the lines of code they passed through."""

COLLECT_AFTER = 100_000
"""New objects after which cycles are looked for: at Python's 700 it takes a fortieth of a run."""

KEPT_BYTES = 1 << 25
"""What is smaller is kept when it is freed, and used again: the most that glibc allows."""
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
"""As glibc's malloc.h has them."""

_EPILOG = """\b
Example, from nothing to a report:
  fgloc make city --seed 1 --out city
  fgloc smooth city --out result
and open result/report.html.

Exit status: 0 done, 2 bad usage or bad input, 3 the estimator failed, 1 anything else.
"""


def _print_version(context: click.Context, _: click.Parameter, value: bool) -> None:
    if value:
        import fgloc

        click.echo(f"fgloc {fgloc.__version__}")
        context.exit()


@click.group(
    epilog=_EPILOG, context_settings={"help_option_names": ["-h", "--help"]},
    no_args_is_help=True,
)  # fmt: skip
@click.option(
    "--version", is_flag=True, expose_value=False, is_eager=True, callback=_print_version,
    help="Show the version and exit.",
)  # fmt: skip
def cli() -> None:
    """Where was the vehicle, and how sure is that? Factor-graph localization of recorded and
    simulated drives past smart infrastructure."""


for _command in (
    datasets, make, import_drive, doctor, degrade, tune, smooth, baseline, compare, evaluate,
    explain, correspond, perceive,
):  # fmt: skip
    cli.add_command(_command)


def run() -> NoReturn:
    """The command `fgloc`: it ends once all is written, and does not wait the tenth of a second in
    which Python takes its modules down."""
    status = main()
    with suppress(OSError):  # nobody reads any more
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(status)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and give back the exit status."""
    gc.set_threshold(COLLECT_AFTER)
    _keep_memory()
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # looking for them takes 40 ms
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # others would spin beside our own threads
    try:
        status = cli.main(
            list(sys.argv[1:] if arguments is None else arguments), "fgloc", standalone_mode=False
        )
        return status if isinstance(status, int) else 0
    except click.ClickException as err:
        err.show()
        return 2
    except click.Abort:
        return _fail("interrupted", 1)
    except FglocError as err:
        return _fail(str(err), err.exit_code)
    except Exception as err:
        text = " ".join(f"{type(err).__name__}: {err}".split())
        return _fail(
            f"internal error: {text}; please report it, with what {TRACEBACK}=1 prints in addition",
            1,
        )


def _keep_memory() -> None:
    """Let all threads use what any of them has freed: to get memory from the system for the first
    time takes longer than to fill it. An hour's drive needs a sixth less memory, and some 4 % less
    time.

    A setting of glibc; elsewhere it is as it is.
    """
    settings = getattr(ctypes.CDLL(None), "mallopt", None)
    if settings is not None:
        settings(_M_ARENA_MAX, 1)
        settings(_M_MMAP_THRESHOLD, KEPT_BYTES)
        settings(_M_TRIM_THRESHOLD, KEPT_BYTES)


def _fail(text: str, status: int) -> int:
    """Tell people on standard error; the status is the command's."""
    if os.environ.get(TRACEBACK) == "1":
        traceback.print_exc()
    click.echo(f"fgloc: {' '.join(text.splitlines())}", err=True)
    return status
