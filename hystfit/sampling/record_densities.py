"""Log densities of single records at posterior draws, also with the offset of the record integrated out."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.inference.density import Density
from hystfit.inference.noise.registry import NOISES
from hystfit.sampling.posterior import Posterior
from hystfit.sampling.predictive import residual_at


def record_densities(posterior: Posterior, draws: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Log densities of every record, shapes (draws, R): at the draws, and with the offsets of the record integrated out.

    None where the noise has shapes that all records share.
    """
    noise = NOISES.make(posterior.noise)
    if noise.has_shapes:
        return None
    problem = posterior.result.problem.with_loss("linear").with_noise(noise)
    own, center, sd = _offsets(posterior)
    prior = (jnp.asarray(own), jnp.asarray(center), jnp.asarray(sd))
    if problem.closed_form:
        density, about = problem.density, (*problem.linearize(posterior.result.x), posterior.result.x)
    else:
        density, about = problem.trimmed().density, None
    rows = _densities(density, jnp.asarray(draws), prior, about)
    return np.asarray(rows[0]), np.asarray(rows[1])


def _offsets(posterior: Posterior) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which parameter is the offset of each record, shape (R, p), bool, and mean and standard deviation of its normal prior, (R,)."""
    space = posterior.result.problem.space
    own = np.zeros((len(posterior.result.data), len(space)), dtype=bool)
    for k, (*_, record) in enumerate(space.sources):
        if record is not None and space.offsets[k] and not own[record].any():
            own[record, k] = True
    quartiles = np.array(
        [posterior.prior_quartiles[space.names[row.argmax()]] if row.any() else [-1, 1] for row in own]
    )
    return own, quartiles.mean(axis=1), np.diff(quartiles, axis=1)[:, 0] / 1.349


@eqx.filter_jit
def _densities(density: Density, draws: Array, prior: Any, about: Any) -> tuple[Array, Array]:
    """Of every record at each draw; `about` as for `residual_at`."""
    direction = prior[0].any(axis=0).astype(draws.dtype)

    def one(x: Array) -> tuple[Array, Array]:
        if about is None:
            residual, column = density.objective.linearize(x[: density.p], direction[None])
        else:
            residual, column = residual_at(density, x, about), (about[1] @ direction)[..., None]
        return _of_records(density, x, residual, column, *prior)

    return jax.lax.map(one, draws)


def _of_records(
    density: Density,
    x: Array,
    residual: Float[Array, "R T"],
    column: Float[Array, "R T 1"],
    own: Array,
    center: Float[Array, " R"],
    sd: Float[Array, " R"],
) -> tuple[Float[Array, " R"], Float[Array, " R"]]:
    """Log densities of records at one draw, and those with the offset integrated out.

    By p(y) = p(y | offset) p(offset) / p(offset | y), whose last density is normal under Gaussian noise.
    """
    noise, setting = density.noise.assemble(x[density.p :]), density.setting
    e, logs = noise.whiten(setting, jnp.concatenate([-residual[..., None], column], axis=-1))
    on = setting.weight > 0
    plain = jnp.sum(jnp.where(on, noise.density(e[..., 0], logs), 0.0), axis=1)
    if not noise.gaussian:
        return plain, plain
    precision = jnp.sum(e[..., 1] ** 2, axis=1) + sd**-2
    offset = own.astype(x.dtype) @ x[: density.p] - center
    shift = (jnp.sum(e[..., 0] * e[..., 1], axis=1) - offset * sd**-2) / precision
    prior = -0.5 * (offset / sd) ** 2 - jnp.log(sd)
    posterior = -0.5 * precision * shift**2 + 0.5 * jnp.log(precision)
    return plain, jnp.where(own.any(axis=1), plain + prior - posterior, plain)
