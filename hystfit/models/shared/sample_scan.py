"""The scan over the samples of a record. Its length can be an argument of a compiled program, which then serves records of any length."""

from __future__ import annotations

import contextlib
import contextvars
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

_count: contextvars.ContextVar[Array | int | None] = contextvars.ContextVar("count", default=None)


@contextlib.contextmanager
def first_samples(count: Array | int | None) -> Iterator[None]:
    """Context in which `scan_samples` ends after so many samples; None for all. Such scans have no derivatives in reverse mode."""
    token = _count.set(count)
    try:
        yield
    finally:
        _count.reset(token)


def scan_samples(
    body: Callable[[Any, Any], tuple[Any, Any]],
    carry: Any,
    rows: Any,
    *,
    rows_per_sample: int = 1,
    samples_per_row: int = 1,
    unroll: int = 1,
) -> tuple[Any, Any]:
    """`jax.lax.scan` over the samples of a record, or over the first of them; the outputs of the others are then zero.

    Args:
        body: takes (carry, one row) to (carry, output).
        carry: before the first row.
        rows: arrays with one row along the first axis for each step.
        rows_per_sample: steps within a sample.
        samples_per_row: samples that a step takes; the last of them may exceed the count.
        unroll: steps in one pass of the loop, which may exceed the count too; it divides the number of rows where samples are counted.

    Returns:
        The carry after the last step, and the outputs of all steps.
    """
    if (count := _count.get()) is None:
        return jax.lax.scan(body, carry, rows, unroll=unroll)
    steps = -(-count // samples_per_row) * rows_per_sample
    at = lambda values, k: jax.lax.dynamic_index_in_dim(values, k, keepdims=False)
    put = lambda values, one, k: jax.lax.dynamic_update_index_in_dim(values, one, k, 0)

    def once(turn: Array, carried: Any) -> Any:
        carry, outputs = carried
        for k in range(unroll):
            step = turn * unroll + k
            carry, one = alone(carry, jax.tree_util.tree_map(lambda values, k=step: at(values, k), rows))
            outputs = jax.tree_util.tree_map(lambda values, new, k=step: put(values, new, k), outputs, one)
        return carry, outputs

    def alone(carry: Any, row: Any) -> tuple[Any, Any]:
        with first_samples(None):  # scans inside a step are not those of the record
            return body(carry, row)

    shapes = jax.eval_shape(alone, carry, jax.tree_util.tree_map(lambda values: values[0], rows))[1]
    total = jax.tree_util.tree_leaves(rows)[0].shape[0]
    outputs = jax.tree_util.tree_map(lambda one: jnp.zeros((total, *one.shape), one.dtype), shapes)
    return jax.lax.fori_loop(0, -(-steps // unroll), once, (carry, outputs))
