"""What is told at an instant of the cooperative graph, as whitened rows on its variables."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from fgloc.measurements import Array

Name = tuple[str, int]
"""Of a variable of the core: its letter in `cooperative_model`, and whose it is."""
STEADY = np.iinfo(np.int64).min
"""No source of a slow error."""
SIZES = {"n": 3, "h": 1, "b": 2, "s": 4, "o": 2}
HEADING: Name = ("h", 0)
ERRORS: Name = ("o", 0)
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Rows:
    """Whitened rows sum A x = b (n, 2) on variables of the core.

    terms   for each: index (m,) among the rows, names (m), A (m, 2, d)
    """

    b: Array
    terms: list[tuple[Index, list[Name], Array]]


@dataclass(frozen=True, eq=False)
class Places:
    """Where tracks (n,) were seen or say they are: whitened rows W p + off n[col] = b.

    W (n, 2, 2), b (n, 2), off (n, 2, 3) already whitened; col (n,) first column of the node's
    survey, -1 where there is none; slow (n,) the source of the slow error in it, or `STEADY`
    """

    track: Index
    W: Array
    b: Array
    col: Index
    off: Array
    slow: Index

    def of(self, tracks: Index) -> "Places":
        """Those of some tracks."""
        return self[np.isin(self.track, tracks)]

    def __add__(self, more: "Places") -> "Places":
        return Places(*(np.concatenate([getattr(one, field.name) for one in (self, more)])
                        for field in fields(self)))  # fmt: skip

    def __getitem__(self, which: Index | NDArray[np.bool_]) -> "Places":
        return Places(self.track[which], self.W[which], self.b[which], self.col[which],
                      self.off[which], self.slow[which])  # fmt: skip
