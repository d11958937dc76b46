"""The stack inverse of a Preisach model with cells (Song et al. 2005, eqs. (6) to (11))."""

from __future__ import annotations

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.models.preisach.everett import CellMemory, Place
from hystfit.models.preisach.plane import AbstractPlane
from hystfit.models.shared.bracketed import Root, solve_rising
from hystfit.models.shared.step_inverse import AbstractStepInverse

_ROUNDING = 64.0  # machine epsilons: error of a difference of two outputs, sums of the outputs of cells, over their size, at most


class PreisachStep(AbstractStepInverse):
    """Inverse by the dominant extrema e_0, e_1, ...: outputs where the input would close its loops are known from the stack.

    The innermost loop that closes beyond the target holds the answer; within it the output is base + 2 E(u, m), m the
    extremum on the other side. Its values at the knots give the interval, in which the output is a quadratic in u.
    """

    model: AbstractPlane  # with cells
    memory: CellMemory  # its tables, made once
    # levels, and for a demagnetized start their mirror images and the center: the output is quadratic between them
    knots: Float[Array, " k"]
    straight: Float[Array, " k"]  # piecewise linear reversible part at the knots, without the offset
    excursion: Float[Array, " dense"]  # what a first excursion adds, at the knots and half-way between them
    needs_limits: ClassVar[bool] = True

    @classmethod
    def of(cls, model: AbstractPlane) -> PreisachStep:
        """Tables of a model (host side)."""
        levels, center = np.asarray(model.levels), float(model.center)
        knots = levels
        if model.initial == "demagnetized" and not model.symmetric:
            knots = np.concatenate([levels, 2 * center - levels, [center]])
        knots = np.unique(np.append(knots, center)) if model.symmetric else np.unique(knots)
        return cls(model, *_tables(model, jnp.asarray(knots)))

    def advance(self, state: Array, u0: Array, u1: Array, dt: Array) -> tuple[Array, Array]:
        """The model's step with the tables at hand."""
        state = self.model.remember(state, u1)
        moves = self._moved(state[1:], state[:-1])
        return state, self.memory.rest + self._first(state[0]) + jnp.sum(moves) + self._single(u1)

    def _first(self, u: Array) -> Array:
        x = jnp.clip(u, self.knots[0], self.knots[-1])
        at = jnp.clip(jnp.sum(self.knots <= x[..., None], axis=-1) - 1, 0, self.knots.shape[0] - 2)
        t = (x - self.knots[at]) / (self.knots[at + 1] - self.knots[at])
        f0, middle, f1 = (self.excursion[2 * at + k] for k in range(3))
        return f0 + t * (4 * middle - f1 - 3 * f0 + t * 2 * (f1 - 2 * middle + f0))

    def _single(self, u: Array) -> Array:
        bent = eqx.tree_at(lambda m: m.slopes, self.model, jnp.zeros(0)).single_valued(u)
        if not self.model.slopes.size:
            return bent
        at = jnp.clip(jnp.sum(self.knots <= u[..., None], axis=-1) - 1, 0, self.knots.shape[0] - 2)
        part = (u - self.knots[at]) / (self.knots[at + 1] - self.knots[at])  # beyond the knots the line continues
        return bent + self.straight[at] + part * (self.straight[at + 1] - self.straight[at])

    def _place(self, u: Array) -> Place:
        # As everett.place; comparing with all levels beats a binary search inside a scan.
        levels = self.memory.levels
        cell = jnp.sum(levels[1:-1] <= u[..., None], axis=-1)
        part = (u - levels[cell]) / (levels[cell + 1] - levels[cell])
        return Place(cell, jnp.clip(part, 0.0, 1.0))

    def _moved(self, u: Array, base: Array) -> Array:
        return self.memory.pair(self._place(u), self._place(base), u > base)

    def solve(self, state: Array, u0: Array, target: Array, dt: Array, low: Array, high: Array) -> Root:
        memory, model = self.memory, self.model
        moves = self._moved(state[1:], state[:-1])
        # height[k]: output of the relays with e_0 .. e_{k-1} remembered and the input on e_{k-1}.
        height = memory.rest + jnp.cumsum(jnp.concatenate([jnp.zeros(1), self._first(state[0])[None], moves]))
        now = height[-1] + self._single(u0)
        s = jnp.where(target < now, -1.0, 1.0)
        other = {"demagnetized": 2 * model.center - state[0], "negative": -jnp.inf, "positive": jnp.inf}[model.initial]
        other = jnp.clip(jnp.asarray(other), model.levels[0], model.levels[-1])
        extrema = jnp.concatenate([other[None], state])
        closing = jnp.concatenate([(memory.rest + self._first(other))[None], height[1:]]) + self._single(extrema)
        ahead = s * (extrema - u0) > 0
        index = jnp.arange(extrema.shape[0])
        loop = jnp.max(jnp.where(ahead & (s * (closing - target) >= 0), index, -1))  # closes beyond the target
        passed = jnp.max(jnp.where(ahead & (index > loop), s * extrema, -jnp.inf))
        edge = s * jnp.where(s > 0, high, low)
        far = jnp.where(loop >= 0, jnp.minimum(s * extrema[jnp.maximum(loop, 0)], edge), edge)
        near = jnp.minimum(jnp.maximum(passed, s * u0), far)
        base, start = state[jnp.maximum(loop, 0)], height[jnp.maximum(loop, 0) + 1]
        first = loop < 0
        output = lambda u: (
            jnp.where(first, memory.rest + self._first(u), start + self._moved(u, jnp.broadcast_to(base, u.shape)))
            + self._single(u)
        )
        rows = jnp.where(
            first, memory.rest + self.excursion[::2], start + self._moved(self.knots, jnp.full(self.knots.shape, base))
        )
        miss = s * (rows + self._single(self.knots) - target)
        along = s * self.knots
        left = jnp.maximum(near, jnp.max(jnp.where((along < far) & (miss < 0), along, -jnp.inf)))
        right = jnp.minimum(far, jnp.min(jnp.where((along > near) & (miss >= 0), along, jnp.inf)))
        size = jnp.maximum(jnp.max(jnp.abs(height)), jnp.abs(target))
        x, rising = _quadratic(output, s, left, right, target, size)
        if model.b.shape[0] > 2:
            ends = jnp.minimum(s * left, s * right), jnp.maximum(s * left, s * right)
            x, rising = solve_rising(lambda u: output(u) - target, s * left, *ends)
        return Root(jnp.where(target == now, u0, x), rising)


@eqx.filter_jit
def _tables(model: AbstractPlane, knots: Array) -> tuple[CellMemory, Array, Array, Array]:
    memory = model.memory()
    plain = eqx.tree_at(lambda m: (m.b, m.offset), model, (jnp.zeros(0), jnp.zeros(())))
    dense = jnp.sort(jnp.concatenate([knots, 0.5 * (knots[1:] + knots[:-1])]))
    return memory, knots, plain.single_valued(knots), memory.first(dense)


def _quadratic(output: object, s: Array, left: Array, right: Array, target: Array, size: Array) -> Root:
    """Where a function that is a rising quadratic between s left and s right meets the target, or the nearer end.

    Where it is flat, the sums of terms of this size differ by rounding.
    """
    y = output(s * (left + jnp.asarray([0.0, 0.5, 1.0]) * (right - left)))  # type: ignore[operator]
    f0, middle, f1 = s * (y - target)
    a, b = 2 * (f1 - 2 * middle + f0), 4 * middle - f1 - 3 * f0
    root = b + jnp.sqrt(jnp.maximum(b * b - 4 * a * f0, 0.0))
    t = jnp.where(f0 >= 0, 0.0, jnp.where(root > 0, -2 * f0 / jnp.where(root > 0, root, 1.0), 1.0))
    return Root(
        s * (left + jnp.clip(t, 0.0, 1.0) * (right - left)), f1 - f0 >= -_ROUNDING * jnp.finfo(y.dtype).eps * size
    )
