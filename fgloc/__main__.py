"""`python -m fgloc`, the same as the command `fgloc`."""

from fgloc.cli import run

if __name__ == "__main__":
    run()
