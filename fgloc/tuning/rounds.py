"""Which fixes are withheld together, and which of them the search never sees.

The fixes are cut into stretches of the longest outage. Every fourth is unseen: the search neither
scores its fixes nor takes them in. Of three seen ones in a row the middle one is withheld as a
whole, and within all three every second block of the shorter lengths, then the others. The unseen
stretches are judged in the same way at the end, with all other fixes taken in. The first and the
last stretch are always taken in: a vehicle that has yet to move, or whose drive ends, says little
of a gap.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgloc.errors import InputError

SHORTEST_S = 30.0
"""A drive shorter than this says nothing of how errors grow."""
STRETCHES, FIXES_EACH = 12, 2
"""At least so many stretches with at least so many fixes: three of them are unseen."""
CYCLE, WHOLE, UNSEEN = 4, 1, 3


@dataclass(frozen=True, eq=False)
class Round:
    """One smoothing without some fixes: `withheld` (fixes,) bool, `scored` (k,) those compared.

    fixes    how many are withheld in a row
    stretch  (k,) the stretch of each scored fix; errors of different ones are independent
    """

    fixes: int
    withheld: NDArray[np.bool_]
    scored: NDArray[np.int64]
    stretch: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Rounds:
    """All rounds of a drive: those of the search, and the unseen; and of each fix (fixes,) the time
    in s, the stretch and whether it is seen (1), unseen (-1) or always taken in (0)."""

    seen: tuple[Round, ...]
    unseen: tuple[Round, ...]
    lengths: tuple[int, ...]
    t_s: NDArray[np.float64]
    stretch: NDArray[np.int64]
    side: NDArray[np.int64]


def make_rounds(t_s: NDArray[np.float64], outage_s: float, name: str) -> Rounds:
    """Rounds for fixes at times (N,), in s, with outages up to `outage_s` where the drive allows.

    The lengths are one fix, the longest outage and their geometric mean: short gaps show the noise
    of the fixes, long ones that of the IMU. Raises InputError for a drive that is too short or has
    too few fixes.
    """
    n, duration_s = len(t_s), float(t_s[-1] - t_s[0])
    if n < STRETCHES * FIXES_EACH or duration_s < SHORTEST_S:
        raise InputError(
            f"drive {name!r} has {n} usable fixes over {duration_s:.1f} s; to find its noise takes "
            f"at least {STRETCHES * FIXES_EACH} over {SHORTEST_S:g} s: give a longer drive"
        )
    wanted = round(outage_s / float(np.median(np.diff(t_s))))
    longest = int(np.clip(wanted, FIXES_EACH, n // STRETCHES))
    lengths = sorted({1, round(longest**0.5), longest})
    stretch = np.arange(n) // longest
    kind = stretch % CYCLE
    kind[(stretch == 0) | (stretch >= (n - 1) // longest)] = -1
    unseen = kind == UNSEEN
    seen = _rounds(stretch, lengths, (kind >= 0) & ~unseen, kind == WHOLE, unseen)
    judged = _rounds(stretch, lengths, unseen, unseen, np.zeros(n, bool))
    side = np.where(kind < 0, 0, np.where(unseen, -1, 1))
    return Rounds(seen, judged, tuple(lengths), t_s, stretch, side)


def _rounds(
    stretch: NDArray[np.int64], lengths: list[int], parts: NDArray[np.bool_],
    whole: NDArray[np.bool_], always: NDArray[np.bool_],
) -> tuple[Round, ...]:  # fmt: skip
    """Two rounds for each length but the longest, of blocks within `parts`; then `whole`."""
    place = np.arange(len(stretch))
    masks = [
        (length, parts & (place // length % 2 == side))
        for length in lengths[:-1]
        for side in (0, 1)
    ]
    return tuple(
        Round(length, scored | always, np.flatnonzero(scored), stretch[scored])
        for length, scored in [*masks, (lengths[-1], whole)]
    )
