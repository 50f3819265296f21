"""Whole files read, with errors that name them."""

from pathlib import Path

from fgloc.errors import DriveError


def read_bytes(path: Path) -> bytes:
    """What a file holds; DriveError where it is missing or cannot be read."""
    try:
        return path.read_bytes()
    except FileNotFoundError as err:
        raise DriveError(f"{path}: no such file") from err
    except OSError as err:
        raise DriveError(f"{path}: cannot be read: {err.strerror}") from err


def read_filled(path: Path, wanted: str = "") -> bytes:
    """As `read_bytes`; DriveError, which may say what is `wanted`, also where nothing is in it."""
    raw = read_bytes(path)
    if not raw or raw.isspace():
        raise DriveError(f"{path}: the file is empty{wanted}")
    return raw


def read_text(path: Path) -> str:
    """The text of a file without a byte order mark; DriveError as above, or where it is no UTF-8.

    Line ends become \\n.
    """
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as err:
        raise DriveError(f"{path}: byte {err.start} is not UTF-8 text") from err
    return text.replace("\r\n", "\n").replace("\r", "\n")
