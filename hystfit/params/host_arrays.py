"""Values of the host as arrays of JAX, without a program compiled for each shape."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
from jax import dtypes

from hystfit.config import compile_whole_loops

compile_whole_loops()  # before JAX computes: every model is made of arrays from here


def to_device(values: Any, dtype: Any = None) -> jax.Array:
    """Numbers or a NumPy array as an array of JAX.

    `jnp.asarray` compiles a program for most values; each takes 10 to 30 ms in the first fit of a process.

    Args:
        values: numbers, nested lists of them, or an array, any shape.
        dtype: of the result; default: that of the values, in the precision of JAX.
    """
    array = np.asarray(values)
    return jax.device_put(np.asarray(array, dtypes.canonicalize_dtype(dtype or array.dtype)))
