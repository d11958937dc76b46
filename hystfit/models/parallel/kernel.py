"""A scan over samples that becomes one kernel of Pallas when many lanes of it run together on a GPU: `scan`, and `linear_run`."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core

from hystfit.models.parallel.lanes import Lanes, UnsupportedError, numbers
from hystfit.models.parallel.route import Route, on_gpu, route

_WIDEST = 1024  # numbers that one lane keeps
_BLOCK = 32  # lanes of one program: a warp, one lane per thread, its state in registers


def scan(body: Callable[[Any, Any], tuple[Any, Any]], carry: Any, rows: Any) -> tuple[Any, Any]:
    """`jax.lax.scan`; on a GPU, one kernel under `jax.vmap` over enough lanes. Derivatives of it are those of `jax.lax.scan`.

    Args:
        body: (carry, row) -> (carry, output).
        carry: before the first row.
        rows: arrays of leading length T.
    """
    if not on_gpu():
        return jax.lax.scan(body, carry, rows)
    row = jax.tree_util.tree_map(lambda v: jax.ShapeDtypeStruct(v.shape[1:], v.dtype), rows)
    closed, shapes = jax.make_jaxpr(body, return_shape=True)(carry, row)
    leaves, treedef = jax.tree_util.tree_flatten(carry)
    begin = [jnp.asarray(leaf, shape.dtype) for leaf, shape in zip(leaves, closed.out_avals, strict=False)]
    known = [not isinstance(c, jax.core.Tracer) and np.size(c) <= _BLOCK for c in closed.consts]
    task = _Task(closed, tuple(known), len(leaves))
    consts = [c for c, k in zip(closed.consts, known, strict=True) if not k]
    end, outputs = _over_lanes(task)(consts, begin, jax.tree_util.tree_leaves(rows))
    return treedef.unflatten(end), jax.tree_util.tree_structure(shapes[1]).unflatten(outputs)


def linear_run(
    step: Callable[..., tuple[Any, Any]], begin: tuple[Any, Any, Any, Any], rows: Any
) -> tuple[jax.Array, jax.Array]:
    """Outputs of a free run and their derivatives along p directions, shapes (T,) and (p, T), in one scan with both.

    Args:
        step: (values, state, *row) -> (state, output).
        begin: values, state, and the derivatives of both with a leading axis p.
        rows: of the scan.
    """
    values, state, by_values, by_state = begin

    def body(carry: tuple[Any, Any], row: Any) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
        push = lambda *along: jax.jvp(lambda v, s: step(v, s, *row), (values, carry[0]), along)
        (state, y), (by_state, by_y) = jax.vmap(push, out_axes=(None, 0))(by_values, carry[1])
        return (state, by_state), (y, by_y)

    _, (y, by_y) = scan(body, (state, by_state), rows)
    return y, by_y.T


class _Task(NamedTuple):
    """A traced body.

    Attributes:
        body: (consts, carry, row) -> (carry, output), as a closed jaxpr.
        known: which of its constants are values to write into the program.
        carried: number of leaves of the carry.
    """

    body: Any
    known: tuple[bool, ...]
    carried: int

    def merged(self, consts: Sequence[Any], of_known: Callable[[Any], Any]) -> list[Any]:
        """All constants, from those that are arguments and those that are known."""
        rest = iter(consts)
        return [of_known(c) if k else next(rest) for c, k in zip(self.body.consts, self.known, strict=True)]

    def plain(self, consts: Sequence[Any], begin: Sequence[Any], rows: Sequence[Any]) -> tuple[list[Any], list[Any]]:
        """The scan without a kernel."""
        function = core.jaxpr_as_fun(core.ClosedJaxpr(self.body.jaxpr, self.merged(consts, jnp.asarray)))

        def once(carry: list[Any], row: list[Any]) -> tuple[list[Any], list[Any]]:
            out = function(*carry, *row)
            return out[: self.carried], out[self.carried :]

        return jax.lax.scan(once, list(begin), list(rows))


def _over_lanes(task: _Task) -> Callable[..., tuple[list[Any], list[Any]]]:
    """The scan as a function of arrays, with its rules for derivatives and for lanes."""

    @jax.custom_batching.custom_vmap
    def lanes(consts: list[Any], begin: list[Any], rows: list[Any]) -> tuple[list[Any], list[Any]]:
        return task.plain(consts, begin, rows)

    @lanes.def_vmap
    def _(size: int, batched: Any, consts: list[Any], begin: list[Any], rows: list[Any]) -> Any:
        axes = jax.tree_util.tree_map(lambda b: 0 if b else None, list(batched))
        by_scan = jax.vmap(task.plain, in_axes=axes)
        ran = None
        if route(rows[0].shape[1 if batched[2][0] else 0], size) is Route.KERNEL:
            wide = lambda values, on: [
                v if b else jnp.broadcast_to(v, (size, *v.shape)) for v, b in zip(values, on, strict=True)
            ]
            by_kernel = lambda consts, begin, rows: in_kernel(
                task, wide(consts, batched[0]), wide(begin, batched[1]), rows, batched[2]
            )
            ran = _attempted(str(task.body), by_kernel, by_scan, (consts, begin, rows))
        if ran is None:
            ran = by_scan(consts, begin, rows)
        return ran, jax.tree_util.tree_map(lambda _: True, ran)

    @jax.custom_jvp
    def run(consts: list[Any], begin: list[Any], rows: list[Any]) -> tuple[list[Any], list[Any]]:
        return lanes(consts, begin, rows)

    run.defjvp(lambda primals, tangents: jax.jvp(task.plain, primals, tangents))
    return run


def _attempted(
    body: str, by_kernel: Callable[..., Any], by_scan: Callable[..., Any], arguments: tuple[Any, ...]
) -> Any:
    """The result of the kernel; None where there is none."""
    try:
        if interpreted():
            return by_kernel(*arguments)
        shapes = jax.tree_util.tree_map(lambda v: jax.ShapeDtypeStruct(v.shape, v.dtype), arguments)
        key = body + str(shapes)
        if key not in _compiles:
            _compiles[key] = compiles(by_kernel, shapes)
    except UnsupportedError:
        return None
    if not _compiles[key]:
        return None
    # Arrays that were put on the CPU take the scan on a machine with a GPU too.
    return jax.lax.platform_dependent(*arguments, cpu=by_scan, default=by_kernel)


_compiles: dict[str, bool] = {}  # whether the device's compiler accepted a kernel


def compiles(by_kernel: Callable[..., Any], shapes: tuple[Any, ...]) -> bool:
    """Whether the device's compiler accepts a kernel, with a warning where it does not: another device, or another version of JAX.

    Raises:
        UnsupportedError: there is no kernel for the body.
    """
    try:
        jax.jit(by_kernel).lower(*shapes).compile()
    except UnsupportedError:
        raise
    except Exception as error:  # whatever a compiler raises
        words = f"no kernel for this model on this device ({type(error).__name__}): simulations run sample by sample"
        warnings.warn(words, RuntimeWarning, stacklevel=2)
        return False
    return True


def interpreted() -> bool:
    """Whether Pallas interprets kernels: on a CPU."""
    return jax.default_backend() == "cpu"


# -- the kernel ------------------------------------------------------------------------------------------------------------------


class Packed(NamedTuple):
    """How arrays of several shapes and types lie in one array of numbers, one row per number."""

    shapes: tuple[tuple[int, ...], ...]
    types: tuple[Any, ...]

    @property
    def sizes(self) -> list[int]:
        """Numbers of each array."""
        return [int(np.prod(shape)) for shape in self.shapes]

    @property
    def rows(self) -> int:
        """Numbers of all; at least one, because empty arrays have no block."""
        return max(sum(self.sizes), 1)

    def pack(self, values: Sequence[Any], lead: tuple[int, ...]) -> jax.Array:
        """Arrays of shape (*lead, *shape) as one of shape (*lead, rows), in double precision: whole numbers up to 2^53."""
        parts = [v.reshape(*lead, size).astype(float) for v, size in zip(values, self.sizes, strict=True)]
        return jnp.concatenate(parts, axis=-1) if sum(self.sizes) else jnp.zeros((*lead, 1))

    def unpack(self, packed: jax.Array) -> list[jax.Array]:
        """The arrays, from one whose last axis has the rows."""
        places, lead = np.cumsum([0, *self.sizes]), packed.shape[:-1]
        parts = [packed[..., k : k + size] for k, size in zip(places, self.sizes, strict=False)]
        return [p.reshape(*lead, *shape).astype(t) for p, shape, t in zip(parts, self.shapes, self.types, strict=True)]

    def numbers(self, read: Callable[[int], Any]) -> list[np.ndarray]:
        """Arrays of numbers, from the number in each row."""
        out, k = [], 0
        for shape, kind in zip(self.shapes, self.types, strict=True):
            array = np.empty(shape, object)
            for at in np.ndindex(shape):
                array[at] = _cast(read(k), kind)
                k += 1
            out.append(array)
        return out


def _cast(value: Any, kind: Any) -> Any:
    return value != 0.0 if np.issubdtype(kind, bool) else value.astype(kind)


def in_kernel(
    task: _Task, consts: Sequence[Any], begin: Sequence[Any], rows: Sequence[Any], by_lane: Sequence[bool]
) -> tuple[list[Any], list[Any]]:
    """Carry at the end and outputs of all lanes, leading axis the lanes.

    Rows have a leading axis for the lanes where `by_lane` says so, then T.

    Raises:
        UnsupportedError: there is no kernel for the body.
    """
    lanes, samples = begin[0].shape[0], rows[0].shape[1 if by_lane[0] else 0]
    padded = -(-lanes // _BLOCK) * _BLOCK
    widen = lambda v: jnp.pad(v, [(0, padded - lanes), *[(0, 0)] * (v.ndim - 1)], mode="edge")
    shape = lambda values: Packed(tuple(v.shape for v in values), tuple(v.dtype for v in values))
    each = lambda values: shape([v[0] for v in values])
    shared = [r for r, own in zip(rows, by_lane, strict=True) if not own]
    own = [r for r, own in zip(rows, by_lane, strict=True) if own]
    layout = _Layout(
        each(consts),
        each(begin),
        shape([r[0] for r in shared]),
        shape([r[0, 0] for r in own]),
        shape(task.body.out_avals[task.carried :]),
        tuple(by_lane),
        samples,
        padded,
    )
    if layout.consts.rows + layout.carry.rows > _WIDEST:
        raise UnsupportedError(f"more than {_WIDEST} numbers")
    packed = (
        layout.consts.pack(list(map(widen, consts)), (padded,)).T,
        layout.carry.pack(list(map(widen, begin)), (padded,)).T,
        layout.shared.pack(shared, (samples,)),
        jnp.moveaxis(layout.own.pack(list(map(widen, own)), (padded, samples)), 0, -1),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        end, out = _call(task, layout)(*packed)
    return layout.carry.unpack(end.T[:lanes]), layout.out.unpack(jnp.moveaxis(out, -1, 0)[:lanes])


class _Layout(NamedTuple):
    """Layouts of what goes in and out of a kernel."""

    consts: Packed
    carry: Packed
    shared: Packed
    own: Packed
    out: Packed
    by_lane: tuple[bool, ...]
    samples: int
    lanes: int


def _call(task: _Task, layout: _Layout) -> Callable[..., tuple[jax.Array, jax.Array]]:
    """The kernel as a function of packed arrays: one program for each block of lanes, the loop over the samples inside."""
    from jax.experimental import pallas as pl
    from jax.experimental.pallas import triton

    def kernel(consts_ref: Any, begin_ref: Any, shared_ref: Any, own_ref: Any, end_ref: Any, out_ref: Any) -> None:
        consts = task.merged(layout.consts.numbers(lambda k: consts_ref[k, :]), numbers)
        wide = lambda v, kind: jnp.broadcast_to(jnp.asarray(v, kind), (_BLOCK,))

        def once(t: Any, state: tuple[Any, ...]) -> tuple[Any, ...]:
            left = iter(state)
            carry = [_filled(s, left) for s in layout.carry.shapes]
            shared = iter(layout.shared.numbers(lambda k: shared_ref[t, k]))
            own = iter(layout.own.numbers(lambda k: own_ref[t, k, :]))
            row = [next(own if lane else shared) for lane in layout.by_lane]
            result = Lanes().run(task.body.jaxpr, consts, [*carry, *row])
            outputs = [v for part in result[task.carried :] for v in part.flat]
            for k, value in enumerate(outputs):
                out_ref[t, k, :] = wide(value, float)
            kinds = [
                kind for kind, size in zip(layout.carry.types, layout.carry.sizes, strict=True) for _ in range(size)
            ]
            flat = [v for part in result[: task.carried] for v in part.flat]
            return tuple(wide(v, kind) for v, kind in zip(flat, kinds, strict=True))

        begin = tuple(v for part in layout.carry.numbers(lambda k: begin_ref[k, :]) for v in part.flat)
        end = jax.lax.fori_loop(np.int32(0), np.int32(layout.samples), once, begin)
        for k, value in enumerate(end):
            end_ref[k, :] = wide(value, float)

    T, by_block = layout.samples, lambda n: pl.BlockSpec((n, _BLOCK), lambda i: (0, i))
    in_time = lambda n: pl.BlockSpec((T, n, _BLOCK), lambda i: (0, 0, i))
    struct = lambda *shape: jax.ShapeDtypeStruct(shape, np.float64)
    return pl.pallas_call(
        kernel,
        grid=(layout.lanes // _BLOCK,),
        in_specs=[
            by_block(layout.consts.rows),
            by_block(layout.carry.rows),
            pl.BlockSpec((T, layout.shared.rows), lambda i: (0, 0)),
            in_time(layout.own.rows),
        ],
        out_specs=(by_block(layout.carry.rows), in_time(layout.out.rows)),
        out_shape=(struct(layout.carry.rows, layout.lanes), struct(T, layout.out.rows, layout.lanes)),
        compiler_params=triton.CompilerParams(num_warps=1, num_stages=1),
        interpret=interpreted(),
    )


def _filled(shape: tuple[int, ...], values: Any) -> np.ndarray:
    out = np.empty(shape, object)
    for at in np.ndindex(shape):
        out[at] = next(values)
    return out
