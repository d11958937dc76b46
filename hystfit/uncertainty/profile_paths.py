"""The paths along which profile likelihoods are followed, compiled once for all parameters of a fit."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.inference.newton import descend
from hystfit.inference.whitened import Whitened

_STEPS = 24  # points on each side at most
_STRIDE = 0.6  # target rise of the root statistic from point to point
_FAR = 12.0  # distance in z beyond which a side counts as open: a factor of 160 000, or within 6e-6 of a bound
_FITS = 12  # Levenberg-Marquardt steps at each point


@eqx.filter_jit
def follow_all(
    whitened: Whitened, x: Array, moving: Array, at: Array, wider: Array, limit: float
) -> tuple[Float[Array, "sides n"], Float[Array, "sides n"], Array, Float[Array, "sides p"]]:
    """Paths to both sides of each parameter.

    Args:
        whitened: the whitened problem.
        x: where the fit ended, physical, shape (p,).
        moving: parameters that are refitted, shape (p,), bool.
        at: positions of the parameters to profile.
        wider: reported over i.i.d. standard error of each of them.
        limit: of the statistic, where a path ends.

    Returns:
        z along each path, the statistic, whether each point counts, and the optimum; for each parameter first down, then up.
    """
    c = whitened.objective.coordinates
    start = c.unconstrained(x)

    cost, normal = whitened.cost_at, whitened.normal_at
    start, _, _ = descend(cost, normal, start, moving, 50, 1e-10)  # a fit's tolerance is wide beside a profile's
    least, _, matrix = normal(start)
    floor = jnp.where(moving, 0.0, 1.0)
    size = jnp.sqrt(jnp.diag(matrix)) + 1e-12
    scaled = jnp.where(moving[:, None] & moving, matrix / size[:, None] / size, 0.0) + jnp.diag(floor + 1e-10)
    error = jnp.sqrt(jnp.diag(jnp.linalg.inv(scaled))) / size

    def side(task: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        k, sign, wider = task
        others = moving & (jnp.arange(start.shape[0]) != k)
        first = jnp.clip(_STRIDE * wider * error[k], 1e-6, 1.0)

        def walk(carry: tuple[Array, ...], _: None) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
            z, step, before, done = carry
            ahead = z.at[k].add(sign * step)
            refit, value, _ = jax.lax.cond(
                done,
                lambda a: (a, least, jnp.ones((), bool)),
                lambda a: descend(cost, normal, a, others, _FITS, 1e-4),
                ahead,
            )
            root = jnp.sqrt(jnp.maximum(2 * (value - least), 0.0)) / wider
            rise = jnp.maximum(root - before, 1e-3)
            change = jnp.clip(_STRIDE / rise, 0.4, 3.0)
            kept = jnp.where(done, z, refit)
            over = (root**2 > 1.3 * limit) | (jnp.abs(refit[k] - start[k]) > _FAR)
            out = (refit[k], root**2, ~done)
            return (kept, jnp.minimum(step * change, 2.0), jnp.where(done, before, root), done | over), out

        begin = (start, first, jnp.zeros(()), jnp.zeros((), bool))
        z, statistic, counts = jax.lax.scan(walk, begin, None, length=_STEPS)[1]
        return z, statistic, counts

    tasks = (jnp.repeat(at, 2), jnp.tile(jnp.asarray([-1.0, 1.0]), at.shape[0]), jnp.repeat(wider, 2))
    z, statistic, counts = jax.lax.map(side, tasks)
    return z, statistic, counts, jnp.broadcast_to(start, (2 * at.shape[0], start.shape[0]))


def crossing(z0: float, z: np.ndarray, statistic: np.ndarray, limit: float) -> float | None:
    """Where the root of the statistic crosses the limit, by linear interpolation; None where it does not."""
    root, z = np.sqrt(np.concatenate([[0.0], statistic])), np.concatenate([[z0], z])
    above = np.flatnonzero(root > np.sqrt(limit))
    if not above.size:
        return None
    j = int(above[0])
    part = (np.sqrt(limit) - root[j - 1]) / (root[j] - root[j - 1])
    return float(z[j - 1] + part * (z[j] - z[j - 1]))
