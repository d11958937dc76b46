"""Coordinates of parameters that enter the output linearly, such as weights, gains and offsets, given all other parameters.

Under Gaussian noise the likelihood of such parameters x is normal, with a mean and a covariance that follow from the others. A thin,
curved ridge is often this mean, known to many digits, as a function of the others. The coordinates here are e with

    x = mean(others) + root(others) e,

so that e is nearly standard normal and independent of the others, whose density is then that of their marginal posterior (a
non-centered parametrization: Papaspiliopoulos, Roberts and Skold 2007, Stat. Sci. 22). No prior is changed, whatever its form.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.inference.density import Density
from hystfit.inference.objective import linearized
from hystfit.inference.problem import Problem
from hystfit.models.shared.shapes import Scalar
from hystfit.params.host_arrays import to_device

_CLEAR = 6.0  # standard deviations from a bound beyond which it cuts nothing off: one in 1e9 of a normal distribution
_SAME = 1e-7  # relative difference of derivatives that is rounding
_STEP = 0.5  # of a parameter's size, or of the way to its bound, over which derivatives are compared


class LinearPart(eqx.Module):
    """The map between e and x of k parameters of a model."""

    places: tuple[int, ...] = eqx.field(static=True)  # of these parameters in z
    reference: Float[Array, " k"]  # z of these from which x is counted
    moves: Float[Array, "k p"]  # steps of the parameters, in which x is counted, one in each row
    precision: Float[Array, " k"]  # of their priors, about, in these steps

    @classmethod
    def of(cls, problem: Problem, z: Float[np.ndarray, " d"], deviations: Float[np.ndarray, " p"]) -> LinearPart | None:
        """Those off their bounds by these standard deviations; None where there are none, or the noise is not Gaussian."""
        space, p = problem.space, len(problem.space)
        if not problem.noise_space or not problem.noise.gaussian:  # type: ignore[union-attr]
            return None
        x = space.physical(z[:p])
        room = np.minimum(x - space.lower, space.upper - x)
        steps = _STEP * np.minimum(np.maximum(np.abs(x), space.scale), room)
        places = _jointly_linear(problem, x, steps, room > _CLEAR * deviations)
        if not places:
            return None
        spread = np.array([np.ptp(problem.priors[k].quantiles([0.16, 0.84])) / 2 for k in places])
        moves = np.eye(p)[places] * steps[places, None]
        numbers = (to_device(value) for value in (z[places], moves, (steps[places] / spread) ** 2))
        return cls(tuple(places), *numbers)

    def without(self, v: Float[Array, "... d"]) -> Float[Array, "... d"]:
        """v with numbers in the place of e that mean nothing."""
        return v.at[..., self.places].set(0.0)

    def z_of(self, density: Density, z: Float[Array, " d"], v: Float[Array, " d"]) -> Float[Array, " d"]:
        """z with these parameters, from that of the others and from v, which has e in their places."""
        return self._of(density, z, v)[1]

    def log_density_and_z(
        self, density: Density, z: Float[Array, " d"], v: Float[Array, " d"], lean: bool = False
    ) -> tuple[Scalar, Float[Array, " d"]]:
        """Log posterior over the others and e, minus infinity beyond a bound, and `z_of`; with `lean`, see `Density.integrated`."""
        value, z, amounts, inside = self._of(density, z, v, lean)
        coordinates, at, e = density.objective.coordinates, jnp.asarray(self.places), v[jnp.asarray(self.places)]
        by_z = jnp.log(jnp.abs(coordinates.slope(z[: density.p])[at]))
        total = value + density.log_prior(z) - jnp.sum(by_z) + 0.5 * jnp.sum(self.precision * amounts**2 - e**2)
        return jnp.where(inside & jnp.isfinite(total), total, -jnp.inf), z

    def _of(self, density: Density, z: Array, v: Array, lean: bool = False) -> tuple[Scalar, Array, Array, Array]:
        """Log of the integral over these parameters, z, their amounts in `moves`, and whether they are within bounds."""
        at = jnp.asarray(self.places)
        value, shift, root = density.integrated(z.at[at].set(self.reference), self.moves, self.precision, lean)
        amounts = jax.scipy.linalg.solve_triangular(root, shift + v[at], lower=True, trans=1)
        coordinates = density.objective.coordinates
        x = coordinates.physical(z.at[at].set(self.reference)[: density.p]) + amounts @ self.moves
        inside = jnp.all((x > coordinates.lower) & (x < coordinates.upper))
        return value, z.at[at].set(coordinates.unconstrained(x)[at]), amounts, inside


def _jointly_linear(problem: Problem, x: np.ndarray, steps: np.ndarray, clear: np.ndarray) -> list[int]:
    """Numbers of parameters, of those that are clear, in which the output is linear together: derivatives over steps are those at x."""
    objective, candidates = problem.objective, np.flatnonzero(clear)
    derivatives = lambda x: linearized(objective, x)[1][..., candidates].reshape(-1, candidates.size)
    here = derivatives(x)
    size = np.sqrt(np.sum(here**2, axis=0))
    changed = np.array([
        np.sqrt(np.sum((derivatives(x + step * unit) - here) ** 2, axis=0)) > _SAME * size
        for step, unit in zip(steps[candidates], np.eye(x.size)[candidates], strict=True)
    ]).reshape(candidates.size, candidates.size)  # fmt: skip
    changed |= changed.T
    alone = np.flatnonzero(~np.diag(changed) & (size > 0))
    chosen: list[int] = []
    for k in sorted(alone, key=lambda k: int(changed[k, alone].sum())):  # those that exclude fewest others first
        if not changed[k, chosen].any():
            chosen.append(int(k))
    return sorted(int(candidates[k]) for k in chosen)
