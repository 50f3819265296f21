"""The command line as people run it, and what it made of two drives."""

import subprocess
import sys
from pathlib import Path

import pytest

from fgloc.cli import main


def shell(*arguments, **more):
    """Run the command as people do."""
    command = [Path(sys.executable).parent / "fgloc", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, **more)


@pytest.fixture
def run(capsys):
    """Run a command in this process: exit status, standard output, standard error."""

    def call(*arguments):
        status = main([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        assert "Traceback" not in out + err
        return status, out, err

    return call


@pytest.fixture
def refuse(run):
    """Run a command that has to end with status 2 and one line; gives the line."""

    def call(*arguments):
        status, out, err = run(*arguments)
        assert (status, out) == (2, "")
        assert err.startswith("fgloc: ") and err.count("\n") == 1, err
        return err

    return call


@pytest.fixture(scope="module")
def mems(tmp_path_factory):
    """The embedded drive smoothed by the real command, report and all."""
    out = tmp_path_factory.mktemp("mems") / "result"
    done = shell("smooth", "mems-rtk", "--out", out)
    assert done.returncode == 0, done.stderr
    return out, done


@pytest.fixture(scope="module")
def city(tmp_path_factory):
    """A folder with a simulated drive of 30 s."""
    folder = tmp_path_factory.mktemp("city") / "drive"
    assert main(["make", "city", "--seed", "1", "--duration", "30", "--out", str(folder)]) == 0
    return folder
