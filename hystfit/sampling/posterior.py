"""The log posterior over the parameters of model and noise, in the coordinates in which samplers move.

x physical, z unconstrained, q whitened: z = center + factor q, with the posterior near N(0, I) in q after a fit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.batch import Batch
from hystfit.errors import DataError, ParameterError
from hystfit.fitting.again import problem_of
from hystfit.fitting.covariance import leftover
from hystfit.fitting.estimate import Estimate
from hystfit.fitting.generalized import linearize, log_prior, raw_residual
from hystfit.fitting.newton import FORWARD, forward, maximize
from hystfit.fitting.released import refine_released
from hystfit.models.base import AbstractHysteresis
from hystfit.noise import AbstractNoise, Setting
from hystfit.params import BOTH, LOWER, UPPER, Coordinates, ParameterSpace
from hystfit.priors import AbstractPrior, LogNormal, choose_priors
from hystfit.problem import Objective, Problem
from hystfit.residuals import Leftover, diagnose
from hystfit.results import FitResult

_MOST = 100  # parameters beyond which sampling is refused
_CURVE = 0.7  # standard deviation of the logarithm of a repeating error's size about what the residuals show of it
_WIDEST = 3.0  # standard deviation in z that a direction without curvature is given to start with


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
        return self.noise.tree(z[self.p :]).log_density(self.setting, r)

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
        density = lambda own, r: self.noise.tree(own).log_density(self.setting, r)
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


@dataclasses.dataclass(frozen=True)
class Setup:
    """A posterior made ready for sampling.

    Attributes:
        problem: model and data, as they were fitted.
        noise_name: which noise model.
        noise_space: its parameters.
        target: centered on the posterior's mode and whitened by the curvature there.
        mode: log posterior at the mode.
        names, units: of all parameters.
        notes: what was chosen, and why.
    """

    problem: Problem
    noise_name: str
    noise_space: ParameterSpace
    target: Target
    mode: float
    names: tuple[str, ...]
    units: tuple[str, ...]
    notes: tuple[str, ...]

    def describe_priors(self) -> dict[str, str]:
        """Priors in words, by parameter."""
        return {name: str(prior) for name, prior in zip(self.names, self.target.priors, strict=True)}


def choose_noise(left: Leftover, asked: str) -> tuple[str, list[str]]:
    """The noise model to use and why: what was asked for, or for "auto" slow noise, unless the residuals call for more."""
    found = diagnose(left)
    if asked == "auto":
        name = found.recommended if found.recommended in ("discrepancy", "student-t") else "ou"
        return name, [f"noise model {name}, because {'; '.join(found.reasons)}"]
    return asked, [f"noise={asked!r} was asked for, but {why}" for why in found.objections(asked)]


def prepare(
    result: FitResult,
    *,
    noise: str = "auto",
    priors: Mapping[str, AbstractPrior] | None = None,
) -> Setup:
    """Make the posterior of a fit ready: noise model, priors, mode and curvature.

    Args:
        result: the fit; its data, free parameters and values are taken.
        noise: "auto", or a name of `hystfit.noise.NOISES`.
        priors: the user's own, by parameter name; defaults for the others (`hystfit.priors.default_priors`).

    Raises:
        ParameterError: an unknown name, a prior that is flat or excludes the fit, too many parameters.
    """
    problem, x = problem_of(result)
    if len(problem.space) > _MOST:
        raise ParameterError(
            f"{len(problem.space)} free parameters are too many to sample (at most {_MOST}): fix most of them, or fewer cells or plays"
        )
    left = leftover(problem, x)
    name, notes = choose_noise(left, noise)
    refined = refine_released(problem, Estimate(x, 0.0, True, "", 0, np.zeros(1)), name)
    space = refined.space
    values = np.concatenate([refined.x, refined.values])
    chosen = choose_priors_for(problem.space, space, noise_priors(space, left) | dict(priors or {}), values)
    z = np.concatenate([_inside(problem.space, refined.x), _inside(space, refined.values)])
    batch = trimmed(problem.objective.batch)
    objective = eqx.tree_at(lambda o: o.batch, problem.objective, batch)
    d = z.size
    start = Target(objective, space.coordinates, Setting.of(batch), chosen, jnp.asarray(z), jnp.eye(d))
    names, units = (*problem.space.names, *space.names), (*problem.space.units, *space.units)
    if not np.isfinite(float(start.log_prior(jnp.asarray(z)))):
        outside = [
            n
            for n, prior, v in zip(names, chosen, values, strict=True)
            if not np.isfinite(float(prior.log_density(jnp.asarray(v))))
        ]
        raise ParameterError(
            f"the fit lies outside the prior of {', '.join(outside)}: widen it, or fit again within it"
        )
    mode = find_mode(start)
    center, factor, value, flat = whiten_by_curvature(mode)
    if not np.isfinite(value):
        raise DataError("the posterior is not finite at the fit: look at the fit's status and notes first")
    notes += [f"the data say next to nothing about {names[k]}: its posterior is its prior" for k in flat]
    target = eqx.tree_at(lambda t: (t.center, t.factor), start, (jnp.asarray(center), jnp.asarray(factor)))
    return Setup(problem, name, space, target, value, names, units, tuple(notes))


def noise_priors(space: ParameterSpace, left: Leftover) -> dict[str, AbstractPrior]:
    """Defaults that the residuals decide.

    Noise slower than a third of the record is a constant, which the offset already is. An error that repeats is about as large as
    the residuals show: model and discrepancy explain each other, and without a prior that says so draws run off to
    errors of any size that the model makes good (Brynjarsdottir and O'Hagan 2014).
    """
    slowest = max(max(row.size for row in left.rows) / 3, 10.0)
    about = LogNormal(float(np.sqrt(slowest)), float(np.log(slowest)) / 4)  # one sample to the slowest: two sd each way
    found: dict[str, AbstractPrior] = {"noise_time": about}
    if left.curve_size is not None:
        found["noise_loop"] = LogNormal(left.curve_size, _CURVE)
    return {name: prior for name, prior in found.items() if name in space.names}


def choose_priors_for(
    model: ParameterSpace, noise: ParameterSpace, own: Mapping[str, AbstractPrior] | None, x: np.ndarray
) -> tuple[AbstractPrior, ...]:
    """Priors of both spaces, in their order; `own` may name parameters of either.

    Raises:
        ParameterError: see `hystfit.priors.choose_priors`.
    """
    own = dict(own or {})
    theirs = {name: own.pop(name) for name in list(own) if name in noise.names}
    return choose_priors(model, own, x[: len(model)]) + choose_priors(noise, theirs, x[len(model) :])


def trimmed(batch: Batch) -> Batch:
    """A batch without padding that no record needs: a long run pays for its own compilation."""
    used = np.asarray(batch.weight) > 0
    end = int(np.max(np.flatnonzero(used.any(axis=0)))) + 1
    return jax.tree_util.tree_map(lambda v: v[:, :end], batch)


def _inside(space: ParameterSpace, x: np.ndarray) -> np.ndarray:
    """z with parameters that lie on a bound moved to where a mode can be found."""
    c = space.coordinates
    z = space.unconstrained(np.clip(x, np.asarray(c.lower), np.asarray(c.upper)))
    kind = np.asarray(c.kinds)
    one = (kind == LOWER) | (kind == UPPER)
    return np.where(one, np.maximum(z, np.log(1e-4)), np.where(kind == BOTH, np.clip(z, -9, 9), z))


@eqx.filter_jit
def _mode(target: Target) -> Any:
    return maximize(target.log_density, target.center, target.slope)


def find_mode(target: Target) -> Any:
    """The posterior's mode in z, by Newton steps from the target's center."""
    return _mode(target)


def whiten_by_curvature(mode: Any) -> tuple[np.ndarray, np.ndarray, float, list[int]]:
    """(center, factor, log posterior, coordinates without information) from an `Optimum`: factor factor' = inverse curvature."""
    curvature = -np.asarray(mode.hessian)
    curvature = np.where(np.isfinite(curvature), curvature, 0.0)
    size, axes = np.linalg.eigh(0.5 * (curvature + curvature.T))
    safe = np.maximum(size, _WIDEST**-2)
    factor = axes / np.sqrt(safe)
    loose = axes[:, size < _WIDEST**-2]
    flat = [int(np.argmax(np.abs(column))) for column in loose.T]
    return np.asarray(mode.z), factor, float(mode.value), sorted(set(flat))
