"""LAPACK's banded Cholesky, called without Python's lock, so that two run side by side.

scipy's wrappers for Python keep the lock; the functions that it offers to compiled code do not ask
for it. They are called by their address, from an extension module that is loaded by itself: all of
scipy.linalg takes longer to import than the matrix of an hour's drive to factorise.
"""

import ctypes
import sys
from importlib import import_module
from importlib.machinery import PathFinder
from importlib.util import module_from_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from fgloc.measurements import Array

OFFERED = "scipy.linalg.cython_lapack"
"""The extension module with what scipy offers to compiled code."""
_name_of = ctypes.PYFUNCTYPE(ctypes.c_char_p, ctypes.py_object)(
    ("PyCapsule_GetName", ctypes.pythonapi)
)
_address_of = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.py_object, ctypes.c_char_p)(
    ("PyCapsule_GetPointer", ctypes.pythonapi)
)


def factorize(band: Array, width: int) -> int:
    """The Cholesky factor L of a symmetric matrix, in its place.

    Row j of the band (m, > width) holds column j of the matrix from the diagonal on, down to so
    many places below it. Returns 0, or the first j, counted from 1, from which on the matrix is not
    positive definite.
    """
    failed = ctypes.c_int64()
    DPBTRF(
        b"L", _number(len(band)), _number(width), _start(band), _number(band.shape[1]),
        ctypes.byref(failed),
    )  # fmt: skip
    return failed.value


def substitute(band: Array, width: int, columns: Array, *, transposed: bool = False) -> None:
    """Solve L x = b or, transposed, L' x = b in the place of each b of some columns (k, m); the
    band is that of `factorize`."""
    DTBTRS(
        b"L", b"T" if transposed else b"N", b"N", _number(len(band)), _number(width),
        _number(len(columns)), _start(band), _number(band.shape[1]), _start(columns),
        _number(len(band)), _number(0),
    )  # fmt: skip


def _number(value: int) -> Any:
    """By its address, and 64 bits wide: the lower 32 alone tell the same to who reads no more."""
    return ctypes.byref(ctypes.c_int64(value))


def _start(array: Array) -> ctypes.c_void_p:
    """Where an array begins."""
    if not (array.flags.c_contiguous and array.dtype == np.float64):
        raise ValueError("LAPACK takes contiguous arrays of float64 alone")
    return ctypes.c_void_p(array.ctypes.data)


def _offered() -> ModuleType:
    """scipy's module of functions, by itself where scipy.linalg has not been imported yet."""
    import scipy

    spec = PathFinder.find_spec(OFFERED, [str(Path(scipy.__file__).parent / "linalg")])
    if "scipy.linalg" in sys.modules or spec is None or spec.loader is None:
        return import_module(OFFERED)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    # It is there once in a process. Who imports it from scipy.linalg later shall find it as if
    # nobody had before: as the same module, and as an attribute of its package.
    sys.modules.pop(OFFERED, None)
    return module


def _function(name: str) -> Any:
    """One of the functions: its address is in a capsule that is named by its signature."""
    capsule = MODULE.__pyx_capi__[name]
    return ctypes.CFUNCTYPE(None)(_address_of(capsule, _name_of(capsule)))


MODULE = _offered()
DPBTRF, DTBTRS = _function("dpbtrf"), _function("dtbtrs")
