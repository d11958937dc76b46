"""Generalized least squares: a fit refined with the likelihood of a noise model, whose own parameters come from the residuals.

For Gaussian noise the hyperparameters maximize the restricted likelihood of the linearized model (with their weak default priors), and the
model's parameters the likelihood given them, in turns. For Student's t both maximize their joint likelihood.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jaxtyping import Array, Float

from hystfit.fitting.estimate import Estimate
from hystfit.inference.newton import Optimum, descend, maximize
from hystfit.inference.noise import AbstractNoise, Setting, White, starting_noise
from hystfit.inference.priors import AbstractPrior, default_priors
from hystfit.inference.problem import Objective, Problem
from hystfit.params.coordinates import Coordinates
from hystfit.params.space import ParameterSpace
from hystfit.results.metrics import autocorrelation_time

_ROUNDS = 4
_LIMIT = 1e3  # times the output's size: residuals beyond are those of a simulation that breaks
_STARTS = (0.2, 1.0, 5.0)  # correlation times tried, in that of the residuals


class Whitened(eqx.Module):
    """Least squares in the coordinates in which a Gaussian noise model is white; shapes of the noise are integrated out.

    Attributes:
        objective: data and model.
        noise: with values.
        setting: the data as the noise sees them.
    """

    objective: Objective
    noise: AbstractNoise
    setting: Setting

    def residual(self, x: Float[Array, " p"]) -> Float[Array, "R T"]:
        """Prediction less measurement at physical x, output units."""
        return raw_residual(self.objective, x)

    def cost(self, x: Float[Array, " p"]) -> Float[Array, ""]:
        """Half the squared whitened residual."""
        return self._project(self.residual(x)[..., None])[0]

    def normal(self, x: Float[Array, " p"]) -> tuple[Float[Array, ""], Float[Array, " p"], Float[Array, "p p"]]:
        """Cost, gradient and information matrix at physical x."""
        r, J = linearize(self.objective, x)
        return self._project(jnp.concatenate([r[..., None], J], axis=-1))

    def rows(self, r: Float[Array, "R T"], J: Float[Array, "R T p"]) -> Float[Array, "n q"]:
        """Whitened columns [shapes, J, r], with the rows that hold the shapes' weights back below: a QR of them solves everything."""
        columns = self.noise.columns(self.setting)
        parts = ([] if columns is None else [columns]) + [J, r[..., None]]
        e, _ = self.noise.whiten(self.setting, jnp.concatenate(parts, axis=-1))
        e = e.reshape(-1, e.shape[-1])
        shapes = 0 if columns is None else columns.shape[-1]
        return jnp.concatenate([e, jnp.eye(shapes, e.shape[1])])

    def _project(self, signals: Array) -> tuple[Array, Array, Array]:
        columns = self.noise.columns(self.setting)
        k = signals.shape[-1]
        e, _ = self.noise.whiten(
            self.setting, signals if columns is None else jnp.concatenate([signals, columns], axis=-1)
        )
        e = e.reshape(-1, e.shape[-1])
        own, shapes = e[:, :k], e[:, k:]
        gram = own.T @ own
        if shapes.shape[1]:
            cross = shapes.T @ own
            gram = gram - cross.T @ jnp.linalg.solve(jnp.eye(shapes.shape[1]) + shapes.T @ shapes, cross)
        return 0.5 * gram[0, 0], gram[0, 1:], gram[1:, 1:]


def raw_residual(objective: Objective, x: Float[Array, " p"]) -> Float[Array, "R T"]:
    """Prediction less measurement, output units, 0 where a sample does not count and limited where the simulation breaks."""
    r = objective.predict_physical(x) - objective.batch.y
    limit = _LIMIT * objective.size
    return jnp.where(objective.batch.weight > 0, jnp.where(jnp.isfinite(r), jnp.clip(r, -limit, limit), limit), 0.0)


def log_likelihood(noise: AbstractNoise, setting: Setting, objective: Objective, r: Float[Array, "R T"]) -> Array:
    """Log density of residuals of `raw_residual`; minus infinity where one was limited.

    A constant, as limited residuals are, is what a repeating error explains best of all.
    """
    limited = jnp.any(jnp.abs(r) >= _LIMIT * objective.size)
    return jnp.where(limited, -jnp.inf, noise.log_density(setting, r))


def linearize(objective: Objective, x: Float[Array, " p"]) -> tuple[Float[Array, "R T"], Float[Array, "R T p"]]:
    """Residuals, output units, and their derivatives, in one forward pass."""
    push = lambda t: jax.jvp(lambda x: raw_residual(objective, x), (x,), (t,))
    r, J = jax.vmap(push, out_axes=(None, 0))(jnp.eye(x.shape[0]))
    return r, jnp.moveaxis(J, 0, -1)


def restricted(noise: AbstractNoise, setting: Setting, r: Array, J: Array, moving: Array) -> Array:
    """Restricted log likelihood of a noise model for residuals r of a model with derivatives J (Patterson and Thompson 1971).

    Columns of J that are not `moving` are left out; a small ridge keeps a rank-deficient J from deciding anything.
    """
    size = jnp.sqrt(jnp.sum(J**2, axis=(0, 1)))
    columns = J * jnp.where(moving & (size > 0), 1 / jnp.where(size > 0, size, 1.0), 0.0) * jnp.linalg.norm(r)
    shapes = noise.columns(setting)
    parts = [r[..., None], columns] + ([] if shapes is None else [shapes])
    e, logs = noise.whiten(setting, jnp.concatenate(parts, axis=-1))
    e = e.reshape(-1, e.shape[-1])
    own, others = e[:, 0], e[:, 1:]
    p = J.shape[-1]
    prior = jnp.concatenate([jnp.where(moving, 1e-10, 1.0), jnp.ones(others.shape[1] - p)])
    matrix = others.T @ others + jnp.diag(prior)
    factor = jnp.linalg.cholesky(matrix)
    half = jax.scipy.linalg.solve_triangular(factor, others.T @ own, lower=True)
    return -0.5 * jnp.sum(logs) - 0.5 * (jnp.sum(own**2) - jnp.sum(half**2)) - jnp.sum(jnp.log(jnp.diag(factor)))


def log_prior(coordinates: Coordinates, priors: tuple[AbstractPrior, ...], z: Array) -> Array:
    """Log prior density over unconstrained coordinates."""
    x = coordinates.physical(z)
    return sum((prior.log_density(x[k]) for k, prior in enumerate(priors)), coordinates.log_jacobian(z))


@eqx.filter_jit
def _restricted_slope(
    coordinates: Coordinates,
    priors: tuple[AbstractPrior, ...],
    setting: Setting,
    r: Array,
    J: Array,
    moving: Array,
    z: Array,
) -> tuple[Array, Array]:
    """Negative of the criterion for the noise's parameters, and its gradient."""

    def value(z: Array) -> Array:
        return -restricted(coordinates.tree(z), setting, r, J, moving) - log_prior(coordinates, priors, z)

    return jax.value_and_grad(value)(z)


def _fit_noise(criterion: Callable[[Array], tuple[Array, Array]], starts: np.ndarray) -> tuple[np.ndarray, bool]:
    """BFGS from the best of the starts: (z, converged). Hessians through the filter would cost ten gradients and more."""

    def host(z: np.ndarray) -> tuple[float, np.ndarray]:
        value, gradient = (np.asarray(v) for v in criterion(jnp.asarray(z)))
        bad = not (np.isfinite(value) and np.isfinite(gradient).all())
        return (1e30, np.zeros(z.size)) if bad else (float(value), gradient)

    values = [host(z)[0] for z in starts] if len(starts) > 1 else [0.0]
    first = starts[int(np.argmin(values))]
    found = scipy.optimize.minimize(host, first, jac=True, method="BFGS", options={"gtol": 1e-3, "maxiter": 100})
    _, gradient = host(found.x)
    return found.x, bool(np.max(np.abs(gradient)) < 0.05)


@eqx.filter_jit
def _fit_model(whitened: Whitened, x: Array, moving: Array) -> tuple[Array, Array, Array]:
    c = whitened.objective.coordinates
    z = c.unconstrained(x)

    def normal(z: Array) -> tuple[Array, Array, Array]:
        slope = c.slope(z)
        value, g, matrix = whitened.normal(c.physical(z))
        return value, g * slope, matrix * slope[:, None] * slope[None, :]

    z, value, done = descend(lambda z: whitened.cost(c.physical(z)), normal, z, moving)
    return jnp.where(moving, c.physical(z), x), value, done


@eqx.filter_jit
def _fit_jointly(
    objective: Objective,
    coordinates: Coordinates,
    priors: tuple[AbstractPrior, ...],
    setting: Setting,
    z: Array,
    x: Array,
    moving: Array,
) -> Optimum:
    """Both kinds of parameters by their joint likelihood; z holds those of the model first."""
    p = x.shape[0]

    def value(z: Array) -> Array:
        own = jnp.where(moving, objective.coordinates.physical(z[:p]), x)
        noise = coordinates.tree(z[p:])
        likelihood = log_likelihood(noise, setting, objective, raw_residual(objective, own))
        total = likelihood + log_prior(coordinates, priors, z[p:])
        return jnp.where(jnp.isfinite(total), total, -jnp.inf)

    return maximize(value, z)


@dataclasses.dataclass(frozen=True)
class NoiseFit:
    """A fit refined with a noise model.

    Attributes:
        x: the model's free parameters, physical, shape (p,).
        noise: with fitted values.
        space: its parameters.
        values: those values, shape (q,).
        root: square root R of the information matrix R'R of x, shape (p, p).
        converged: both optimizations met their tolerances.
    """

    x: np.ndarray
    noise: AbstractNoise
    space: ParameterSpace
    values: np.ndarray
    root: np.ndarray
    converged: bool

    def describe(self) -> str:
        """The noise in words, with units."""
        shown = ", ".join(
            f"{name} = {value:.3g} {unit}".rstrip()
            for name, value, unit in zip(self.space.names, self.values, self.space.units, strict=True)
        )
        return f"noise model {self.noise.name}: {shown}"


def refine(problem: Problem, estimate: Estimate, name: str, moving: np.ndarray) -> NoiseFit:
    """Refine an estimate with a noise model by name; parameters that are not `moving` (on a bound) stay.

    Raises:
        ParameterError: an unknown noise model.
    """
    objective, setting = problem.objective, Setting.of(problem.objective.batch)
    x = jnp.asarray(estimate.x)
    r, J = _linearize(objective, x)
    used = np.asarray(objective.batch.weight) > 0
    rows = [row[on] for row, on in zip(np.asarray(r), used, strict=True)]
    time = max(autocorrelation_time(row) for row in rows)
    noise = starting_noise(name, rows, time)
    space = ParameterSpace.of(noise, scales=problem.scales)
    priors = tuple(default_priors(space)[known] for known in space.names)
    z = space.unconstrained(space.vector(noise))
    live = jnp.asarray(moving)
    if not noise.gaussian:
        return _refine_jointly(problem, space, priors, setting, z, x, live)
    starts = np.tile(z, (len(_STARTS), 1))
    if "noise_time" in space.names:
        starts[:, space.names.index("noise_time")] += np.log(_STARTS)
    settled = False
    for _ in range(_ROUNDS):
        criterion = functools.partial(_restricted_slope, space.coordinates, priors, setting, r, J, live)
        best, found = _fit_noise(criterion, starts)
        noise = space.tree(best)
        new, _, done = _fit_model(Whitened(objective, noise, setting), x, live)
        shift = float(jnp.max(jnp.abs(new - x) / objective.coordinates.scale))
        x, starts = new, best[None]
        r, J = _linearize(objective, x)
        settled = bool(done) and found
        if shift < 1e-3:
            break
    root = _root(Whitened(objective, noise, setting), r, J)
    return NoiseFit(np.asarray(x), noise, space, space.physical(starts[0]), root, settled)


def _refine_jointly(
    problem: Problem,
    space: ParameterSpace,
    priors: tuple[AbstractPrior, ...],
    setting: Setting,
    z: np.ndarray,
    x: Array,
    moving: Array,
) -> NoiseFit:
    objective, p = problem.objective, x.shape[0]
    start = jnp.concatenate([objective.coordinates.unconstrained(x), jnp.asarray(z)])
    found = _fit_jointly(objective, space.coordinates, priors, setting, start, x, moving)
    x = jnp.where(moving, objective.coordinates.physical(found.z[:p]), x)
    noise = space.tree(found.z[p:])
    r, J = _linearize(objective, x)
    # Fisher information about the location of Student's t, per sample, is (dof + 1) / (dof + 3) / scale^2.
    scale = noise.noise_white * jnp.sqrt((noise.noise_dof + 3) / (noise.noise_dof + 1))
    root = _root(Whitened(objective, White(noise_white=scale), setting), r, J)
    return NoiseFit(np.asarray(x), noise, space, space.physical(found.z[p:]), root, bool(found.converged))


@eqx.filter_jit
def _linearize(objective: Objective, x: Array) -> tuple[Array, Array]:
    return linearize(objective, x)


@eqx.filter_jit
def _rows(whitened: Whitened, r: Array, J: Array) -> Array:
    return whitened.rows(r, J)


def _root(whitened: Whitened, r: Array, J: Array) -> np.ndarray:
    """R with R'R the information about the parameters after the noise's shapes are eliminated, by QR."""
    rows, p = np.asarray(_rows(whitened, r, J)), J.shape[-1]
    size = np.linalg.norm(rows, axis=0)
    size[size == 0] = 1.0
    triangle = np.asarray(np.linalg.qr(rows / size, mode="r"))
    return triangle[-p - 1 : -1, -p - 1 : -1] * size[-p - 1 : -1]
