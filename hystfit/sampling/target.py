"""The log posterior in whitened coordinates q: y = center + factor q, with the posterior near N(0, I) in q after a fit."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.inference.density import Density
from hystfit.params.coordinates import BOTH
from hystfit.params.host_arrays import compiled, to_device
from hystfit.sampling.bend import Bend, Shear
from hystfit.sampling.linear_part import LinearPart
from hystfit.sampling.noise_coordinates import NoiseCoordinates
from hystfit.sampling.slope_coordinates import SlopeCoordinates

ROWS = 200  # places at once where only sums are kept
TOGETHER = 8  # places at once where they are heavy: more do not fit into the cache


class Target(eqx.Module):
    """The log posterior that samplers draw from."""

    density: Density  # over z, the unconstrained parameters of model and noise
    bend: Bend  # between z and the coordinates v of `hystfit.sampling.bend`
    center: Float[Array, " d"]  # center, factor: y = center + factor q
    factor: Float[Array, "d d"]
    shear: Shear | None = None  # between y and v; None where they are the same
    # coordinates of white and slow noise; None where the noise model has one part
    noise: NoiseCoordinates | None = None
    # coordinates of slopes of which the hysteresis takes a part; None where the model has none
    slopes: SlopeCoordinates | None = None
    # parameters whose coordinates are relative to their distribution given all the others; None for none
    linear: LinearPart | None = None

    @classmethod
    def about(cls, density: Density, z: Float[Array, " d"], widths: Float[Array, " d"] | None = None) -> Target:
        """Centered on z, not whitened."""
        kinds, slopes = (*density.objective.coordinates.kinds, *density.noise.kinds), SlopeCoordinates.of(density)
        both = np.equal(kinds, BOTH) if slopes is None else slopes.bent(kinds)
        bend = Bend(to_device(both), to_device(np.zeros(z.shape)) if widths is None else widths)
        eye, noise = to_device(np.eye(z.shape[0])), NoiseCoordinates.of(density)
        plain = cls(density, bend, z, eye, noise=noise, slopes=slopes)
        return plain.whitened(_v_of_z(plain, z), eye)

    def whitened(self, center: Float[Array, " d"], factor: Float[Array, "d d"]) -> Target:
        """The same density in other coordinates q."""
        return dataclasses.replace(self, center=center, factor=factor)

    def sheared(self, factor: Float[Array | np.ndarray, "d d"]) -> Target:
        """The same density in coordinates of another factor, in which others follow those with two bounds; outside traced code.

        The center stays where it is; that of this target is one of v.
        """
        center, factor = np.asarray(self.center), np.asarray(factor)
        shear = Shear.of(self.bend, center, factor)
        center = to_device(shear.unsheared(center, np))
        return dataclasses.replace(self, center=center, factor=to_device(factor), shear=shear)

    def given_others(self, linear: LinearPart) -> Target:
        """The same density with the coordinates of `LinearPart`, whitened by the same covariance of the others; outside traced code."""
        at, center = list(linear.places), np.array(self.center)
        covariance = np.asarray(self.factor) @ np.asarray(self.factor).T
        covariance[at], covariance[:, at], center[at] = 0.0, 0.0, 0.0
        covariance[at, at] = 1.0
        both, width = np.array(self.bend.both), np.array(self.bend.width)
        both[at], width[at] = False, 0.0
        numbers = (to_device(value) for value in (center, np.linalg.cholesky(covariance)))
        target = self.whitened(*numbers)
        return dataclasses.replace(target, bend=Bend(to_device(both), to_device(width)), linear=linear)

    def v_of(self, q: Any, xp: Any = jnp) -> Any:
        """v from q, shape (..., d); `xp` is the module of the arrays, as in `q_of`."""
        y = xp.asarray(self.center) + q @ xp.asarray(self.factor).T
        return y if self.shear is None else self.shear.sheared(y, xp)

    def q_of(self, v: Any, xp: Any = jnp) -> Any:
        """q from v."""
        y = v if self.shear is None else self.shear.unsheared(v, xp)
        return xp.linalg.solve(xp.asarray(self.factor), (y - xp.asarray(self.center))[..., None])[..., 0]

    def unwhitened(self, q: Float[Array | np.ndarray, "... d"]) -> Float[Array, "... d"]:
        """z from q."""
        return _unwhitened(self, to_device(q) if isinstance(q, np.ndarray) else q)

    def physical(self, q: Float[Array, " d"]) -> Float[Array, " d"]:
        """x from q."""
        return self.density.physical(self.unwhitened(q))

    def z_and_slope(self, w: Float[Array, " d"]) -> tuple[Float[Array, " d"], Float[Array, ""]]:
        """z from v without its bend, and log |det dz/dw|."""
        w = w if self.slopes is None else self.slopes.z_of(self.density, w)
        return (w, jnp.zeros(())) if self.noise is None else self.noise.z_and_slope(w)

    def log_density(self, v: Float[Array, " d"], lean: bool = False) -> Float[Array, ""]:
        """Log posterior over v; `lean` as for `Density.log_density`."""
        return self.log_density_and_z(v, lean)[0]

    def log_density_and_z(
        self, v: Float[Array, " d"], lean: bool = False
    ) -> tuple[Float[Array, ""], Float[Array, " d"]]:
        """`log_density` and z, which coordinates given others have only from the same simulations."""
        bend = self.bend.log_slope(v)
        if self.linear is not None:
            z, change = self.z_and_slope(self.bend.unbent(self.linear.without(v)))
            total, z = self.linear.log_density_and_z(self.density, z, v, lean)
        else:
            z, change = self.z_and_slope(self.bend.unbent(v))
            total = self.density.log_density(z, lean)
        return total + change + bend, z

    def slope(self, v: Float[Array, " d"]) -> tuple[Float[Array, ""], Float[Array, " d"]]:
        """`log_density` and its gradient."""
        if self.linear is not None:
            total, gradient = jax.value_and_grad(self.log_density)(v)
            return total, jnp.where(jnp.isfinite(gradient), gradient, 0.0)
        w, stretch = jax.jvp(self.bend.unbent, (v,), (jnp.ones_like(v),))
        (z, change), pull = jax.vjp(self.z_and_slope, w)
        total, gradient = self.density.slope(z)
        bent, by_bend = jax.value_and_grad(self.bend.log_slope)(v)
        return total + change + bent, pull((gradient, jnp.ones(())))[0] * stretch + by_bend

    def __call__(self, q: Float[Array, " d"]) -> Float[Array, ""]:
        """Log posterior over q; its reverse-mode gradient is that of `slope`."""

        @jax.custom_vjp
        def value(q: Array) -> Array:
            return self.log_density(self.v_of(q))

        def both(q: Array) -> tuple[Array, Array]:
            v, pull = jax.vjp(self.v_of, q)
            total, gradient = self.slope(v)
            return total, pull(gradient)[0]

        value.defvjp(both, lambda gradient, cotangent: (cotangent * gradient,))
        return value(q)


# Operations of JAX outside compiled code are one program each: 30 of 20 ms or more, and loops that are compiled again in every call.
@eqx.filter_jit
def _v_of_z(target: Target, z: Array) -> Array:
    w = z if target.noise is None else target.noise.of_z(z)
    return target.bend.bent(w if target.slopes is None else target.slopes.of_z(target.density, w))


@eqx.filter_jit
def _unwhitened(target: Target, q: Array) -> Array:
    v, linear = target.v_of(q), target.linear
    w = target.bend.unbent(v if linear is None else linear.without(v))
    w = w if target.slopes is None else target.slopes.z_of(target.density, w)
    z = w if target.noise is None else target.noise.z_of(w)
    if linear is None:
        return z
    rows = (row.reshape(-1, row.shape[-1]) for row in (z, v))
    return jax.lax.map(lambda at: linear.z_of(target.density, *at), tuple(rows)).reshape(z.shape)


@compiled
def log_densities_and_z(target: Target, q: Array) -> tuple[Array, Array]:
    """Log posterior at q of shape (n, d), for as many at once as the cache has room for; and z of the same shape as q."""
    return _at_once(lambda row: target.log_density_and_z(target.v_of(row), lean=True), target.density, q)


@compiled
def log_posterior(density: Density, z: Array) -> Array:
    """Log posterior over z at z of shape (n, d)."""
    return _at_once(lambda row: density.log_density(row, lean=True), density, z)


def _at_once(function: Callable[[Array], Any], density: Density, rows: Array) -> Any:
    """A function of each row, of as many at once as the cache has room for."""
    return jax.lax.map(function, rows, batch_size=TOGETHER if density.is_heavy else min(ROWS, len(rows)))
