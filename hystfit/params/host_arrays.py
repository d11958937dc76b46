"""NumPy values as JAX arrays, without compiling a program for each shape."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax
import numpy as np
from jax import dtypes

from hystfit.config import on_device, program_options, set_compiler_flags
from hystfit.params.kept_programs import ARRAYS, kept, unoptimized

_P = ParamSpec("_P")
_R = TypeVar("_R")
NUMBERS = 2**21  # of an array that is computed at once (16 MiB in double precision)
set_compiler_flags()  # before JAX computes: every model is made of arrays from here


_ALIGNED = 64  # bytes, at which arrays begin that JAX takes on a CPU without a copy


def zeros(*shape: int) -> np.ndarray:
    """Zeros that JAX takes on a CPU without a copy; they must not change from then on."""
    size = math.prod(shape)
    room = np.zeros(size + _ALIGNED // 8)
    first = -room.ctypes.data % _ALIGNED // 8
    return room[first : first + size].reshape(shape)


def to_device(values: Any, dtype: Any = None) -> jax.Array:
    """Numbers or a NumPy array as an array of JAX, of this dtype or that of the values, in the precision of JAX.

    `jnp.asarray` compiles a program for most values; each takes 10 to 30 ms in the first fit of a process.
    """
    array = np.asarray(values)
    with on_device():
        return jax.device_put(np.asarray(array, dtypes.canonicalize_dtype(dtype or array.dtype)))


def compiled(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """`equinox.filter_jit`, at a third of its cost per call where all leaves of the arguments are arrays or NumPy numbers.

    For functions at the level of a module, of positional arguments that are trees. The command line keeps its programs on disk
    (`hystfit.params.kept_programs`).
    """
    programs = dict[Any, Callable[..., _R]]()

    @functools.cache
    def of_any(unoptimized: bool) -> Callable[..., _R]:
        return eqx.filter_jit(function, compiler_options=program_options(unoptimized))

    def program_for(structure: Any, unoptimized: bool) -> Callable[..., _R]:
        of_trees: Callable[..., _R] = function

        def of_leaves(*leaves: Any) -> _R:
            return of_trees(*structure.unflatten(leaves))

        of_leaves.__name__ = function.__name__
        program = jax.jit(of_leaves, compiler_options=program_options(unoptimized))
        return programs.setdefault((structure, unoptimized), program)

    @functools.wraps(function)
    def call(*trees: Any) -> _R:
        leaves, structure = jax.tree_util.tree_flatten(trees)
        quick = unoptimized(leaves)
        with on_device():
            if not all(isinstance(leaf, ARRAYS) for leaf in leaves):
                return of_any(quick)(*trees)
            # JAX would flatten the trees once more: half the time of a short simulation.
            return (programs.get((structure, quick)) or program_for(structure, quick))(*leaves)

    return kept(function, call)
