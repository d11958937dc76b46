"""The traced log density over the parameters of model and noise: likelihood, priors and gradient."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.inference.correlated_priors import Dependence
from hystfit.inference.newton import FORWARD, forward
from hystfit.inference.noise.base import AbstractNoise, integral
from hystfit.inference.noise.setting import Setting
from hystfit.inference.objective import Objective, by_record
from hystfit.inference.priors import AbstractPrior
from hystfit.models.shared.shapes import Scalar
from hystfit.params.coordinates import Coordinates


class Density(eqx.Module):
    """Log likelihood, prior and posterior at z, the unconstrained parameters of the model, then of the noise, shape (d,)."""

    objective: Objective
    noise: Coordinates
    setting: Setting
    priors: tuple[AbstractPrior, ...]
    dependence: Dependence | None = None

    @property
    def p(self) -> int:
        """Number of the model's parameters."""
        return len(self.objective.coordinates.kinds)

    def physical(self, z: Float[Array, " d"]) -> Float[Array, " d"]:
        """x from z."""
        return jnp.concatenate([self.objective.coordinates.physical(z[: self.p]), self.noise.physical(z[self.p :])])

    def log_prior(self, z: Float[Array, " d"]) -> Scalar:
        x = self.physical(z)
        total = sum((prior.log_density(x[k]) for k, prior in enumerate(self.priors)), jnp.zeros(()))
        if self.dependence is not None:
            total += self.dependence.log_density(self.priors, x)
        model, noise = self.objective.coordinates, self.noise
        return total + model.log_jacobian(z[: self.p]) + noise.log_jacobian(z[self.p :])

    def log_likelihood(self, z: Float[Array, " d"]) -> Scalar:
        """Log density of the data that count."""
        return self.log_likelihood_of(self.physical(z))

    def log_likelihood_of(self, x: Float[Array, " d"]) -> Scalar:
        """`log_likelihood` at physical parameters, which may lie on their bounds."""
        return self._of_residual(self.noise.assemble(x[self.p :]), self.objective.residual(x[: self.p]))

    def _of_residual(self, noise: AbstractNoise, r: Float[Array, "R T"]) -> Array:
        # Otherwise the constant residuals of simulations that are not finite would be likely under a recurring error.
        return jnp.where(self.objective.broken(r), -jnp.inf, noise.log_density(self.setting, r))

    def integrated(
        self, z: Float[Array, " d"], moves: Float[Array, "k p"], precision: Float[Array, " k"], lean: bool = False
    ) -> tuple[Scalar, Float[Array, " k"], Float[Array, "k k"]]:
        """`AbstractNoise.integrated` over w, for a model whose output is linear in w at the physical parameters x(z) + w moves.

        With `lean`, in one scan that keeps no trajectory, where the model and the noise allow for it.
        """
        x, noise = self.objective.coordinates.physical(z[: self.p]), self.noise.tree(z[self.p :])
        several = jnp.concatenate([x[None], x + moves])
        if lean and not self.keeps_trajectories:
            return integral(*self._products(several, noise), precision)
        # Differences of outputs instead of derivatives: differentiating these again compiles in half the time.
        r = jax.vmap(self.objective.residual)(several)
        signals = jnp.moveaxis(r[0] - r[1:], 0, -1)
        value, shift, root = noise.integrated(self.setting, r[0], signals, precision)
        return jnp.where(self.objective.broken(r[0]), -jnp.inf, value), shift, root

    def _products(self, x: Float[Array, "m p"], noise: AbstractNoise) -> tuple[Scalar, Float[Array, "m m"]]:
        """Log density of no residuals, and products of whitened signals: the residual of the first x, and its excess over each other."""
        left, right = np.tril_indices(len(x))

        def update(carry: tuple[Array, ...], r: Array, weight: Array, gap: Array) -> tuple[Array, ...]:
            signals = jnp.concatenate([r[:1], r[0] - r[1:]])
            state, e, logs = noise.steps(carry[0], signals, gap, weight)
            e, none = jnp.where(weight > 0, e, 0.0), noise.density(jnp.zeros_like(logs), logs)
            return state, carry[1] + jnp.where(weight > 0, none, 0.0), carry[2] + e[left] * e[right]

        start = noise.start_of(len(x)), jnp.zeros(()), jnp.zeros(left.size)
        _, plain, products = self._accumulate(x, start, update)
        whole = jnp.zeros((len(x), len(x))).at[left, right].set(products)
        return plain, whole.at[right, left].set(products)

    def log_density(self, z: Float[Array, " d"], lean: bool = False) -> Scalar:
        """Log posterior over z, up to a constant, minus infinity where it is not finite; `lean` by `log_likelihood_lean`."""
        total = self.log_prior(z) + (self.log_likelihood_lean(z) if lean else self.log_likelihood(z))
        return jnp.where(jnp.isfinite(total), total, -jnp.inf)

    # -- without trajectories ------------------------------------------------------------------------------------------

    def log_likelihood_lean(self, z: Float[Array, " d"]) -> Scalar:
        """`log_likelihood` in one scan that keeps no trajectory: several times the throughput under vmap over many z."""
        if self.keeps_trajectories:
            return self.log_likelihood(z)
        noise = self.noise.tree(z[self.p :])
        x = self.objective.coordinates.physical(z[: self.p])
        if noise.by_squares:
            return noise.of_squares(self.setting, self.squares(x))

        def update(carry: tuple[Array, Array], r: Array, weight: Array, gap: Array) -> tuple[Array, Array]:
            state, e, logs = noise.step(carry[0], r, gap, weight)
            return state, carry[1] + jnp.where(weight > 0, noise.density(e, logs), 0.0)

        return self._accumulate(x, (noise.init(), jnp.zeros(())), update)[1]

    @property
    def keeps_trajectories(self) -> bool:
        """Whether even the lean likelihood needs whole trajectories: of the model's parts, or for shapes of the noise."""
        return not self._scans or self.noise.tree(jnp.zeros(len(self.noise.kinds))).has_shapes

    @property
    def is_heavy(self) -> bool:
        """Whether one likelihood fills much of the cache: trajectories, or a step with a loop of its own, such as several substeps.

        200 at once take 4.4 ms each for Jiles-Atherton, 8 at once 2.5 ms; for Bouc-Wen 0.07 and 0.14 ms.
        """
        if self.keeps_trajectories:
            return True
        model, zero = self.objective.coordinates.assemble(jnp.zeros(self.p), 0), jnp.zeros(())
        return _has_loop(jax.make_jaxpr(lambda state: model.step(state, zero, zero, zero))(model.init(zero)))

    @property
    def _scans(self) -> bool:
        """Whether the scan over the samples can include the noise."""
        return self.objective.coordinates.assemble(jnp.zeros(self.p)).one_scan

    def squares(self, x: Float[Array, " p"]) -> Scalar:
        """Weighted sum of squared residuals at physical x [y^2]; no trajectory is kept."""
        return self._accumulate(x, jnp.zeros(()), lambda total, r, weight, gap: total + weight * r**2)

    def _accumulate(self, x: Array, start: Any, update: Callable[[Any, Array, Array, Array], Any]) -> Any:
        """Fold `update` over the residuals within the model's scan; summed over records.

        For several parameter vectors, x of shape (m, p), `update` takes m residuals at once.
        """
        batch, setting = self.objective.batch, self.setting
        each: Any = jax.vmap if x.ndim == 2 else lambda function: function

        def record(k: Any) -> Any:
            models, u = each(lambda x: self.objective.coordinates.assemble(x, k))(x), batch.u[k]
            first = each(lambda model: model.init(u[0]))(models)
            single = first.shape[-1:] == (1,)  # carried as a number: see `AbstractHysteresis.sweep`

            def sample(carry: tuple[Array, Any], at: tuple[Array, ...]) -> tuple[tuple[Array, Any], None]:
                (state, total), (before, now, dt, y, weight, gap) = carry, at
                step = each(lambda model, state: model.step(state, before, now, dt))
                state, out = step(models, state[..., None] if single else state)
                return (state[..., 0] if single else state, update(total, y - out, weight, gap)), None

            rows = (jnp.concatenate([u[:1], u[:-1]]), u, batch.dt[k], batch.y[k], setting.weight[k])
            begin = (first[..., 0] if single else first, start)
            if setting.gap.ndim == 0:  # even sampling: what depends on the gap alone stays outside the loop
                return jax.lax.scan(lambda c, at: sample(c, (*at, setting.gap)), begin, rows)[0][1]
            return jax.lax.scan(sample, begin, (*rows, setting.gap[k]))[0][1]

        return jax.tree_util.tree_map(lambda v: jnp.sum(v, axis=0), by_record(record, batch.u.shape[0]))

    # -- gradient ------------------------------------------------------------------------------------------------------

    def slope(self, z: Float[Array, " d"]) -> tuple[Scalar, Float[Array, " d"]]:
        """`log_density` and its gradient: a forward pass through the model, a backward one through the noise."""
        # For few parameters, one scan that only accumulates sums and their derivatives is faster.
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
        density = lambda noise, total: self.noise.tree(noise).of_squares(self.setting, total)
        value, (by_noise, by_squares) = jax.value_and_grad(density, argnums=(0, 1))(z[self.p :], squares)
        return value, by_squares * push, by_noise

    def _slope_by_residuals(self, z: Array) -> tuple[Array, Array, Array]:
        """`_slope_by_squares` for any noise model."""
        x = self.objective.coordinates.physical(z[: self.p])
        density = lambda noise, r: self._of_residual(self.noise.tree(noise), r)
        slopes = jax.value_and_grad(density, argnums=(0, 1))
        if self.p > FORWARD:  # one backward pass costs less than so many forward ones
            r, pull = jax.vjp(self.objective.residual, x)
            value, (by_noise, by_residual) = slopes(z[self.p :], r)
            return value, pull(by_residual)[0], by_noise
        r, J = self.objective.linearize(x)
        value, (by_noise, by_residual) = slopes(z[self.p :], r)
        return value, jnp.einsum("rt,rtp->p", by_residual, J), by_noise


def _has_loop(program: Any) -> bool:
    """Whether a program of JAX, or one within it, has a loop."""
    inner = lambda step: jax.tree_util.tree_leaves(
        tuple(step.params.values()), is_leaf=lambda part: hasattr(part, "eqns")
    )
    return any(
        step.primitive.name in ("scan", "while")
        or any(_has_loop(part) for part in inner(step) if hasattr(part, "eqns"))
        for step in program.eqns
    )
