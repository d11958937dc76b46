"""The traced log posterior over the parameters of model and noise, and its gradient.

x physical, z unconstrained, q whitened: z = center + factor q, with the posterior near N(0, I) in q after a fit.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hystfit.fitting.generalized import linearize, log_likelihood, log_prior, raw_residual
from hystfit.inference.newton import FORWARD, forward
from hystfit.inference.noise import AbstractNoise, Setting
from hystfit.inference.priors import AbstractPrior
from hystfit.inference.problem import Objective
from hystfit.models.base import AbstractHysteresis
from hystfit.params.coordinates import Coordinates


class Target(eqx.Module):
    """The traced log posterior.

    Attributes:
        objective: data and model.
        noise: coordinates of the noise model.
        setting: the data as the noise sees them.
        priors: of the model's parameters, then the noise's.
        center, factor: z = center + factor q.
    """

    objective: Objective
    noise: Coordinates
    setting: Setting
    priors: tuple[AbstractPrior, ...]
    center: Float[Array, " d"]
    factor: Float[Array, "d d"]

    @property
    def p(self) -> int:
        """Number of the model's parameters; the noise's follow."""
        return len(self.objective.coordinates.kinds)

    def unwhitened(self, q: Float[Array, " d"]) -> Float[Array, " d"]:
        """z from q."""
        return self.center + self.factor @ q

    def physical(self, z: Float[Array, " d"]) -> Float[Array, " d"]:
        """x from z."""
        return jnp.concatenate([self.objective.coordinates.physical(z[: self.p]), self.noise.physical(z[self.p :])])

    def log_prior(self, z: Float[Array, " d"]) -> Float[Array, ""]:
        """Log prior density over z."""
        p = self.p
        own = log_prior(self.objective.coordinates, self.priors[:p], z[:p])
        return own + log_prior(self.noise, self.priors[p:], z[p:])

    def log_likelihood(self, z: Float[Array, " d"]) -> Float[Array, ""]:
        """Log density of the data that count."""
        r = raw_residual(self.objective, self.objective.coordinates.physical(z[: self.p]))
        return log_likelihood(self.noise.tree(z[self.p :]), self.setting, self.objective, r)

    def log_likelihood_lean(self, z: Float[Array, " d"]) -> Float[Array, ""]:
        """The same in one scan that keeps no trajectory: several times the throughput under vmap over many z."""
        if self.keeps_trajectories:
            return self.log_likelihood(z)
        noise = self.noise.tree(z[self.p :])
        x = self.objective.coordinates.physical(z[: self.p])
        if noise.by_squares:
            return noise.of_squares(self.setting, self.squares(x))

        def learn(carry: tuple[Array, Array], r: Array, weight: Array, gap: Array) -> tuple[Array, Array]:
            silent, e, logs = noise.step(carry[0], r, gap, weight)
            return silent, carry[1] + jnp.where(weight > 0, noise.density(e, logs), 0.0)

        return self._gather(x, (noise.init(), jnp.zeros(())), learn)[1]

    @property
    def keeps_trajectories(self) -> bool:
        """Whether even the lean likelihood needs whole trajectories: of the model's parts, or of shapes that the noise adds."""
        noise = self.noise.tree(jnp.zeros(len(self.noise.kinds)))
        return not self._scans or type(noise).columns is not AbstractNoise.columns

    @property
    def _scans(self) -> bool:
        """Whether the model knows no better way over the samples than one scan, which can then take the noise along."""
        model = self.objective.coordinates.assemble(jnp.zeros(self.p))
        return type(model).sweep is AbstractHysteresis.sweep

    def squares(self, x: Float[Array, " p"]) -> Float[Array, ""]:
        """Sum of the squared residuals, output units, each times its weight, at physical x; no trajectory is kept."""
        return self._gather(x, jnp.zeros(()), lambda total, r, weight, gap: total + weight * r**2)

    def _gather(self, x: Array, start: Any, learn: Callable[[Any, Array, Array, Array], Any]) -> Any:
        """What `learn` makes of the residuals, sample by sample, within the model's scan; summed over records."""
        batch, setting = self.objective.batch, self.setting

        def record(k: Any) -> Any:
            model, u = self.objective.coordinates.assemble(x, k), batch.u[k]
            first = model.init(u[0])
            single = first.shape == (1,)  # carried as a number: see `AbstractHysteresis.sweep`

            def sample(carry: tuple[Array, Any], at: tuple[Array, ...]) -> tuple[tuple[Array, Any], None]:
                (state, known), (before, now, dt, y, weight, gap) = carry, at
                state, out = model.step(state[None] if single else state, before, now, dt)
                return (state[0] if single else state, learn(known, y - out, weight, gap)), None

            rows = (jnp.concatenate([u[:1], u[:-1]]), u, batch.dt[k], batch.y[k], setting.weight[k])
            begin = (first[0] if single else first, start)
            if setting.gap.ndim == 0:  # even sampling: what depends on the gap alone stays outside the loop
                return jax.lax.scan(lambda c, at: sample(c, (*at, setting.gap)), begin, rows)[0][1]
            return jax.lax.scan(sample, begin, (*rows, setting.gap[k]))[0][1]

        if batch.u.shape[0] == 1:
            return record(0)
        parts = jax.lax.map(record, jnp.arange(batch.u.shape[0]))
        return jax.tree_util.tree_map(lambda v: jnp.sum(v, axis=0), parts)

    def log_density(self, z: Float[Array, " d"], lean: bool = False) -> Float[Array, ""]:
        """Log posterior over z, up to a constant; minus infinity where it is not finite."""
        total = self.log_prior(z) + (self.log_likelihood_lean(z) if lean else self.log_likelihood(z))
        return jnp.where(jnp.isfinite(total), total, -jnp.inf)

    def slope(self, z: Float[Array, " d"]) -> tuple[Float[Array, ""], Float[Array, " d"]]:
        """`log_density` and its gradient: a forward pass through the model, a backward one through the noise."""
        # One pass that only sums pays for few parameters; the derivatives by many would fill the loop.
        short = self._scans and self.p <= FORWARD and self.noise.tree(z[self.p :]).by_squares
        likelihood, by_x, by_noise = (self._slope_by_squares if short else self._slope_by_residuals)(z)
        by_model = by_x * self.objective.coordinates.slope(z[: self.p])
        prior, by_prior = jax.value_and_grad(self.log_prior)(z)
        total, gradient = prior + likelihood, by_prior + jnp.concatenate([by_model, by_noise])
        return jnp.where(jnp.isfinite(total), total, -jnp.inf), jnp.where(jnp.isfinite(gradient), gradient, 0.0)

    def _slope_by_squares(self, z: Array) -> tuple[Array, Array, Array]:
        """Log likelihood and its derivatives by x and by the noise's z, in one scan that keeps nothing."""
        x = self.objective.coordinates.physical(z[: self.p])
        squares, push = forward(self.squares)(x)
        density = lambda own, total: self.noise.tree(own).of_squares(self.setting, total)
        value, (by_noise, by_squares) = jax.value_and_grad(density, argnums=(0, 1))(z[self.p :], squares)
        return value, by_squares * push, by_noise

    def _slope_by_residuals(self, z: Array) -> tuple[Array, Array, Array]:
        """The same for any noise."""
        r, J = linearize(self.objective, self.objective.coordinates.physical(z[: self.p]))
        density = lambda own, r: log_likelihood(self.noise.tree(own), self.setting, self.objective, r)
        value, (by_noise, by_residual) = jax.value_and_grad(density, argnums=(0, 1))(z[self.p :], r)
        return value, jnp.einsum("rt,rtp->p", by_residual, J), by_noise

    def __call__(self, q: Float[Array, " d"]) -> Float[Array, ""]:
        """Log posterior over q; its reverse-mode gradient is `slope`'s."""

        @jax.custom_vjp
        def value(q: Array) -> Array:
            return self.log_density(self.unwhitened(q))

        def both(q: Array) -> tuple[Array, Array]:
            total, gradient = self.slope(self.unwhitened(q))
            return total, self.factor.T @ gradient

        value.defvjp(both, lambda gradient, cotangent: (cotangent * gradient,))
        return value(q)
