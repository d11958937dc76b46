"""A small dense optimizer for compiled code: damped Newton steps on any smooth function."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hystfit.models.shared.shapes import Scalar

FORWARD = 16  # coordinates up to which forward-mode second derivatives are the cheaper ones
LONGEST = 2.0  # step in z, infinity norm
_CLIMBING, _POLISHING, _DONE = 0, 1, 2
_FARTHEST = 0.2  # in z
# Of a standard deviation: over differences of gradients this far apart, the kinks that a likelihood has where a sample changes branch
# do not look like curvature.
_PART = 0.5


class Optimum(NamedTuple):
    """End point z of an optimizer, with the value and the second derivatives there.

    It has converged where the predicted gain of a further step is negligible, by the gradient there or by its average about it: on a
    maximum that is a kink the former does not vanish.
    """

    z: Float[Array, " d"]
    value: Scalar
    hessian: Float[Array, "d d"]
    converged: Array


def forward(function: Callable[[Array], Array]) -> Callable[[Array], tuple[Array, Array]]:
    """Value and gradient of a scalar function from one forward pass: for few coordinates the cheapest, else one backward pass."""

    def both(z: Array) -> tuple[Array, Array]:
        if z.shape[0] > FORWARD:
            return jax.value_and_grad(function)(z)
        return jax.vmap(lambda t: jax.jvp(function, (z,), (t,)), out_axes=(None, 0))(jnp.eye(z.shape[0]))

    return both


def second_order(
    slope: Callable[[Array], tuple[Array, Array]],
    z: Float[Array, " d"],
    axes: Float[Array, "d d"],
    width: Float[Array, " d"],
) -> tuple[Scalar, Float[Array, "2 d"], Float[Array, "d d"]]:
    """Value; gradient, at z and averaged over the points about it; and the Hessian by central differences of the gradient.

    Differences are taken by `width` to either side along orthonormal `axes` (columns): near the principal axes and a standard deviation
    every entry keeps its digits. Second derivatives through a scan cost far more on a CPU; one loop compiles the function once.
    """
    d = z.shape[0]
    steps = (axes * width).T
    values, gradients = jax.lax.map(slope, z + jnp.concatenate([jnp.zeros((1, d)), steps, -steps]))
    along = 0.5 * (gradients[1 : d + 1] - gradients[d + 1 :]) @ axes * width
    back = axes / width
    return values[0], jnp.stack([gradients[0], gradients[1:].mean(axis=0)]), back @ (0.5 * (along + along.T)) @ back.T


class _Climb(NamedTuple):
    """A maximization between two evaluations: the next one is at z + step, by differences of `width` along `axes`."""

    z: Array
    step: Array
    value: Array
    hessian: Array
    axes: Array
    width: Array
    phase: Array
    count: Array
    near: Array


def maximize(
    function: Callable[[Array], Array],
    z: Float[Array, " d"],
    slope: Callable[[Array], tuple[Array, Array]] | None = None,
    steps: int = 60,
) -> Optimum:
    """Maximize by Newton steps on the absolute curvature, with halving: it leaves saddle points, and the value never decreases.

    `slope` gives value and gradient of z; by default a forward pass through the function.
    """
    slope = slope or forward(function)

    def search(z: Array, value: Array, step: Array) -> Array:
        """The longest of step, step / 2, ... that climbs; zero where none does."""

        def worse(carry: tuple[Array, Array, Array]) -> Array:
            _, new, k = carry
            return ~(new > value) & (k < 30)

        def halve(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            t, _, k = carry
            return 0.5 * t, function(z + 0.5 * t * step), k + 1

        start = (jnp.asarray(2.0), jnp.asarray(-jnp.inf), jnp.asarray(0))
        t, new, _ = jax.lax.while_loop(worse, halve, start)
        return jnp.where(new > value, t, 0.0) * step

    def unfinished(last: _Climb) -> Array:
        return (last.phase < _DONE) & (last.count < steps)

    def once(last: _Climb) -> _Climb:
        z, polishing = last.z + last.step, last.phase == _POLISHING
        value, gradients, hessian = second_order(slope, z, last.axes, last.width)
        # Differences half as wide and Richardson's extrapolation: in a bent valley the wide ones reach its walls.
        hessian = jnp.where(polishing, (4 * hessian - last.hessian) / 3, hessian)
        size, axes = jnp.linalg.eigh(jnp.where(jnp.isfinite(hessian), hessian, 0.0))
        size = jnp.maximum(jnp.abs(size), 1e-8 * jnp.max(jnp.abs(size)) + 1e-12)
        along = jnp.where(jnp.isfinite(gradients), gradients, 0.0) @ axes
        step = axes @ (along[0] / size)
        step = step * jnp.minimum(1.0, LONGEST / jnp.maximum(jnp.max(jnp.abs(step)), 1e-30))
        gain = jnp.sum(along**2 / size, axis=1)
        small = ((gain[0] < 1e-7) & (last.count > 0)) | polishing
        step = jax.lax.cond(small, lambda: jnp.zeros_like(z), lambda: search(z, value, step))
        there = small | ~jnp.any(step != 0)
        axes = jnp.where(there, last.axes, axes)
        width = jnp.where(there, 0.5 * last.width, jnp.clip(_PART / jnp.sqrt(size), 1e-7, _FARTHEST))
        phase = jnp.where(polishing, _DONE, jnp.where(there, _POLISHING, _CLIMBING))
        return _Climb(z, step, value, hessian, axes, width, phase, last.count + 1, jnp.min(gain) < 1e-2)

    d = z.shape[0]
    start = _Climb(
        z=z,
        step=jnp.zeros(d),
        value=jnp.asarray(-jnp.inf),
        hessian=jnp.zeros((d, d)),
        axes=jnp.eye(d),
        width=jnp.full(d, 1e-4),  # in z, before any curvature is known
        phase=jnp.asarray(_CLIMBING),
        count=jnp.asarray(0),
        near=jnp.zeros((), bool),
    )
    end = jax.lax.while_loop(unfinished, once, start)
    finite = jnp.isfinite(end.value) & jnp.all(jnp.isfinite(end.hessian))
    return Optimum(end.z, end.value, end.hessian, end.near & finite)
