"""The traced half of a parameter space: maps between physical and unconstrained coordinates.

no bound      x = scale z                one bound   x = lower + scale exp(z)   (or upper - scale exp(z))
two bounds    x = lower + (upper - lower) / (1 + exp(-z))
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.params.host_arrays import to_device
from hystfit.params.plain_module import PlainModule

REAL, LOWER, UPPER, BOTH = range(4)


def _physical(z: Any, lower: Any, upper: Any, scale: Any, kinds: tuple[int, ...], xp: Any = jnp) -> Any:
    kind = xp.asarray(kinds, dtype=int)
    # One exponential for all maps; for two bounds it is exp(-|z|), measured from the nearer bound, so that the slope is
    # accurate next to either. Without a bound its argument is 0: a branch that is not selected must not overflow in the gradient.
    away = xp.where(kind == BOTH, xp.where(z < 0, z, -z), z)
    grown = xp.exp(xp.where(kind == REAL, 0.0, away))
    low = xp.where(xp.isfinite(lower), lower, 0.0)
    high = xp.where(xp.isfinite(upper), upper, 0.0)
    x = xp.where(kind == REAL, scale * z, low + scale * grown)
    x = xp.where(kind == UPPER, high - scale * grown, x)
    part = (high - low) * grown / (1.0 + grown)
    both = xp.where(z < 0, low + part, high - part)
    return xp.where(kind == BOTH, both, x)


# Jitted because samplers call them outside traced code too.
_physical_traced = functools.partial(jax.jit, static_argnums=4, inline=True)(_physical)


def _slope(z: Any, lower: Any, upper: Any, scale: Any, kinds: tuple[int, ...], xp: Any = jnp) -> Any:
    kind = xp.asarray(kinds, dtype=int)
    grown = xp.exp(xp.where(kind == BOTH, -xp.abs(z), xp.where(kind == REAL, 0.0, z)))
    width = xp.where(kind == BOTH, upper - lower, 0.0)
    one = scale * xp.where(kind == UPPER, -grown, grown)
    return xp.where(kind == BOTH, width * grown / (1.0 + grown) ** 2, one)


_slope_traced = functools.partial(jax.jit, static_argnums=4, inline=True)(_slope)


class Coordinates(PlainModule):
    """The traced half of a `ParameterSpace`: arrays and structure without labels, which would cause compilations."""

    leaves: tuple[Any, ...]  # all leaves of the template tree
    lower: Float[Array, " p"]  # lower, upper, scale: of each free element, shape (p,)
    upper: Float[Array, " p"]
    scale: Float[Array, " p"]
    kinds: tuple[int, ...] = eqx.field(static=True)  # map of each free element
    # for each leaf with free elements (leaf index, flat positions, whether it differs between records)
    layout: tuple[tuple[int, tuple[int, ...], bool], ...] = eqx.field(static=True)
    treedef: Any = eqx.field(static=True)
    n_records: int = eqx.field(static=True)
    # values of leaves that are given for each record (covariates), shapes (R, ...), at the indices `constant_at`
    constants: tuple[Any, ...] = ()
    constant_at: tuple[int, ...] = eqx.field(static=True, default=())
    # elements that follow from others: (leaf index, flat position, those of the source, factor, constant)
    ties: tuple[tuple[int, int, int, int, float, float], ...] = eqx.field(static=True, default=())

    def at(self, tree: Any) -> Coordinates:
        """The same coordinates with the constants of a tree for every record: for predictions of another one."""
        leaves = jax.tree_util.tree_leaves(tree)
        rows = [
            np.broadcast_to(leaves[k], np.shape(old)) for k, old in zip(self.constant_at, self.constants, strict=True)
        ]
        return eqx.tree_at(lambda c: c.constants, self, tuple(map(to_device, rows))) if rows else self

    @property
    def own_count(self) -> int:
        """Number m of the parameters that each record depends on, see `own`."""
        return sum(len(positions) for _, positions, _ in self.layout)

    @property
    def own(self) -> np.ndarray:
        """Positions in x of the m parameters that each of R records depends on, shape (R, m)."""
        columns, start = [np.zeros((self.n_records, 0), dtype=int)], 0
        for _, positions, per_record in self.layout:
            count = len(positions)
            block = start + np.arange(count * (self.n_records if per_record else 1)).reshape(-1, count)
            columns.append(np.broadcast_to(block, (self.n_records, count)))
            start += block.size
        return np.hstack(columns)

    def physical(self, z: Any, xp: Any = jnp) -> Any:
        """x from z, shape (p,); `xp` is the module of the arrays, as in `unconstrained`."""
        return self._mapped(_physical_traced if xp is jnp else _physical, z, xp)

    def unconstrained(self, x: Any, inside: float = 1e-9, xp: Any = jnp) -> Any:
        """z from physical x, shape (p,); values on a bound or beyond are moved inside, as the maps reach a bound only in the limit.

        They are moved by a fraction `inside` of the scale or of the interval: an estimate stays at its bound with a small one; a start can
        leave it with a large one. `xp` is jax.numpy, also inside traced code, or numpy.
        """
        lower, upper, scale, kind = (xp.asarray(v) for v in (self.lower, self.upper, self.scale, self.kinds))
        low = xp.where(xp.isfinite(lower), lower, 0.0)
        high = xp.where(xp.isfinite(upper), upper, 0.0)
        edge = inside * xp.where(kind == BOTH, high - low, scale)
        above, below = (xp.where(distance > 0, distance, edge) for distance in (x - low, high - x))
        z = xp.where(kind == LOWER, xp.log(above / scale), x / scale)
        z = xp.where(kind == UPPER, xp.log(below / scale), z)
        return xp.where(kind == BOTH, xp.log(above) - xp.log(below), z)

    def slope(self, z: Any, xp: Any = jnp) -> Any:
        """dx/dz, element by element (the maps do not mix parameters), shape (p,); `xp` as in `physical`."""
        return self._mapped(_slope_traced if xp is jnp else _slope, z, xp)

    def _mapped(self, map_of: Callable[..., Any], z: Any, xp: Any) -> Any:
        """A map of z by the bounds and scales, traced or on the host."""
        if xp is jnp:
            return map_of(z, self.lower, self.upper, self.scale, self.kinds)
        with np.errstate(all="ignore"):
            return map_of(*(np.asarray(v, float) for v in (z, self.lower, self.upper, self.scale)), self.kinds, np)

    def log_jacobian(self, z: Float[Array, " p"]) -> Float[Array, ""]:
        """log |det dx/dz|."""
        kind = jnp.asarray(self.kinds, dtype=int)
        free = jnp.log(self.scale)
        width = jnp.where(kind == BOTH, self.upper - self.lower, 1.0)
        both = jnp.log(width) + jax.nn.log_sigmoid(z) + jax.nn.log_sigmoid(-z)
        return jnp.sum(jnp.where(kind == REAL, free, jnp.where(kind == BOTH, both, free + z)))

    def assemble(
        self, x: Float[Array, " p"] | Float[np.ndarray, " p"], record: Any = 0, place: Callable[[Any], Any] = to_device
    ) -> Any:
        """The tree with the free elements set from x, with the parameters of record number `record`.

        NumPy values are set on the host: operations of JAX outside compiled code would take a hundred times longer. `place` then makes
        the leaves of the arrays; `np.asarray` leaves them on the host.
        """
        leaves, start = list(self.leaves), 0
        if isinstance(x, np.ndarray):
            for index, rows in self._rows(x[None], record).items():
                leaves[index] = place(rows[0])
            return self.treedef.unflatten(leaves)
        for index, rows in zip(self.constant_at, self.constants, strict=True):
            leaves[index] = jnp.take(rows, jnp.asarray(record), axis=0)
        for index, positions, per_record in self.layout:
            count = len(positions)
            values = x[start : start + count]
            if per_record:
                block = x[start : start + count * self.n_records].reshape(self.n_records, count)
                values = jnp.take(block, jnp.asarray(record), axis=0)
            start += count * (self.n_records if per_record else 1)
            leaf = jnp.asarray(leaves[index])
            flat = values if count == leaf.size else leaf.reshape(-1).at[np.asarray(positions)].set(values)
            leaves[index] = flat.reshape(leaf.shape)
        for index, k, source, j, factor, constant in self.ties:
            leaf, value = jnp.asarray(leaves[index]), factor * jnp.asarray(leaves[source]).reshape(-1)[j] + constant
            leaves[index] = leaf.reshape(-1).at[k].set(value).reshape(leaf.shape)
        return self.treedef.unflatten(leaves)

    def assemble_rows(self, x: Float[np.ndarray, "N p"]) -> Iterator[Any]:
        """`assemble` of many parameter vectors of one record on the host: the leaves of all are set together."""
        leaves = jax.tree_util.tree_leaves(self.assemble_stacked(x))
        yield from (self.treedef.unflatten(row) for row in zip(*leaves, strict=True))

    def assemble_stacked(self, x: Float[np.ndarray, "N p"]) -> Any:
        """The trees of `assemble_rows` as one, whose arrays have a leading axis."""
        rows = self._rows(x, 0)
        same = lambda leaf: np.broadcast_to(leaf, (len(x), *np.shape(leaf)))
        return self.treedef.unflatten([rows[k] if k in rows else same(leaf) for k, leaf in enumerate(self.leaves)])

    def _rows(self, x: Float[np.ndarray, "N p"], record: int) -> dict[int, np.ndarray]:
        """The leaves that depend on x or on the record, by index, each with a leading axis."""
        rows, start = dict[int, np.ndarray](), 0
        for index, values in zip(self.constant_at, self.constants, strict=True):
            rows[index] = np.asarray(values)[[record] * len(x)]
        for index, positions, per_record in self.layout:
            count, leaf = len(positions), np.asarray(self.leaves[index])
            first = start + (count * record if per_record else 0)
            values = x[:, first : first + count]
            if count < leaf.size:
                flat = np.tile(leaf.reshape(-1), (len(x), 1))
                flat[:, list(positions)] = values
                values = flat
            rows[index] = values.reshape(len(x), *leaf.shape)
            start += count * (self.n_records if per_record else 1)
        for index, k, source, j, factor, constant in self.ties:
            flat, other = (
                rows[at].reshape(len(x), -1) if at in rows else np.tile(np.ravel(self.leaves[at]), (len(x), 1))
                for at in (index, source)
            )
            flat = flat.copy()
            flat[:, k] = factor * other[:, j] + constant
            rows[index] = flat.reshape(len(x), *np.shape(self.leaves[index]))
        return rows

    def tree(self, z: Float[Array, " p"], record: Any = 0) -> Any:
        """The tree at unconstrained coordinates z, with the parameters of record number `record`."""
        return self.assemble(self.physical(z), record)
