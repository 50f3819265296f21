"""Importer `nmea`: a log of NMEA-0183 sentences, from any talker (GP, GN, GL, ...).

* GGA gives the fixes. Height is the one above mean sea level plus the geoid separation, hence above
  the ellipsoid; where no fix has a separation, heights stay above mean sea level and the origin
  says so.
* RMC gives the date. A fix belongs to the day that puts it nearest to the RMC before it (before the
  first: after it), so that midnight may pass. Without RMC the day of the first fix is the option
  `date`. Speed and course of RMC are not taken: a vertical velocity is missing.
* GST of the same time gives the covariance. Without it sigmas are HDOP times `uere_m` in the plane,
  both axes alike, and one and a half times that for the height, which HDOP says nothing of.
* HDT is a heading that a drive has no table for; it is counted like all other sentences.

Left out and counted: lines that are no sentence or fail the checksum, GGA without a valid fix
(quality 0, or 6 to 8, which are not measured) or, where others have one, without a geoid
separation, fixes with an impossible covariance.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgloc.datasets.imu_files import with_imu
from fgloc.datasets.nmea_sentences import Sentence, angle_deg, date_ns, gst_covariance, parse
from fgloc.datasets.recording import (
    DAY_NS,
    INDEFINITE,
    calendar_ns,
    check_sigma,
    geodetic_fixes,
    left_out,
    read_lines,
)
from fgloc.drive import About, Drive, Rig
from fgloc.errors import DriveError
from fgloc.measurements import Array
from fgloc.timing import Instants

Mask = NDArray[np.bool_]

UERE_M = 3.0
"""Error of one range, as the user sees it, of a single-frequency receiver under an open sky."""
VERTICAL_RATIO = 1.5
"""Vertical to horizontal error of such a receiver: there are no satellites below."""

_NOT_MEASURED = (6, 7, 8)
"""Quality of dead reckoning, manual input and simulation: no satellites were needed for it."""

_USED = ("GGA", "RMC", "GST")


def import_nmea(
    source: str | Path,
    *,
    uere_m: float = UERE_M,
    date: str | None = None,
    imu: str | Path | None = None,
    imu_noise: str | Path | None = None,
) -> Drive:
    """The drive in a log, with the IMU of two files beside it where they are given.

    uere_m  error of a range in m, for fixes without GST
    date    day (UTC) of the first fix, such as 2025-07-08, for a log without RMC

    Raises DriveError where the log holds no fix, no date or a sentence whose checksum is right and
    whose content is not; InputError for a wrong option.
    """
    check_sigma("uere_m", uere_m)
    path = Path(source)
    sentences, lost = _sentences(path)
    gga = [one for one in sentences if one.kind == "GGA"]
    usable, places, has_separation = _places(gga)
    lost["GGA without a valid fix"] = int((~usable).sum())
    if has_separation.any():
        lost["GGA without a geoid separation"] = int((usable & ~has_separation).sum())
        usable &= has_separation
    chosen = [one for one, good in zip(gga, usable, strict=True) if good]
    dates = _calendar(path, sentences, chosen, date)
    t_ns = dates.instants(chosen)
    fixes, origin, lost[INDEFINITE] = geodetic_fixes(
        path, [one.line for one in chosen], t_ns, places[usable],
        _covariances(sentences, chosen, t_ns, dates, uere_m),
        datum="ellipsoid" if has_separation.any() else "msl",
    )  # fmt: skip
    drive = Drive("nmea", origin, Rig(), {"gnss": fixes}, about=_about(path, sentences, lost))
    return with_imu(drive, imu, imu_noise)


def _sentences(path: Path) -> tuple[list[Sentence], dict[str, int]]:
    """All sentences whose checksum is right, and how many lines hold none."""
    lines = [(i, line) for i, line in enumerate(read_lines(path), 1) if line.strip()]
    found = [parse(path, i, line) for i, line in lines]
    sentences = [one for one in found if one is not None]
    if not any(one.kind == "GGA" for one in sentences):
        raise DriveError(
            f"{path}: no GGA sentence with a right checksum in {len(lines)} lines; let the "
            "receiver write GGA and RMC"
        )
    return sentences, {"lines with a wrong or no checksum": len(lines) - len(sentences)}


def _places(gga: Sequence[Sentence]) -> tuple[Mask, Array, Mask]:
    """(N,) which are valid fixes, (N, 3) latitude, longitude, height, (N,) which have a separation.

    The height is above the ellipsoid where there is a separation, above mean sea level elsewhere.
    """
    rows = np.array([
        (
            one.number(6, "quality"), angle_deg(one, 2, "latitude", "NS"),
            angle_deg(one, 4, "longitude", "EW"), one.number(9, "altitude"),
            one.number(11, "geoid separation"),
        )
        for one in gga
    ])  # fmt: skip
    is_fix = (rows[:, 0] > 0) & ~np.isin(rows[:, 0], _NOT_MEASURED)
    usable: Mask = is_fix & np.isfinite(rows[:, 1:4]).all(-1)
    has_separation: Mask = usable & np.isfinite(rows[:, 4])
    places = rows[:, 1:4].copy()
    places[has_separation, 2] += rows[has_separation, 4]
    return usable, places, has_separation


@dataclass(frozen=True)
class _Calendar:
    """Lines (N,) whose instant (N,) is known, by which others get their day."""

    lines: Instants
    t_ns: Instants

    def instants(self, sentences: Sequence[Sentence]) -> Instants:
        """(M,) instants of sentences that have a time of day in their first field."""
        if not len(self.lines):
            return np.zeros(0, np.int64)
        times = np.array([one.time_of_day_ns() for one in sentences], np.int64)
        after = np.searchsorted(self.lines, [one.line for one in sentences], side="right")
        days = np.rint((self.t_ns[np.maximum(after - 1, 0)] - times) / DAY_NS).astype(np.int64)
        return np.asarray(times + days * DAY_NS, np.int64)


def _calendar(
    path: Path, sentences: Sequence[Sentence], fixes: Sequence[Sentence], date: str | None
) -> _Calendar:
    """The days by the valid RMC, or without any by the date given for the first fix."""
    valid = [one for one in sentences if one.kind == "RMC" and one.text(2) == "A"]
    if valid:
        stamps = [date_ns(one) + one.time_of_day_ns() for one in valid]
        return _Calendar(np.array([one.line for one in valid]), np.array(stamps, np.int64))
    if date is None:
        raise DriveError(
            f"{path}: no valid RMC sentence tells the date; give it: --set date=2025-07-08"
        )
    midnight_ns = calendar_ns("option date", date, "00:00:00")
    times = np.array([one.time_of_day_ns() for one in fixes], np.int64)
    days = np.cumsum(np.diff(times, prepend=times[:1]) < -DAY_NS / 2)
    return _Calendar(np.array([one.line for one in fixes]), midnight_ns + times + days * DAY_NS)


def _covariances(
    sentences: Sequence[Sentence], fixes: Sequence[Sentence], t_ns: Instants, dates: _Calendar,
    uere_m: float,
) -> Array:  # fmt: skip
    """(N, 3, 3) in m^2, ENU: that of the GST of the same instant, or by HDOP; NaN without both."""
    gst = [one for one in sentences if one.kind == "GST" and one.text(1)]
    stated = dict(zip(dates.instants(gst).tolist(), map(gst_covariance, gst), strict=True))
    hdop = np.array([one.number(8, "HDOP") for one in fixes])
    # HDOP times the range error is the error in the plane; an axis has its part of one in sqrt(2).
    axes_m = np.array([np.sqrt(0.5), np.sqrt(0.5), VERTICAL_RATIO]) * uere_m
    cov_m2: Array = (hdop[:, None] * axes_m)[:, :, None] ** 2 * np.eye(3)
    for row, instant in enumerate(t_ns.tolist()):
        if (known := stated.get(instant)) is not None:
            cov_m2[row] = known
    return cov_m2


def _about(path: Path, sentences: Sequence[Sentence], lost: dict[str, int]) -> About:
    unused = Counter(one.kind for one in sentences if one.kind not in _USED)
    names = ", ".join(f"{kind} ({n})" for kind, n in sorted(unused.items())) or "none"
    return About(
        title="GNSS log in NMEA-0183",
        source=f"{path.name}; sentences not used: {names}; {left_out(lost)}",
    )
