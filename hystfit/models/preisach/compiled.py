"""The fast form of a Preisach model: an input compiled once into states and table indices, then weights to outputs by look-ups.

`respond` gives the numbers of `hystfit.simulate`; `hystfit.models.preisach.design_matrix` what the weights are multiplied by.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from hystfit.models.preisach.everett import Place, accumulate, grid
from hystfit.models.preisach.plane import AbstractPlane
from hystfit.models.preisach.staircase import Staircase, compile_input
from hystfit.models.shapes import Signal
from hystfit.params.host_arrays import compiled


class Terms(eqx.Module):
    """Look-up terms: what each of K nodes or states adds to the output of its parent.

    Attributes:
        first: of those without a parent, which come first: their input (cells), or where in the table of first excursions (relays).
        high, low: ends of the triangle that each of the others switches; for relays `cell` is a number of rows, and the first column.
        sign: +2 where it switches up, -2 where down.
    """

    first: Array
    high: Place
    low: Place
    sign: Float[Array, " K"]


class Compiled(eqx.Module):
    """An input as arrays: pass it to jitted code as an argument, because XLA would fold a constant of this size for seconds.

    Attributes:
        nodes, states: look-ups of the K dominant extrema and of the S distinct states.
        jumps: ancestors of nodes at distance 1, 2, 4, ..., shape (levels, K).
        parent: node before each state, shape (S,), K for none.
        tied: states in which the input fell just onto a level, where the relay on the diagonal stays up, and the number of that
            level, shape (2, ties); none for cells.
        u: input of each state (cells) or of each sample (relays), for the single-valued part.
        index: state of each sample, shape (T,).
    """

    nodes: Terms
    states: Terms
    jumps: Int[Array, "levels K"]
    parent: Int[Array, " S"]
    tied: Int[Array, "two ties"]
    u: Float[Array, " U"]
    index: Int[Array, " T"]


def compile_for(model: AbstractPlane, u: np.ndarray) -> Compiled:
    """Compile an input for the levels, center and initial state of a model; its weights may change afterwards."""
    u = np.asarray(u, dtype=float)
    code, stairs = staircase_of(model, u)
    terms = _cell_terms if code is None else functools.partial(_relay_terms, code=code)
    nodes = terms(model, stairs.node_value, stairs.node_parent, stairs.node_value)
    states = terms(model, stairs.state_value, stairs.state_parent, stairs.node_value)
    tied = np.zeros((2, 0)) if code is None else ties(model, code, stairs)
    parent = np.where(stairs.state_parent < 0, stairs.node_value.size, stairs.state_parent)
    inputs = stairs.state_value if code is None else u
    return Compiled(
        nodes, states, _small(stairs.jumps()), _small(parent), _small(tied), _real(inputs), _small(stairs.index)
    )


def _small(values: np.ndarray) -> Array:
    return jnp.asarray(values, dtype=jnp.int32)


def _real(values: np.ndarray) -> Array:
    return jnp.asarray(values, dtype=jnp.result_type(float))


class Code:
    """Whole numbers that tell apart, for a grid of relays, the inputs that matter: 2 k between marks k - 1 and k, 2 k + 1 on mark k.

    The marks are the levels and, for a demagnetized start, their mirror images, so that comparing a code with a mirrored code is exact.
    """

    def __init__(self, levels: np.ndarray, center: float | None):
        self.levels = levels
        self.marks = levels
        if center is not None:
            images = 2 * center - levels
            gap = np.abs(images[:, None] - levels).min(axis=1)
            # Rounding must not part a level from its image: codes would not be symmetric.
            self.marks = np.sort(np.append(levels, images[gap > 1e-12 * (np.ptp(levels) + abs(center))]))
        self.top = 2 * self.marks.size

    def of(self, u: np.ndarray) -> np.ndarray:
        """Codes of inputs."""
        below = np.searchsorted(self.marks, u, side="left")
        on = self.marks[np.minimum(below, self.marks.size - 1)] == u
        return 2 * below + on

    def passed(self) -> tuple[np.ndarray, np.ndarray]:
        """For every code, the number of levels <= and < its inputs."""
        code = np.arange(self.top + 1)
        reached = np.append(np.searchsorted(self.levels, self.marks, side="right"), self.levels.size)
        before = np.append(np.searchsorted(self.levels, self.marks, side="left"), self.levels.size)
        # An odd code lies on its mark; an even one lies below the mark and above the one before it.
        at_most = np.where(code % 2 == 1, reached[code // 2], before[code // 2])
        return at_most, before[code // 2]


def staircase_of(model: AbstractPlane, u: np.ndarray) -> tuple[Code | None, Staircase]:
    """The states that an input visits: of the input itself for cells, of its codes for relays."""
    center = float(model.center)
    if model.elements == "cells":
        return None, compile_input(u, model.initial, center)
    code = Code(np.asarray(model.levels), center if model.initial == "demagnetized" else None)
    return code, compile_input(code.of(u), model.initial, 0.5 * code.top)


def _cell_terms(model: AbstractPlane, value: np.ndarray, parent: np.ndarray, nodes: np.ndarray) -> Terms:
    count = int(np.count_nonzero(parent < 0))
    before, now = nodes[parent[count:]], value[count:]
    levels = np.asarray(model.levels)
    high, low = locate(levels, np.maximum(now, before)), locate(levels, np.minimum(now, before))
    return Terms(_real(value[:count]), high, low, _real(np.where(now > before, 2.0, -2.0)))


def _relay_terms(
    model: AbstractPlane, value: np.ndarray, parent: np.ndarray, nodes: np.ndarray, *, code: Code
) -> Terms:
    count = int(np.count_nonzero(parent < 0))
    at_most, below = code.passed()
    before, now, first = nodes[parent[count:]], value[count:], value[:count]
    high, low = at_most[np.maximum(now, before)], below[np.minimum(now, before)]
    none = _real(np.zeros(high.size))
    first = np.where(rises_first(model, code, first), at_most[first], model.n + 1 + below[first])
    return Terms(
        _small(first), Place(_small(high), none), Place(_small(low), none), _real(np.where(now > before, 2.0, -2.0))
    )


def rises_first(model: AbstractPlane, code: Code, first: np.ndarray) -> np.ndarray:
    """Whether a first excursion, given by its code, switches relays up."""
    if model.initial == "demagnetized":
        return 2 * first >= code.top
    return np.full(first.shape, model.initial == "negative")


def ties(model: AbstractPlane, code: Code, stairs: Staircase) -> np.ndarray:
    """States in which the input fell just onto a level, and the number of that level, shape (2, ties)."""
    at_most, below = code.passed()
    value, parent = stairs.state_value, stairs.state_parent
    falls = value < np.where(parent < 0, 0, stairs.node_value[parent])
    falls[parent < 0] = ~rises_first(model, code, value[parent < 0])
    at = np.flatnonzero(falls & (at_most[value] > below[value]))
    return np.stack([at, below[value[at]]])


def locate(levels: np.ndarray, u: np.ndarray) -> Place:
    """`hystfit.models.preisach.everett.place` on the host."""
    cell = np.clip(np.searchsorted(levels, u, side="right") - 1, 0, levels.size - 2)
    part = np.clip((u - levels[cell]) / (levels[cell + 1] - levels[cell]), 0.0, 1.0)
    return Place(_small(cell), _real(part))


# -- weights to outputs ----------------------------------------------------------------------------------------------------


@compiled
def respond(model: AbstractPlane, compiled: Compiled) -> Signal:
    """Output of a model on an input compiled for it, shape (T,): what `hystfit.simulate` returns, by look-ups.

    Differentiable, forward and backward, in the weights and in whatever they depend on.
    """
    if model.elements == "relays":
        return respond_states(model, compiled)[compiled.index] + model.single_valued(jnp.asarray(compiled.u))
    return respond_states(model, compiled)[compiled.index]


def respond_states(model: AbstractPlane, compiled: Compiled) -> Float[Array, " S"]:
    """Output of each distinct state, shape (S,); of relays, without the single-valued part, which states do not determine."""
    if model.elements == "cells":
        memory = model.memory()
        first, pair, rest = memory.first, memory.everett, memory.rest + model.single_valued(jnp.asarray(compiled.u))
    else:
        first, pair, rest = _relay_tables(model)
    chain = _values(compiled.nodes, first, pair)
    for jump in compiled.jumps:
        chain = chain + jnp.append(chain, 0.0)[jump]
    y = rest + jnp.append(chain, 0.0)[compiled.parent] + _values(compiled.states, first, pair)
    if not compiled.tied.shape[1]:
        return y
    at, level = jnp.asarray(compiled.tied)
    return y.at[at].add(2 * model.masses()[level * (level + 1) // 2 + level])


def _values(terms: Terms, first: Callable[[Array], Array], pair: Callable[[Place, Place], Array]) -> Array:
    return jnp.concatenate([first(jnp.asarray(terms.first)), terms.sign * pair(terms.high, terms.low)])


def _relay_tables(model: AbstractPlane) -> tuple[Callable[[Array], Array], Callable[[Place, Place], Array], Array]:
    n = model.n
    w = model.masses()
    table = accumulate(grid(w, n)).reshape(-1)
    total = table[n * (n + 1)]
    pair = lambda high, low: table[high.cell * (n + 1) + low.cell]
    up, down, rest = table[:: n + 1], table[n * (n + 1) :], total
    if model.initial == "demagnetized":
        alpha, beta = model.thresholds()
        above = alpha + beta > 2.0 * model.center
        square_up, square_down = grid(jnp.where(above, w, 0.0), n), grid(jnp.where(above, 0.0, w), n)
        up = jnp.append(0.0, jnp.cumsum(square_up.sum(axis=1)))
        down = jnp.append(jnp.cumsum(square_down.sum(axis=0)[::-1])[::-1], 0.0)
        rest = total - 2 * up[-1]
    elif model.initial == "negative":
        rest = -total
    excursions = 2 * jnp.concatenate([up, -down])
    return lambda at: excursions[at], pair, rest
