"""Residuals and derivatives of long records, one stretch of samples after another: memory holds those of a single stretch."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.batch import Batch
from hystfit.inference.blocks import beside, triangle
from hystfit.inference.linearization import Linearization
from hystfit.inference.objective import Objective, flat, misfit_of
from hystfit.models.shared.simulation import Resume, run
from hystfit.params.host_arrays import NUMBERS, compiled, to_device

_ENTRIES = 2**18  # residuals and derivatives of one stretch (2 MiB), which stay in the cache of a processor
_FEWEST = 2**10  # samples of one


class Stretch(NamedTuple):
    """Successive samples of one record, with residuals and derivatives with respect to all parameters."""

    record: int
    at: slice
    residual: Float[np.ndarray, " m"]
    jacobian: Float[np.ndarray, "m p"]


def in_stretches(objective: Objective) -> bool:
    """Whether the derivatives are too many to be computed at once, records are long, and the simulation can be resumed."""
    batch, own = objective.batch, objective.coordinates.own_count
    if batch.u.size * own <= NUMBERS or batch.u.shape[1] < _length(own):
        return False
    return bool(objective.coordinates.assemble(np.asarray(objective.coordinates.lower)).causal)


def stretches(objective: Objective, x: Float[np.ndarray, " p"], *, misfit: bool = False) -> Iterator[Stretch]:
    """Residuals and their derivatives with respect to physical x, without the samples behind the last one that counts.

    All derivatives share one simulation, and all stretches of records of any length one program. With `misfit`, both are as they count in
    the misfit, not in output units.
    """
    own, used = objective.coordinates.own, np.asarray(objective.batch.weight) > 0
    length = _length(own.shape[1])
    for record, positions in enumerate(own):
        end = used.shape[1] - int(np.argmax(used[record, ::-1])) if used[record].any() else 0
        init = objective.coordinates.assemble(x, record).init
        directions, state = np.eye(x.size)[positions], np.zeros(jax.eval_shape(init, jnp.zeros(())).shape)
        along, before = np.zeros((len(positions), *state.shape)), np.float64(0.0)
        for start in range(0, end, length):
            at = slice(start, min(start + length, end))
            part = _part(objective, record, at, length)
            begin = (np.bool_(start == 0), state, along, before)
            residual, J, state, along = _advance(part, x, np.int64(record), directions, *begin)
            before = np.asarray(part.batch.u)[0, -1]
            residual, jacobian = np.asarray(residual), _of_all(np.asarray(J), positions, x.size)
            if misfit:
                residual, jacobian = misfit_of(part, residual[None], jacobian[None])
            yield Stretch(record, at, residual[: at.stop - start], jacobian[: at.stop - start])


def _length(derivatives: int) -> int:
    """Samples of a stretch, a power of two, for as many derivatives of each."""
    return max(1 << ((_ENTRIES // (derivatives + 1)).bit_length() - 1), _FEWEST)


def _of_all(jacobian: Float[np.ndarray, "m k"], positions: np.ndarray, p: int) -> Float[np.ndarray, "m p"]:
    """Derivatives with respect to all parameters, from those to the parameters at some positions."""
    if len(positions) < p:
        spread = np.zeros((len(jacobian), p))
        spread[:, positions] = jacobian
        jacobian = spread
    return flat(jacobian)


def linearized_by_stretches(
    objective: Objective, x: Float[np.ndarray, " p"]
) -> tuple[Float[np.ndarray, "R T"], Float[np.ndarray, "R T p"]]:
    """`objective.linearized` with respect to all parameters, of which it takes the place where `in_stretches`."""
    residual, jacobian = np.zeros(objective.batch.u.shape), np.zeros((*objective.batch.u.shape, x.size))
    for one in stretches(objective, x):
        residual[one.record, one.at], jacobian[one.record, one.at] = one.residual, one.jacobian
    return residual, jacobian


def linearization_by_stretches(objective: Objective, x: Float[np.ndarray, " p"]) -> Linearization:
    """The misfit and the triangular factor of its derivatives, by one pass; the derivatives themselves take one more."""
    used, misfit = np.asarray(objective.batch.weight) > 0, np.zeros(objective.batch.u.shape)
    order = np.arange(x.size)

    def rows() -> Iterator[np.ndarray]:
        for one in stretches(objective, x, misfit=True):
            misfit[one.record, one.at] = one.residual
            yield from beside(one.jacobian, one.residual, order)

    with np.errstate(over="ignore", invalid="ignore"):
        joint = triangle(rows(), x.size + 1)

    def blocks() -> Iterator[np.ndarray]:
        for one in stretches(objective, x, misfit=True):
            on = used[one.record, one.at]
            yield one.jacobian if on.all() else one.jacobian[on]

    return Linearization(misfit.reshape(-1), used.reshape(-1), x.size, blocks, joint)


def _part(objective: Objective, record: int, at: slice, length: int) -> Objective:
    """The objective on some samples of one record, padded as in `Batch`."""
    batch, extra = objective.batch, (0, length - (at.stop - at.start))
    u, *others = (np.asarray(v)[record, at] for v in (batch.u, batch.y, batch.dt, batch.weight))
    padded = np.pad(u, extra, mode="edge"), *(np.pad(values, extra) for values in others)
    return dataclasses.replace(objective, batch=Batch(*(to_device(values[None]) for values in padded)))


@compiled
def _advance(
    part: Objective, x: Array, record: Array, directions: Array, first: Array, state: Array, along: Array, before: Array
) -> tuple[Array, Array, Array, Array]:
    """Residuals, their derivatives along k directions, and the state behind the samples of a part with its own derivatives.

    The part has some samples of the record of that number, which begins here if it is `first`; `directions` has shape (k, p). Before it are
    the state, its derivatives `along` the directions, shape (k, states), and the input `before`.
    """
    batch = part.batch
    u, dt = batch.u[0], batch.dt[0]

    def outputs(x: Any, state: Any) -> tuple[Array, Array]:
        model = part.coordinates.assemble(x, record)
        begin = Resume(jnp.where(first, model.init(u[0]), state), jnp.where(first, u[0], before))
        y, end = run(model, u, dt, begin)
        return part.counted(y - batch.y[0], batch.weight[0]), end.state

    push = lambda of_x, of_state: jax.jvp(outputs, (x, state), (of_x, of_state))
    (residual, state), (jacobian, along) = jax.vmap(push, out_axes=((None, None), (1, 0)))(directions, along)
    return residual, jacobian, state, along
