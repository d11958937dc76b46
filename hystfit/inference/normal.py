"""Normal equations of an objective at one point: from the derivatives of all samples, or in the scan over the samples."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import jaxprs_in_params
from jaxtyping import Array, Float

from hystfit.inference.objective import BROKEN, Objective, bend, linearized_runs, misfit_slope
from hystfit.models.shared.shapes import Scalar

FEW = 12  # parameters up to which one scan sums the normal matrix: it carries a number for each entry


class Normal(NamedTuple):
    """Normal equations at unconstrained z: half the sum of squared misfits, infinite where one is not finite, J'r and J'J."""

    z: Float[Array, " p"]
    cost: Scalar
    gradient: Float[Array, " p"]
    matrix: Float[Array, "p p"]

    def checked(self) -> Normal:
        """With an infinite cost where something is not finite."""
        finite = functools.reduce(jnp.logical_and, [jnp.isfinite(value).all() for value in self])
        return self._replace(cost=jnp.where(finite, self.cost, jnp.inf))


def normal_at(objective: Objective, z: Float[Array, " p"]) -> Normal:
    """From the derivatives of all samples, which are in memory at once: the faster form where one lane follows another."""
    if not objective.apart:
        residual, columns = objective.linearize_at(z)
        return Normal(z, 0.5 * residual @ residual, columns @ residual, columns @ columns.T).checked()
    misfit, slopes = objective.linearize_records_at(z)  # the others are zero
    own, p = objective.coordinates.own, z.shape[0]
    gradient = jnp.zeros(p).at[own].add(jnp.einsum("rmt,rt->rm", slopes, misfit))
    blocks = jnp.einsum("rmt,rnt->rmn", slopes, slopes)
    matrix = jnp.zeros((p, p)).at[own[:, :, None], own[:, None, :]].add(blocks)
    return Normal(z, 0.5 * jnp.sum(misfit**2), gradient, matrix).checked()


def normal_on_host(objective: Objective, z: Float[np.ndarray, " p"]) -> Normal:
    """`normal_at` by the program of `linearized`, which the last steps of a fit and its standard errors need too."""
    with np.errstate(all="ignore"):  # from simulations that are not finite
        residual, slopes = linearized_runs(objective, objective.coordinates.physical(z, np))
        misfit, weight = (values.reshape(residual.shape) for values in misfit_slope(objective, residual))
        own, p = objective.coordinates.own, len(z)
        slopes = slopes * weight[:, None] * objective.coordinates.slope(z, np)[own][..., None]
        gradient, matrix = np.zeros(p), np.zeros((p, p))
        np.add.at(gradient, own, np.einsum("rmt,rt->rm", slopes, misfit))
        np.add.at(matrix, (own[:, :, None], own[:, None, :]), slopes @ slopes.swapaxes(1, 2))
        normal = Normal(z, 0.5 * np.sum(misfit**2), gradient, matrix)
    return normal if all(np.isfinite(value).all() for value in normal) else normal._replace(cost=np.inf)


def suits_one_scan(objective: Objective) -> bool:
    """Whether `normal_in_scan` can be used: one record, few parameters, and a model whose step is all that it needs."""
    p = len(objective.coordinates.kinds)
    model = objective.coordinates.assemble(jnp.zeros(p))
    return (
        objective.batch.u.shape[0] == 1
        and 0 < p <= FEW
        and model.causal
        and model.one_scan
        and not objective.coordinates.ties
    )


def suits_lanes(objective: Objective) -> bool:
    """Whether lanes of `normal_in_scan` fill the vectors of a CPU: the state is a number, and a step has no loops and no powers.

    XLA computes powers one by one. With them a pass of `bouc-wen-asymmetric` over 16 lanes took 1.2 times as long as of one after another.
    """
    if not suits_one_scan(objective):
        return False
    model = lambda o: o.coordinates.assemble(jnp.zeros(len(o.coordinates.kinds)))
    state = jax.eval_shape(lambda o: model(o).init(o.batch.u[0, 0]), objective)
    number = jax.ShapeDtypeStruct((), state.dtype)
    step = jax.make_jaxpr(lambda o, state, *sample: model(o).step(state, *sample))(objective, state, *[number] * 3)
    return state.shape == (1,) and not _operations(step.jaxpr) & {"pow", "scan", "while"}


def _operations(jaxpr: Any) -> set[str]:
    """Names of all operations of a traced function."""
    inner = [jaxprs_in_params(one.params) for one in jaxpr.eqns]
    return {one.primitive.name for one in jaxpr.eqns}.union(*(_operations(part) for parts in inner for part in parts))


def _depends(function: Callable[[Array], Any], value: Array) -> bool:
    """Whether what a function returns depends on its argument, as far as its operations show."""
    jaxpr = jax.make_jaxpr(function)(value).jaxpr
    reached = {id(variable) for variable in jaxpr.invars}
    for one in jaxpr.eqns:
        if any(id(variable) in reached for variable in one.invars):
            reached |= {id(variable) for variable in one.outvars}
    return any(id(variable) in reached for variable in jaxpr.outvars)


def normal_in_scan(objective: Objective, z: Float[Array, " p"], unroll: int = 1, block: int | None = None) -> Normal:
    """By one scan whose carry holds the state, its derivatives, the cost, J'r and J'J; nothing is kept of a sample.

    The objective is of one record, see `suits_one_scan`. Under `jax.vmap` over thousands of lanes this is the faster form, and its memory
    does not grow with the number of samples. Each number of the carry is a leaf of its own, so that lanes lie side by side. One turn of the
    loop takes `unroll` samples; a block of samples of all lanes is laid side by side at a time, so that it stays in the cache.
    """
    coordinates, p = objective.coordinates, z.shape[0]
    u, y, dt, weight = (row[0] for row in objective.batch.signals)
    x = coordinates.physical(z)
    leaves, treedef = jax.tree_util.tree_flatten(coordinates.assemble(x))
    places = [(leaf, k) for leaf, positions, _ in coordinates.layout for k in positions]
    ways = [
        jnp.zeros(np.shape(leaves[leaf])).reshape(-1).at[k].set(1.0).reshape(np.shape(leaves[leaf]))
        for leaf, k in places
    ]
    pairs = np.triu_indices(p)

    def with_leaf(leaf: int, value: Array) -> Any:
        return treedef.unflatten([value if k == leaf else other for k, other in enumerate(leaves)])

    first = treedef.unflatten(leaves).init(u[0])
    single = first.shape == (1,)
    inner, outer = (lambda s: s[None], lambda s: s[0]) if single else (lambda s: s, lambda s: s)
    begin = lambda leaf: lambda value: outer(with_leaf(leaf, value).init(u[0]))
    moves = lambda leaf: lambda value: (begin(leaf)(value), with_leaf(leaf, value).step(first, u[0], u[0], dt[0])[0])
    along = [
        jax.jvp(begin(leaf), (leaves[leaf],), (way,))[1] if _depends(moves(leaf), leaves[leaf]) else None
        for (leaf, _), way in zip(places, ways, strict=True)
    ]

    def once(carry: Any, row: Any) -> tuple[Any, None]:
        (state, before, along, cost, gradient, matrix), (now, step, measured, root) = carry, row
        moved, slopes = [], []
        advance = lambda leaf: lambda value, s: with_leaf(leaf, value).step(inner(s), before, now, step)
        after, out = advance(0)(leaves[0], state)
        for (leaf, _), way, push in zip(places, ways, along, strict=True):
            if push is None:  # of an offset, say
                slope = jax.jvp(lambda value: advance(leaf)(value, state)[1], (leaves[leaf],), (way,))[1]  # noqa: B023
            else:
                (after, out), (push, slope) = jax.jvp(advance(leaf), (leaves[leaf], state), (way, push))
            moved.append(None if push is None else outer(push))
            slopes.append(slope)
        gap = out - measured
        good = jnp.isfinite(gap)
        weigh = lambda r: bend(root * r, objective.bend, objective.loss)
        residual = jnp.where(good, gap, BROKEN * objective.size)
        misfit, factor = jax.jvp(weigh, (residual,), (jnp.ones_like(gap),))
        factor = jnp.where(good & (root > 0), factor, 0.0)
        J = [jnp.where(good, slope, 0.0) * factor for slope in slopes]
        cost = cost + misfit**2
        gradient = [g + misfit * slope for g, slope in zip(gradient, J, strict=True)]
        matrix = [h + J[a] * J[b] for h, a, b in zip(matrix, *pairs, strict=True)]
        return (outer(after), now, moved, cost, gradient, matrix), None

    def stretch(begin: Any, carry: Any) -> Any:
        now, step, measured, w = (jax.lax.dynamic_slice_in_dim(row, begin, at_once) for row in (u, dt, y, weight))
        return jax.lax.scan(once, carry, (now, step, measured, jnp.sqrt(w) / objective.size), unroll=unroll)[0]

    zero, at_once = jnp.zeros(()), math.gcd(u.size, block or u.size)
    start = (outer(first), u[0], along, zero, [zero] * p, [zero] * len(pairs[0]))
    ended = jax.lax.fori_loop(0, u.size // at_once, lambda k, carry: stretch(k * at_once, carry), start)
    *_, cost, gradient, upper = ended
    matrix = jnp.zeros((p, p)).at[pairs].set(jnp.stack(upper))
    matrix, slope = matrix + jnp.triu(matrix, 1).T, coordinates.slope(z)
    return Normal(z, 0.5 * cost, slope * jnp.stack(gradient), slope * matrix * slope[:, None]).checked()
