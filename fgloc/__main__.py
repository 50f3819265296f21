"""`python -m fgloc`, the same as the command `fgloc`."""

import sys

from fgloc.cli import main

if __name__ == "__main__":
    sys.exit(main())
