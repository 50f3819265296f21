"""Arrays that nobody can change, of finite numbers: what tables and other records are made of."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgloc.errors import InputError

Array = NDArray[np.float64]


def freeze(array: Any, dtype: type = np.float64) -> NDArray[Any]:
    """A read-only array; what somebody else could still change is copied."""
    result: NDArray[Any] = np.asarray(array, dtype)
    owner = result
    while not owner.flags.writeable and isinstance(owner.base, np.ndarray):
        owner = owner.base
    if owner.flags.writeable:
        result = result.copy()
        result.flags.writeable = False
    return result


def freeze_ns(name: str, t_ns: Any, error: type[InputError] = InputError) -> NDArray[np.int64]:
    """Instants as a read-only array; `error` where they are no integers.

    A float has 53 bits, which is too few for the nanoseconds of today: they are lost already.
    """
    result = np.asarray(t_ns)
    if result.size and result.dtype.kind not in "iu":
        raise error(f"{name} is of type {result.dtype}; give whole nanoseconds as int64")
    return freeze(result, np.int64)


def sealed(array: NDArray[Any]) -> NDArray[Any]:
    """A new array that nobody else has, read-only as it stands: `freeze` need not copy it."""
    array.flags.writeable = False
    return array


def finite_rows(*columns: Array) -> NDArray[np.bool_]:
    """(N,) bool: in which rows of some columns (N, ...) all numbers are finite."""
    fine = np.ones(len(columns[0]), bool)
    for finite in map(np.isfinite, columns):
        if not finite.all():  # by rows it takes twenty times longer
            fine &= finite.reshape(len(fine), -1).all(-1)
    return fine
