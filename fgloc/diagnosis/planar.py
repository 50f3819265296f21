"""How one set of horizontal vectors comes from another: by what gain, turned or mirrored."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from fgloc.diagnosis.motion import fit
from fgloc.measurements import Array

_SIGNIFICANT = 5.0
_ROUND = 0.3


@dataclass(frozen=True)
class Planar:
    """y = gain * turn * (mirror) * x.

    gain      size of y over that of x
    turn_deg  angle from x to y counter-clockwise; of a mirrored pair that of the x axis
    mirrored  whether left and right are exchanged
    """

    gain: float
    turn_deg: float
    mirrored: bool

    @classmethod
    def of(cls, y: Array, x: Array, *, constant: bool = False) -> Self | None:
        """The relation of (S, 2) to (S, 2), or None where the data does not show one.

        With `constant`, an unknown constant may lie between.
        """
        A = np.column_stack([x, np.ones(len(x))]) if constant else x
        fits = [fit(A, column) for column in y.T]
        M = np.stack([solution[:2] for solution, _ in fits])
        sigma = np.stack([sigmas[:2] for _, sigmas in fits]).max()
        large, small = np.linalg.svd(M, compute_uv=False)
        if small < _SIGNIFICANT * sigma or small < _ROUND * large:
            return None
        turn = np.degrees(np.arctan2(M[1, 0], M[0, 0]))
        mirrored = bool(np.linalg.det(M) < 0)
        if not mirrored:
            turn = np.degrees(np.arctan2(M[1, 0] - M[0, 1], M[0, 0] + M[1, 1]))
        return cls(float(np.sqrt(large * small)), float(turn), mirrored)
