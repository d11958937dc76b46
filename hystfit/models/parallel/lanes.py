"""A traced function evaluated number by number, for many lanes at once.

Kernels of Triton have arrays of one power of two; they can neither index nor concatenate. Here every array of a function is a NumPy
array of numbers, each of which is an array over the lanes: indexing, stacking and reshaping happen while the kernel is traced.
"""

from __future__ import annotations

import functools
import itertools
import operator
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core

_LARGEST = 20_000  # operations on numbers in one step, beyond which a kernel takes minutes to compile
_UNROLLED = 64  # length of an inner loop

_ELEMENTWISE = frozenset(
    "abs acos acosh add add_any and asin asinh atan atan2 atanh cbrt ceil clamp convert_element_type copy copy_p cos cosh div eq erf "
    "exp exp2 expm1 floor ge gt integer_pow is_finite le log log1p logistic lt max min mul ne neg not or pow rem round rsqrt "
    "select_n sign sin sinh sqrt square stop_gradient sub tan tanh xor".split()
)
_INNER = {
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "closed_call": "call_jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "remat2": "jaxpr",
}
_INNER |= {"custom_vjp_call": "call_jaxpr", "checkpoint": "jaxpr", "core_call": "call_jaxpr"}
_REDUCTIONS: dict[str, Callable[[Any, Any], Any]] = {
    "reduce_sum": operator.add,
    "reduce_prod": operator.mul,
    "reduce_max": jnp.maximum,
    "reduce_min": jnp.minimum,
    "reduce_and": operator.and_,
    "reduce_or": operator.or_,
}
_MOVED = {
    "gather": (0,),
    "dynamic_slice": (0,),
    "scatter": (0, 2),
    "dynamic_update_slice": (0, 1),
}  # the rest are positions
_MOVERS = frozenset(_MOVED) | {"concatenate", "pad", "rev", "slice", "split", "stack", "unstack", "transpose"}


class UnsupportedError(Exception):
    """The function has an operation that has no form over lanes."""


def numbers(array: Any) -> np.ndarray:
    """An array of known values as an array of its numbers, each of the array's type."""
    array = np.asarray(array)
    out = np.empty(array.shape, object)
    for at in np.ndindex(array.shape):
        out[at] = array[at]
    return out


class Lanes:
    """Evaluates a jaxpr on arrays of numbers; see the module."""

    def __init__(self) -> None:
        self.count = 0

    def run(self, jaxpr: Any, consts: Sequence[np.ndarray], values: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Outputs of a jaxpr.

        Raises:
            UnsupportedError: an operation, or a number of them, for which a kernel is not the place.
        """
        known = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*consts, *values], strict=True))
        read = lambda v: numbers(v.val) if isinstance(v, core.Literal) else known[v]
        for eqn in jaxpr.eqns:
            outs = self._apply(eqn, [read(v) for v in eqn.invars])
            known.update(zip(eqn.outvars, outs, strict=True))
        return [read(v) for v in jaxpr.outvars]

    def _apply(self, eqn: Any, values: list[np.ndarray]) -> list[np.ndarray]:
        name, params, avals = eqn.primitive.name, eqn.params, [v.aval for v in eqn.outvars]
        if name in _ELEMENTWISE:
            return [self._elementwise(functools.partial(eqn.primitive.bind, **params), values)]
        if name in _INNER:
            return self._inner(params[_INNER[name]], values)
        if name in ("reshape", "squeeze", "expand_dims"):
            return [values[0].reshape(avals[0].shape)]
        if name == "broadcast_in_dim":
            shape = np.ones(len(avals[0].shape), int)
            shape[list(params["broadcast_dimensions"])] = values[0].shape
            return [np.broadcast_to(values[0].reshape(shape), avals[0].shape)]
        if name == "iota":
            shape, at = avals[0].shape, params["dimension"]
            line = np.arange(shape[at], dtype=avals[0].dtype).reshape([-1 if k == at else 1 for k in range(len(shape))])
            return [numbers(np.broadcast_to(line, shape))]
        if name in _MOVERS:
            return self._moved(eqn.primitive, params, values, _MOVED.get(name, range(len(values))))
        if name in _REDUCTIONS:
            return [self._reduced(_REDUCTIONS[name], values[0], params["axes"])]
        if name == "dot_general":
            return [self._dot(*values, params["dimension_numbers"])]
        if name == "cond":
            return self._cond(params["branches"], values)
        if name == "scan":
            return self._loop(params, values)
        raise UnsupportedError(name)

    def _inner(self, jaxpr: Any, values: Sequence[np.ndarray]) -> list[np.ndarray]:
        closed = isinstance(jaxpr, core.ClosedJaxpr)
        consts = [numbers(c) for c in jaxpr.consts] if closed else []
        return self.run(jaxpr.jaxpr if closed else jaxpr, consts, values)

    def _elementwise(self, function: Callable[..., Any], values: Sequence[np.ndarray]) -> np.ndarray:
        rows = np.broadcast_arrays(*values)
        out = np.empty(rows[0].shape, object)
        for at in np.ndindex(out.shape):
            out[at] = self._bind(function, [row[at] for row in rows])
        return out

    def _bind(self, function: Callable[..., Any], values: Sequence[Any]) -> Any:
        """A function of numbers, some of which may be the same for all lanes, or known."""
        self.count += 1
        if self.count > _LARGEST:
            raise UnsupportedError(f"more than {_LARGEST} operations")
        if all(isinstance(value, np.generic) for value in values):
            with jax.ensure_compile_time_eval():
                return np.asarray(function(*values))[()]
        shape = max((np.shape(value) for value in values), key=len)
        return function(*(value if np.shape(value) == shape else jnp.broadcast_to(value, shape) for value in values))

    def _reduced(self, join: Callable[[Any, Any], Any], values: np.ndarray, axes: Sequence[int]) -> np.ndarray:
        kept = [k for k in range(values.ndim) if k not in axes]
        rows = values.transpose([*kept, *axes]).reshape(*(values.shape[k] for k in kept), -1)
        if not rows.shape[-1]:
            raise UnsupportedError("a reduction of nothing")
        out = np.empty(rows.shape[:-1], object)
        for at in np.ndindex(out.shape):
            out[at] = functools.reduce(lambda a, b: self._bind(join, (a, b)), rows[at])
        return out

    def _dot(self, a: np.ndarray, b: np.ndarray, dimensions: Any) -> np.ndarray:
        (sum_a, sum_b), (batch_a, batch_b) = dimensions

        def blocked(values: np.ndarray, summed: Sequence[int], batch: Sequence[int]) -> tuple[np.ndarray, Any]:
            free = [k for k in range(values.ndim) if k not in (*summed, *batch)]
            ordered = values.transpose([*batch, *free, *summed])
            kept = len(batch) + len(free)
            edges = itertools.pairwise((0, len(batch), kept, None))
            return ordered.reshape([int(np.prod(ordered.shape[i:j])) for i, j in edges]), ordered.shape[:kept]

        (rows, shape), (columns, other) = blocked(a, sum_a, batch_a), blocked(b, sum_b, batch_b)
        product = self._elementwise(operator.mul, (rows[:, :, None], columns[:, None]))
        return self._reduced(operator.add, product, (3,)).reshape((*shape, *other[len(batch_b) :]))

    def _moved(self, primitive: Any, params: dict[str, Any], values: list[np.ndarray], data: Any) -> list[np.ndarray]:
        """The operation on the places of the numbers, then the numbers at the places."""
        edges = np.cumsum([0, *(values[k].size for k in data)])
        line = np.concatenate([values[k].reshape(-1) for k in data])
        operands = [self._known(value) if k not in data else None for k, value in enumerate(values)]
        for k, begin in zip(data, edges[:-1], strict=True):
            operands[k] = np.arange(begin, begin + values[k].size, dtype=np.int32).reshape(values[k].shape)
        with jax.ensure_compile_time_eval():
            out = primitive.bind(*map(jnp.asarray, operands), **params)
        places = [np.asarray(part) for part in (out if primitive.multiple_results else [out])]
        if any(part.size and not (0 <= part.min() and part.max() < line.size) for part in places):
            raise UnsupportedError("a place out of range")
        return [line[part] for part in places]

    def _known(self, values: np.ndarray) -> np.ndarray:
        if not all(isinstance(value, np.generic) for value in values.flat):
            raise UnsupportedError("a place that depends on the lane or the sample")
        if not values.size:
            return np.zeros(values.shape, int)
        return np.array(values.tolist(), dtype=values.flat[0].dtype).reshape(values.shape)

    def _cond(self, branches: Sequence[Any], values: list[np.ndarray]) -> list[np.ndarray]:
        """All branches, and a selection: lanes may differ."""
        which, *rest = values
        results = [self._inner(branch, rest) for branch in branches]
        chosen = results[-1]
        for k in range(len(branches) - 2, -1, -1):
            here = self._bind(lambda w, k=k: w <= k, [which[()]])
            pick = np.vectorize(lambda a, b, here=here: self._bind(jnp.where, (here, a, b)), otypes=[object])
            chosen = [pick(a, b) if a.size else a for a, b in zip(results[k], chosen, strict=True)]
        return chosen

    def _loop(self, params: dict[str, Any], values: list[np.ndarray]) -> list[np.ndarray]:
        """An inner loop of few steps, written out."""
        length, n, m = params["length"], params["num_consts"], params["num_carry"]
        if length > _UNROLLED or "while" in params:
            raise UnsupportedError(f"an inner loop of {length} steps")
        consts, carry, rows = values[:n], values[n : n + m], values[n + m :]
        outs: list[Any] = [None] * length
        for k in reversed(range(length)) if params["reverse"] else range(length):
            result = self._inner(params["jaxpr"], [*consts, *carry, *(row[k] for row in rows)])
            carry, outs[k] = result[:m], result[m:]
        return [*carry, *(np.stack(column) for column in zip(*outs, strict=True))]
