"""Refinement of a fit by the likelihood of a noise model, whose parameters come from the residuals.

For Gaussian noise the noise parameters maximize the restricted likelihood of the linearized model (with their weak default priors), and
the model's parameters the likelihood given them, in turns. For other noise both maximize their joint likelihood.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import scipy  # loads its subpackages when they are first used, which optimize is not in most fits
from jaxtyping import Array

from hystfit.inference.autocorrelation import autocorrelation_time
from hystfit.inference.bounded_newton import BoundedNewton
from hystfit.inference.density import Density
from hystfit.inference.newton import Optimum, maximize
from hystfit.inference.noise.base import AbstractNoise, ResidualScales
from hystfit.inference.noise.registry import NOISES
from hystfit.inference.noise.white import White
from hystfit.inference.problem import Problem
from hystfit.inference.whitened import Whitened, restricted
from hystfit.params.host_arrays import compiled
from hystfit.params.space import ParameterSpace

_STARTS = (0.2, 1.0, 5.0)  # correlation times tried, relative to that of the residuals


@dataclasses.dataclass(frozen=True)
class Refined:
    """A fit refined with a noise model."""

    x: np.ndarray  # the model's free parameters, physical, shape (p,)
    problem: Problem  # with the noise model and its fitted values
    values: np.ndarray  # those values, shape (q,)
    root: np.ndarray  # square root R of the information matrix R'R of x, shape (p, p)
    converged: bool  # both optimizations met their tolerances

    @property
    def noise(self) -> AbstractNoise:
        """The noise model with fitted values."""
        return self.problem.noise  # type: ignore[return-value]

    @property
    def parameters(self) -> dict[str, float]:
        """Fitted values of the noise by name."""
        return dict(zip(self.space.names, map(float, self.values), strict=True))

    @property
    def space(self) -> ParameterSpace:
        """Parameters of the noise."""
        return self.problem.noise_space  # type: ignore[return-value]


def refine(problem: Problem, x: np.ndarray, noise: str | type[AbstractNoise]) -> Refined:
    """Refine a fit with a noise model.

    Parameters on a bound are moved inside and freed, because the noise may have pushed them there; those that return are fixed in a second
    round. Linear weights stay on their bound: a solver put them there, and there may be hundreds.
    """
    on_bound = problem.on_bound(x)
    weights = on_bound & problem.space.linear
    released = on_bound & ~weights
    if not released.any():
        return refine_moving(problem, x, noise, ~on_bound)
    space = problem.space
    edge = 0.05 * space.width  # of the parameter's scale, or of the way between two bounds
    inside = np.where(released, np.clip(x, space.lower + edge, space.upper - edge), x)
    refined = refine_moving(problem, inside, noise, ~weights)
    returned = problem.on_bound(refined.x) & released
    if not returned.any():
        return refined
    return refine_moving(problem, np.where(returned, x, refined.x), noise, ~(returned | weights))


def refine_moving(problem: Problem, x: np.ndarray, noise: str | type[AbstractNoise], moving: np.ndarray) -> Refined:
    """`refine` where only the parameters `moving`, shape (p,), bool, may change."""
    r, J = problem.linearize(x)
    rows = [row[on] for row, on in zip(r, problem.used, strict=True)]
    time = max(autocorrelation_time(row) for row in rows)
    start = NOISES.find(noise).start(ResidualScales.of(rows, time))  # type: ignore[attr-defined]
    problem = problem.with_noise(start)
    if not start.gaussian:
        return _refine_jointly(problem, x, moving)
    density, space, live = problem.density, problem.noise_space, jnp.asarray(moving)
    assert space is not None
    starts = np.tile(space.unconstrained(space.vector(start)), (len(_STARTS), 1))
    if "noise_time" in space.names:
        starts[:, space.names.index("noise_time")] += np.log(_STARTS)
    settled, scale = False, problem.space.scale
    for _ in range(4):
        criterion = functools.partial(_restricted_slope, density, jnp.asarray(r), jnp.asarray(J), live)
        best, noise_settled = _fit_noise(criterion, starts)
        values = space.tree(best)
        newton = BoundedNewton(problem, problem.whitened(values), x)
        end = newton.descend(newton.coordinates(x), moving, tolerance=1e-6)
        new = np.where(moving, newton.physical(end.v), x)
        shift = float(np.max(np.abs(new - x) / scale))
        x, starts = new, best[None]
        r, J = problem.linearize(x)
        settled = end.settled and noise_settled
        if shift < 1e-3:
            break
    problem.noise = space.tree(starts[0])
    root = _information_root(problem.whitened(), r, J)
    return Refined(x, problem, space.physical(starts[0]), root, settled)


def _refine_jointly(problem: Problem, x: np.ndarray, moving: np.ndarray) -> Refined:
    p, space = len(problem.space), problem.noise_space
    assert space is not None
    z_of_noise = space.unconstrained(space.vector(problem.noise))
    start = np.concatenate([np.asarray(problem.space.coordinates.unconstrained(jnp.asarray(x))), z_of_noise])
    best = Optimum(*_fit_jointly(problem.density, jnp.asarray(start), jnp.asarray(x), jnp.asarray(moving)))
    x = np.where(moving, problem.space.physical(best.z[:p]), x)
    noise: AbstractNoise = space.tree(best.z[p:])
    problem.noise = noise
    r, J = problem.linearize(x)
    root = _information_root(problem.whitened(White(noise_white=noise.gaussian_scale())), r, J)
    return Refined(x, problem, space.physical(best.z[p:]), root, bool(best.converged))


def _log_prior(density: Density, z: Array) -> Array:
    """Log prior of the parameters of the noise in their unconstrained coordinates."""
    x, priors = density.noise.physical(z), density.priors[density.p :]
    return sum((prior.log_density(x[k]) for k, prior in enumerate(priors)), density.noise.log_jacobian(z))


@compiled
def _restricted_slope(density: Density, r: Array, J: Array, moving: Array, z: Array) -> tuple[Array, Array]:
    """Negative of the criterion for the parameters of the noise, and its gradient."""

    def value(z: Array) -> Array:
        return -restricted(density.noise.tree(z), density.setting, r, J, moving) - _log_prior(density, z)

    return jax.value_and_grad(value)(z)


def _fit_noise(criterion: Callable[[Array], tuple[Array, Array]], starts: np.ndarray) -> tuple[np.ndarray, bool]:
    """BFGS from the best of the starts: (z, converged). A Hessian through the filter would cost more than ten gradients."""

    def host(z: np.ndarray) -> tuple[float, np.ndarray]:
        value, gradient = (np.asarray(v) for v in criterion(jnp.asarray(z)))
        bad = not (np.isfinite(value) and np.isfinite(gradient).all())
        return (1e30, np.zeros(z.size)) if bad else (float(value), gradient)

    values = [host(z)[0] for z in starts] if len(starts) > 1 else [0.0]
    first = starts[int(np.argmin(values))]
    solution = scipy.optimize.minimize(host, first, jac=True, method="BFGS", options={"gtol": 1e-3, "maxiter": 100})
    _, gradient = host(solution.x)
    return solution.x, bool(np.max(np.abs(gradient)) < 0.05)


@compiled
def _fit_jointly(density: Density, z: Array, x: Array, moving: Array) -> tuple[Array, ...]:
    """Parameters of model and noise by their joint likelihood and the priors of the noise: the fields of an `Optimum`."""
    held = density.objective.coordinates.unconstrained(x)

    def value(z: Array) -> Array:
        model, noise = jnp.where(moving, z[: density.p], held), z[density.p :]
        total = density.log_likelihood(jnp.concatenate([model, noise])) + _log_prior(density, noise)
        return jnp.where(jnp.isfinite(total), total, -jnp.inf)

    return tuple(maximize(value, z))


_rows = compiled(Whitened.rows)


def _information_root(whitened: Whitened, r: np.ndarray, J: np.ndarray) -> np.ndarray:
    """R with R'R the information about the parameters after the noise's shapes are eliminated, by QR."""
    rows, p = np.asarray(_rows(whitened, jnp.asarray(r), jnp.asarray(J))), J.shape[-1]
    size = np.linalg.norm(rows, axis=0)
    size[size == 0] = 1.0
    triangle = np.asarray(np.linalg.qr(rows / size, mode="r"))
    return triangle[-p - 1 : -1, -p - 1 : -1] * size[-p - 1 : -1]
