"""The exceptions of fgloc. Each message names the file, row, field, value and remedy it knows."""

import difflib
from collections.abc import Iterable


class FglocError(Exception):
    """Root of every error that fgloc raises on purpose; `exit_code` is the command's status."""

    exit_code = 1


class InputError(FglocError):
    """Something handed to fgloc is wrong: a name, an option, a value. Exit status 2."""

    exit_code = 2


class DriveError(InputError):
    """A drive, a recording or one of its tables cannot be used as it is."""


class ConfigError(InputError):
    """A configuration does not validate; the message lists every fault at once."""


class SolverError(FglocError):
    """The estimator failed; the message names state, time and missing information. Exit 3."""

    exit_code = 3


def nearest(name: str, valid: Iterable[str]) -> str:
    """The valid name most like a wrong one, for the message; upper and lower case are alike.

    There must be at least one valid name.
    """
    names = {one.lower(): one for one in valid}
    return names[difflib.get_close_matches(name.lower(), list(names), n=1, cutoff=0.0)[0]]
