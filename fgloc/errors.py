"""The exceptions of fgloc. Each message names the file, row, field, value and remedy it knows."""


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
