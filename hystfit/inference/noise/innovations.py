"""Noise of a further measurement in innovations form: the filter of a noise model driven by resampled innovations.

The innovations of a Gaussian noise model, scaled to unit variance, are independent standard normal numbers only if the noise is
Gaussian. Where it has spikes, their distribution has a narrow middle and heavy tails, and Gaussian noise of the same variance gives
bands of 90 % that cover 92 to 97 %. Bands from resampled innovations have the form of the noise and keep its size and correlation
(Stoffer and Wall 1991; Davison and Hinkley 1997, chapter 6). The resampled values are smoothed by a normal kernel (Silverman 1986,
sections 3.4 and 6.4), without which few residuals have too short tails.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from hystfit.inference.noise.setting import Setting
from hystfit.models.shapes import Scalar, State


def resample(
    e: Float[Array, " n"], on: Bool[Array, " n"], shape: tuple[int, ...], key: Array
) -> Float[Array, "*shape"]:
    """Independent values with the distribution of the innovations, of mean zero and unit variance: a smoothed bootstrap.

    Args:
        e: innovations, shape (n,).
        on: which count, shape (n,).
        shape: of the values.
        key: of the random numbers.
    """
    count = jnp.sum(on)
    mean = jnp.sum(jnp.where(on, e, 0.0)) / count
    deviation = jnp.where(on, e - mean, 0.0)
    unit = deviation / jnp.maximum(jnp.sqrt(jnp.sum(deviation**2) / count), jnp.finfo(e.dtype).tiny)
    low, high = jnp.nanquantile(jnp.where(on, unit, jnp.nan), jnp.array([0.25, 0.75]))
    width = 0.9 * jnp.minimum(1.0, (high - low) / 1.34) * count**-0.2
    first, second = jax.random.split(key)
    chosen = jax.random.choice(first, unit, shape, p=on / count)
    return (chosen + width * jax.random.normal(second, shape)) / jnp.sqrt(1 + width**2)


def drive(
    step: Callable[[State, Scalar, Scalar, Scalar], tuple[State, Scalar, Scalar]],
    state: State,
    setting: Setting,
    e: Float[Array, "R T"],
) -> Float[Array, "R T"]:
    """The noise whose innovations are given [y], shape (R, T).

    Args:
        step, state: of the noise model's filter, whose innovation is affine in the residual.
        setting: the records; all their weights are positive.
        e: innovations scaled to unit variance, shape (R, T).
    """

    def sample(state: State, at: tuple[Array, ...]) -> tuple[State, Array]:
        e, gap, weight = at
        _, of_zero, log_variance = step(state, jnp.zeros(()), gap, weight)
        r = jnp.exp(0.5 * log_variance) * (e - of_zero)
        return step(state, r, gap, weight)[0], r

    gap = jnp.broadcast_to(setting.gap, setting.weight.shape)
    return jax.vmap(lambda *rows: jax.lax.scan(sample, state, rows)[1])(e, gap, setting.weight)
