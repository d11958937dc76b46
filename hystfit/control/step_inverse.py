"""One-sample inverses: the input that brings a model in a given state to a given output."""

from __future__ import annotations

import abc
import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.control.bracketed import Root, solve_rising
from hystfit.models.base import AbstractHysteresis
from hystfit.models.bouc_wen import BoucWen
from hystfit.models.bouc_wen_steps import passed_rates
from hystfit.models.compose import Series, Sum
from hystfit.models.creep import LogCreep
from hystfit.models.prandtl_ishlinskii import PrandtlIshlinskii


class AbstractStepInverse(eqx.Module):
    """Solves `model.step(state, u0, u1, dt)[1] == target` for u1.

    Attributes:
        model: what is inverted.
    """

    model: eqx.AbstractVar[AbstractHysteresis]

    @property
    @abc.abstractmethod
    def needs_limits(self) -> bool:
        """A search needs an interval to search in; a closed form needs none."""

    @abc.abstractmethod
    def solve(
        self,
        state: Float[Array, " state"],
        u0: Float[Array, ""],
        target: Float[Array, ""],
        dt: Float[Array, ""],
        low: Float[Array, ""],
        high: Float[Array, ""],
    ) -> Root:
        """The input, which a closed form may put outside the limits, and whether the output rises on the way to it."""

    def advance(
        self, state: Float[Array, " state"], u0: Float[Array, ""], u1: Float[Array, ""], dt: Float[Array, ""]
    ) -> tuple[Float[Array, " state"], Float[Array, ""]]:
        """The model's step."""
        return self.model.step(state, u0, u1, dt)


class SearchStep(AbstractStepInverse):
    """Bracketed search on the model's own step: for every model whose output rises, or falls, with its input.

    Attributes:
        model: any model.
        sign: -1 where the output falls with the input.
    """

    model: AbstractHysteresis
    sign: float = eqx.field(static=True, default=1.0)
    needs_limits: bool = eqx.field(static=True, default=True)

    def solve(self, state: Array, u0: Array, target: Array, dt: Array, low: Array, high: Array) -> Root:
        """See the class."""
        miss = lambda u1: self.sign * (self.model.step(state, u0, u1, dt)[1] - target)
        return solve_rising(miss, jnp.clip(u0, low, high), low, high)


class BoucWenStep(AbstractStepInverse):
    """Explicit inverse of `BoucWen` (after Minase et al. 2010): a quadratic for the semi-implicit step, Newton for the exact one.

    With q = s h and x = |dv| the output moves by s dy = c x - (q' - q), which is convex in x: Newton steps from above cannot fail.
    """

    model: BoucWen
    needs_limits: bool = eqx.field(static=True, default=False)

    def solve(self, state: Array, u0: Array, target: Array, dt: Array, low: Array, high: Array) -> Root:
        """See the class."""
        bw = self.model
        gap = target - (bw.offset + bw.c * u0 - state[0])
        s, way = jnp.where(gap < 0, -1.0, 1.0), jnp.abs(gap)
        q, m = s * state[0], bw.mu * bw.c
        up, down = bw.tau * (1 + bw.rho), bw.tau * (1 - bw.rho)
        slope = bw.c - m + jnp.where(q >= 0, up, down) * q

        def root(alpha: Array, beta: Array) -> Array:
            """x where half the integral of the rates is alpha x + beta."""
            a, b, d = alpha * bw.c, bw.c * (1 + beta) - m + alpha * (2 * q - way), way * (1 + beta) - 2 * q * beta
            part = jnp.sqrt(jnp.maximum(b * b + 4 * a * d, 0.0))
            return jnp.where(b > 0, 2 * d / jnp.where(b > 0, b + part, 1.0), (part - b) / jnp.where(a > 0, 2 * a, 1.0))

        x = root(0.5 * jnp.where(q >= 0, up, down), jnp.zeros_like(q))
        crosses = (q < 0) & (m * x > -q)
        x = jnp.where(crosses, root(0.5 * up, 0.5 * (up - down) * q / jnp.where(m > 0, m, 1.0)), x)
        moved = lambda x: s * bw.step(state, u0, u0 + s * x, dt)[0][0]
        bound = jnp.where(up > 0, m / jnp.where(up > 0, up, 1.0), jnp.inf)
        if bw.scheme == "semi-implicit":
            # Where a long step is held at the bound of h, h is known.
            half = 0.5 * passed_rates(q, x, m, up, down)
            stuck = ((1 - half) * q + m * x) / (1 + half)
            held = jnp.clip(stuck, jnp.minimum(q, bound), jnp.maximum(q, bound))
            x = jnp.where(held == stuck, x, (way + held - q) / bw.c)
        else:
            far = (way + jnp.maximum(bound, q) - q) / bw.c
            x = jnp.where(slope > 0, jnp.minimum(far, way / jnp.where(slope > 0, slope, 1.0)), far)

            def newton(_: Array, x: Array) -> Array:
                h = moved(x)
                rate = bw.c - m + jnp.where(h >= 0, up, down) * h
                return jnp.maximum(x - (bw.c * x - (h - q) - way) / jnp.where(rate > 0, rate, bw.c), 0.0)

            x = jax.lax.fori_loop(0, 12, newton, x)
        return Root(u0 + s * x, slope > 0)


class PlayStep(AbstractStepInverse):
    """Exact inverse of `PrandtlIshlinskii` with one identity envelope and a straight single-valued part.

    A way d from the last input moves the plays whose dead band t_j it has passed: b d + sum of w_j max(0, d - t_j) is
    piecewise linear and rising, and the active plays follow from its values at the t_j. Stops give min(d, t_j) instead.
    """

    model: PrandtlIshlinskii
    needs_limits: bool = eqx.field(static=True, default=False)

    def solve(self, state: Array, u0: Array, target: Array, dt: Array, low: Array, high: Array) -> Root:
        """See the class."""
        pi = self.model
        w, x0 = pi.w[0], (u0 - pi.low) / (pi.high - pi.low)
        steepness = 2.0 * pi.b[0]
        now = pi.step(state, u0, u0, dt)[1]
        s, way = jnp.where(target < now, -1.0, 1.0), jnp.abs(target - now)
        dead = jnp.maximum(s * (state - x0) + pi.r, 0.0)
        reached = dead[:, None] - dead[None, :]  # way at the start of play k less the dead band of play j
        if pi.operator == "play":
            gains = steepness * dead + jnp.maximum(reached, 0.0) @ w
            active = gains < way
            slope, shift = steepness + jnp.sum(jnp.where(active, w, 0.0)), jnp.sum(jnp.where(active, w * dead, 0.0))
        else:
            gains = steepness * dead + jnp.minimum(dead[:, None], dead[None, :]) @ w
            active = gains < way
            slope, shift = steepness + jnp.sum(jnp.where(active, 0.0, w)), -jnp.sum(jnp.where(active, w * dead, 0.0))
        d = jnp.where(slope > 0, (way + shift) / jnp.where(slope > 0, slope, 1.0), jnp.where(way > 0, jnp.inf, 0.0))
        return Root(pi.low + (x0 + s * d) * (pi.high - pi.low), slope >= 0)


class CreepStep(AbstractStepInverse):
    """Inverse of `LogCreep` (papers' eq. (19)): what the relaxations have left is taken off, the rest divided by the gain of one sample."""

    model: LogCreep
    needs_limits: bool = eqx.field(static=True, default=False)

    def solve(self, state: Array, u0: Array, target: Array, dt: Array, low: Array, high: Array) -> Root:
        """See the class."""
        creep = self.model
        share = -jnp.expm1(-dt / creep.tau)
        left = target - jnp.sum((1 - share) * state)
        k = jnp.sum(share * creep.weights) - creep.base
        gain = lambda x: x * (1 + k * creep._rate(x))
        if creep.gamma.shape[0] == 1:
            slope = 1 + k * creep.gamma[0]
            return Root(left / slope, slope > 0)

        def newton(_: Array, x: Array) -> Array:
            value, slope = jax.jvp(gain, (x,), (jnp.ones_like(x),))
            return x - (value - left) / slope

        x = jax.lax.fori_loop(0, 8, newton, u0)
        return Root(x, jax.jvp(gain, (x,), (jnp.ones_like(x),))[1] > 0)


class LinearStep(AbstractStepInverse):
    """Inverse of a filter whose output is affine in the new input (`Lag`, `Relaxation`): two steps give its gain."""

    model: AbstractHysteresis
    needs_limits: bool = eqx.field(static=True, default=False)

    def solve(self, state: Array, u0: Array, target: Array, dt: Array, low: Array, high: Array) -> Root:
        """See the class."""
        value, gain = jax.jvp(lambda u: self.model.step(state, u0, u, dt)[1], (u0,), (jnp.ones_like(u0),))
        return Root(u0 + (target - value) / jnp.where(gain > 0, gain, jnp.inf), gain > 0)


class SumStep(AbstractStepInverse):
    """Inverse of one model beside constants."""

    model: Sum
    inner: AbstractStepInverse
    which: int = eqx.field(static=True)

    @property
    def needs_limits(self) -> bool:
        """As the part."""
        return self.inner.needs_limits

    def solve(self, state: Array, u0: Array, target: Array, dt: Array, low: Array, high: Array) -> Root:
        """See the class."""
        constants = [part.value for k, part in enumerate(self.model.parts) if k != self.which]
        own = split_state(state, self.model.parts)[self.which]
        return self.inner.solve(own, u0, target - sum(constants), dt, low, high)


class SeriesStep(AbstractStepInverse):
    """Inverses of the parts of a `Series`, from the last to the first.

    Attributes:
        model: the series.
        inner: an inverse for each part.
        edges: between which input limits each part but the first is searched, infinite for closed forms.
    """

    model: Series
    inner: tuple[AbstractStepInverse, ...]
    edges: Float[Array, "parts two"]

    @property
    def needs_limits(self) -> bool:
        """As its first part."""
        return self.inner[0].needs_limits

    def solve(self, state: Array, u0: Array, target: Array, dt: Array, low: Array, high: Array) -> Root:
        """See the class."""
        count = len(self.inner) - 1
        own = split_state(state, self.model.parts)
        before = [u0, *(state[state.shape[0] - count + k] for k in range(count))]
        rising: Array = jnp.asarray(True)
        for k in range(count, 0, -1):
            target, fine = self.inner[k].solve(own[k], before[k], target, dt, *self.edges[k])
            rising = rising & fine
        u1, fine = self.inner[0].solve(own[0], u0, target, dt, low, high)
        return Root(u1, rising & fine)


def split_state(state: Float[Array, " state"], parts: tuple[AbstractHysteresis, ...]) -> list[Array]:
    """States of the parts of a composition, which come first in its state, one after another."""
    sizes = [jax.eval_shape(part.init, jnp.zeros((), state.dtype)).shape[0] for part in parts]
    edges = np.cumsum([0, *sizes])
    return [state[lo:hi] for lo, hi in itertools.pairwise(edges)]
