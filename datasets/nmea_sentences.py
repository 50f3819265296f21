"""NMEA-0183 sentences: checksum, type and fields, and what GGA, RMC and GST say.

Field numbers in messages count from 1 after the type, as receivers' manuals do.
"""

from dataclasses import dataclass
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np

from fgloc.datasets import recording
from fgloc.datasets.recording import calendar_ns
from fgloc.errors import DriveError
from fgloc.measurements import Array

_NAN = float("nan")


@dataclass(frozen=True)
class Sentence:
    """One sentence with a right checksum: `kind` without the talker, such as GGA."""

    path: Path
    line: int
    kind: str
    fields: tuple[str, ...]

    @property
    def where(self) -> str:
        """File and line, for messages."""
        return f"{self.path}:{self.line}"

    def text(self, i: int) -> str:
        """Field i, counted from 1; empty where the sentence is shorter."""
        return self.fields[i - 1].strip() if i <= len(self.fields) else ""

    def number(self, i: int, name: str) -> float:
        """Field i as a number, NaN where it is empty; DriveError where it is none."""
        text = self.text(i)
        return recording.number(self.where, f"{self.kind} {name}", text) if text else _NAN

    def time_of_day_ns(self) -> int:
        """Field 1, hhmmss.ss, in nanoseconds; DriveError where it is none."""
        clock = self.text(1)
        if not clock[:6].isdecimal() or len(clock) < 6:
            raise DriveError(f"{self.where}: {self.kind} time = {clock!r} is not hhmmss.ss")
        return calendar_ns(self.where, "1970-01-01", f"{clock[:2]}:{clock[2:4]}:{clock[4:]}")


def parse(path: Path, number: int, line: str) -> Sentence | None:
    """The sentence in line `number` of a file, or None.

    None stands for a line without a sentence and for one whose checksum is missing or wrong.
    """
    _, dollar, rest = line.strip().rpartition("$")
    body, star, checksum = rest.partition("*")
    if not (dollar and star) or checksum_of(body) != checksum[:2].upper():
        return None
    name, *fields = body.split(",")
    return Sentence(path, number, name[-3:], tuple(fields))


def checksum_of(body: str) -> str:
    """The two hexadecimal digits for what stands between $ and *: all characters by XOR."""
    return f"{reduce(xor, body.encode(), 0):02X}"


def angle_deg(sentence: Sentence, i: int, name: str, signs: str) -> float:
    """Degrees of field i, (d)ddmm.mmm, with the hemisphere after it; `signs` is NS or EW.

    NaN where the field is empty; DriveError where it is no angle.
    """
    value = sentence.number(i, name)
    hemisphere = sentence.text(i + 1).upper()
    if np.isnan(value):
        return value
    degrees, minutes = divmod(value, 100)
    if minutes >= 60 or value < 0 or hemisphere not in tuple(signs):
        raise DriveError(
            f"{sentence.where}: {sentence.kind} {name} = {sentence.text(i)},{sentence.text(i + 1)} "
            f"is not degrees and minutes with {' or '.join(signs)}"
        )
    return (degrees + minutes / 60) * (1 if hemisphere == signs[0] else -1)


def date_ns(sentence: Sentence) -> int:
    """Midnight in nanoseconds since 1970 of an RMC's date, ddmmyy; DriveError where it is none."""
    date = sentence.text(9)
    if not (date.isdecimal() and len(date) == 6):
        raise DriveError(f"{sentence.where}: RMC date = {date!r} is not ddmmyy")
    century = 19 if int(date[4:]) >= 80 else 20  # GPS time began in 1980
    return calendar_ns(sentence.where, f"{century}{date[4:]}-{date[2:4]}-{date[:2]}", "00:00:00")


def gst_covariance(sentence: Sentence) -> Array | None:
    """(3, 3) in m^2, ENU, of a GST: by its error ellipse, or by the sigmas of each axis.

    The ellipse is taken where all of it is given, since it alone knows the correlation. None where
    the fields are empty.
    """
    major, minor, heading_deg, north, east, up = (
        sentence.number(i, "field") for i in range(3, 9)
    )  # fmt: skip
    cov_m2 = np.diag([east, north, up]) ** 2
    if not np.isnan([major, minor, heading_deg]).any():
        sine, cosine = np.sin(np.deg2rad(heading_deg)), np.cos(np.deg2rad(heading_deg))
        axes = np.array([[sine, cosine], [cosine, -sine]])  # columns: the major, the minor axis
        cov_m2[:2, :2] = axes @ np.diag([major**2, minor**2]) @ axes.T
    return None if np.isnan(cov_m2).any() else cov_m2
